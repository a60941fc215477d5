"""A record is declared once: the fields that mypy knows are those that lie in memory, in the same order."""

import math
from collections.abc import Sequence
from typing import Annotated, Protocol, get_type_hints

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.control import cancellation, cascade, notch, servo
from hil.control.compiled import compiled
from hil.control.records import Rows, record_dtype
from plant_emulator.motion import record
from plant_emulator.physics import axis

DECLARED = [
    (cascade.CascadeConfigRow, cascade.CASCADE_CONFIG),
    (cascade.CascadeStateRow, cascade.CASCADE_STATE),
    (notch.NotchConfigRow, notch.NOTCH_CONFIG),
    (notch.NotchStateRow, notch.NOTCH_STATE),
    (servo.LawRow, servo.LAW),
    (cancellation.CancellationConfigRow, cancellation.CANCELLATION_CONFIG),
    (cancellation.CancellationStateRow, cancellation.CANCELLATION_STATE),
    (axis.PlantRow, axis.PLANT),
    (axis.PlantStateRow, axis.PLANT_STATE),
    (record.MotionRow, record.MOTION),
    (record.AxisRow, record.AXIS),
]


class Inner(Protocol):
    gain: float
    count: int


class Outer(Protocol):
    scale: float
    matrix: Annotated[NDArray[np.float64], (2, 3)]
    inner: Inner
    several: Annotated[Rows[Inner], (2,)]


@pytest.mark.parametrize(("row", "dtype"), DECLARED, ids=[row.__name__ for row, _ in DECLARED])
def test_the_fields_of_a_protocol_are_those_of_its_dtype(row, dtype):
    hints = get_type_hints(row)
    assert dtype.names == tuple(hints)
    kinds = {name: dtype[name] for name in dtype.names}
    assert {name for name, kind in kinds.items() if kind == np.int64} == {name for name, of in hints.items() if of is int}
    assert {name for name, kind in kinds.items() if kind == np.float64} == {name for name, of in hints.items() if of is float}


@pytest.mark.parametrize(("row", "dtype"), DECLARED, ids=[row.__name__ for row, _ in DECLARED])
def test_a_record_has_no_gaps(row, dtype):
    del row
    sizes = [dtype[name].itemsize for name in dtype.names]
    assert [dtype.fields[name][1] for name in dtype.names] == [sum(sizes[:place]) for place in range(len(sizes))]
    assert dtype.itemsize == sum(sizes)


def test_arrays_and_records_lie_inside_a_record():
    dtype = record_dtype(Outer)
    assert dtype["matrix"].shape == (2, 3)
    assert dtype["inner"] == record_dtype(Inner)
    assert dtype["several"].shape == (2,)
    assert dtype.itemsize == 8 * (1 + 6 + 2 + 4)


@compiled
def _shaken(outer: Outer) -> float:
    total = 0.0
    for i in range(2):
        inner = outer.several[i]
        inner.count += 1
        inner.gain = outer.scale * outer.matrix[i, 2]
        total += inner.gain + outer.inner.gain
    outer.inner.count = 7
    return total


def test_a_compiled_function_changes_the_records_inside_a_record_in_place():
    rows = np.zeros(2, record_dtype(Outer))
    rows["scale"], rows["inner"]["gain"] = 2.0, 0.5
    rows["matrix"] = np.arange(6.0).reshape(2, 3)
    assert math.isclose(_shaken(rows[1]), 2.0 * 2.0 + 2.0 * 5.0 + 1.0)
    assert rows["several"]["gain"].tolist() == [[0.0, 0.0], [4.0, 10.0]]
    assert rows["several"]["count"].tolist() == [[0, 0], [1, 1]]
    assert rows["inner"]["count"].tolist() == [0, 7]


class Text(Protocol):
    name: str


class Loose(Protocol):
    values: Sequence[float]


@pytest.mark.parametrize("wrong", [Text, Loose])
def test_a_field_of_another_type_is_refused_by_its_name(wrong):
    with pytest.raises(TypeError, match=r"^(Text\.name|Loose\.values) is "):
        record_dtype(wrong)
