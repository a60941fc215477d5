"""The table of treatments: names, and what follows from a row."""

from typing import get_args

import pytest

from hil.control.shapers import NAMES
from hil.control.treatments import TABLE, PlainTreatmentName, TreatmentName, treatment


def names(wanted):
    return {row.name for row in TABLE if wanted(row)}


def test_the_types_of_names_hold_the_names_of_the_table():
    assert get_args(TreatmentName) == tuple(row.name for row in TABLE)
    assert set(get_args(PlainTreatmentName)) == names(lambda row: row.is_plain)


def test_no_name_and_no_title_means_two_treatments():
    assert len({row.name for row in TABLE}) == len({row.title for row in TABLE}) == len(TABLE)


def test_a_row_says_what_acts_and_where():
    assert names(lambda row: row.cancels == "set-points") == {
        "cancellation",
        "cancellation+notch",
        "cancellation-learnt",
        "cancellation-following",
        *(f"cancellation+shaper-{name}" for name in NAMES),
    }
    assert names(lambda row: row.cancels == "inside") == {"cancellation-inside"}
    assert names(lambda row: row.filters == "variable") == {"notch", "notch-designed", "cancellation+notch"}
    assert names(lambda row: row.loops == ("host",)) == {"fixed-notch"}
    assert names(lambda row: "host" in row.loops) == {"none", "low-gains", "fixed-notch", "notch", "notch-designed"}


def test_remedies_are_those_that_are_meant_to_keep_the_specification():
    shapers = {f"shaper-{name}" for name in NAMES}
    assert names(lambda row: not row.is_remedy) == {"none", "low-gains", "fixed-notch", *shapers}, "no shaper cancels an error"
    assert names(lambda row: row.is_shaper) == shapers
    assert names(lambda row: row.shaper is not None) == shapers | {f"cancellation+{name}" for name in shapers}


def test_a_name_that_is_none_is_refused_with_those_that_are():
    assert treatment("notch").title == "notch"
    with pytest.raises(ValueError, match=r"no treatment 'ate'; expected one of none, low-gains, .*cancellation-learnt"):
        treatment("ate")
