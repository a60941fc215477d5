"""What learning keeps of the orders that were known before it, and of a motor's delay: never worse than what it began with."""

import cmath
import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import pytest

from hil.bench.model import IdentifiedError
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm
from hil.design.transmission_error import TransmissionError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.following import DelaySearch, Following
from hil.experiments.cancellation.known_orders import KnownOrders, OrderValue
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge
from hil.robot_tables import TransmissionErrorTable, amplitude_key, phase_key

GOOD = JointEstimate(
    TransmissionError({2: 5.0}, {2: 222.0}), {2: 0.03}, {2: 0.2},
    Arm(6.2, 0.038, 1e-4), Arm(0.01, 0.001, 1e-4), 0.01, 0.99, 0.99, 1.0, 0.03, (), 1.0, (3.1, 13.0),
)  # fmt: skip
TRUE = MappingProxyType({1: (28.0, 30.0), 2: (14.6, 247.0), 4: (1.7, 58.0)})
ALL = frozenset(TRUE)


def known(values: Mapping[float, tuple[float, float]] = TRUE, error: float = 0.1, error_deg: float = 0.5) -> KnownOrders:
    """What an identification has found."""
    errors = {amplitude_key(order): error for order in values} | {phase_key(order): error_deg for order in values}
    table = TransmissionErrorTable.of({k: each[0] for k, each in values.items()}, {k: each[1] for k, each in values.items()})
    return KnownOrders.of(IdentifiedError(values=table, standard_error=errors))


def learnt(values: Mapping[float, tuple[float, float]] = TRUE, error: float = 0.2, error_deg: float = 1.0) -> JointEstimate:
    """What the passes have found."""
    return replace(
        GOOD,
        error=TransmissionError({k: each[0] for k, each in values.items()}, {k: each[1] for k, each in values.items()}),
        amplitude_error_arcsec=dict.fromkeys(values, error),
        phase_error_deg=dict.fromkeys(values, error_deg),
    )


def verdict(order: float, acted: OrderValue, true: tuple[float, float], sigma: float = 0.02) -> PartVerdict:
    """The verdict on a value's cancellation, with so much noise."""
    there = cmath.rect(true[0], math.radians(true[1]))
    variance = (sigma * true[0]) ** 2
    return judge(Part(2, order), 1.0, [Seen(1, gain, there - gain * acted.phasor, variance) for gain in (0.0, 1.0)])


def acted(keeper: KnownOrders, estimate: JointEstimate) -> None:
    """A pass that cancels what is chosen."""
    keeper.acted = keeper.choices(estimate, ALL)


def test_an_order_that_the_ramps_do_not_reach_is_kept_with_its_standard_errors() -> None:
    keeper, estimate = known(), learnt({**TRUE, 1: (24.5, 33.0)}, 0.01, 0.01)
    found = keeper.choices(estimate, {2, 4})
    assert (found[1].source, found[1].amplitude_arcsec) == ("known", 28.0)
    assert (found[1].amplitude_error, found[1].phase_error) == (0.1, 0.5)
    assert found[1].why == "the ramps end below its resonance"
    assert "A_1 = 28.00 ± 0.10″, φ_1 = 30.0 ± 0.50°" in found[1].words(1)
    assert {found[2].source, found[4].source} == {"learnt"}, "known less well than the passes know them"


def test_an_order_that_the_passes_lack_or_lose_in_noise_is_kept() -> None:
    keeper = known({**TRUE, 3: (2.0, 10.0)})
    noisy = learnt(error=1.0, error_deg=30.0)
    found = keeper.choices(noisy, ALL)
    assert found[3].source == "known"
    assert (found[4].source, found[4].why) == ("known", "the passes do not show it")
    assert (found[2].source, found[2].amplitude_arcsec) == ("known", 14.6)


def test_of_two_values_that_agree_the_more_exact_one_is_used() -> None:
    slightly = {order: (size + 0.1, angle + 0.2) for order, (size, angle) in TRUE.items()}
    assert {each.source for each in known().choices(learnt(slightly), ALL).values()} == {"known"}
    better = learnt(slightly, 0.05, 0.1)
    assert {each.source for each in known().choices(better, ALL).values()} == {"learnt"}
    without = KnownOrders.of(IdentifiedError(values=TransmissionErrorTable(a2_arcsec=14.0, phi2_deg=240.0)))
    assert without.choices(learnt(), ALL)[2].source == "learnt", "a value without a standard error is no exact one"


def test_an_error_that_has_changed_is_learnt_anew() -> None:
    changed = {**TRUE, 2: (14.6, 200.0)}
    keeper, estimate = known(), learnt(changed)
    acted(keeper, estimate)
    assert keeper.acted[2].source == "learnt"
    verdicts = [verdict(order, value, changed[order]) for order, value in keeper.acted.items()]
    assert keeper.judged(verdicts, estimate, ALL, is_last=True) == {}
    assert keeper.choices(estimate, ALL)[2].source == "learnt"


def test_what_is_learnt_and_leaves_no_less_than_what_was_known_is_not_kept() -> None:
    keeper, estimate = known(), learnt({**TRUE, 2: (14.6, 215.0)})
    acted(keeper, estimate)
    assert keeper.acted[2].source == "learnt", "they do not agree, so a pass compares them"
    keeper.judged([verdict(2, keeper.acted[2], TRUE[2])], estimate, ALL, is_last=True)
    found = keeper.choices(estimate, ALL)[2]
    assert (found.source, found.phase_deg, found.why) == ("known", 247.0, "the learnt values do not reduce it further")


def test_a_refused_value_gives_way_to_the_other_one_or_the_order_is_left_out() -> None:
    keeper, estimate = known(), learnt({**TRUE, 2: (14.6, 67.0)})
    acted(keeper, estimate)
    assert keeper.judged([verdict(2, keeper.acted[2], TRUE[2])], estimate, ALL, is_last=False) == {}
    assert keeper.choices(estimate, ALL)[2].source == "known"
    keeper, estimate = known(), learnt()
    acted(keeper, estimate)
    left = keeper.judged([verdict(2, keeper.acted[2], (14.6, 67.0))], estimate, ALL, is_last=False)
    assert set(left) == {2}, "both are the same, and wrong"
    assert 2 not in keeper.choices(estimate, ALL)


def test_what_a_last_pass_cannot_judge_is_kept_where_it_was_known_and_else_left_out() -> None:
    for keeper, left in ((known(), set()), (KnownOrders(), {2})):
        estimate = learnt()
        acted(keeper, estimate)
        unclear = verdict(2, keeper.acted[2], TRUE[2], sigma=2.0)
        assert unclear.verdict == "not judged"
        assert set(keeper.judged([unclear], estimate, ALL, is_last=False)) == set()
        assert set(keeper.judged([unclear], estimate, ALL, is_last=True)) == left


def test_a_delay_within_its_standard_error_or_of_a_motor_that_does_not_follow_is_not_believed() -> None:
    slow_sync = Following(0.98, 6e-4, 1e-4, least_s=8e-4)
    for following in (
        slow_sync,
        Following(0.98, -2.5e-3, 1.2e-3),
        Following(0.13, -67e-3, 1e-3),
        Following(1.5, 22e-3, 1e-3),
        None,
    ):
        search = DelaySearch()
        search.take(following, 1.0, is_last=False)
        assert search.delay_s == 0.0


def test_a_delay_is_kept_only_where_the_next_pass_vibrates_less_with_it() -> None:
    late = Following(0.98, 2e-3, 1e-4)
    search = DelaySearch(1e-3)
    assert search.take(late, 1.0, is_last=False) == 0.98
    assert search.delay_s == pytest.approx(3e-3)
    search.take(Following(1.0, 0.0, 1e-4), 0.2, is_last=False)
    assert search.delay_s == pytest.approx(3e-3)
    search.take(late, 0.2, is_last=False)
    search.take(late, 0.3, is_last=False)
    assert search.delay_s == pytest.approx(3e-3), "taken back, and no other is tried"
    search = DelaySearch()
    search.take(late, 1.0, is_last=True)
    assert search.delay_s == 0.0, "no pass has tried it"
    search = DelaySearch()
    search.take(late, 1.0, is_last=False)
    search.take(Following(0.99, 5e-4, 1e-5), 0.3, is_last=True)
    assert search.delay_s == pytest.approx(2.5e-3), "the rest of a delay that has helped"


def test_the_foot_of_a_resonance_refuses_nothing() -> None:
    keeper, estimate = known(), learnt()
    acted(keeper, estimate)
    wrong = verdict(1, keeper.acted[1], (28.0, 210.0))
    assert wrong.verdict == "refused"
    assert keeper.judged([wrong], estimate, {2, 4}, is_last=False) == {}
    assert keeper.choices(estimate, {2, 4})[1].source == "known"
    assert set(keeper.judged([wrong], estimate, ALL, is_last=False)) == {1}, "a pass through it does"


def test_what_passes_know_better_holds_although_the_last_one_cannot_judge_it() -> None:
    keeper, estimate = known(error=3.0, error_deg=7.0), learnt()
    acted(keeper, estimate)
    unclear = verdict(2, keeper.acted[2], TRUE[2], sigma=2.0)
    assert unclear.verdict == "not judged"
    assert keeper.judged([unclear], estimate, ALL, is_last=True) == {}
    assert keeper.choices(estimate, ALL)[2].source == "learnt"
    keeper = known(error=3.0, error_deg=7.0)
    acted(keeper, estimate)
    keeper.judged([unclear], estimate, {4}, is_last=True)
    assert keeper.choices(estimate, {4})[2].source == "known", "no pass has met it"
