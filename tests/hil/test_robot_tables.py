"""The tables that bench files and robot files have in common."""

import numpy as np
import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads, toml_value
from hil import robot_tables
from hil.bench.bench import REFERENCE as BENCH_FILE
from hil.bench.bench import Bench, Model, load_bench
from hil.errors import NotPossibleError
from hil.experiments.motions import line_motion
from hil.robot_tables import NotchShape, NotchTable, PlantTable, TransmissionErrorTable
from plant_emulator.robots.robot import REFERENCE as ROBOT_FILE
from plant_emulator.robots.robot import Robot, RobotAxis, load_robot
from plant_emulator.robots.tuning import TunedAxis
from plant_emulator.studies.simulate import simulate


@pytest.mark.parametrize("key", ["geometry", "line_motion", "constant_acceleration"])
def test_bench_and_robot_have_one_shape_of_what_both_state(key):
    assert Bench.model_fields[key].annotation == Robot.model_fields[key].annotation


def test_what_one_side_says_more_of_is_derived_from_what_both_say():
    assert issubclass(RobotAxis, PlantTable)
    assert issubclass(Model, PlantTable)
    assert RobotAxis.model_fields["ate"].annotation is Model.model_fields["ate"].annotation is TransmissionErrorTable
    assert issubclass(NotchTable, NotchShape)
    assert TunedAxis.model_fields["notch"].default == ()


ERROR = "a2_arcsec = 5.0\nphi2_deg = 222.0\na4_arcsec = 3.0\nphi4_deg = 126.0\n"


def test_a_file_without_a_first_order_has_none():
    table = loads(ERROR, TransmissionErrorTable)
    assert (table.a1_arcsec, table.more) == (0.0, ())
    assert table.amplitudes_arcsec() == {2: 5.0, 4: 3.0}
    assert table.phases_deg() == {2: 222.0, 4: 126.0}


def test_amplitudes_and_phases_of_any_orders_make_the_table_they_came_from():
    amplitudes, phases = {0.5: 1.0, 1: 40.0, 2.0: 5.0, 3: 2.0}, {0.5: 10.0, 1: 20.0, 2.0: 30.0, 3: 40.0}
    table = TransmissionErrorTable.of(amplitudes, phases)
    assert (table.amplitudes_arcsec(), table.phases_deg()) == (amplitudes, phases)
    assert [type(line.order) for line in table.more] == [float, int]
    assert [type(order) for order in table.amplitudes_arcsec()] == [float, int, int, int]
    assert loads("\n".join(f"{key} = {toml_value(value)}" for key, value in table.model_dump().items()), type(table)) == table


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("{ order = 2.0, a_arcsec = 1.0 }", "order 2 twice"),
        ("{ order = 3, a_arcsec = 1.0 }, { order = 3.0, a_arcsec = 2.0 }", "order 3 twice"),
        ("{ order = 0, a_arcsec = 1.0 }", "order"),
        ("{ order = 3, a_arcsec = -1.0 }", "a_arcsec"),
        (", ".join(f"{{ order = {order}, a_arcsec = 1.0 }}" for order in (3, 5, 6, 7, 8)), "more"),
    ],
)
def test_an_order_that_a_table_cannot_hold_is_refused(more, said):
    with pytest.raises(FileError, match=said):
        loads(ERROR + f"more = [{more}]\n", TransmissionErrorTable)


def test_an_amplitude_without_a_phase_is_refused():
    with pytest.raises(ValueError, match="order 3 has an amplitude but no phase"):
        TransmissionErrorTable.of({2: 1.0, 3: 1.0}, {2: 0.0})


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


ON_1_2_3 = {2: 1, 3: 2, 5: 3}


def renumbered(table):
    """A bench or a robot whose shoulder, elbow and wrist have other numbers."""
    axes = {ON_1_2_3[number]: axis for number, axis in table.axis.items()}
    geometry = table.geometry.model_copy(update={"axes": (1, 2, 3)})
    return type(table).model_validate({**table.model_dump(exclude_none=True), "axis": {
        number: axis.model_dump(exclude_none=True) for number, axis in axes.items()
    }, "geometry": geometry.model_dump()})  # fmt: skip


def test_the_line_is_moved_by_the_axes_that_the_geometry_names():
    bench = renumbered(load_bench("reference"))
    ours, theirs = line_motion(bench, 0.002), line_motion(load_bench("reference"), 0.002)
    assert (ours.axes, theirs.axes) == ((1, 2, 3), (2, 3, 5))
    np.testing.assert_array_equal(ours.motor_angle_rad, theirs.motor_angle_rad)


def test_an_emulated_arm_moves_its_tip_the_same_whatever_its_axes_are_called():
    robot = load_robot("reference")
    controls = {number: axis.control for number, axis in load_bench("reference").axis.items()}
    here = simulate(robot, None, controls=controls, notches={})
    there = simulate(renumbered(robot), None, controls={ON_1_2_3[n]: c for n, c in controls.items()}, notches={})
    assert there.axes == (1, 2, 3)
    np.testing.assert_allclose(there.tip_acceleration_m_s2, here.tip_acceleration_m_s2, atol=1e-9)


@pytest.mark.parametrize("file", [BENCH_FILE, ROBOT_FILE])
def test_a_chain_that_the_robot_lacks_is_refused_with_what_to_write(file):
    model = Bench if file is BENCH_FILE else Robot
    text = file.read_text(encoding="utf-8")
    text = text if file is BENCH_FILE else text.replace("[geometry]", "[geometry]\naxes = [2, 3, 5]")
    with pytest.raises(
        FileError, match=r"needs axes 2, 3, 6; the file has axes 2, 3, 5: put the numbers of shoulder, elbow and wrist"
    ):
        loads(text.replace("axes = [2, 3, 5]", "axes = [2, 3, 6]"), model)
    with pytest.raises(FileError, match="three different axes"):
        loads(text.replace("axes = [2, 3, 5]", "axes = [2, 3, 3]"), model)


def test_a_bench_without_the_arms_lengths_says_what_a_line_needs():
    bench = load_bench("reference").model_copy(update={"geometry": None, "line_motion": None})
    with pytest.raises(NotPossibleError, match=r"no geometry and no line_motion table: .* axes = \[shoulder, elbow, wrist\]"):
        line_motion(bench, 0.002)


def test_every_table_says_what_it_is():
    tables = [each for each in vars(robot_tables).values() if isinstance(each, type) and each.__module__ == robot_tables.__name__]
    assert len(tables) == 11
    assert all(table.__doc__ for table in tables)
