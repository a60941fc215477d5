"""A trigger fires at the first row in which what it waits for has happened, in whatever pieces the rows come."""

import numpy as np
import pytest
from pydantic import ValidationError

from hil.scope.trigger import Trigger, TriggerRule


def fired(rule, values, pieces=1, emergencies_s=()):
    trigger, time_s = Trigger(rule), np.arange(len(values)) * 0.001
    table = np.asarray(values, dtype=float).reshape(len(values), -1)
    for times, part in zip(np.array_split(time_s, pieces), np.array_split(table, pieces), strict=True):
        if (found := trigger.feed(times, part, emergencies_s)) is not None:
            return round(1000 * found)
    return None


WAVE = [0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, -1.0, 0.0, 3.0]


@pytest.mark.parametrize("pieces", [1, 3, 10])
@pytest.mark.parametrize(
    ("slope", "level", "row"),
    [
        ("rising", 1.5, 2),
        ("falling", 1.5, 5),
        ("either", 1.5, 2),
        ("rising", 3.0, 3),
        ("falling", -0.5, 7),
        ("rising", 9.0, None),
    ],
)
def test_an_edge_fires_where_the_level_is_crossed(slope, level, row, pieces):
    assert fired(TriggerRule(kind="edge", signal="x", level=level, slope=slope), WAVE, pieces) == row


def test_a_signal_that_lies_on_the_level_crosses_nothing():
    assert fired(TriggerRule(kind="edge", signal="x", level=1.0), [1.0, 1.0, 1.0, 2.0]) is None


def test_missing_samples_are_passed_over():
    values = [0.0, np.nan, np.nan, 2.0, np.nan]
    assert fired(TriggerRule(kind="edge", signal="x", level=1.0), values, 5) == 3
    assert fired(TriggerRule(kind="edge", signal="x", level=1.0), [np.nan, 2.0]) is None


@pytest.mark.parametrize("pieces", [1, 4])
def test_a_status_fires_by_its_state_and_not_by_other_bits(pieces):
    words = [0x0637, 0x1637, 0x1637, 0x1638]
    assert fired(TriggerRule(kind="status"), words, pieces) == 3
    assert fired(TriggerRule(kind="status"), np.column_stack([[0x0637] * 4, [0x0637, 0x0633, 0x0637, 0x0637]]), pieces) == 1


def test_an_emergency_fires_at_its_time():
    assert fired(TriggerRule(kind="emcy"), WAVE, emergencies_s=[0.004]) == 4


@pytest.mark.parametrize("wrong", [{"kind": "edge", "level": float("nan")}, {"kind": "edge", "before_s": -1}, {"kind": "noise"},
    {"kind": "edge", "more": 1}])  # fmt: skip
def test_a_rule_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValidationError):
        TriggerRule.model_validate(wrong)
