"""A line motion by the arm of the bench file: which axes move, the same run as by the planar chain, and what is refused."""

import math
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from drive_profiles.errors import FileError
from hil.arm.kinematics import Kinematics
from hil.arm.straight_line import LineError
from hil.bench.bench import Bench, load_bench
from hil.experiments.motions import line_motion
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World
from tests.hil.arm.arms import six_axis_urdf
from tests.hil.arm.reference import ARM, bench_with_arm

PERIOD_S = 0.002


def test_the_same_links_make_the_same_line_as_the_planar_chain(reference_bench: Bench, tmp_path: Path) -> None:
    bench = bench_with_arm(tmp_path)
    by_chain, by_arm = line_motion(reference_bench, PERIOD_S), line_motion(bench, PERIOD_S)
    assert by_arm.axes == by_chain.axes == bench.chain_axes == (2, 3, 5)
    assert by_arm.starts_at_home
    np.testing.assert_allclose(by_arm.motor_angle_rad, by_chain.motor_angle_rad, rtol=0.0, atol=1e-9)


def test_the_levers_of_a_bench_file_are_those_of_its_arm(reference_bench: Bench, tmp_path: Path) -> None:
    bench = bench_with_arm(tmp_path)
    assert math.isclose(bench.axis[5].tip_lever_m, reference_bench.axis[5].tip_lever_m, abs_tol=1e-12)
    arm = bench.arm
    assert arm is not None
    shoulder, tip = np.array([0.05, 0.0, 0.33]), Kinematics.of(arm).pose(arm.home_rad())[0]
    assert math.isclose(bench.axis[2].tip_lever_m, float(np.linalg.norm(tip - shoulder)), rel_tol=1e-12)


def run_line(bench: Bench, robot: Robot) -> np.ndarray:
    channel = InProcessChannel(World(robot))
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        result = session.run(line_motion(bench, PERIOD_S), "none", "drive")
    assert result.stopped is None
    return np.column_stack(list(result.recording.columns.values()))


@pytest.mark.ci
def test_a_run_by_the_arm_is_the_run_by_the_planar_chain(reference_bench: Bench, reference_robot: Robot, tmp_path: Path) -> None:
    by_chain, by_arm = run_line(reference_bench, reference_robot), run_line(bench_with_arm(tmp_path), reference_robot)
    np.testing.assert_allclose(by_arm, by_chain, rtol=0.0, atol=1e-9)


def test_a_line_that_does_not_start_at_home_is_begun_where_it_starts(reference_robot: Robot, tmp_path: Path) -> None:
    bench = bench_with_arm(tmp_path, start_m="{ x = 0.55, z = 0.50 }", end_m="{ x = 0.62, z = 0.50 }")
    motion = line_motion(bench, PERIOD_S)
    assert float(np.min(np.abs(motion.motor_angle_rad[0]))) > 1.0
    channel = InProcessChannel(World(reference_robot))
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        result = session.run(motion, "none", "drive")
    assert result.stopped is None
    first = [float(result.recording.axis(axis, "position_rad")[0]) for axis in motion.axes]
    np.testing.assert_allclose(first, motion.motor_angle_rad[0], atol=0.05)
    assert max(abs(channel.world.axes.plant_state["motor_angle_rad"])) < 0.05  # and everything went home again


@pytest.mark.ci
@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            {"end_m": "{ x = 1.20, z = 0.45 }"},
            r"after 37\d\.\d mm, 53\.\d % of the way: the arm does not bring its tip to x = 0\.87",
        ),
        ({"end_m": "{ x = 0.70, y = 0.1, z = 0.45 }"}, r"the arm does not bring its tip to .* in the required direction"),
        ({"duration_s": "0.7"}, r"axis \d would turn at up to .*°/s; its limit is .*: duration_s"),
        ({"end_m": "{ x = 0.50, z = 0.45 }"}, "start_m and end_m are equal"),
    ],
)
def test_a_line_that_the_arm_cannot_follow_is_refused_with_its_place(line: dict[str, str], words: str, tmp_path: Path) -> None:
    with pytest.raises(LineError, match=words):
        line_motion(bench_with_arm(tmp_path, **line), PERIOD_S)


def test_a_position_limit_on_the_way_is_refused_with_the_axis_and_the_place(tmp_path: Path) -> None:
    bench = bench_with_arm(tmp_path)
    limits = bench.axis[2].limits.model_copy(update={"position_max_rev": 4.0})
    axes = {**bench.axis, 2: bench.axis[2].model_copy(update={"limits": limits})}
    with pytest.raises(LineError, match=r"mm, .* % of the way: axis 2 would be at .*°; its limits are"):
        line_motion(bench.model_copy(update={"axis": axes}), PERIOD_S)


@pytest.mark.parametrize(
    ("arm", "words"),
    [
        (ARM + "\n[geometry]\nshoulder_offset_m = 0.05\nshoulder_height_m = 0.33\nupper_arm_m = 0.44\nforearm_m = [0.4, 0.0]\n"
         "tool_m = 0.1\n", "leave the geometry out"),
        (ARM.replace("axis = 5", "axis = 4"), "has no drive"),
        (ARM[: ARM.rindex("[[arm.link]]")].replace(", -", ", -", 1).replace("home_deg", "# home_deg"), "axis 5 moves no link"),
    ],
)  # fmt: skip
def test_an_arm_that_is_not_the_benchs_is_refused(arm: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=words):
        bench_with_arm(tmp_path, arm)


def test_a_lever_that_is_not_the_arms_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    bench_with_arm(tmp_path)
    path.write_text(path.read_text().replace("[axis.3]", "[axis.3]\ntip_lever_m = 0.36"))
    with pytest.raises(FileError, match=r"axis 3: tip_lever_m is 0\.36, but the arm table gives 0\.4"):
        load_bench(path)


def urdf_bench(folder: Path, ratio: float = 120.0, joint: str = "joint_3") -> Bench:
    """Six axes whose links a URDF file has, and a line in space."""
    (folder / "six.urdf").write_text(six_axis_urdf(), encoding="utf-8")
    lines = ['name = "six"', "[bus]", 'address = "local:/tmp/none.sock"', "[accelerometer]", "node_id = 16"]
    lines += ["[arm]", 'urdf = "six.urdf"', f"home_deg = {SIX_HOME_DEG}", "[line_motion]", "duration_s = 2.0"]
    start, end = six_ends(folder)
    lines += [f"{name} = {{ x = {x!r}, y = {y!r}, z = {z!r} }}" for name, (x, y, z) in (("start_m", start), ("end_m", end))]
    limits = "{ torque_nm = 5.0, speed_rps = 40.0, position_min_rev = -60.0, position_max_rev = 60.0 }"
    for number in range(1, 7):
        own = joint if number == 3 else f"joint_{number}"
        reduction = ratio if number == 2 else 100.0
        lines += [
            f"[axis.{number}]",
            f"node_id = {number}",
            f'joint = "{own}"',
            f"reduction_ratio = {reduction}",
            f"limits = {limits}",
        ]
        lines += ['control = "as found"']
    path = folder / "six.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_bench(path)


SIX_HOME_DEG = [10.0, -35.0, 50.0, 20.0, 65.0, -15.0]


def six_ends(folder: Path) -> tuple[list[float], list[float]]:
    """Where pinocchio has the tip at home, and a place 160 mm away."""
    model = pinocchio.buildModelFromUrdf(str(folder / "six.urdf"))
    start = tool_of(model, np.radians(SIX_HOME_DEG)).translation
    return start.tolist(), (start + np.array([-0.06, 0.12, -0.08])).tolist()


def tool_of(model, angles: np.ndarray):
    q = np.concatenate([angles[:5], [math.cos(angles[5]), math.sin(angles[5])]])  # a continuous joint's
    data = model.createData()
    pinocchio.forwardKinematics(model, data, q)
    pinocchio.updateFramePlacements(model, data)
    return data.oMf[model.getFrameId("tool0")]


def test_six_axes_of_a_urdf_file_bring_the_tool_along_a_line_in_space_as_pinocchio_sees_it(tmp_path: Path) -> None:
    bench = urdf_bench(tmp_path)
    motion = line_motion(bench, 0.01)
    assert motion.axes == (1, 2, 3, 4, 5, 6)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "six.urdf"))
    start, end = map(np.array, six_ends(tmp_path))
    ratios = np.array([bench.axis[axis].reduction_ratio for axis in motion.axes])
    angles = np.radians(SIX_HOME_DEG) + motion.motor_angle_rad / ratios
    tools = [tool_of(model, row) for row in angles]
    along = (end - start) / float(np.linalg.norm(end - start))
    away = np.array([tool.translation for tool in tools]) - start
    np.testing.assert_allclose(away - np.outer(away @ along, along), 0.0, atol=1e-9)
    np.testing.assert_allclose(tools[-1].translation, end, atol=1e-9)
    for tool in tools:
        np.testing.assert_allclose(tool.rotation, tools[0].rotation, atol=1e-9)


def test_a_urdf_file_that_is_not_the_benchs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="axis 2: reduction_ratio is 100, but 120 in the URDF file"):
        urdf_bench(tmp_path, ratio=100.0)
    with pytest.raises(FileError, match="joint_3"):
        urdf_bench(tmp_path, joint="elbow")


def test_an_arm_with_more_joints_than_a_pose_needs_turns_no_joint_for_nothing(tmp_path: Path) -> None:
    links = "".join(
        f"[[arm.link]]\naxis = {number}\norigin_m = [0.0, 0.0, {0.0 if number == 1 else 0.25}]\ndirection = {direction}\n"
        for number, direction in enumerate([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]], start=1)
    )
    axes = "".join(
        f'[axis.{number}]\nnode_id = {number}\nreduction_ratio = 100.0\ncontrol = "as found"\n'
        "limits = { torque_nm = 5.0, speed_rps = 40.0, position_min_rev = -60.0, position_max_rev = 60.0 }\n"
        for number in range(1, 8)
    )
    path = tmp_path / "seven.toml"
    head = 'name = "seven"\n[bus]\naddress = "local:/tmp/none.sock"\n[accelerometer]\nnode_id = 16\n'
    arm = f"[arm]\ntip_m = [0.0, 0.0, 0.1]\nhome_deg = [0.0, 30.0, 0.0, 70.0, 0.0, 50.0, 0.0]\n{links}"
    path.write_text(head + arm + axes, encoding="utf-8")
    table = load_bench(path).arm
    assert table is not None
    kinematics = Kinematics.of(table)
    start, frame = kinematics.pose(table.home_rad())
    end = start + np.array([-0.10, 0.08, 0.05])
    points = [f"{{ x = {x!r}, y = {y!r}, z = {z!r} }}" for x, y, z in (start.tolist(), end.tolist())]
    line = f"[line_motion]\nstart_m = {points[0]}\nend_m = {points[1]}\nduration_s = 2.0\n"
    path.write_text(head + arm + axes + line, encoding="utf-8")
    motion = line_motion(load_bench(path), PERIOD_S)
    assert motion.axes == (1, 2, 3, 4, 5, 6, 7)
    angles = table.home_rad() + motion.motor_angle_rad / 100.0
    places, frames = kinematics.pose(angles)
    np.testing.assert_allclose(places[-1], end, atol=1e-9)
    np.testing.assert_allclose(frames, np.broadcast_to(frame, frames.shape), atol=1e-9)
    steps = np.diff(angles[100:-300], axis=0)
    _, _, rows = np.linalg.svd(kinematics.jacobian(angles[100:-301]))
    idle = np.abs(np.einsum("nj,nj->n", rows[:, 6], steps)) / np.linalg.norm(steps, axis=1)
    assert float(np.max(idle)) < 0.02  # next to nothing of the joints' speed moves the elbow alone
