"""The tables that bench files and robot files have in common."""

import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil import robot_tables
from hil.bench.bench import REFERENCE as BENCH_FILE
from hil.bench.bench import Bench, Model
from hil.robot_tables import NotchShape, NotchTable, PlantTable, TransmissionErrorTable
from plant_emulator.robots.robot import REFERENCE as ROBOT_FILE
from plant_emulator.robots.robot import GearTransmissionError, Robot, RobotAxis
from plant_emulator.robots.tuning import TunedAxis


@pytest.mark.parametrize("key", ["geometry", "line_motion", "constant_acceleration"])
def test_bench_and_robot_have_one_shape_of_what_both_state(key):
    assert Bench.model_fields[key].annotation == Robot.model_fields[key].annotation


def test_what_one_side_says_more_of_is_derived_from_what_both_say():
    assert issubclass(RobotAxis, PlantTable)
    assert issubclass(Model, PlantTable)
    assert issubclass(GearTransmissionError, TransmissionErrorTable)
    assert issubclass(NotchTable, NotchShape)
    assert TunedAxis.model_fields["notch"].default == ()


def test_a_robot_s_gear_shows_a_first_order_that_a_bench_does_not_believe_in():
    extra = set(GearTransmissionError.model_fields) - set(TransmissionErrorTable.model_fields)
    assert extra == {"a1_arcsec", "phi1_deg"}


@pytest.mark.parametrize(("file", "model"), [(BENCH_FILE, Bench), (ROBOT_FILE, Robot)])
def test_a_line_motion_whose_ramps_do_not_fit_is_refused_in_either_file(file, model):
    text = file.read_text(encoding="utf-8")
    assert "[line_motion]" in text
    with pytest.raises(FileError, match="line_motion"):
        loads(text.replace("[line_motion]", "[line_motion]\nramp_s = 1e3"), model)


@pytest.mark.parametrize("shape", ["switched", "trapezoid"])
def test_a_notch_with_three_keys_less_takes_the_law_s_defaults(shape):
    values = {"shape": shape, "start_rps": 4.0, "end_rps": 9.0, "offset_hz": 0.5, "zeta_rn": 0.02, "zeta_rdth": 0.1}
    assert NotchShape(**values).notch() == NotchTable(**values).notch()


def test_every_table_says_what_it_is():
    tables = [each for each in vars(robot_tables).values() if isinstance(each, type) and each.__module__ == robot_tables.__name__]
    assert len(tables) == 9
    assert all(table.__doc__ for table in tables)
