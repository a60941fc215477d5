"""Transmission error, arm and delay found again in ramps that another integrator made, of a plant about which nothing is told."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import signal

from hil.control.angles import ARCSEC
from hil.design.ate.identification import Agreement, identify, searched
from hil.design.ate.model import Arm, RampsModel, Sensing, Sweep, modelled
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.identify import delay_of

FINE = 1e-4
RATIO, LEVER = 120.0, 0.7
OMEGA, ZETA, SHARE = 2.0 * math.pi * 12.45, 0.038, 0.9
TRUTH = TransmissionError({2: 5.0, 4: 3.0}, {2: 222.0, 4: 126.0})


def motor_angle() -> tuple[np.ndarray, np.ndarray]:
    """Rest, 4 rps/s up to 9 rps, 20 rps/s down, rest, and back; with its directions, every 0.1 ms."""
    pieces = [(0.3, 0.0, 0), (2.25, 4.0, 1), (0.45, -20.0, 0), (0.6, 0.0, 0), (2.25, -4.0, -1), (0.45, 20.0, 0), (0.5, 0.0, 0)]
    counts = [round(duration / FINE) for duration, _, _ in pieces]
    rate = np.concatenate([np.full(n, a) for n, (_, a, _) in zip(counts, pieces, strict=True)])
    direction = np.concatenate([np.full(n, d, dtype=np.int8) for n, (_, _, d) in zip(counts, pieces, strict=True)])
    # a motor is never exactly where it is told to be
    soft = signal.lfilter(*signal.butter(2, 40.0, fs=1.0 / FINE), rate)
    return 2.0 * math.pi * np.cumsum(np.cumsum(soft) * FINE) * FINE, direction


ANGLE, DIRECTION = motor_angle()


def arm_acceleration(angle: np.ndarray, error: TransmissionError, zeta: float = ZETA, motion: float = 1.0) -> np.ndarray:
    """θ̈_l by integrating H s² as a state space; `motion` is the part of the motor's own motion that it has."""
    through = [2.0 * SHARE * zeta * OMEGA, OMEGA**2]
    driven = motion * angle / RATIO + error.angle_rad(angle)
    a, b, c, d = signal.tf2ss(through, [1.0, 2.0 * zeta * OMEGA, OMEGA**2])
    start = -np.linalg.solve(a, b[:, 0] * driven[0])
    swing = signal.lsim((a, b, c, d), driven, np.arange(len(driven)) * FINE, X0=start)[1]
    return np.gradient(np.gradient(swing, FINE), FINE)


@cache
def true_arm() -> np.ndarray:
    """The same for the true error, once."""
    return arm_acceleration(ANGLE, TRUTH)


def sweep(period_s: float = 0.002, delay_s: float = 0.0, noise: float = 0.05, seed: int = 1, scale: float = LEVER) -> Sweep:
    step, late = round(period_s / FINE), round(delay_s / FINE)
    tip = scale * np.concatenate([np.zeros(late), true_arm()])[: len(ANGLE)][::step]
    tip = np.round((tip + np.random.default_rng(seed).normal(0.0, noise, len(tip))) / 0.01) * 0.01
    count = 2.0 * math.pi / 131072
    return Sweep(np.round(ANGLE[::step] / count) * count, tip, period_s, DIRECTION[::step])


def apart(first_deg: float, second_deg: float) -> float:
    return abs((first_deg - second_deg + 180.0) % 360.0 - 180.0)


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [0.001, 0.002])
@pytest.mark.parametrize("delay_s", [0.0037, 0.015])
def test_everything_comes_back_with_nothing_known(period_s: float, delay_s: float) -> None:
    found = identify([sweep(period_s, delay_s)], RATIO, Sensing(LEVER))
    for order, amplitude, phase in ((2, 0.03, 2.0), (4, 0.045, 3.0)):  # one pass of 4 rps/s; several reach 2 and 3 %
        assert found.error.amplitude_arcsec[order] == pytest.approx(TRUTH.amplitude_arcsec[order], rel=amplitude)
        assert apart(found.error.phase_deg[order], TRUTH.phase_deg[order]) < phase
    assert found.arm.delay_s == pytest.approx(delay_s, abs=3e-4)
    assert found.arm.resonance_hz == pytest.approx(OMEGA / (2.0 * math.pi), rel=0.003)
    assert found.motion_scale == pytest.approx(1.0, abs=0.15)
    assert found.explained_by_error > 0.99


@pytest.mark.ci
def test_the_search_keeps_within_the_delays_that_are_known_of_the_sensor() -> None:
    data = [sweep(delay_s=0.045)]  # 40 ms, half a period, from a delay that is as likely
    turned = identify(data, RATIO, Sensing(LEVER))
    found = identify(data, RATIO, Sensing(LEVER, 0.0, 0.03, 0.06))
    assert apart(turned.error.phase_deg[2], TRUTH.phase_deg[2]) > 170.0, "the case that is to be told apart"
    assert apart(found.error.phase_deg[2], TRUTH.phase_deg[2]) < 2.0
    assert found.arm.delay_s == pytest.approx(0.045, abs=3e-4)


@pytest.mark.ci
def test_a_wrong_start_and_a_right_one_lead_to_the_same() -> None:
    data = [sweep(delay_s=0.0037)]
    free = identify(data, RATIO, Sensing(LEVER))
    for start in (Arm(9.0, 0.2), Arm(12.3, 0.05)):
        led = identify(data, RATIO, Sensing(LEVER), start)
        assert led.error.amplitude_arcsec[2] == pytest.approx(free.error.amplitude_arcsec[2], rel=1e-4)
        assert led.arm.delay_s == pytest.approx(free.arm.delay_s, abs=1e-6)


def test_a_share_of_damping_that_is_believed_wrongly_goes_into_the_delay_alone() -> None:
    data = [sweep()]
    right, wrong = (identify(data, RATIO, Sensing(LEVER), Arm(12.4, 0.04, gear_fraction=fraction)) for fraction in (0.9, 0.5))
    assert wrong.arm.delay_s - right.arm.delay_s == pytest.approx(-2.0 * 0.4 * ZETA / OMEGA, abs=1e-4)
    assert apart(wrong.error.phase_deg[2], right.error.phase_deg[2]) < 0.1
    assert wrong.error.amplitude_arcsec[2] == pytest.approx(right.error.amplitude_arcsec[2], rel=0.01)
    # and the delay's standard error says so, where the share is told with its own: noise alone would be 40 of them off
    assert abs(wrong.arm.delay_s) < 3.0 * delay_of(wrong, 0.29).standard_error
    assert abs(wrong.arm.delay_s) > 3.0 * delay_of(wrong, 0.0).standard_error


def test_a_delay_with_a_damping_beyond_the_plants_is_open_by_the_lead_that_is_no_lead() -> None:
    """A gear that is no spring blurs its resonance; taken for its lead, that made a sensor late by ten standard errors."""
    clear = identify([sweep(delay_s=0.004)], RATIO, Sensing(LEVER))
    zeta, lead_s = clear.arm.damping, 2.0 * SHARE * clear.arm.damping / OMEGA
    blurred = replace(clear, arm=replace(clear.arm, damping=2.0 * zeta, delay_s=0.004 + lead_s))
    before, after = delay_of(blurred, 0.01), delay_of(blurred, 0.01, zeta)
    assert abs(before.value - 0.004) > 10.0 * before.standard_error
    assert abs(after.value - 0.004) < 2.0 * after.standard_error
    assert delay_of(clear, 0.01, zeta) == delay_of(clear, 0.01)


@pytest.mark.slow
def test_a_small_vibration_that_rings_otherwise_than_a_large_one_is_within_its_error() -> None:
    """On a gear whose small vibrations ring with more damping than its large ones."""
    large, small = TransmissionError({2: 40.0}, {2: 222.0}), TransmissionError({3: 3.0, 4: 10.0}, {3: 50.0, 4: 126.0})
    tip = arm_acceleration(ANGLE, large) + arm_acceleration(ANGLE, small, 1.5 * ZETA, motion=0.0)
    rows = slice(None, None, 20)
    noisy = LEVER * tip[rows] + np.random.default_rng(1).normal(0.0, 0.01, len(ANGLE[rows]))
    found = identify([Sweep(ANGLE[rows], noisy, 0.002, DIRECTION[rows])], RATIO, Sensing(LEVER), orders=(2, 3, 4))
    for order, size in ((3, 3.0), (4, 10.0)):
        off = abs(found.error.amplitude_arcsec[order] - size)
        assert off < 3.0 * found.amplitude_error_arcsec[order]


@pytest.mark.slow
def test_the_standard_errors_are_those_of_the_noise() -> None:
    found = [identify([sweep(seed=seed)], RATIO, Sensing(LEVER), Arm(12.4, 0.04)) for seed in range(12)]
    for order in (2, 4):
        amplitude = np.std([each.error.amplitude_arcsec[order] for each in found])
        phase = np.std([each.error.phase_deg[order] for each in found])
        assert 0.5 < np.mean([each.amplitude_error_arcsec[order] for each in found]) / amplitude < 2.0
        assert 0.5 < np.mean([each.phase_error_deg[order] for each in found]) / phase < 2.0
    delay = np.std([each.arm.delay_s for each in found])
    assert 0.5 < np.mean([each.arm_error.delay_s for each in found]) / delay < 2.0


def test_a_clear_recording_of_a_spring_tells_its_phase_as_exactly_as_it_knows_it() -> None:
    """A floor of a tenth of a degree made every phase of a linear gear twice as uncertain as it was."""
    found = identify([sweep(noise=0.01)], RATIO, Sensing(LEVER), Arm(12.4, 0.04))
    assert found.phase_error_deg[2] < 0.09
    assert apart(found.error.phase_deg[2], TRUTH.phase_deg[2]) < 3.0 * found.phase_error_deg[2]


@pytest.mark.ci
def test_two_passes_know_more_than_one() -> None:
    one = identify([sweep(seed=1)], RATIO, Sensing(LEVER))
    two = identify([sweep(seed=1), sweep(seed=2)], RATIO, Sensing(LEVER))
    assert two.amplitude_error_arcsec[2] < 0.85 * one.amplitude_error_arcsec[2]


def test_a_pass_counts_by_what_it_leaves() -> None:
    quiet, more = sweep(noise=0.005, seed=2), sweep(noise=0.005, seed=3)
    # a gear that is no spring: the arm rings otherwise than the model of one has it
    bent = replace(quiet, signal=LEVER * arm_acceleration(ANGLE, TRUTH, zeta=2.0 * ZETA)[:: round(quiet.period_s / FINE)])
    arm, band = Arm(OMEGA / 2.0 / math.pi, ZETA, 0.0, SHARE), (6.2, 26.0)
    assert RampsModel([quiet, quiet], RATIO, Sensing(LEVER), (2, 4), band).weights(arm) == pytest.approx((1.0, 1.0))
    alike = RampsModel([bent, quiet, more], RATIO, Sensing(LEVER), (2, 4), band)
    weights = alike.weights(arm)
    assert weights[1] > 2.0 * weights[0]
    assert float(np.mean(np.square(weights))) == pytest.approx(1.0)
    weighted = RampsModel([bent, quiet, more], RATIO, Sensing(LEVER), (2, 4), band, weights=weights)
    off = [abs(math.hypot(*each.solve(arm)[0][:2]) / ARCSEC / 5.0 - 1.0) for each in (alike, weighted)]
    assert off[1] < 0.3 * off[0]


def test_orders_that_are_searched_together_lead_each_to_the_arm_that_they_do_alone() -> None:
    given, choices = ([sweep()], RATIO, Sensing(LEVER)), [(2, 4), (2, 4, 3), (2, 4, 5)]
    assert searched(*given, choices) == [searched(*given, [choice])[0] for choice in choices]


@pytest.mark.parametrize("band", [(6.0, 25.2), (3.0, 12.6)], ids=["as long", "longer"])
def test_a_model_like_another_is_the_one_that_is_made_anew(band: tuple[float, float]) -> None:
    given, arm = ([sweep()], RATIO, Sensing(LEVER), (2, 4)), Arm(12.0, ZETA)
    new = RampsModel(*given, band)
    for old, like in zip(
        new.columns(arm), RampsModel(*given, band, like=RampsModel(*given, (6.1, 25.4))).columns(arm), strict=True
    ):
        assert old.tobytes() == like.tobytes()


def test_a_lever_that_is_not_the_arms_shows_in_the_motors_own_motion() -> None:
    found = identify([sweep(scale=0.36)], RATIO, Sensing(LEVER))
    assert found.motion_scale == pytest.approx(0.36 / 0.7, abs=0.1)
    assert abs(found.motion_scale - 1.0) > 5.0 * found.motion_scale_error


def test_standard_errors_contain_what_the_directions_disagree_on() -> None:
    data = sweep(noise=0.01)
    middle = len(ANGLE) // 2 // 20
    bent = data.signal.copy()
    bent[middle:] *= 1.2
    found = identify([replace(data, signal=bent)], RATIO, Sensing(LEVER))
    off = {each.name: each.forward - each.backward for each in found.agreement}
    assert max(each.sigma for each in found.agreement) > 5.0
    assert not found.is_spring
    for order in (2, 4):
        assert found.amplitude_error_arcsec[order] > 0.25 * abs(off[f"a{order}_arcsec"])


def test_a_disagreement_is_told_in_symbols_and_units() -> None:
    assert Agreement("phi2_deg", 199.384, 197.11, 6.0).words == "φ_2 is 199.38° forwards and 197.11° backwards"
    assert Agreement("a1.5_arcsec", 9.8, 9.49, 2.5).words == "A_1.5 is 9.80″ forwards and 9.49″ backwards"


def test_the_motor_torque_serves_as_well() -> None:
    motor, arm = 2.6e-4, 8.0
    own = np.gradient(np.gradient(ANGLE, FINE), FINE)
    torque = (motor * own + arm / RATIO * true_arm())[::20] + 0.1
    count = 2.0 * math.pi / 131072
    noisy = torque + np.random.default_rng(2).normal(0.0, 0.003, len(torque))
    data = Sweep(np.round(ANGLE[::20] / count) * count, noisy, 0.002, DIRECTION[::20])
    found = identify([data], RATIO, Sensing(arm / RATIO, motor))
    assert found.error.amplitude_arcsec[2] == pytest.approx(5.0, rel=0.03)
    assert apart(found.error.phase_deg[2], 222.0) < 2.0


def test_the_model_replays_what_was_measured() -> None:
    played = modelled(sweep(), RATIO, Sensing(LEVER), Arm(OMEGA / (2.0 * math.pi), ZETA, 0.0, SHARE), TRUTH)
    truth = LEVER * true_arm()[::20]
    assert np.sqrt(np.mean((played - truth)[300:-300] ** 2)) < 0.03 * np.std(truth)


def test_what_cannot_be_fitted_is_refused() -> None:
    data = sweep()
    with pytest.raises(ValueError, match="shapes"):
        identify([replace(data, signal=data.signal[:-1])], RATIO, Sensing(LEVER))
    forwards = np.where(data.direction > 0, data.direction, 0).astype(np.int8)
    with pytest.raises(ValueError, match=r"0\.00 s of ramps backwards are too short for 7 values"):
        identify([replace(data, direction=forwards)], RATIO, Sensing(LEVER))
