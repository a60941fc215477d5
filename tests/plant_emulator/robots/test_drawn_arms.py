"""Arms drawn by seed: the same from the same seed, as real as the reference arm, and with a bench that they can be run by."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from typer.testing import CliRunner

from drive_profiles.files.toml import loads
from hil.arm.masses import mass_matrix
from hil.bench.bench import Bench, load_bench
from hil.errors import NotPossibleError
from hil.experiments.motions import line_motion
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.cli.main import app
from plant_emulator.robots.blank_bench import blank_bench, file_text
from plant_emulator.robots.drawn_arms import ARM_RANGES, arm_facts, draw_arm
from plant_emulator.robots.robot import ArmRobot, load_robot
from plant_emulator.world import World
from tests.oracles.links import gravity_torques

SEEDS = (0, 3, 5)


def test_equal_seeds_give_equal_arms_and_others_others():
    assert draw_arm(5) == draw_arm(5)
    assert draw_arm(5).arm != draw_arm(6).arm
    with pytest.raises(ValueError, match="seed -1 is negative"):
        draw_arm(-1)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_arm_rings_and_weighs_as_arms_of_its_size_do(seed):
    robot = draw_arm(seed)
    home = robot.arm.home_rad()
    gears = np.diag([robot.axis[number].gear_stiffness_nm_rad for number in robot.arm.axes])
    modes_hz = np.sqrt(eigh(gears, mass_matrix(robot.arm, home), eigvals_only=True)) / (2.0 * np.pi)
    low, high = ARM_RANGES["antiresonance_hz"]
    assert 0.5 * low < modes_hz[0] < high  # coupling lowers the lowest
    for number, weight in zip(robot.arm.axes, gravity_torques(robot.arm, home), strict=True):
        axis = robot.axis[number]
        assert abs(weight) / axis.reduction_ratio < 0.5 * axis.torque_limit_nm
        assert 50 <= axis.reduction_ratio <= 160


def test_an_arm_is_written_as_a_robot_file_and_read_again(tmp_path):
    robot = draw_arm(3)
    path = tmp_path / "arm.toml"
    path.write_text(file_text(robot), encoding="utf-8")
    again = load_robot(path)
    assert isinstance(again, ArmRobot)
    assert again == robot


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_its_bench_knows_its_joints_and_no_masses_and_has_a_line_that_it_can_follow(seed):
    robot = draw_arm(seed)
    bench = loads(blank_bench(robot), Bench)
    assert all(link.body is None for link in bench.arm.link)
    assert bench.arm.payload is None
    assert all(axis.model is None for axis in bench.axis.values())
    assert line_motion(bench, 0.002).time_s[-1] > 1.5
    ramp = bench.constant_acceleration
    turned = 180.0 * ramp.end_rps**2 * (1.0 / ramp.acceleration_rps_s + 1.0 / ramp.deceleration_rps_s)
    assert turned / min(robot.axis[number].reduction_ratio for number in (1, 2, 3)) < 15.5 or ramp.acceleration_rps_s == 20.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 135])
def test_a_drawn_arm_follows_its_line_behind_the_master(seed):
    """The bench file of 135 stated 4100 rev/s² of 2²⁰ counts: more than a drive's object holds, so that every run was refused."""
    robot = draw_arm(seed)
    bench = loads(blank_bench(robot), Bench)
    session = Session(bench, InProcessChannel(World(robot)), BusLog(None))
    with session:
        session.bring_up()
        result = session.run(line_motion(bench, 0.002), "none", "drive")
    assert result.stopped is None
    for number in (2, 3):
        assert np.ptp(result.recording.axis(number, "position_rad")) > 5.0


def test_a_limit_that_no_drive_can_hold_is_refused_by_its_key():
    robot = draw_arm(135)
    bench = loads(blank_bench(robot).replace("= 4095", "= 4100"), Bench)
    with Session(bench, InProcessChannel(World(robot)), BusLog(None)) as session:
        session.bring_up()
        with pytest.raises(NotPossibleError, match=r"25761.*: choose a limits\.acceleration_rps_s that the drive can hold"):
            session.run(line_motion(bench, 0.002), "none", "drive")


def test_the_command_writes_arms_with_their_benches_and_overwrites_nothing(tmp_path):
    out = tmp_path / "arms"
    command = ["fleet", "--seeds", "1-2", "--arms", "--out", str(out)]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "bench-1.toml",
        "bench-2.toml",
        "robot-1.toml",
        "robot-2.toml",
        "robots.csv",
    ]
    assert load_robot(out / "robot-2.toml") == draw_arm(2)
    header, first, _ = (out / "robots.csv").read_text(encoding="utf-8").splitlines()
    found = dict(zip(header.split(","), map(float, first.split(",")), strict=True))
    assert found == {"seed": 1.0, **arm_facts(draw_arm(1))}
    assert CliRunner().invoke(app, command).exit_code == 3


EXAMPLE = Path(__file__).parents[3] / "examples" / "arm.urdf"
DOWN = "0,20,95,0,65,0"


def fleet(*words):
    return CliRunner().invoke(app, ["fleet", *map(str, words)])


@pytest.mark.ci
def test_the_arm_of_a_urdf_file_is_given_drives_and_a_bench_that_reads_the_same_file(tmp_path):
    (tmp_path / "arm.urdf").write_bytes(EXAMPLE.read_bytes())
    out = tmp_path / "mine"
    assert fleet("--seeds", "2-3", "--urdf", tmp_path / "arm.urdf", "--home-deg", DOWN, "--out", out).exit_code == 0
    assert 'urdf = "../arm.urdf"' in (out / "robot-2.toml").read_text(encoding="utf-8")
    robot, bench = load_robot(out / "robot-2.toml"), load_bench(out / "bench-2.toml")
    assert robot.arm == bench.arm
    assert [link.name for link in robot.arm.link][:2] == ["base_turn", "shoulder"]
    assert [robot.axis[number].reduction_ratio for number in (1, 2, 3)] == [121.0, 121.0, 101.0]  # of its transmissions
    for number, axis in bench.axis.items():
        assert axis.motor_inertia_kg_m2 == pytest.approx(robot.axis[number].motor_inertia_kg_m2, rel=0.05)
        assert axis.model is None
    assert line_motion(bench, 0.002).axes == (2, 3, 5)
    other = load_robot(out / "robot-3.toml")
    assert other.arm == robot.arm
    assert other.axis[2] != robot.axis[2]


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--urdf", EXAMPLE, "--home-deg", "0,20,95"), 2, "3 angles for 6 links"),
        (("--urdf", EXAMPLE, "--home-deg", "0,twenty,95,0,65,0"), 2, "not a list of angles"),
        (("--urdf", EXAMPLE, "--home-deg", "0,200,95,0,65,0"), 2, "outside of its range_deg"),
        (("--urdf", EXAMPLE, "--tip-link", "wrist"), 3, "not at the arm's end"),
        (("--urdf", "nowhere.urdf"), 3, "cannot be read"),
        (("--arms", "--home-deg", DOWN), 2, "needs --urdf"),
    ],
)
def test_a_urdf_arm_that_cannot_be_drawn_is_refused_and_nothing_is_written(tmp_path, words, status, said):
    out = tmp_path / "mine"
    done = fleet("--seeds", "2", "--out", out, *words)
    text = " ".join(done.output.replace("│", " ").split())
    assert (done.exit_code, said in text) == (status, True), text
    assert not out.exists()
