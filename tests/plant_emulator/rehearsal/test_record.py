"""The record of a walk: one flat row, verdicts by truth alone."""

import math

import pytest

from plant_emulator.rehearsal.record import (
    COLUMNS,
    FLOOR_FACTOR,
    QUIET_MM,
    PathRecord,
    ProbeRecord,
    QuantityRecord,
    StepRecord,
)

DONE = StepRecord("done")


def record(**changes):
    return PathRecord(**{"name": "robot", "seed": 3, "axis": 2} | changes)


def test_a_row_has_the_same_columns_whatever_a_walk_has_found():
    full = record(
        steps={"plant": DONE, "cancellation": StepRecord("refused", "CancellationRefusedError", "no")},
        quantities={"a2_arcsec": QuantityRecord(10.0, 10.2, 0.1)},
        tips={"none": {1: 0.1, 2: 0.2, 4: 0.3}},
        floor={2: 0.004},
        probes={"phi2_off_90": ProbeRecord(accepted=False)},
    )
    for each in (full, record()):
        row = each.row()
        assert tuple(row) == COLUMNS
        assert all(isinstance(cell, str | float | int | bool | None) for cell in row.values())
    assert full.row()["a2_arcsec_z"] == pytest.approx(2.0)
    assert full.row()["probe_phi2_off_90_accepted"] is False


def test_phases_are_compared_on_the_circle():
    across = QuantityRecord(359.0, 1.0, 0.5)
    assert across.z(is_angle=True) == pytest.approx(4.0)
    assert across.z() == pytest.approx(-716.0)
    assert QuantityRecord(1.0, 2.0, None).z() is None
    assert QuantityRecord(1.0, None, 0.1).z() is None


def test_the_path_ends_with_the_learnt_cancellation_unless_its_trial_clearly_left_more_or_with_the_notch():
    tips = {"none": {2: 0.3}, "notch_designed": {2: 0.1}, "cancellation": {2: 0.02}, "cancellation_learnt": {2: 0.03}}
    both = {"cancellation": DONE, "cancellation_learnt": DONE, "notch_designed": DONE}
    assert record(tips=tips, steps=both).end_treatment == "cancellation_learnt"
    left, hidden = {"cancellation": 0.004, "cancellation_learnt": 0.006}, {"cancellation": 0.001, "cancellation_learnt": 0.003}
    assert record(tips=tips, steps=both, left=left, hidden=hidden).end_treatment == "cancellation_learnt"
    left["cancellation_learnt"] = 0.008
    assert record(tips=tips, steps=both, left=left, hidden=hidden).end_treatment == "cancellation"
    learnt = both | {"cancellation": StepRecord("refused", "HilError", "no")}
    assert record(tips=tips, steps=learnt).end_treatment == "cancellation_learnt"
    refused = StepRecord("refused", "CancellationRefusedError", "no")
    found = record(tips=tips, steps={"cancellation": refused, "notch_designed": DONE})
    assert (found.end_treatment, found.end_tip_mm) == ("notch_designed", 0.1)
    assert record(tips=tips).end_tip_mm == 0.3


def test_the_goal_is_a_hundredth_of_a_millimetre_or_the_floor_with_some_room():
    assert record().goal_mm == QUIET_MM
    found = record(floor={1: 0.05, 2: 0.01}, tips={"none": {1: 0.064}})
    assert found.goal_mm == pytest.approx(FLOOR_FACTOR * 0.05)
    assert found.is_quiet
    assert record().is_quiet is None


def test_a_treatment_that_raises_one_order_by_more_than_a_trifle_is_worse():
    before = {1: 0.1, 2: 0.1, 4: 0.001}
    after = {1: 0.104, 2: 0.04, 4: 0.0029}  # less than 5 %, better, less than 2 µm
    fine = record(tips={"none": before, "cancellation": after}, steps={"cancellation": DONE})
    assert fine.worse == ()
    worse = record(tips={"none": before, "cancellation": after | {4: 0.0031}}, steps={"cancellation": DONE})
    assert worse.worse == ("cancellation k4",)
    not_used = record(tips={"none": before, "cancellation": after | {4: 0.5}}, steps={"cancellation": StepRecord("refused")})
    assert not_used.worse == ()


def test_a_tip_that_rises_to_the_floor_of_the_motions_own_jolt_and_not_beyond_is_told_apart():
    before, floor, done = {2: 0.166, 4: 0.0917}, {2: 0.094, 4: 0.109}, {"cancellation": DONE}
    at_floor = record(tips={"none": before, "cancellation": {2: 0.096, 4: 0.110}}, steps=done, floor=floor)
    assert (at_floor.worse, at_floor.raised_to_floor) == ((), ("cancellation k4",))
    beyond = record(tips={"none": before, "cancellation": {2: 0.096, 4: 0.116}}, steps=done, floor=floor)
    assert (beyond.worse, beyond.raised_to_floor) == (("cancellation k4",), ())
    below_both = record(tips={"none": before, "cancellation": {2: 0.120, 4: 0.090}}, steps=done, floor=floor)
    assert (below_both.worse, below_both.raised_to_floor) == ((), ())


def test_words_that_are_too_long_for_a_table_are_cut():
    row = record(steps={"plant": StepRecord("refused", "HilError", "x" * 5000)}).row()
    assert len(row["plant_words"]) < 1000
    assert math.isclose(row["plant_cpu_s"], 0.0)
