"""Verdicts on orders: what is accepted, what is refused, and what cannot be told, from amplitudes with known noise."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge

GAIN = 0.3
PART = Part(2, 4)
THERE = 3.0 * cmath.exp(1j * math.radians(126.0))


def judged(factor: float, turn_deg: float, sigma: float, seed: int | None, *, wholes: int = 1) -> PartVerdict:
    """The verdict on a cancellation that is so many times too large and turned by so much, after some runs with the whole."""
    generator = np.random.default_rng(seed)
    taken = factor * THERE * cmath.exp(1j * math.radians(turn_deg))
    seen = []
    for gain in (0.0, GAIN, *(1.0, 0.0) * wholes):
        noise = 0.0 if seed is None else complex(*(sigma * generator.standard_normal(2)))
        seen.append(Seen(1, gain, THERE - gain * taken + noise, sigma**2))
    return judge(PART, GAIN, seen)


@pytest.mark.parametrize("turn_deg", [-30.0, 0.0, 30.0])
@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_what_is_nearly_right_is_accepted(factor: float, turn_deg: float) -> None:
    for seed in range(50):
        found = next(
            each
            for wholes in (1, 2, 3, 4)
            if (each := judged(factor, turn_deg, 0.1, seed, wholes=wholes)).verdict != "not judged"
        )
        assert found.verdict == "accepted", (seed, found)


@pytest.mark.parametrize(
    ("factor", "turn_deg"),
    [(1.0, 60.0), (1.0, -60.0), (0.7, 60.0), (0.3, 60.0), (1.0, 90.0), (1.0, -90.0), (1.0, 180.0), (0.3, 180.0), (3.0, 0.0)],
)
def test_what_is_wrong_is_never_accepted_however_noisy(factor: float, turn_deg: float) -> None:
    for sigma in (0.01, 0.1, 0.3, 1.0, 3.0):
        verdicts = [judged(factor, turn_deg, sigma, seed).verdict for seed in range(100)]
        # 60° at less than the whole amplitude is 13 % beyond the limit, less than noise of a tenth and more can tell each time
        assert verdicts.count("accepted") <= (0 if sigma <= 0.1 else 2), sigma
        assert sigma > 0.1 or set(verdicts) <= {"refused", "not judged"}


def test_the_fraction_alone_already_refuses_a_wrong_sign() -> None:
    assert judged(1.0, 180.0, 0.1, 1, wholes=0).verdict == "refused"
    assert judged(1.0, 0.0, 0.1, 1, wholes=0).verdict == "accepted"


def test_45_degrees_are_the_boundary() -> None:
    assert judged(1.0, 44.0, 0.001, None).verdict == "accepted"
    assert judged(1.0, 46.0, 0.001, None).verdict == "refused"
    near = judged(1.0, 45.0, 0.1, None)
    assert near.verdict == "not judged"
    assert "not certain to be right: the whole leaves 7" in near.words


@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.3])
def test_a_boundary_case_is_accepted_as_often_as_the_probability_says(sigma: float) -> None:
    verdicts = [judged(1.0, 45.0, sigma, seed).verdict for seed in range(2000)]
    assert verdicts.count("accepted") / 2000 < 0.035
    assert verdicts.count("refused") / 2000 < 0.035


def judged_together(turn_deg: float, sigmas: dict[int, float], seed: int) -> PartVerdict:
    """The verdict of runs in several directions, each with noise of its own."""
    generator = np.random.default_rng(seed)
    taken = THERE * cmath.exp(1j * math.radians(turn_deg))
    noise = {way: sigma * (generator.standard_normal(4) + 1j * generator.standard_normal(4)) for way, sigma in sigmas.items()}
    gains = (0.0, 1.0, 0.0, 1.0)
    seen = [
        Seen(way, gain, THERE - gain * taken + noise[way][i], sigma**2)
        for way, sigma in sigmas.items()
        for i, gain in enumerate(gains)
    ]
    return judge(PART, 1.0, seen)


def test_a_motion_that_hides_a_part_takes_nothing_from_what_ramps_tell_and_one_that_shows_it_adds_to_it() -> None:
    ramps = {1: 0.8, -1: 0.8}
    counts = {
        name: sum(judged_together(0.0, sigmas, seed).verdict == "accepted" for seed in range(300))
        for name, sigmas in (("ramps", ramps), ("hidden", ramps | {0: 30.0}), ("shown", ramps | {0: 0.8}))
    }
    assert counts["hidden"] >= counts["ramps"] - 3, counts
    assert counts["shown"] > counts["ramps"], counts
    for sigma in (0.8, 3.0, 30.0):
        verdicts = [judged_together(60.0, ramps | {0: sigma}, seed).verdict for seed in range(300)]
        assert verdicts.count("accepted") <= 6, sigma


def test_what_all_runs_add_alike_is_not_averaged_away() -> None:
    """The motion's own vibration taken for an order's: 60° off looks right, and no number of runs shows it."""
    own = THERE * cmath.exp(1j * math.radians(60.0)) - THERE
    seen = [
        Seen(1, gain, THERE + own - gain * THERE * cmath.exp(1j * math.radians(60.0)), 1e-4, 0.5 * abs(own) ** 2)
        for gain in (0.0, 1.0) * 8
    ]
    alike = judge(PART, GAIN, seen)
    assert alike.verdict == "not judged"
    assert not alike.could_be_judged(100.0)
    assert judge(PART, GAIN, [replace(each, bias_variance=0.0) for each in seen]).verdict == "accepted"


def test_an_order_below_the_noise_is_not_judged_and_more_runs_can_only_help_where_it_is_near() -> None:
    far, near = judged(1.0, 0.0, 6.0, 3), judged(1.0, 0.0, 0.9, 2)
    assert far.verdict == "not judged"
    assert not replace(far, left_error=4.0).could_be_judged(4.0)
    assert "its effect is too small" in far.words
    assert near.verdict == "not judged"
    assert near.could_be_judged(4.0)


def test_the_factor_says_how_the_cancellation_should_be_multiplied() -> None:
    factors, turns = [], []
    for seed in range(200):
        found = judged(0.8, 20.0, 0.1, seed)
        assert found.factor is not None
        assert found.factor_error is not None
        assert found.turn_deg is not None
        assert found.turn_error_deg is not None
        factors.append((found.factor - 1.25) / found.factor_error)
        turns.append((found.turn_deg + 20.0) / found.turn_error_deg)
    assert 0.5 < float(np.sqrt(np.mean(np.square(factors)))) < 1.4
    assert 0.5 < float(np.sqrt(np.mean(np.square(turns)))) < 1.4
    assert "the correct cancellation is 1.2" in found.words


def test_an_unknown_delay_is_seen_though_the_directions_cancel_in_the_mean() -> None:
    """60° late forwards are 60° early backwards: half of the amplitude would be right in the mean of both."""
    seen = [
        Seen(way, gain, THERE - gain * THERE * cmath.exp(1j * math.radians(60.0 * way)), 1e-4)
        for way in (1, -1)
        for gain in (0.0, GAIN, 1.0)
    ]
    assert judge(PART, GAIN, seen).verdict == "refused"


def test_a_part_that_was_never_without_is_no_comparison() -> None:
    with pytest.raises(ValueError, match="axis 2, order 4 was recorded with"):
        judge(PART, GAIN, [Seen(1, 0.3, THERE, 1.0), Seen(1, 0.3, THERE, 1.0)])
