"""The robot file: the reference robot is what the bench believes, and what makes no robot is refused."""

import math

import numpy as np
import pytest

from drive_profiles.files.toml import FileError
from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.robot_tables import MOST_MORE_ORDERS, TransmissionErrorTable
from plant_emulator.physics.axis import PLANT
from plant_emulator.robots.robot import REFERENCE, Robot, load_robot

ROBOT = load_robot("reference")


def test_the_reference_bench_believes_what_the_reference_robot_is():
    bench = load_bench("reference")
    assert set(bench.axis) == set(ROBOT.axis)
    for number, believed in bench.axis.items():
        true = ROBOT.axis[number]
        assert (believed.reduction_ratio, believed.tip_lever_m) == (true.reduction_ratio, true.tip_lever_m)
        assert believed.limits.torque_nm == true.torque_limit_nm
        if believed.model is not None:
            for name, value in believed.model.model_dump(exclude={"ate"}).items():
                assert value == getattr(true, name)
            for name, value in believed.model.ate.model_dump().items():
                assert value == getattr(true.ate, name)
    assert bench.geometry.model_dump() == ROBOT.geometry.model_dump()
    assert bench.line_motion == type(bench.line_motion)(**ROBOT.line_motion.model_dump())
    assert bench.constant_acceleration.model_dump() == ROBOT.constant_acceleration.model_dump()


def test_the_transmission_errors_are_those_of_table_2():
    rows = np.zeros(2, PLANT)
    for row, number in zip(rows, (2, 3), strict=True):
        ROBOT.axis[number].write(row, 0.0)
    np.testing.assert_allclose(rows["a2_rad"] * 180 * 3600 / math.pi, [5.0, 10.0])
    np.testing.assert_allclose(rows["a4_rad"] * 180 * 3600 / math.pi, [3.0, 5.0])
    np.testing.assert_allclose(np.degrees(rows["phi2_rad"]), [222.0, 262.0])
    np.testing.assert_allclose(np.degrees(rows["phi4_rad"]), [126.0, 306.0])


def test_other_orders_of_a_gear_are_written_too_and_a_table_s_room_is_the_plant_s():
    table = TransmissionErrorTable.of({2: 5.0, 3: 4.0, 0.5: 6.0}, {2: 0.0, 3: 90.0, 0.5: 180.0})
    row = np.full(1, np.nan, PLANT)[0]
    ROBOT.axis[2].model_copy(update={"ate": table}).write(row, 0.0)
    assert (row["has_more_orders"], row["more_orders"].tolist()) == (1.0, [0.5, 3.0, 0.0, 0.0])
    np.testing.assert_allclose(row["more_rad"] / ARCSEC, [6.0, 4.0, 0.0, 0.0])
    np.testing.assert_allclose(np.degrees(row["more_phi_rad"]), [180.0, 90.0, 0.0, 0.0])
    assert len(row["more_orders"]) == MOST_MORE_ORDERS


def test_every_field_of_the_plant_is_written_in_si():
    axis = ROBOT.axis[2].model_copy(
        update={
            "gear_reaction": True,
            "wind_up_softness": 0.3,
            "wind_up_torsion_arcsec": 50.0,
            "hysteresis_torque_nm": 1.5,
            "hysteresis_torsion_arcsec": 25.0,
            "current_time_constant_s": 1e-3,
        }
    )
    row = np.full(1, np.nan, PLANT)
    axis.write(row[0], 0.25)
    assert not any(np.isnan(row[0][name]).any() for name in PLANT.names)
    want = {
        "home_angle_rad": 0.25,
        "gear_reaction": 1.0,
        "wind_up_softness": 0.3,
        "wind_up_torsion_rad": 50.0 * ARCSEC,
        "hysteresis_torque_nm": 1.5,
        "hysteresis_torsion_rad": 25.0 * ARCSEC,
        "current_time_constant_s": 1e-3,
        "gear_stiffness_nm_rad": 48950.0,
        "gravity_moment_nm": 52.0,
        "motor_inertia_kg_m2": 2.6e-4,
    }
    assert {name: float(row[0][name]) for name in want} == pytest.approx(want)


def test_home_is_the_start_of_the_line_and_gravity_pulls_every_link_down():
    joints = ROBOT.home_joints()
    np.testing.assert_allclose(ROBOT.geometry.chain().tip(joints), [0.50, 0.45], atol=1e-12)
    lean = joints[0]
    assert ROBOT.home_angle(2) == pytest.approx(lean + 0.5 * math.pi)
    # leaning forwards, the upper arm is pulled further forwards: its moment m g l cos(q₀) is negative
    assert lean > 0.0
    assert math.cos(ROBOT.home_angle(2)) < 0.0
    # the tool points straight down: no moment
    assert math.cos(ROBOT.home_angle(5)) == pytest.approx(0.0, abs=1e-12)
    # a forearm lifts against its weight by the cosine of its angle above the horizontal
    assert ROBOT.home_angle(3) == pytest.approx(0.5 * math.pi - joints[0] + joints[1])


def test_a_home_angle_of_the_file_goes_before_the_geometrys():
    axis = ROBOT.axis[3].model_copy(update={"home_deg": 30.0})
    assert ROBOT.model_copy(update={"axis": {**ROBOT.axis, 3: axis}}).home_angle(3) == pytest.approx(math.pi / 6.0)
    assert ROBOT.model_copy(update={"geometry": None}).home_angle(3) == 0.0


def test_the_rated_torque_is_a_third_of_the_peak_in_whole_millinewtonmetres_unless_told():
    assert ROBOT.axis[2].rated_torque == pytest.approx(2.367)
    told = ROBOT.axis[2].model_copy(update={"rated_torque_nm": 1.2345})
    assert told.rated_torque == pytest.approx(1.234, abs=1e-3)
    assert told.model_copy(update={"rated_torque_nm": 1e-9}).rated_torque == 0.001


def values(**changes):
    return {**ROBOT.model_dump(exclude_none=True), **changes}


def test_two_nodes_with_one_number_are_refused():
    axes = {number: {**axis, "node_id": 4} for number, axis in values()["axis"].items()}
    with pytest.raises(ValueError, match="node-ID 4"):
        Robot.model_validate(values(axis=axes))


def test_a_geometry_without_its_axes_is_refused():
    with pytest.raises(ValueError, match="2, 3, 5"):
        Robot.model_validate(values(axis={2: values()["axis"][2]}))


@pytest.mark.parametrize(
    ("lag_s", "substeps", "is_taken"), [(0.0, 4, True), (20e-6, 4, False), (32e-6, 4, True), (20e-6, 8, True)]
)
def test_a_current_loop_that_the_solver_cannot_follow_is_refused(lag_s, substeps, is_taken):
    axes = {number: {**axis, "current_time_constant_s": lag_s} for number, axis in values()["axis"].items()}
    changed = values(axis=axes, plant_substeps=substeps)
    if is_taken:
        Robot.model_validate(changed)
    else:
        with pytest.raises(ValueError, match=r"axis 2: current_time_constant_s 2e-05 .*6\.25e-05 s"):
            Robot.model_validate(changed)


@pytest.mark.parametrize(
    ("key", "value"),
    [("reduction_ratio", "-120.0"), ("arm_inertia_kg_m2", "0.0"), ("encoder_counts_per_rev", "2"), ("torque_limit_nm", '"much"')],
)
def test_an_impossible_value_is_refused_with_its_key_and_its_line(tmp_path, key, value):
    lines = REFERENCE.read_text(encoding="utf-8").splitlines()
    place = next(i for i, line in enumerate(lines) if line.startswith(f"{key} ="))
    lines[place] = f"{key} = {value}"
    path = tmp_path / "robot.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(FileError) as caught:
        load_robot(path)
    assert key in str(caught.value)
    assert str(place + 1) in str(caught.value)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(FileError, match=r"nowhere\.toml"):
        load_robot(tmp_path / "nowhere.toml")


def test_a_robot_without_geometry_has_no_home_joints():
    assert ROBOT.model_copy(update={"geometry": None}).home_joints() is None
    assert ROBOT.node_ids == {2: 2, 3: 3, 5: 5}


def test_switches_and_behaviour_are_tables_of_an_axis(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(
        REFERENCE.read_text(encoding="utf-8")
        + """
[axis.3.switches]
negative_limit_deg = -90.0
positive_limit_deg = 90.0
home_deg = [-1.0, 1.0]
index_deg = 180.0

[axis.3.behaviour]
tpdo_delay_us = 250.0
pp_handshake_cycles = 3
""",
        encoding="utf-8",
    )
    axes = load_robot(path).axis
    assert axes[3].switches.positive_limit_deg == 90.0
    assert axes[3].switches.home_deg == (-1.0, 1.0)
    assert (axes[3].behaviour.delays_frames, axes[3].behaviour.pp_handshake_cycles) == (True, 3)
    assert axes[2].switches is None
    assert not axes[2].behaviour.delays_frames


def test_the_motor_constant_gives_the_rated_current():
    axis = ROBOT.axis[3]
    assert axis.rated_current_ma == axis.rated_torque_mnm
    assert axis.model_copy(update={"torque_constant_nm_a": 0.1}).rated_current_ma == 10 * axis.rated_torque_mnm
