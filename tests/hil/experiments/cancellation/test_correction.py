"""The correction that silences the tip: what it begins with, and what it learns from what a pass leaves."""

import cmath
import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from hil.bench.model import Correlation, IdentifiedError
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm
from hil.design.ate.reaction import Reaction
from hil.design.estimate import Estimate
from hil.experiments.cancellation.correction import Correction, OrderValue
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.reaction_watch import ReactionWatch
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge
from hil.robot_tables import TransmissionErrorTable
from tests.hil.estimates import apart

GOOD = JointEstimate(
    (2,), apart((2,), np.array([5.0, 222.0]), np.array([0.03, 0.2])),
    Arm(6.2, 0.038, 1e-4), Arm(0.01, 0.001, 1e-4), 0.01, 0.99, 0.99, 1.0, 0.03, (), (3.1, 13.0),
)  # fmt: skip
TRUE = MappingProxyType({1: (28.0, 30.0), 2: (14.6, 247.0), 4: (1.7, 58.0)})
ALL = frozenset(TRUE)
ARM_HZ = 12.0


def known(values: Mapping[float, tuple[float, float]] = TRUE, error: float = 0.1, error_deg: float = 0.5) -> Correction:
    """What an identification has found."""
    errors = {amplitude_key(order): error for order in values} | {phase_key(order): error_deg for order in values}
    table = TransmissionErrorTable.of({k: each[0] for k, each in values.items()}, {k: each[1] for k, each in values.items()})
    return Correction(IdentifiedError(values=table, standard_error=errors), 0.002)


def fitted(values: Mapping[float, tuple[float, float]] = TRUE, error: float = 0.2, error_deg: float = 1.0) -> JointEstimate:
    """What the first passes have found."""
    found = np.array([each for pair in values.values() for each in pair])
    return replace(GOOD, orders=tuple(values), values=apart(tuple(values), found, np.tile([error, error_deg], len(values))))


def phasor(value: tuple[float, float]) -> complex:
    return cmath.rect(value[0], math.radians(value[1]))


def left(
    correction: Correction, silent: Mapping[float, complex], noise: float = 0.01, late_s: float = 0.0, response: complex = 1.0
) -> dict[float, list[Seen]]:
    """What a pass leaves where `silent` would have silenced the tip, seen through a response that is off."""
    found: dict[float, list[Seen]] = {}
    for order, value in correction.acted.items():
        late = late_s - correction.acted_delay_s
        made = {way: value.phasor * cmath.exp(-2j * math.pi * ARM_HZ * way * late) for way in (1, -1)}
        found[order] = [Seen(way, 1.0, response * (silent[order] - made[way]), noise**2) for way in (1, -1)]
    return found


def act(correction: Correction) -> None:
    """A pass that cancels what is known."""
    correction.acted, correction.acted_delay_s = correction.values(), correction.set_point_delay_s


def verdict(order: float, acted: OrderValue, true: tuple[float, float], sigma: float = 0.02) -> PartVerdict:
    """The verdict on a value's cancellation, with so much noise."""
    there, variance = phasor(true), (sigma * true[0]) ** 2
    return judge(Part(2, order), 1.0, [Seen(1, gain, there - gain * acted.phasor, variance) for gain in (0.0, 1.0)])


@pytest.mark.parametrize("response", [1.0, 0.8 + 0.2j, 1.2 - 0.2j])
def test_passes_end_at_the_correction_that_silences_the_tip_though_the_motor_makes_less_and_late(response: complex) -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    silent = {order: phasor(value) * cmath.rect(1.02, math.radians(1.0)) for order, value in TRUE.items()}
    for _ in range(4):
        act(correction)
        correction.take(left(correction, silent, late_s=4e-4, response=response), ARM_HZ)
    for order, value in correction.values().items():
        assert value.source == "learnt"
        assert abs(value.phasor - silent[order]) < 0.002 * abs(silent[order]) + 3.0 * correction.error_arcsec(order)
    assert correction.set_point_delay_s == pytest.approx(4e-4, abs=2e-5)
    assert correction.left_fraction(ARM_HZ) < 0.005


def test_an_error_that_all_amplitudes_share_is_told_by_the_orders_that_passes_show() -> None:
    """An arm's ζ that is 2 % off makes all A_k 2 % off; order 1, whose resonance no ramp passes, is told by the others."""
    off = {order: (1.02 * size, phase) for order, (size, phase) in TRUE.items()}
    correction = known(off, error=0.0, error_deg=0.01)
    assert correction.part is not None
    keys = [amplitude_key(order) for order in TRUE]
    errors = {amplitude_key(order): 0.02 * size for order, (size, _) in TRUE.items()}
    shared = Correlation.of(Estimate(tuple(keys), np.zeros(3), np.ones((3, 3)) + 1e-3 * np.eye(3)))
    for correlation, least, most in ((None, 0.019, 0.021), (shared, 0.0, 0.002)):
        part = correction.part.model_copy(update={"standard_error": correction.part.standard_error | errors})
        each = Correction(part.model_copy(update={"correlation": correlation}), 0.002)
        each.begin(fitted(off, error=20.0, error_deg=90.0), {2, 4})
        act(each)
        each.take(left(each, {order: phasor(value) for order, value in TRUE.items()}), ARM_HZ)
        assert least < abs(each.values()[1].phasor / phasor(TRUE[1]) - 1.0) < most


def test_a_plant_that_is_hardly_known_shows_in_the_errors_of_what_is_learnt() -> None:
    """What silences the tip differs from A_k by as much as the motor may make too much: all A_k alike."""
    found = {}
    for made_error in (0.0, 0.02):
        correction = replace(known(error=2.0), made_error=made_error)
        correction.begin(fitted(error=20.0, error_deg=90.0), ALL)
        act(correction)
        correction.take(left(correction, {order: 1.015 * phasor(value) for order, value in TRUE.items()}), ARM_HZ)
        found[made_error] = correction.values()[2]
    assert found[0.0].amplitude_arcsec == pytest.approx(1.015 * TRUE[2][0], rel=2e-3)
    assert found[0.02].amplitude_arcsec == pytest.approx(found[0.0].amplitude_arcsec, rel=2e-3)
    assert abs(found[0.0].amplitude_arcsec - TRUE[2][0]) > 4.0 * found[0.0].amplitude_error
    assert abs(found[0.02].amplitude_arcsec - TRUE[2][0]) < found[0.02].amplitude_error


PER_REACTION = {
    (1.0, 1): -0.012 - 0.008j, (2.0, 1): -0.024 - 0.016j, (4.0, 1): -0.044 - 0.030j,
    (1.0, -1): 0.004 - 0.003j, (2.0, -1): 0.005 - 0.003j, (4.0, -1): 0.010 - 0.007j,
}  # fmt: skip
"""What a whole reaction does under gravity, on a drawn robot of 10 Hz."""


def after_passes(true: float, torque: Reaction | None, per_reaction: Mapping[tuple[float, int], complex]) -> Correction:
    """Three passes of a gear that reacts so much, of which the torque says something else."""
    correction = known()
    correction.torque_shows = torque
    correction.begin(fitted(), ALL)
    silent = {order: phasor(value) for order, value in TRUE.items()}
    for _ in range(3):
        act(correction)
        correction.acted_reaction = 0.0 if correction.reaction is None else correction.reaction.value
        seen = {
            order: [
                replace(
                    each,
                    amplitude=each.amplitude
                    + (true - correction.acted_reaction) * silent[order] * PER_REACTION[order, each.direction],
                )
                for each in sights
            ]
            for order, sights in left(correction, silent).items()
        }
        correction.take(seen, ARM_HZ, per_reaction)
    return correction


def test_what_is_learnt_is_written_with_the_correlation_of_its_errors() -> None:
    """A reaction of the gear turns all corrections alike, so its error is one of all phases."""
    correction = after_passes(1.0, Reaction(0.5, 0.5), PER_REACTION)
    found = correction.correlation(correction.values())
    assert found is not None
    at = {name: row for row, name in enumerate(found.names)}
    assert {"set_point_delay_s", "gear_reaction"} == set(at) - {key(order) for order in ALL for key in (amplitude_key, phase_key)}
    assert min(found.matrix[at["gear_reaction"], at[phase_key(order)]] for order in ALL) > 0.05
    assert np.linalg.eigvalsh(found.matrix).min() > 0.0


@pytest.mark.parametrize("true", [0.0, 1.0])
@pytest.mark.parametrize("torque", [None, Reaction(0.99, 0.11), Reaction(0.5, 0.5), Reaction(0.0, 0.1)])
def test_the_tip_tells_a_reaction_of_the_gear_whatever_the_torque_says(true: float, torque: Reaction | None) -> None:
    """A gear that did not react was taken for one that does, and A_k and delay were turned to make up for it."""
    correction = after_passes(true, torque, PER_REACTION)
    assert correction.reaction is not None
    assert correction.reaction.value == pytest.approx(true, abs=0.1)
    assert correction.left_fraction(ARM_HZ) < 0.01
    assert abs(correction.set_point_delay_s) < 5e-6
    is_told_otherwise = torque is not None and (torque.value > 0.5) != (true > 0.5)
    assert any("on its motor, as the tip shows" in each for each in correction.notes()) == is_told_otherwise
    for order, value in correction.values().items():
        assert value.phasor == pytest.approx(phasor(TRUE[order]), rel=1e-3)


def test_a_tip_that_shows_nothing_of_a_reaction_leaves_it_as_the_torque_shows_it() -> None:
    torque = Reaction(0.8, 0.3)
    found = after_passes(0.8, torque, {}).reaction
    assert found is not None
    assert (found.value, found.standard_error) == pytest.approx((torque.value, torque.standard_error))


@pytest.mark.parametrize("late_s", [5e-3, 1e-3])
def test_a_delay_of_several_milliseconds_is_found(late_s: float) -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    silent = {order: phasor(value) for order, value in TRUE.items()}
    for _ in range(4):
        act(correction)
        correction.take(left(correction, silent, late_s=late_s), ARM_HZ)
    assert correction.set_point_delay_s == pytest.approx(late_s, abs=5e-5)
    assert correction.values()[1].phasor == pytest.approx(silent[1], rel=0.003)


def test_a_standard_error_is_that_of_the_noise_and_falls_with_the_passes() -> None:
    silent = {order: phasor(value) for order, value in TRUE.items()}
    errors = []
    correction = known(error=1.0)
    correction.begin(fitted(error=2.0), ALL)
    for _ in range(3):
        act(correction)
        correction.take(left(correction, silent, noise=0.1), ARM_HZ)
        errors.append(correction.error_arcsec(2))
    assert errors == pytest.approx([0.1 / math.sqrt(n) for n in (1, 2, 3)], rel=0.15)


def test_the_motions_own_vibration_does_not_contradict_what_is_known() -> None:
    """On an arm of 4 Hz the ramps' jolts looked like an order 4 of 20″ in each pass, and 12″ became 25″."""
    correction = known()
    correction.begin(fitted(), ALL)
    silent = {order: phasor(value) for order, value in TRUE.items()} | {4.0: phasor(TRUE[4]) + 15.0 - 12.0j}
    for _ in range(3):
        act(correction)
        seen = left(correction, silent, noise=0.5)
        seen[4.0] = [replace(each, bias_variance=10.0**2) for each in seen[4.0]]
        correction.take(seen, ARM_HZ)
    assert correction.values()[4].source == "known"
    assert correction.values()[2].phasor == pytest.approx(phasor(TRUE[2]), abs=0.3)


def test_noise_above_what_is_known_changes_nothing_and_the_order_says_so() -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    act(correction)
    silent = {order: phasor(value) + 0.4 for order, value in TRUE.items()}
    correction.take(left(correction, silent, noise=3.0), ARM_HZ)
    found = correction.values()[4]
    assert (found.source, found.amplitude_arcsec, found.why) == ("known", 1.7, "the passes show it less exactly")
    assert "A_4 = 1.70 ± 0.10″, φ_4 = 58.0 ± 0.50°" in found.words(4)


def test_an_order_that_the_ramps_do_not_reach_is_kept_with_its_standard_errors() -> None:
    correction = known()
    correction.begin(fitted({**TRUE, 1: (24.5, 33.0)}, 0.01, 0.01), {2, 4})
    act(correction)
    silent = {order: phasor(value) + (9.0 if order == 1 else 0.0) for order, value in TRUE.items()}
    correction.take(left(correction, silent), ARM_HZ)
    found = correction.values()[1]
    assert (found.source, found.amplitude_arcsec, found.phase_deg) == ("known", 28.0, 30.0)
    assert (found.amplitude_error, found.phase_error) == (0.1, 0.5)
    assert found.why == "the ramps end below its resonance"


def test_an_order_that_the_passes_lack_or_lose_in_noise_begins_with_what_was_known() -> None:
    correction = known({**TRUE, 3: (2.0, 10.0)})
    correction.begin(fitted(error=1.0, error_deg=30.0), ALL)
    assert {order: each.amplitude_arcsec for order, each in correction.values().items()} == {1: 28.0, 2: 14.6, 3: 2.0, 4: 1.7}


def test_of_two_values_that_agree_the_more_exact_one_begins() -> None:
    slightly = {order: (size + 0.1, angle + 0.2) for order, (size, angle) in TRUE.items()}
    for errors, wanted in (((0.2, 1.0), 14.6), ((0.05, 0.1), 14.7)):
        correction = known()
        correction.begin(fitted(slightly, *errors), ALL)
        assert correction.values()[2].amplitude_arcsec == pytest.approx(wanted)
    without = Correction(IdentifiedError(values=TransmissionErrorTable(a2_arcsec=14.0, phi2_deg=240.0)), 0.002)
    without.begin(fitted(), ALL)
    assert without.values()[2].amplitude_arcsec == 14.6, "a value without a standard error is no exact one"


def test_an_error_that_has_changed_is_noticed_said_and_learnt_anew() -> None:
    changed = {**TRUE, 2: (14.6, 200.0)}
    correction = known()
    correction.begin(fitted(changed), ALL)
    assert correction.values()[2].phase_deg == 200.0
    assert correction.notes() == [
        "order 2 differs from its known value (A_2 = 14.60 ± 0.10″, φ_2 = 247.0 ± 0.50°): "
        "the passes show A_2 = 14.60 ± 0.20″, φ_2 = 200.0 ± 1.00°"
    ]


def test_a_fit_that_is_wrong_is_corrected_by_the_passes_though_it_claimed_to_be_exact() -> None:
    correction = Correction()
    correction.begin(fitted({**TRUE, 2: (12.0, 225.0)}, 0.01, 0.01), ALL)
    silent = {order: phasor(value) for order, value in TRUE.items()}
    for _ in range(4):
        act(correction)
        correction.take(left(correction, silent), ARM_HZ)
    assert correction.values()[2].phasor == pytest.approx(silent[2], rel=0.005)


WRONG = MappingProxyType({**TRUE, 2: (14.6, 67.0)})


def refused(correction: Correction, true: tuple[float, float], *, is_last: bool = False) -> set[float]:
    """Orders that are left out after the verdict on what acted on order 2."""
    wrong = verdict(2, correction.acted[2], true)
    assert wrong.verdict == "refused"
    return set(correction.judged([wrong], is_last=is_last))


def test_a_refused_fit_gives_way_to_the_known_value_and_does_not_come_back() -> None:
    correction = known()
    correction.begin(fitted(WRONG), ALL)
    act(correction)
    assert refused(correction, TRUE[2]) == set()
    assert correction.values()[2].phase_deg == 247.0
    correction.begin(fitted(WRONG), ALL)
    assert correction.values()[2].phase_deg == 247.0
    assert correction.notes() == []


def test_a_refused_known_value_gives_way_to_a_fit_that_the_pass_does_not_speak_against() -> None:
    correction = known(WRONG)
    correction.begin(fitted(error=20.0), ALL)  # the first pass does not show it
    act(correction)
    correction.begin(fitted(), ALL)
    assert refused(correction, TRUE[2]) == set()
    assert correction.values()[2].phase_deg == 247.0


@pytest.mark.parametrize("is_last", [False, True])
def test_an_order_is_left_out_where_the_pass_speaks_against_every_value(*, is_last: bool) -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    act(correction)
    assert refused(correction, (14.6, 67.0), is_last=is_last) == {2}, "both are the same, and wrong"
    correction = known()
    correction.begin(fitted({**TRUE, 2: (14.6, 157.0)}), ALL)
    act(correction)
    assert refused(correction, (14.6, 337.0), is_last=is_last) == {2}, "the known one is 90° off"


def test_a_value_that_was_refused_is_not_tried_again() -> None:
    correction = known()
    correction.begin(fitted(WRONG), ALL)
    act(correction)
    assert refused(correction, TRUE[2]) == set()
    act(correction)
    assert refused(correction, WRONG[2]) == {2}, "both have been refused"


def test_learning_goes_on_until_next_to_nothing_is_left_and_every_new_order_is_judged() -> None:
    silent = {order: phasor(value) for order, value in TRUE.items()}
    for correction, is_open in ((known(), False), (Correction(), True)):
        correction.begin(fitted(), ALL)
        act(correction)
        correction.take(left(correction, {order: 1.05 * each for order, each in silent.items()}), ARM_HZ)
        assert correction.is_open([], ALL, ARM_HZ), "5 % is left"
        act(correction)
        correction.take(left(correction, {order: 1.05 * each for order, each in silent.items()}), ARM_HZ)
        assert not correction.is_open([], ALL, ARM_HZ)
        assert correction.is_open([], {*ALL, 3}, ARM_HZ), "an order has not been cancelled yet"
        unclear = verdict(2, correction.acted[2], TRUE[2], sigma=2.0)
        assert correction.is_open([unclear], ALL, ARM_HZ) == is_open
        assert correction.is_open([verdict(2, correction.acted[2], (14.6, 67.0))], ALL, ARM_HZ), "one was refused"


def test_the_foot_of_a_resonance_refuses_nothing_that_was_known() -> None:
    for correction, refused in ((known(), set()), (Correction(), {1})):
        correction.begin(fitted(), {2, 4})
        act(correction)
        at_the_foot = verdict(1, correction.acted[1], (28.0, 210.0))
        assert at_the_foot.verdict == "refused"
        assert set(correction.judged([at_the_foot], is_last=True)) == refused


def test_an_order_that_a_last_pass_cannot_judge_returns_to_what_was_known() -> None:
    correction = known()
    correction.begin(fitted({**TRUE, 4: (1.7, 238.0)}), ALL)
    act(correction)
    assert correction.acted[4].phase_deg == 238.0
    unclear = verdict(4, correction.acted[4], TRUE[4], sigma=2.0)
    assert correction.judged([unclear], is_last=True) == {}
    assert correction.values()[4].phase_deg == 58.0


def test_a_correction_that_is_not_made_as_calculated_is_said_and_no_exact_transmission_error() -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    silent = {order: 1.3 * phasor(value) for order, value in TRUE.items()}
    for _ in range(4):
        act(correction)
        correction.take(left(correction, silent), ARM_HZ)
    value = correction.values()[2]
    assert value.amplitude_arcsec == pytest.approx(1.3 * 14.6, rel=0.01)
    assert value.amplitude_error == pytest.approx(0.3 * 14.6 / math.sqrt(2.0), rel=0.05)
    assert "order 2 needs 18.98″ at 247.0° to be silent, but learning began with A_2 = 14.60 ± 0.10″" in correction.notes()[1]


def test_a_motor_does_not_lead_its_set_points() -> None:
    correction = known()
    correction.begin(fitted(), ALL)
    silent = {order: phasor(value) for order, value in TRUE.items()}
    act(correction)
    correction.take(left(correction, silent, late_s=-3e-3), ARM_HZ)
    assert abs(correction.set_point_delay_s) < 4e-4


def test_what_a_last_pass_cannot_judge_is_kept_where_it_was_known_and_else_left_out() -> None:
    for correction, without in ((known(), set()), (Correction(), {2})):
        correction.begin(fitted(), ALL)
        act(correction)
        unclear = verdict(2, correction.acted[2], TRUE[2], sigma=2.0)
        assert unclear.verdict == "not judged"
        assert correction.judged([unclear], is_last=False) == {}
        assert set(correction.judged([unclear], is_last=True)) == without


@pytest.mark.parametrize(("value", "error", "expected"), [(0.0, None, None), (1.0, None, 0.0), (0.9, 0.1, 0.1), (0.0, 0.2, 0.2)])
def test_a_reaction_of_the_model_file_counts_with_and_without_a_standard_error(
    value: float, error: float | None, expected: float | None
) -> None:
    known = ReactionWatch(2, None, value, error).known
    assert known == (None if expected is None else Reaction(value, expected))


def test_an_order_that_the_noise_hides_is_corrected_by_what_the_motor_makes_of_the_others() -> None:
    """All orders meet the resonance at one frequency, where the motor makes 0.6 % too little of each."""
    correction = known(error=0.001, error_deg=0.01)
    correction.begin(fitted(), ALL)
    silent = {order: 1.006 * phasor(value) for order, value in TRUE.items()}
    for _ in range(3):
        act(correction)
        seen = left(correction, silent, noise=0.003)
        seen[4.0] = [replace(each, amplitude=each.amplitude + 0.05, variance=1.0) for each in seen[4.0]]
        correction.take(seen, ARM_HZ)
    found = correction.values()
    for order in (1, 2):
        assert found[order].phasor == pytest.approx(silent[order], rel=1e-3)
    assert found[4].phasor == pytest.approx(silent[4], rel=1.5e-3)
