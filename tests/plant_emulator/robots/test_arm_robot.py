"""Robot files with an arm: the reference arm, URDF files, and what makes no robot."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.arm.masses import levers, mass_matrix
from hil.arm.mounting import Mounting
from hil.bench.bench import Bench
from plant_emulator.motion.axes import Axes
from plant_emulator.robots.blank_bench import blank_bench, file_text
from plant_emulator.robots.robot import SHIPPED, ArmRobot, Robot, load_robot
from tests.hil.arm.arms import LIMIT, joint_xml, link_xml, planar_arm, six_axis_urdf, ur5e_urdf
from tests.oracles.links import gravity_torques

ARM = load_robot("reference-arm")
REFERENCE = load_robot("reference")
TEXT = SHIPPED["reference-arm"].read_text(encoding="utf-8")


def test_at_home_the_reference_arm_has_the_inertias_of_the_reference_robot():
    for number, axis in REFERENCE.axis.items():
        assert ARM.axis[number].arm_inertia_kg_m2 == pytest.approx(axis.arm_inertia_kg_m2, rel=1e-6)


def test_gears_motors_and_transmission_errors_of_its_axes_2_3_and_5_are_the_reference_robots():
    of_the_arm = {"arm_inertia_kg_m2", "gravity_moment_nm", "tip_lever_m"}
    for number, axis in REFERENCE.axis.items():
        given = axis.model_dump(exclude=of_the_arm)
        assert {key: getattr(ARM.axis[number], key) for key in given} == {key: getattr(axis, key) for key in given}


def test_in_its_plane_the_reference_arm_is_the_planar_one_and_rings_with_its_three_modes():
    home = ARM.arm.home_rad()
    matrix, planar = mass_matrix(ARM.arm, home), planar_arm()
    plane, rest = [1, 2, 4], [0, 3, 5]
    np.testing.assert_allclose(matrix[np.ix_(plane, plane)], mass_matrix(planar, planar.home_rad()), atol=1e-6)
    np.testing.assert_allclose(matrix[np.ix_(plane, rest)], 0.0, atol=1e-12)
    np.testing.assert_allclose(gravity_torques(ARM.arm, home)[plane], gravity_torques(planar, planar.home_rad()), atol=1e-6)
    gears = np.diag([ARM.axis[number].gear_stiffness_nm_rad for number in ARM.arm.axes])
    modes_hz = np.sqrt(eigh(gears, matrix, eigvals_only=True)) / (2.0 * np.pi)
    for mode_hz in (10.44, 14.73, 36.00):
        assert np.min(np.abs(modes_hz - mode_hz)) < 0.01


def test_its_tip_stands_where_the_line_of_the_reference_robot_begins():
    start = REFERENCE.line_motion.start_m
    axes = Axes(ARM.model_copy(update={"arm": ARM.arm.model_copy(update={"gravity_m_s2": (0.0, 0.0, 0.0)})}))
    np.testing.assert_allclose(axes.arm.moved[0], [start.x, 0.0, start.z], atol=1e-4)  # as much as θ_sync turns it
    assert levers(ARM.arm, ARM.arm.home_rad())[0] == pytest.approx(start.x)
    assert ARM.axis[1].tip_lever_m == pytest.approx(start.x)


def test_a_robot_with_an_arm_is_written_and_read_again():
    again = loads(file_text(ARM), ArmRobot)
    assert again.arm == ARM.arm
    assert again.axis[2].model_dump() == ARM.axis[2].model_dump()


def changed(tmp_path, *replacements):
    text = TEXT
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("replacement", "said"),
    [
        (("axis = 6\n", "axis = 7\n"), "link 'flange' .axis 7. has no drive: the file has axes 1, 2, 3, 4, 5, 6"),
        (("[axis.6]\n", "[axis.7]\n"), "link 'flange' .axis 6. has no drive"),
        (("[axis.2]\n", "[axis.2]\narm_inertia_kg_m2 = 8.0\n"), "axis 2: the links of .arm. define arm_inertia_kg_m2"),
        (("[axis.2]\n", "[axis.2]\ngravity_moment_nm = 52.0\n"), "axis 2: the links of .arm. define gravity_moment_nm"),
        (("[axis.2]\n", '[axis.2]\njoint = "shoulder"\n'), "axis 2: joint needs a URDF file"),
        (("mass_kg = 15.0", "mass_kg = -15.0"), "at least 0"),
        (("yy = 2.81531257", "yy = 9.0"), "triangle inequality"),
        (("[arm]\n", '[arm]\nurdf = "arm.urdf"\n'), "either"),
        (("home_deg = [0.0", "home_deg = [200.0"), "outside of its range_deg"),
    ],
)
def test_what_makes_no_arm_of_these_axes_is_refused(tmp_path, replacement, said):
    with pytest.raises(FileError, match=said):
        load_robot(changed(tmp_path, replacement))


def test_an_arm_whose_last_joint_turns_nothing_is_refused(tmp_path):
    bare = (
        "body = { mass_kg = 0.3, centre_m = [0.0, 0.0, 0.005], inertia_kg_m2 = { xx = 0.0007, yy = 0.0007, zz = 0.0005 } }\n",
        "",
    )
    load = TEXT[TEXT.index("payload = ") : TEXT.index("\n\n[[arm.link]]")]
    with pytest.raises(FileError, match=r"link 'flange' .axis 6. turns no mass"):
        load_robot(changed(tmp_path, bare, (load, "")))


def test_a_geometry_beside_links_is_refused(tmp_path):
    text = file_text(REFERENCE)
    table = text[text.index("[geometry]") : text.index("[line_motion]")]
    with pytest.raises(FileError, match=r"the links of .arm. define the tip"):
        load_robot(changed(tmp_path, ("[arm]\n", f"{table}\n[arm]\n")))


def urdf_robot(tmp_path, urdf, *, joints=range(1, 7), arm="", ratio=120.0):
    """A robot file beside a URDF file, all axes like axis 2 of the reference arm."""
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    axis = TEXT[TEXT.index("[axis.2]") : TEXT.index("[axis.3]")].partition("\n")[2].replace("node_id = 2\n", "")
    axis = axis.replace("reduction_ratio = 120.0", f"reduction_ratio = {ratio}")
    axes = "".join(f'[axis.{number}]\njoint = "joint_{number}"\n{axis}\n' for number in joints)
    path = tmp_path / "robot.toml"
    path.write_text(f'{axes}[arm]\nurdf = "arm.urdf"\n{arm}', encoding="utf-8")
    return path


def test_a_robot_of_a_urdf_file_has_its_links_and_moves(tmp_path):
    payload = "payload = { mass_kg = 3.0, inertia_kg_m2 = { xx = 0.01, yy = 0.01, zz = 0.01 } }\n"
    robot = load_robot(urdf_robot(tmp_path, ur5e_urdf(), arm=f"home_deg = [0.0, -90.0, 90.0, 0.0, 90.0, 0.0]\n{payload}"))
    assert [link.name for link in robot.arm.link] == [f"joint_{i}" for i in range(1, 7)]
    assert robot.arm.urdf is None
    inertias = np.diag(mass_matrix(robot.arm, robot.arm.home_rad()))
    np.testing.assert_allclose([robot.axis[i].arm_inertia_kg_m2 for i in range(1, 7)], inertias)
    axes = Axes(robot)
    axes.advance(8)
    np.testing.assert_allclose(axes.plant_state["arm_speed_rad_s"], 0.0, atol=1e-9)


def test_a_urdf_file_with_another_reduction_is_refused(tmp_path):
    load_robot(urdf_robot(tmp_path, six_axis_urdf()))
    with pytest.raises(FileError, match="axis 2: reduction_ratio is 100, but 120 in the URDF file"):
        load_robot(urdf_robot(tmp_path, six_axis_urdf(), ratio=100.0))


def test_a_urdf_file_with_a_joint_without_a_drive_is_refused(tmp_path):
    with pytest.raises(FileError, match=r"arm\.urdf:\d+: joint 'joint_6': has no drive"):
        load_robot(urdf_robot(tmp_path, ur5e_urdf(), joints=range(1, 6)))


def test_an_axis_of_a_urdf_file_names_its_joint_and_no_other_does(tmp_path):
    path = urdf_robot(tmp_path, ur5e_urdf())
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('joint = "joint_3"\n', ""), encoding="utf-8")
    with pytest.raises(FileError, match="axis 3: needs joint"):
        load_robot(path)
    path.write_text(text.replace('joint = "joint_3"', 'joint = "joint_2"'), encoding="utf-8")
    with pytest.raises(FileError, match="joint 'joint_2' is given to two axes"):
        load_robot(path)


def test_a_urdf_file_that_is_not_there_or_describes_no_arm_is_refused_with_its_name(tmp_path):
    path = urdf_robot(tmp_path, "<robot/>", joints=(1,))
    with pytest.raises(FileError, match=r"arm\.urdf:1: <robot>: has no link"):
        load_robot(path)
    (tmp_path / "arm.urdf").unlink()
    with pytest.raises(FileError, match=r"arm\.urdf: cannot be read"):
        load_robot(path)


def test_a_robot_without_an_arm_has_no_links():
    assert type(REFERENCE) is Robot
    assert REFERENCE.links is None
    assert Axes(REFERENCE).arm is None


def test_a_link_without_inertia_of_its_own_may_stand_in_the_middle(tmp_path):
    base, light, heavy = link_xml("base", None), link_xml("light", None), link_xml("heavy", planar_arm().link[0].body)
    first = joint_xml("joint_1", "revolute", "base", "light", axis="0 1 0", inside=LIMIT)
    second = joint_xml("joint_2", "revolute", "light", "heavy", "0 0 0.3", axis="1 0 0", inside=LIMIT)
    robot = load_robot(urdf_robot(tmp_path, f"<robot>{base}{light}{heavy}{first}{second}</robot>", joints=(1, 2)))
    assert robot.arm.link[0].body is None
    Axes(robot).advance(8)


def test_the_blank_bench_of_an_arm_has_its_drawing_and_nothing_that_an_engineer_does_not_know():
    robot = load_robot("reference-arm")
    mounting = Mounting(axis=5, origin_m=(0.0, 0.02, 0.05), rpy_deg=(0.0, 90.0, 0.0), misalignment_deg=(0.5, 0.0, 0.0))
    robot = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"mounting": mounting})})
    text = blank_bench(robot)
    bench = loads(text, Bench)
    for word in ("body", "payload", "misalignment", "arm_inertia", "inertia_kg_m2 = {", "tip_lever_m"):
        assert word not in text
    assert bench.accelerometer.mounting == mounting.model_copy(update={"misalignment_deg": (0.0, 0.0, 0.0)})
    assert bench.arm is not None
    for believed, true in zip(bench.arm.link, robot.links.link, strict=True):
        assert believed == true.model_copy(update={"body": None})
    assert bench.arm.home_deg == robot.links.home_deg
    assert bench.axis[6].tip_lever_m == 0.0  # behind the sensor's link
    assert bench.axis[5].tip_lever_m == pytest.approx(0.05)  # its direction is -y: what is along y does not count
    link, home = robot.links.link[2], robot.links.home_deg[2]
    assert link.range_deg is not None
    limits, [low, high] = bench.axis[3].limits, [(end - home) / 360.0 * 100.0 for end in link.range_deg]
    assert low <= limits.position_min_rev < low + 1.0  # what the link's range leaves of the motor's travel
    assert limits.position_max_rev <= high


def test_a_sensor_on_a_link_that_is_not_there_is_refused():
    on_nothing = TEXT.replace("noise_m_s2 = 0.02", "noise_m_s2 = 0.02\nmounting = { axis = 7 }")
    with pytest.raises(FileError, match="the accelerometer sits on axis 7; the arm has axes 1, 2, 3, 4, 5, 6"):
        loads(on_nothing, ArmRobot)
    without_arm = SHIPPED["reference"].read_text(encoding="utf-8").replace("[accelerometer]", "[accelerometer]\nmounting = {}")
    with pytest.raises(FileError, match=r"the robot has no \[arm\]"):
        loads(without_arm, Robot)


def test_the_first_table_of_the_page_makes_an_arm():
    page = (Path(__file__).parents[3] / "docs" / "arm-table.md").read_text(encoding="utf-8")
    table = re.findall(r"```toml\n(\[arm\]\n.*?)```", page, re.DOTALL)[0]
    axes = TEXT[TEXT.index("[axis.1]") : TEXT.index("[axis.3]")]
    robot = loads(axes + table, ArmRobot)
    assert robot.arm.axes == (1, 2)
    assert robot.arm.bodies()[1].mass_kg == pytest.approx(15.0 + 7.0)


def test_the_page_says_what_the_reference_arm_weighs():
    page = (Path(__file__).parents[3] / "docs" / "arm.md").read_text(encoding="utf-8")
    mass = sum(link.body.mass_kg for link in ARM.arm.link)
    assert f"({mass:.0f} kg, and a payload of {ARM.arm.payload.mass_kg:.0f} kg)" in page
