"""The reference arm behind the unchanged master: its line motion, and all six drives at once."""

import numpy as np
import pytest
from scipy import signal

from hil.bench.bench import Bench, load_bench
from hil.experiments.motions import constant_acceleration, line_motion
from hil.master.motion import Motion
from hil.master.session import Session
from hil.recording import BusLog
from hil.robot_tables import Control
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.studies.simulate import simulate
from plant_emulator.world import World
from tests.bench.conftest import with_bus

MM_PER_M_S2 = 1e3 / (2.0 * np.pi * 11.84) ** 2  # the paper's f_al of axis 2


@pytest.fixture(scope="module")
def quiet_arm() -> Robot:
    robot = load_robot("reference-arm")
    sensor = robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    return robot.model_copy(update={"accelerometer": sensor})


def without_error(robot: Robot) -> Robot:
    axes = {number: axis.model_copy(update={"ate": axis.ate.of({}, {})}) for number, axis in robot.axis.items()}
    return robot.model_copy(update={"axis": axes})


def session_of(bench: Bench, robot: Robot) -> Session:
    return Session(with_bus(bench, answer_timeout_s=0.05), InProcessChannel(World(robot)), BusLog(None))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("has_error", "treatment", "x_mm", "z_mm"),
    [(True, "none", 0.095, 0.0562), (True, "notch", 0.073, 0.0401), (False, "none", 0.005, 0.0029)],
)
def test_the_tip_shakes_on_the_line_as_much_as_that_of_a_planar_arm_calculated_in_closed_form(
    reference_bench: Bench, quiet_arm: Robot, has_error: bool, treatment: str, x_mm: float, z_mm: float
) -> None:
    """The closed form of three links in a plane, in an emulator of its own, gave these peaks; 6 to 25 Hz, as the paper judges."""
    session = session_of(reference_bench, quiet_arm if has_error else without_error(quiet_arm))
    with session:
        session.bring_up()
        recording = session.run(line_motion(reference_bench, 0.002), treatment, "drive").recording  # type: ignore[arg-type]
    band = signal.butter(2, [6.0, 25.0], "band", fs=500.0, output="sos")
    time = recording.time_s
    window = (time > 0.2 + 0.5) & (time < 0.2 + 2.0)
    tip = [recording.columns[f"tip_{way}_m_s2"] for way in "xyz"]
    found = [np.max(np.abs(signal.sosfiltfilt(band, each)[window])) * MM_PER_M_S2 for each in tip]
    assert found[0] == pytest.approx(x_mm, abs=1e-3)
    assert found[1] == pytest.approx(0.0, abs=1e-4)  # across its plane the arm is a mirror image of itself
    assert found[2] == pytest.approx(z_mm, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [2, None])
def test_what_went_over_can_equals_the_simulation_of_the_arm_without_can(quiet_arm: Robot, axis: int | None) -> None:
    bench, period = load_bench("reference-arm"), 0.002
    motion = line_motion(bench, period) if axis is None else constant_acceleration(bench, axis, period)
    session = session_of(bench, quiet_arm)
    with session:
        session.bring_up()
        recording = session.run(motion, "none", "drive").recording
    controls = {number: Control(**table.control.model_dump()) for number, table in bench.axis.items()}  # type: ignore[union-attr]
    settle_s = bench.settle_s + 2 * period  # the brakes open with one SYNC, and the settling begins two later
    without_can = simulate(quiet_arm, axis, controls=controls, notches={}, sync_period_s=period, settle_s=settle_s)
    assert without_can.axes == motion.axes
    tip = np.array([recording.columns[f"tip_{way}_m_s2"] for way in "xyz"]).T
    np.testing.assert_allclose(tip, without_can.tip_acceleration_m_s2, atol=1.1e-3)  # of the wire's mm/s²
    for column, number in enumerate(motion.axes):
        counts = recording.axis(number, "position_rad") / (2.0 * np.pi) * quiet_arm.axis[number].encoder_counts_per_rev
        np.testing.assert_array_equal(np.round(counts), without_can.position_counts[:, column])


@pytest.mark.slow
def test_all_six_drives_are_brought_up_and_follow_together(quiet_arm: Robot) -> None:
    bench = load_bench("reference-arm")
    time = np.arange(0.0, 1.2, 0.002)
    faster, slower = np.clip(time - 0.1, 0.0, 0.5), np.clip(time - 0.6, 0.0, 0.5)
    turns = 2.0 * np.pi * (faster**2 + slower - slower**2)
    motion = Motion(tuple(bench.axis), time, turns[:, np.newaxis] * [1, -1, 1, -1, 1, -1], starts_at_home=False)
    session = session_of(bench, quiet_arm)
    with session:
        session.bring_up()
        result = session.run(motion, "none", "drive")
    assert result.stopped is None
    for column, number in enumerate(bench.axis):
        error = result.recording.axis(number, "position_rad")[:-1] - motion.motor_angle_rad[: len(time) - 1, column]
        assert np.max(np.abs(error[:50])) < 0.02  # at rest, gravity held
        assert (
            np.max(np.abs(error)) < 1.1 * 4.0 * np.pi * 0.5 / 25.0
        )  # a cascade without feed-forward is late by its speed over K_pp
        assert abs(result.recording.axis(number, "position_rad")[-1]) > 0.5
