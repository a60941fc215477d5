"""The servo law as a whole: notch behind the PI, limit, anti-windup."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.control.cascade import Cascade
from hil.control.notch import NOTCHES, Notch
from hil.control.servo import Servo, ServoConfig

T = 250e-6
AXIS_2 = Cascade(25.0, 0.196, 3.92, 300.0)
INERTIA = 2.6e-4 + 8.0 / 120.0**2  # motor and arm as one, motor side


def test_the_notch_filters_the_torque_command_behind_the_pi():
    """At a constant measured speed the law with a notch is the law without one, sent through scipy's filter."""
    notch = Notch()
    rng = np.random.default_rng(5)
    speed = 2.0 * math.pi * 5.92
    bare, filtered = Servo(ServoConfig(AXIS_2, 1e6), T), Servo(ServoConfig(AXIS_2, 1e6, (notch,)), T)
    for servo in (bare, filtered):
        servo.start(0.0, speed, 0.3)
    count = 4000
    angle = speed * T * np.arange(1, count + 1)
    wiggle = 0.05 * rng.standard_normal(count)
    u, got = np.empty(count), np.empty(count)
    wiggle[0] = 0.0
    for i in range(count):
        position = angle[i] + speed / 25.0 + wiggle[i]
        u[i], got[i] = bare.step(position, angle[i]), filtered.step(position, angle[i])
    zero, pole = 2.0 * math.pi * 2.0 * 5.92, 2.0 * math.pi * (2.0 * 5.92 + 0.5)
    gain = (pole / zero) ** 2
    b, a = signal.bilinear([gain, gain * 2.0 * 0.028 * zero, gain * zero**2], [1.0, 2.0 * 0.1 * pole, pole**2], fs=1.0 / T)
    want, _ = signal.lfilter(b, a, u, zi=0.3 * signal.lfilter_zi(b, a))
    assert filtered.notch_state["active"][0, 0] == 1
    np.testing.assert_allclose(got, want, atol=1e-8)


@pytest.mark.parametrize("torque_nm", [0.8, -0.8])
@pytest.mark.parametrize("speed_rps", [0.0, 5.92, -5.92])
def test_the_law_takes_over_a_moving_loaded_axis_without_a_bump(speed_rps, torque_nm):
    servo = Servo(ServoConfig(AXIS_2, 7.1, (Notch(), Notch(order=4, start_rps=2.2, end_rps=7.0))), T)
    speed = 2.0 * math.pi * speed_rps
    servo.start(50.0, speed, torque_nm)
    for i in range(1, 400):
        angle = 50.0 + speed * T * i
        assert servo.step(angle + speed / 25.0, angle) == pytest.approx(torque_nm, rel=1e-6)
    assert servo.notch_state["active"].any() == (speed_rps != 0.0)


def test_the_torque_offset_is_added_behind_the_notch_and_inside_the_limit():
    speed = 2.0 * math.pi * 6.0
    for offset, want in ((0.25, 0.35), (-0.5, -0.4), (30.0, 2.0), (-30.0, -2.0)):
        servo = Servo(ServoConfig(AXIS_2, 2.0, (Notch(),)), T)
        servo.start(0.0, speed, 0.1)
        torque = servo.step(speed * T + speed / 25.0, speed * T, torque_offset=offset)
        assert torque == pytest.approx(want, rel=1e-9)


def speed_step(limit_nm, speed_rad_s, anti_windup):
    """A step of the reference speed of a rigid motor, position loop open: the largest speed and the last, over the step."""
    velocity_loop = Cascade(0.0, AXIS_2.velocity_gain_nm_s_rad, AXIS_2.velocity_integral_gain_nm_rad)
    servo = Servo(ServoConfig(velocity_loop, limit_nm if anti_windup else 1e12), T)
    servo.start(0.0)
    angle = speed = top = 0.0
    for _ in range(round(1.5 / T)):
        torque = servo.step(0.0, angle, velocity_offset=speed_rad_s)
        torque = min(limit_nm, max(-limit_nm, torque))
        angle += (speed + 0.5 * torque / INERTIA * T) * T
        speed += torque / INERTIA * T
        top = max(top, speed)
    return top / speed_rad_s, speed / speed_rad_s


def test_after_a_long_saturation_the_integrator_recovers_without_overshoot():
    """A quarter of a second at the limit. Without anti-windup the same law overshoots by a third and more."""
    top, end = speed_step(0.2, 60.0, anti_windup=True)
    assert end == pytest.approx(1.0, abs=1e-3)
    assert top < 1.01
    wound_up, _ = speed_step(0.2, 60.0, anti_windup=False)
    assert wound_up > 1.3


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_an_axis_that_was_blocked_lets_go_of_the_limit_as_soon_as_it_is_told_to(direction):
    """Ten seconds against a stop: the integrator holds at most the limit, so the torque turns at once."""
    servo = Servo(ServoConfig(AXIS_2, 0.5), T)
    servo.start(0.0)
    torques = [servo.step(direction * 1.0, 0.0) for _ in range(40_000)]
    assert torques[-1] == direction * 0.5
    torques = [servo.step(-direction * 1.0, 0.0) for _ in range(10)]
    assert direction * torques[0] < 0.0
    assert direction * torques[-1] == -0.5


def test_what_the_law_cannot_run_is_refused():
    with pytest.raises(ValueError, match=f"{NOTCHES + 1} notches"):
        ServoConfig(AXIS_2, 1.0, (Notch(),) * (NOTCHES + 1))
    with pytest.raises(ValueError, match="torque_limit_nm = 0"):
        ServoConfig(AXIS_2, 0.0)
    with pytest.raises(ValueError, match="period_s = 0"):
        Servo(ServoConfig(AXIS_2, 1.0), 0.0)
