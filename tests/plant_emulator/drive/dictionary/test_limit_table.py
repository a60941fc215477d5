"""The table of limits: whole, and such that no row can stop an axis that has no drive."""

import ast
import math
from pathlib import Path

import pytest

import plant_emulator
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.units import Scaling
from plant_emulator.drive.dictionary.cia402_objects import cia402_entries
from plant_emulator.drive.dictionary.limit_table import MOTION_LIMITS, SPEED, TIME, Limit
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import MOTION, UNTIL_WRITTEN
from tests.plant_emulator.rig import ONE_AXIS, Rig

ROWS = tuple(MOTION_LIMITS.values())
ALONE = [row for row in ROWS if row.field is not None]


def test_a_row_whose_field_would_limit_an_axis_without_a_drive_is_refused():
    with pytest.raises(KeyError, match="torque_nm has no value in UNTIL_WRITTEN"):
        Limit(Object.MAX_CURRENT, SPEED, "torque_nm")


def test_every_field_of_the_table_is_one_of_the_motion_and_no_two_rows_fill_the_same():
    fields = [row.field for row in ALONE]
    assert set(fields) <= set(MOTION.names)
    assert len(set(fields)) == len(fields)


def test_every_value_that_waits_for_a_drive_is_a_field_of_the_motion():
    assert set(UNTIL_WRITTEN) <= set(MOTION.names)


def test_an_axis_without_a_drive_is_limited_by_none_of_the_rows():
    row = Axes(ONE_AXIS).motion[0]
    assert {field: row[field] for field in UNTIL_WRITTEN} == UNTIL_WRITTEN
    unlimited = {field for field in UNTIL_WRITTEN if field.startswith(("max_", "torque_slope")) or "_window_r" in field}
    assert {row[field] for field in unlimited} == {math.inf}


def test_every_row_has_an_entry_in_the_dictionary_of_every_drive():
    indices = {entry.index for entry in cia402_entries(131072, 1000, 3000, ())}
    assert set(MOTION_LIMITS) <= indices


@pytest.mark.parametrize("row", ALONE, ids=lambda row: row.index.name)
def test_a_row_that_acts_alone_acts_as_soon_as_it_is_written(row):
    rig = Rig()
    rig.set(row.index, 0, 40)
    expected = row.quantity.si(rig.drive.scaling, 40)
    if row.quantity is TIME:
        expected = round(expected / ONE_AXIS.control_period_s)
    assert rig.motion[row.field] == expected


def test_a_ramp_of_zero_counts_as_one_since_it_would_have_no_end():
    rig = Rig()
    cell = rig.drive.slave.dictionary.cell(Object.PROFILE_ACCELERATION)
    cell.write_hook(0)
    assert rig.motion["profile_acceleration_rad_s2"] == Scaling(131072, 1.0).acceleration_rad_s2(1)


def test_a_plain_limit_is_named_by_five_production_files_at_most_and_by_none_twice():
    """607Fh and its field: what a new limit of its kind has to touch."""
    names = {}
    packages = Path(plant_emulator.__file__).parents[1]
    for package in ("drive_profiles", "plant_emulator"):
        for path in (packages / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "MAX_PROFILE_VELOCITY" in text and (count := _mentions(ast.parse(text), "MAX_PROFILE_VELOCITY")):
                names[path.relative_to(packages).as_posix()] = count
    assert names == {
        "drive_profiles/standard/cia402.py": 1,
        "plant_emulator/drive/dictionary/cia402_objects.py": 1,
        "plant_emulator/drive/dictionary/limit_table.py": 1,
    }


def _mentions(tree, name):
    return sum(
        (isinstance(node, ast.Attribute) and node.attr == name) or (isinstance(node, ast.Name) and node.id == name)
        for node in ast.walk(tree)
    )
