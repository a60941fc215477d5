"""A sensor as it is mounted, through bus and kinematics: the line as an ideal one shows it, and an axis identified with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drive_profiles.files.toml import loads
from hil.arm.mounting import Mounting
from hil.bench.bench import Bench, Model, load_bench
from hil.errors import NotPossibleError
from hil.experiments.ate.identify import identify_on
from hil.experiments.ate.request import AteRequest, Goal, axis_knowledge
from hil.experiments.motions import LINE_MOTION, constant_acceleration, line_motion
from hil.experiments.plan import Experiment
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.runner import run_experiments
from hil.master.session import Session
from hil.recording import SENSED, TIP, BusLog, Recording
from hil.robot_tables import LineMotion
from hil.tip_vector import displacement_mm
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.robot import ArmRobot, Robot, load_robot
from plant_emulator.world import World

FRAME = {"rpy_deg": (35.0, -20.0, 70.0), "misalignment_deg": (0.6, -0.5, 0.8)}
ONE_PASS = Goal({1: 9.0, 2: 1.0, 4: 1.0}, {1: 180.0, 2: 90.0, 4: 90.0})

LINE = loads("start_m = { x = 0.50, z = 0.45 }\nend_m = { x = 0.75, z = 0.45 }\nduration_s = 2.2\n", LineMotion)
ONE_LINK = """
name = "forearm"
seed = 3
[accelerometer]
noise_m_s2 = 0.05
range_m_s2 = 30.0
mounting = { origin_m = [0.33, 0.06, 0.04], rpy_deg = [35.0, -20.0, 70.0], misalignment_deg = [0.6, -0.5, 0.8] }
[axis.3]
reduction_ratio = 100.0
motor_inertia_kg_m2 = 1.20e-4
motor_damping_nm_s_rad = 4.0e-4
arm_damping_nm_s_rad = 2.5
gear_stiffness_nm_rad = 16170.0
gear_damping_nm_s_rad = 13.5
coulomb_friction_nm = 0.05
static_friction_nm = 0.065
torque_limit_nm = 3.8
encoder_counts_per_rev = 131072
ate = { a2_arcsec = 10.0, phi2_deg = 262.0, a4_arcsec = 5.0, phi4_deg = 306.0 }
[arm]
home_deg = [25.0]
tip_m = [0.36, 0.0, 0.0]
[[arm.link]]
axis = 3
origin_m = [0.1, 0.2, 0.8]
rpy_deg = [10.0, 0.0, 40.0]
direction = [0.0, -1.0, 0.0]
body = { mass_kg = 12.0, centre_m = [0.15, 0.0, 0.0], inertia_kg_m2 = { xx = 0.2, yy = 2.53, zz = 2.5 } }
"""


def mounted(robot: Robot, mounting: Mounting | None) -> Robot:
    sensor = robot.accelerometer.model_copy(update={"mounting": mounting, "noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    return robot.model_copy(update={"accelerometer": sensor})


def bench_of(robot: Robot, mounting: Mounting | None) -> Bench:
    """A bench that knows no more than the drawing; of the sensor, what is given."""
    bench = loads(blank_bench(robot), Bench).on("local:/tmp/none.sock")
    bus = bench.bus.model_copy(update={"answer_timeout_s": 0.05})
    sensor = bench.accelerometer.model_copy(update={"mounting": mounting})
    return Bench.model_validate(bench.model_copy(update={"bus": bus, "accelerometer": sensor, "line_motion": LINE}))


def line_of(robot: Robot, mounting: Mounting | None) -> Recording:
    bench = bench_of(robot, mounting)
    with Session(bench, InProcessChannel(World(mounted(robot, mounting))), BusLog(None)) as session:
        session.bring_up()
        result = session.run(line_motion(bench, 0.002), "none", "drive")
    assert result.stopped is None
    return result.recording


@pytest.mark.slow
def test_a_sensor_turned_anyhow_at_the_tip_shows_the_line_as_an_ideal_one_does() -> None:
    robot = load_robot("reference-arm")
    ideal, real = line_of(robot, None), line_of(robot, Mounting(origin_m=(0.0, 0.0, 0.05), **FRAME))
    raw = np.stack([real.columns[name] for name in SENSED], axis=1)
    assert float(np.max(np.abs(np.linalg.norm(raw, axis=1) - 9.81))) < 2.0  # its weight is most of what it feels
    shown = [np.stack([each.columns[name] for name in TIP], axis=1) for each in (ideal, real)]
    # gears that give way by some mrad tilt the sensor, which no motor shows: some cm/s² of its weight, as slow as the motion
    assert float(np.max(np.std(shown[1] - shown[0], axis=0))) < 0.02
    by_ideal, by_real = (displacement_mm(each, 0.002, (6.0, 25.0))[200:-200] for each in shown)
    assert float(np.max(np.abs(by_ideal))) > 0.05
    assert float(np.max(np.abs(by_real - by_ideal))) < 0.001


@pytest.fixture(scope="module")
def forearm() -> Robot:
    robot = loads(ONE_LINK, ArmRobot)
    return robot.with_links_read(Path())


def believed(robot: Robot) -> Bench:
    bench = loads(blank_bench(robot), Bench)
    assert bench.accelerometer.mounting == Mounting(origin_m=(0.33, 0.06, 0.04), rpy_deg=FRAME["rpy_deg"])  # not how askew it is
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"answer_timeout_s": 0.05})})


@pytest.mark.ci
def test_the_transmission_error_is_identified_along_the_lever_of_a_sensor_that_looks_anywhere(forearm: Robot) -> None:
    bench = believed(forearm)
    assert bench.axis[3].tip_lever_m == pytest.approx(float(np.hypot(0.33, 0.04)))
    with Session(bench, InProcessChannel(World(forearm)), BusLog(None)) as session:
        session.bring_up()
        request = AteRequest(3, goal=ONE_PASS)
        found = identify_on(session, request, axis_knowledge(bench, 3, None, sensorless=False))
    error = found.estimate.error
    assert error.amplitude_arcsec[2] == pytest.approx(10.0, rel=0.03)
    assert error.phase_deg[2] == pytest.approx(262.0, abs=2.0)
    assert error.amplitude_arcsec[4] == pytest.approx(5.0, rel=0.06)
    assert error.phase_deg[4] == pytest.approx(306.0, abs=3.0)
    assert found.estimate.motion_scale == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow  # three runs of up to a minute of the bench's time
def test_the_plant_is_identified_with_it(forearm: Robot, tmp_path: Path) -> None:
    bench = believed(forearm)
    outcome = run_identify_plant(
        bench, PlantRequest(3, amplitude_nm=0.5, periods=6), tmp_path, channel=InProcessChannel(World(forearm))
    )
    parameters = outcome.result.parameters
    inertia = 2.53 + 12.0 * 0.15**2
    assert parameters["antiresonance_hz"].value == pytest.approx(np.sqrt(16170.0 / inertia) / (2.0 * np.pi), rel=0.01)
    assert parameters["lever_ratio"].value == pytest.approx(1.0, abs=0.05)


@pytest.mark.ci
def test_a_run_asks_where_the_other_axes_stand() -> None:
    mounting = Mounting(origin_m=(0.0, 0.0, 0.05), **FRAME)
    robot = mounted(load_robot("reference-arm"), mounting)
    bench, world = bench_of(robot, mounting), World(robot)
    world.axes.plant_state["motor_angle_rad"][2] = -40.0  # axis 3, braked, 23 degrees off home
    assert world.axes.arm is not None
    world.axes.arm.hang_at_rest()
    with Session(bench, InProcessChannel(world), BusLog(None)) as session:
        session.bring_up()
        motion = constant_acceleration(bench, 2, 0.002)
        still = replace(motion, motor_angle_rad=0.0 * motion.motor_angle_rad)
        recording = session.run(still, "none", "drive").recording
    for name in TIP:
        assert float(np.max(np.abs(recording.columns[name]))) < 0.2  # its weight is taken off where it is, not where home is


def test_a_sensor_that_is_not_mounted_as_the_bench_says_identifies_nothing(forearm: Robot, tmp_path: Path) -> None:
    bench = believed(forearm)
    wrong = Mounting(origin_m=(0.33, 0.06, 0.04), rpy_deg=(35.0, -20.0 + 90.0, 70.0))
    bench = bench.model_copy(update={"accelerometer": bench.accelerometer.model_copy(update={"mounting": wrong})})
    with Session(bench, InProcessChannel(World(forearm)), BusLog(None)) as session:
        session.bring_up()
        knowledge = axis_knowledge(bench, 3, None, sensorless=False)
        with pytest.raises(NotPossibleError, match=r"gravity \d\d° off its mounting"):
            identify_on(session, AteRequest(3, goal=ONE_PASS), knowledge)


@pytest.mark.slow  # five runs of six axes
def test_a_cancellation_is_tried_and_judged_with_it_along_every_direction(tmp_path: Path) -> None:
    """All errors right, the sensor turned, a degree askew and noisy: each part is accepted, the line is quiet in x, y and z."""
    robot, known = load_robot("reference-arm"), Mounting(origin_m=(0.0, 0.0, 0.05), rpy_deg=FRAME["rpy_deg"])
    real = known.model_copy(update={"misalignment_deg": FRAME["misalignment_deg"]})
    robot = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"mounting": real})})
    bench = load_bench("reference-arm")
    axes = {}
    for number, axis in robot.axis.items():
        model = Model.model_validate({key: getattr(axis, key) for key in Model.model_fields})
        axes[number] = bench.axis[number].model_copy(update={"model": model})
    sensor = bench.accelerometer.model_copy(update={"mounting": known})
    experiments = [Experiment(LINE_MOTION, None, "none"), Experiment(LINE_MOTION, None, "cancellation")]
    bench = bench.model_copy(update={"axis": axes, "accelerometer": sensor})
    outcome = run_experiments(bench, experiments, tmp_path, channel=InProcessChannel(World(robot)))
    before, after = outcome.result.runs
    assert before.directions is not None
    assert after.directions is not None
    assert before.tip_peak_mm is not None
    assert before.tip_peak_mm > 0.07
    assert not [part for trial in outcome.trials for part in trial.refused]
    for name in ("x", "y", "z"):
        assert (after.directions[name].tip_peak_mm or 1.0) < 0.010
