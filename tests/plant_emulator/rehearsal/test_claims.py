"""The numbers that must be reached are judged from the rows: each claim fails for the robot that breaks it, and for no other."""

import math
from typing import get_args

import numpy as np
import pytest

from hil.errors import RefusalCause
from plant_emulator.rehearsal.many.causes import CAUSES, main_refusal, refusals
from plant_emulator.rehearsal.many.claims import FEWEST_FAR, claims_of
from plant_emulator.rehearsal.many.rows import CRASHED, WALKED, crashed
from plant_emulator.rehearsal.many.summary import quantities
from plant_emulator.trials.statistics import fraction_text, percentiles
from tests.plant_emulator.rehearsal.made import CURED, refused, row

NOISE = "not identified: the ratio of the largest amplitude, A_2, to its standard error: 3.8 (at least 5)"


def judged(rows):
    return {each.key: each for each in claims_of(rows)}


def holds(rows):
    return {key: each.holds for key, each in judged(rows).items()}


def honest(count, seed=3):
    """Estimates whose deviations are as large as their standard errors say."""
    z = np.random.default_rng(seed).normal(size=count)
    return [{"a2_arcsec": (20.0, 20.0 + 0.1 * float(each), 0.1)} for each in z]


# -- all together ------------------------------------------------------------------------------------------------------


def test_robots_that_are_cured_and_honestly_measured_reach_every_number():
    probes = {"phi2_off_60": False, "a2_times_3": False}
    rows = [
        row(seed, kind, quantities=each, probes=probes)
        for seed, (kind, each) in enumerate(zip(["linear", "real"] * 100, honest(200), strict=True))
    ]
    rows.append(refused(900, NOISE, "real", ("noise",), facts={"noise_m_s2": 0.06}))
    assert set(holds(rows).values()) == {True}


def test_what_no_robot_shows_is_not_judged():
    found = holds([row(1)])
    assert found["quiet_linear"] is True
    assert [found[key] for key in ("quiet_real", "true_cause", "wrong_refused", "rms_z", "far_together", "far_each")] == [
        None
    ] * 6


def test_no_robot_reaches_nothing():
    assert set(holds([]).values()) == {None}


# -- one by one --------------------------------------------------------------------------------------------------------


def test_one_order_that_an_accepted_treatment_raises_is_worse():
    raised = row(2, tips={"cancellation": {1: 0.008, 2: 0.009, 4: 0.054}})
    assert holds([row(1), raised])["never_worse"] is False
    assert judged([row(1), raised])["never_worse"].measured == "1 of 2 robots, with 6 accepted treatments"


def test_what_was_refused_makes_nothing_worse():
    ended = {"cancellation": "refused"}
    assert holds([row(2, ended=ended, tips={"cancellation": {1: 0.9, 2: 0.9, 4: 0.9}})])["never_worse"] is True


def test_the_copied_notch_is_nobody_s_choice():
    assert holds([row(2, tips={"notch": {1: 0.9, 2: 0.9, 4: 0.9}})])["never_worse"] is True


def test_one_wrong_correction_that_is_accepted_is_one_too_many():
    rows = [row(seed, probes={"phi2_off_60": seed == 7, "phi1_off_180": False}) for seed in range(10)]
    found = judged(rows)["wrong_refused"]
    assert (found.holds, found.measured) == (False, "1 of 20")


@pytest.mark.parametrize(
    ("kind", "others", "is_reached"), [("linear", 1, True), ("linear", 2, False), ("real", 4, True), ("real", 5, False)]
)
def test_of_forty_linear_robots_one_may_stay_loud_and_of_forty_real_ones_four(kind, others, is_reached):
    loud = {step: {1: 0.02, 2: 0.02, 4: 0.02} for step in ("cancellation", "cancellation_learnt")}
    rows = [row(seed, kind, tips=loud if seed < others else None) for seed in range(40)]
    assert holds(rows)[f"quiet_{kind}"] is is_reached


def test_a_robot_whose_process_died_is_neither_quiet_nor_refused():
    died = {"kind": "linear"} | dict(crashed(2))
    assert died["walk"] == CRASHED != WALKED
    found = holds([row(1), died])
    assert (found["quiet_linear"], found["true_cause"], found["whole"]) == (False, False, False)


def test_a_step_that_breaks_is_no_end_of_a_walk():
    assert holds([row(1, ended={"design": "crashed"})])["whole"] is False


def test_a_standard_error_that_is_half_of_what_it_should_be_is_seen():
    proud = [{"a2_arcsec": (true, estimate, 0.5 * error)} for each in honest(200) for true, estimate, error in each.values()]
    assert holds([row(seed, quantities=each) for seed, each in enumerate(proud)])["rms_z"] is False
    timid = [{"a2_arcsec": (true, estimate, 2.0 * error)} for each in honest(200) for true, estimate, error in each.values()]
    assert holds([row(seed, quantities=each) for seed, each in enumerate(timid)])["rms_z"] is False


def test_one_deviation_in_fifty_beyond_four_standard_errors_is_too_many():
    rows = [row(seed, quantities=each) for seed, each in enumerate(honest(FEWEST_FAR))]
    assert holds(rows)["far_each"] is True
    far = [row(1000 + seed, quantities={"a2_arcsec": (20.0, 20.5, 0.1)}) for seed in range(3)]
    assert holds(rows + far)["far_each"] is holds(rows + far)["far_together"] is False


def test_one_robot_that_takes_longer_is_one_too_many():
    assert holds([row(1), row(2, cpu_s=9.9)])["cpu"] is True
    assert holds([row(1), row(2, cpu_s=10.1)])["cpu"] is False


def test_processor_time_over_a_bus_is_another_matter():
    over = row(2, cpu_s=200.0) | {"over_bus": True}
    assert holds([over])["cpu"] is None


# -- causes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("named", "facts", "cause", "is_true"),
    [
        (("limits",), {}, "limits", False),
        (("cycle",), {"sync_period_s": 0.008}, "cycle", True),
        (("cycle",), {"sync_period_s": 0.001}, "cycle", False),
        (("noise", "encoder"), {"encoder_bits": 13.0}, "noise or encoder", True),
        (("bus load",), {"sync_period_s": 0.001, "bitrate": 500_000}, "bus load", True),
        (("bus load",), {"sync_period_s": 0.001}, "bus load", False),
        (("noise",), {"noise_m_s2": 0.06}, "noise", True),
        (("wrong axis or wiring",), {"noise_m_s2": 0.06}, "wrong axis or wiring", False),
        ((), {"noise_m_s2": 0.06}, "none of the known causes", False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("words", [NOISE, "said otherwise"])
def test_a_refusal_is_right_where_the_robot_has_the_cause_that_it_names(words, named, facts, cause, is_true):
    found = main_refusal(refused(1, words, causes=named, facts=facts))
    assert (found.cause, found.is_true, found.step, found.words) == (cause, is_true, "learn", words)
    assert holds([refused(1, words, causes=named, facts=facts)])["true_cause"] is is_true


def test_nothing_to_cancel_is_true_of_a_robot_that_is_quiet_without_a_treatment():
    named = ("nothing to cancel",)
    assert main_refusal(refused(1, "it is quiet", causes=named, tips={"none": {1: 0.005}})).is_true
    assert not main_refusal(refused(1, "it is quiet", causes=named)).is_true


def test_every_cause_of_an_error_has_a_condition_and_no_other():
    assert {cause.name for cause in CAUSES} == set(get_args(RefusalCause))


def test_a_refusal_that_only_misses_an_earlier_result_leaves_the_word_to_that_one():
    ended = {"plant": "refused", "cancellation": "refused", "learn": "refused", "cancellation_learnt": "skipped"}
    assert main_refusal(row(1, ended=ended, causes={"plant": ("noise",)})).step == "plant"


def test_a_robot_that_is_treated_and_still_loud_is_not_refused():
    loud = row(1, tips={"cancellation_learnt": {1: 0.02}, "cancellation": {1: 0.02}})
    assert main_refusal(loud) is None
    assert holds([loud])["true_cause"] is False


def told(causes, without_mm):
    """A row of a robot that is treated, still at 0.020 mm, and of which the run says why."""
    loud = row(1, tips={"cancellation": {1: 0.020}, "cancellation_learnt": {1: 0.020}})
    return loud | {"end_causes": causes, "end_words": "left: 0.0200 mm", "without_cause_mm": without_mm}


@pytest.mark.parametrize(
    ("without_mm", "is_true"), [(0.009, True), (0.0149, True), (0.016, False), (0.025, False), (None, False)]
)
def test_a_cause_of_what_is_left_is_true_where_the_robot_without_it_loses_half_of_it(without_mm, is_true):
    found = main_refusal(told("gear reaction, speed limit", without_mm))
    assert found.named == ("gear reaction", "speed limit")
    assert found.is_true is is_true


def test_what_is_not_explained_is_no_refusal():
    assert main_refusal(told("not explained", 0.001)) is None


def test_quiet_robots_need_no_refusal():
    assert refusals([row(1)]) == []


# -- numbers -----------------------------------------------------------------------------------------------------------


def test_a_phase_deviates_on_the_circle():
    [found] = quantities([row(1, quantities={"phi2_deg": (359.0, 1.0, 1.0)})])
    assert (found.rms_z, found.median_off, found.far) == (2.0, 2.0, 0)


def test_an_estimate_without_a_standard_error_promises_nothing():
    assert quantities([row(1, quantities={"a2_arcsec": (20.0, 21.0, None)})]) == []


def test_the_largest_deviation_names_its_robot():
    rows = [row(seed, quantities={"a2_arcsec": (20.0, 20.0 + off, 0.1)}) for seed, off in ((4, 0.1), (5, -0.6), (6, 0.2))]
    [found] = quantities(rows)
    assert (found.worst_seed, found.far) == (5, 1)
    assert math.isclose(found.worst_z, -6.0, rel_tol=1e-9)


def test_a_fraction_has_wilson_s_interval():
    """Brown, Cai and DasGupta 2001, equation (4): 0 of 20 reaches to z²/(20 + z²) = 16 %."""
    assert fraction_text(0, 20) == "0 of 20, 0 % (0–16)"


def test_percentiles_are_a_robot_s_own_values():
    assert percentiles([4.0, 1.0, 3.0, 2.0, 5.0]) == {5: 1.0, 50: 3.0, 95: 5.0}


def test_the_made_rows_are_cured():
    assert max(CURED["cancellation_learnt"].values()) <= row(1)["goal_mm"]
