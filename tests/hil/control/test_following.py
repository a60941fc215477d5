"""The law of a cancellation that follows, on a tip made by its own equations: what it finds, and where it keeps still."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.control.following import Followed, FollowingLaw, FollowingSettings, SecondDifference
from hil.design.following import Resonance, arm_model, band_pass, resonance_of, rounding_noise_m_s2

PERIOD, RATIO, LEVER, F_AL = 0.002, 100.0, 1.0, 10.0
OMEGA = 2.0 * math.pi * F_AL
ARM = Resonance(OMEGA**2, 0.1 * OMEGA, 0.1 * OMEGA, OMEGA**2, F_AL)
ORDER = Followed(2, 0.7, 5.0 * math.pi / 648000.0)
SECONDS, STEP_S = 9.0, 4.0


def made(turn_deg, *, noise_m_s2=0.02, speed_rps=5.0, misses=(0.0, 0.0), arm=ARM, settings=None, orders=(ORDER,)):
    """Factors over the time where the error turns at `STEP_S`; the tip answers to what the factors leave."""
    law = FollowingLaw(
        [arm_model(arm, RATIO, PERIOD)], [orders], band_pass(F_AL, F_AL, PERIOD), PERIOD, settings or FollowingSettings()
    )
    random, true, fine = np.random.default_rng(1), ARM, 8
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    speed = 2.0 * math.pi * speed_rps * np.clip((time - 1.0) / 1.0, 0.0, 1.0)
    angle = np.cumsum(speed) * PERIOD
    x = v = acceleration = 0.0
    factors = []
    for i, now in enumerate(time):
        heard = acceleration + noise_m_s2 * random.standard_normal()
        law.step([angle[i]], [angle[i]], [LEVER], None if misses[0] <= now < misses[1] else heard)
        factors.append(law.factors(0)[2])
        error = np.exp(1j * math.radians(turn_deg if now >= STEP_S else 0.0)) - factors[-1]
        for part in range(fine):
            turned = 2.0 * (angle[i] + speed[i] * part * PERIOD / fine) + ORDER.phase_rad
            drive = -((2.0 * speed[i]) ** 2) * ORDER.amplitude_rad * (error * np.exp(1j * turned)).real
            v += PERIOD / fine * (drive - true.a1 * v - true.a0 * x)
            x += PERIOD / fine * v
        acceleration = LEVER * (true.b0 * x + true.b1 * v)
    return time, np.array(factors), law


def test_a_phase_step_is_followed_within_five_revolutions():
    time, factors, law = made(30.0)
    before, after = factors[time < STEP_S], factors[time > STEP_S + 5.0 / 5.0]
    assert np.all(before == 1.0)
    assert np.all(np.abs(after - np.exp(1j * math.radians(30.0))) < 0.05)
    assert law.given_up(0) == ()


def test_nothing_is_changed_where_the_cancellation_is_right():
    for noise in (0.0, 0.02, 0.2):
        assert np.all(made(0.0, noise_m_s2=noise)[1] == 1.0)


def test_an_error_beyond_the_bounds_is_taken_back_to_what_was_identified():
    _, factors, law = made(120.0)
    assert np.max(np.abs(np.angle(factors))) <= math.radians(60.0) + 1e-9
    assert law.given_up(0) == (2,)
    assert abs(factors[-1] - 1.0) < 0.05


def test_the_amplitude_never_leaves_its_bounds():
    tight = FollowingSettings(least_gain=0.95, most_gain=1.05, most_angle_rad=math.radians(10.0))
    factors = made(30.0, settings=tight)[1]
    assert np.min(np.abs(factors)) >= 0.95 - 1e-9
    assert np.max(np.abs(factors)) <= 1.05 + 1e-9
    assert np.max(np.abs(np.angle(factors))) <= math.radians(10.0) + 1e-9


@pytest.mark.parametrize("speed_rps", [1.0, 12.0])
def test_it_is_frozen_at_speeds_at_which_the_order_does_not_show(speed_rps):
    assert np.all(made(30.0, speed_rps=speed_rps)[1] == 1.0)


def test_it_is_frozen_in_noise_that_hides_the_order():
    assert np.all(made(30.0, noise_m_s2=20.0)[1] == 1.0)


def test_it_is_frozen_while_the_sensor_is_silent():
    time, factors, _ = made(30.0, misses=(STEP_S, STEP_S + 2.0))
    assert np.all(factors[(time >= STEP_S) & (time < STEP_S + 2.0)] == 1.0)


def test_a_resonance_that_is_five_percent_off_is_followed_all_the_same():
    off = Resonance(1.05**2 * ARM.b0, ARM.b1, ARM.a1, 1.05**2 * ARM.a0, 1.05 * F_AL)
    time, factors, _ = made(30.0, arm=off)
    assert np.all(np.abs(factors[time > STEP_S + 3.0] - np.exp(1j * math.radians(30.0))) < 0.15)


def test_what_has_to_leave_more_keeps_still_and_says_how_near_it_came():
    own = [ORDER._replace(begin_part=0.7)]
    _, factors, law = made(30.0, orders=own)
    assert np.all(factors == 1.0)
    assert law.nearest(0)[2] == pytest.approx(2.0 * math.sin(math.radians(15.0)), rel=0.15)
    assert np.all(made(0.0, orders=own)[2].nearest(0)[2] < 0.06)


def test_an_encoder_tells_the_tip_s_acceleration_a_period_late_and_begins_anew_after_a_gap():
    time = np.arange(200) * PERIOD
    angle, told = 1e-4 * np.cos(OMEGA * time), SecondDifference(LEVER, F_AL, PERIOD)
    heard = [told(None if i == 100 else float(each)) for i, each in enumerate(angle)]
    assert [i for i, each in enumerate(heard) if each is None] == [0, 1, 100, 101, 102]
    exact = -LEVER * OMEGA**2 * angle
    assert all(abs(each - exact[i - 1]) < 1e-6 * LEVER * OMEGA**2 for i, each in enumerate(heard) if each is not None)


def test_the_noise_of_counts_is_what_the_band_lets_through():
    band, random, q = band_pass(F_AL, F_AL, PERIOD), np.random.default_rng(3), 2.0 * math.pi / 2**20
    rounded = q * (random.random(40000) - 0.5)
    second = LEVER * np.diff(rounded, 2) / PERIOD**2
    section = np.array([*band[:3], 1.0, *band[3:]])
    heard = signal.sosfilt(np.stack([section, section]), second)[500:]
    assert np.std(heard) == pytest.approx(rounding_noise_m_s2(q, LEVER, band, PERIOD), rel=0.05)


def test_there_is_something_to_follow():
    with pytest.raises(ValueError, match="expected one set of at least 1 order for each arm"):
        FollowingLaw([], [], band_pass(F_AL, F_AL, PERIOD), PERIOD)


def test_the_arm_is_found_as_one_resonance():
    found = resonance_of(ARM.at, F_AL)
    assert (found.b0, found.b1, found.a1, found.a0) == pytest.approx((ARM.b0, ARM.b1, ARM.a1, ARM.a0), rel=1e-6)
    assert found.ring_down_s == pytest.approx(2.0 / ARM.a1)
    with pytest.raises(ValueError, match="no resonance that rings down"):
        resonance_of(Resonance(ARM.b0, ARM.b1, -ARM.a1, ARM.a0, F_AL).at, F_AL)
