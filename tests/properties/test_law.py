"""What the servo law keeps for every input, gain and speed path."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID, Notch, notch_coefficients
from hil.control.servo import Servo, ServoConfig

relaxed = settings(max_examples=100)  # the first call compiles

periods = st.sampled_from([250e-6, 500e-6, 1e-3, 2e-3])
dampings = st.floats(1e-3, 2.0)


@st.composite
def notches(draw):
    start = draw(st.floats(0.5, 20.0))
    return Notch(
        mode=draw(st.sampled_from([NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID])),
        order=draw(st.integers(1, 8)),
        start_rps=start,
        end_rps=start + draw(st.floats(0.1, 30.0)),
        offset_hz=draw(st.floats(0.0, 5.0)),
        zeta_rn=draw(dampings),
        zeta_rdth=draw(dampings),
        hysteresis_rps=draw(st.floats(0.0, 0.4)),
        speed_lowpass_hz=draw(st.floats(5.0, 500.0)),
        ramp_rps=draw(st.floats(0.1, 5.0)),
    )


cascades = st.builds(Cascade, st.floats(0.0, 1e3), st.floats(0.0, 1e2), st.floats(0.0, 1e4), st.floats(0.1, 1e4))


@pytest.mark.ci
@relaxed
@given(st.floats(0.1, 400.0), st.floats(0.0, 50.0), dampings, dampings, periods)
def test_every_frozen_filter_is_stable_with_its_zeros_inside_and_passes_dc_as_it_is(zero, offset, rn, rd, period):
    b0, b1, b2, a1, a2 = notch_coefficients(zero, zero + offset, rn, rd, period)
    for name, polynomial in (("poles", [1.0, a1, a2]), ("zeros", [b0, b1, b2])):
        # Jury's conditions: exact where np.roots loses the digits of a double root near 1
        c0, c1, c2 = (value / polynomial[0] for value in polynomial)
        assert c2 < 1.0, name
        assert 1.0 + c1 + c2 > 0.0, name
        assert c0 - c1 + c2 > 0.0, name
    assert abs((b0 + b1 + b2) / (1.0 + a1 + a2) - 1.0) < 1e-4


@relaxed
@given(st.floats(0.5, 400.0), st.floats(0.0, 50.0), dampings, dampings, periods)
def test_every_filter_is_scipys_bilinear_transform_of_eq_6(zero, offset, rn, rd, period):
    wn, wd = 2.0 * math.pi * zero, 2.0 * math.pi * (zero + offset)
    gain = (wd / wn) ** 2
    b, a = signal.bilinear([gain, gain * 2.0 * rn * wn, gain * wn**2], [1.0, 2.0 * rd * wd, wd**2], fs=1.0 / period)
    got = notch_coefficients(zero, zero + offset, rn, rd, period)
    np.testing.assert_allclose(got, [*b, *a[1:]], rtol=1e-9, atol=1e-12)


@relaxed
@given(
    cascades,
    st.lists(notches(), max_size=2),
    st.floats(1e-3, 1e3),
    periods,
    st.lists(
        st.tuples(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
        min_size=1,
        max_size=60,
    ),
)
def test_the_torque_is_finite_and_never_exceeds_the_limit_whatever_comes_in(cascade, filters, limit, period, samples):
    servo = Servo(ServoConfig(cascade, limit, tuple(filters)), period)
    for position, angle, velocity_offset, torque_offset in samples:
        torque = servo.step(position, angle, velocity_offset, torque_offset)
        assert math.isfinite(torque)
        assert abs(torque) <= limit


@relaxed
@given(
    st.lists(notches(), min_size=1, max_size=2),
    st.lists(st.tuples(st.floats(-60.0, 60.0), st.integers(1, 120)), min_size=1, max_size=8),
    st.integers(0, 2**32 - 1),
)
def test_any_speed_path_gives_finite_torque_within_the_limit(filters, path, seed):
    """Steps of the speed between −60 and 60 rps, through zero and in and out of every range, with a noisy encoder."""
    period, limit = 250e-6, 7.1
    servo = Servo(ServoConfig(Cascade(25.0, 0.196, 3.92), limit, tuple(filters)), period)
    servo.start(0.0)
    noise = np.random.default_rng(seed)
    angle = 0.0
    for speed_rps, count in path:
        for draw in noise.standard_normal(count):
            angle += 2.0 * math.pi * speed_rps * period
            shown = angle + 1e-4 * float(draw)
            torque = servo.step(angle + 0.1, shown)
            assert math.isfinite(torque)
            assert abs(torque) <= limit
    assert np.all(np.isfinite([servo.notch_state[name] for name in servo.notch_state.dtype.names]))


@relaxed
@given(st.lists(notches(), max_size=2), st.floats(-30.0, 30.0), st.floats(-5.0, 5.0), st.floats(-100.0, 100.0))
def test_taking_over_at_any_speed_and_torque_is_without_a_bump(filters, speed_rps, torque, angle):
    servo = Servo(ServoConfig(Cascade(25.0, 0.196, 3.92), 7.1, tuple(filters)), 250e-6)
    speed = 2.0 * math.pi * speed_rps
    servo.start(angle, speed, torque)
    for i in range(1, 20):
        now = angle + speed * 250e-6 * i
        assert abs(servo.step(now + speed / 25.0, now) - torque) < 1e-6


@relaxed
@given(notches(), st.floats(0.0, 60.0), st.floats(-3.0, 3.0))
def test_the_mirrored_motion_gives_the_mirrored_torque(notch, speed_rps, torque):
    speed = 2.0 * math.pi * speed_rps
    config = ServoConfig(Cascade(25.0, 0.196, 3.92), 7.1, (notch,))
    forward, backward = Servo(config, 250e-6), Servo(config, 250e-6)
    forward.start(0.0, speed, torque)
    backward.start(0.0, -speed, -torque)
    for i in range(1, 50):
        angle = speed * 250e-6 * i
        position = angle + math.sin(0.3 * i)
        assert forward.step(position, angle) == -backward.step(-position, -angle)
