"""The tip of an arm: its motion against pinocchio, and the specific force that a sensor in the tool's frame feels."""

import numpy as np
import pinocchio
import pytest

from hil.arm.mounting import Mounting
from hil.arm.rotation import rotation
from plant_emulator.core import CORE
from plant_emulator.motion.arm import CoupledArm
from plant_emulator.motion.axes import Axes
from plant_emulator.physics.articulated import ACCELERATION, POSITION, SPECIFIC_FORCE, VELOCITY
from tests.hil.arm.oracles import pinocchio_model
from tests.plant_emulator.physics.flexible_rig import FlexibleArm, six_axes

TORQUES = (2.0, -1.5, 0.3, 0.2, 0.1, -0.2)
GRAVITY = np.array([0.0, 0.0, -9.81])


def tool_of(robot, state, accelerations):
    """Position, velocity and acceleration of the tip, and the tool's frame, as pinocchio has them."""
    arm = robot.links
    model = pinocchio_model(arm)
    data, frame = model.createData(), pinocchio.SE3(rotation(*np.radians(arm.tip_rpy_deg)), np.array(arm.tip_m))
    tool = model.addFrame(pinocchio.Frame("tool", len(arm.link), 0, frame, pinocchio.FrameType.OP_FRAME))
    data = model.createData()
    pinocchio.forwardKinematics(model, data, arm.home_rad() + state[:, 2], state[:, 3], accelerations)
    place = pinocchio.updateFramePlacement(model, data, tool)
    aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    velocity = pinocchio.getFrameVelocity(model, data, tool, aligned).linear
    acceleration = pinocchio.getFrameClassicalAcceleration(model, data, tool, aligned).linear
    return place.translation.copy(), velocity.copy(), acceleration.copy(), place.rotation.copy()


@pytest.mark.parametrize("periods", [8, 400])
def test_the_tip_moves_as_pinocchio_says(periods):
    robot = six_axes()
    arm = FlexibleArm(robot)
    state = arm.run(TORQUES, periods)
    rates = arm.axes.plant_state["arm_acceleration_rad_s2"][arm.order]
    position, velocity, acceleration, frame = tool_of(robot, state, rates)
    moved = arm.axes.arm.moved
    np.testing.assert_allclose(moved[POSITION], position, atol=1e-13)
    np.testing.assert_allclose(moved[VELOCITY], velocity, atol=1e-12)
    np.testing.assert_allclose(moved[ACCELERATION], acceleration, atol=1e-9)
    np.testing.assert_allclose(moved[SPECIFIC_FORCE], frame.T @ (acceleration - GRAVITY), atol=1e-9)
    assert arm.axes.tip_acceleration() == tuple(moved[ACCELERATION].tolist())
    assert np.linalg.norm(acceleration) > 0.1


def test_at_rest_a_sensor_feels_gravity_upwards_and_the_tip_accelerates_nowhere():
    axes = Axes(six_axes())
    np.testing.assert_allclose(axes.arm.moved[SPECIFIC_FORCE], -GRAVITY, atol=0.05)  # the gears sink: the tool leans by 4 mrad
    assert axes.arm.acceleration() == (0.0, 0.0, 0.0)
    before = axes.arm.moved[SPECIFIC_FORCE].copy()
    axes.advance(8)
    np.testing.assert_allclose(axes.arm.moved[SPECIFIC_FORCE], before, atol=1e-9)
    np.testing.assert_allclose(axes.tip_acceleration(), 0.0, atol=1e-9)
    np.testing.assert_allclose(axes.arm.moved[POSITION], (0.5, 0.0, 0.45), atol=2e-3)


def test_tips_are_written_for_each_of_the_last_periods():
    first, second = FlexibleArm(six_axes()), FlexibleArm(six_axes())
    tips = np.zeros((8, 3))
    arm: CoupledArm = first.axes.arm
    for row, torque in zip(first.order, TORQUES, strict=True):
        first.axes.motion[row]["target_torque_nm"] = torque
    rows = CORE.pointer(first.axes.rows, "axis")
    CORE.call.advance_arm(8, 250e-6, 4, rows, arm.shared, CORE.pointer(tips), len(tips))
    for i in range(8):
        second.run(TORQUES, 1)
        np.testing.assert_array_equal(tips[i], second.axes.tip_acceleration())


def test_an_accelerometer_with_a_delay_shows_what_the_arm_did_before():
    robot = six_axes()
    late = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"delay_s": 0.002})})
    now, then = FlexibleArm(robot), FlexibleArm(late)
    before = None
    for _ in range(20):
        shown = now.axes.tip_acceleration()
        now.run(TORQUES, 8)
        then.run(TORQUES, 8)
        if before is not None:
            np.testing.assert_allclose(then.axes.sensed_acceleration(), shown, rtol=1e-12)
        before = shown
    np.testing.assert_array_equal(now.state, then.state)


@pytest.mark.parametrize(("axis", "gravity"), [(None, True), (4, True), (3, False)])
def test_a_sensor_on_a_link_feels_what_pinocchio_says_along_its_own_axes(axis, gravity):
    robot = six_axes()
    mounting = Mounting(
        axis=axis, origin_m=(0.03, -0.02, 0.05), rpy_deg=(20.0, -40.0, 110.0), misalignment_deg=(0.5, -1.0, 0.7), gravity=gravity
    )
    robot = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"mounting": mounting})})
    arm, of = FlexibleArm(robot), mounting.frame(robot.links)
    state = arm.run(TORQUES, 40)
    model = pinocchio_model(robot.links)
    sensor = model.addFrame(
        pinocchio.Frame("sensor", of.link, 0, pinocchio.SE3(of.frame, of.origin_m), pinocchio.FrameType.SENSOR)
    )
    data = model.createData()
    rates = arm.axes.plant_state["arm_acceleration_rad_s2"][arm.order]
    pinocchio.forwardKinematics(model, data, robot.links.home_rad() + state[:, 2], state[:, 3], rates)
    frame = pinocchio.updateFramePlacement(model, data, sensor).rotation
    aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    acceleration = pinocchio.getFrameClassicalAcceleration(model, data, sensor, aligned).linear
    expected = frame.T @ (acceleration - gravity * GRAVITY)
    np.testing.assert_allclose(arm.axes.sensed_acceleration(), expected, atol=1e-9)
    np.testing.assert_allclose(
        arm.axes.tip_acceleration(), arm.axes.arm.moved[ACCELERATION], atol=0.0
    )  # the tip's stays the tip's


def test_a_mounted_sensor_at_rest_feels_what_holds_it_up():
    robot = six_axes()
    mounting = Mounting(rpy_deg=(90.0, 0.0, 0.0))
    axes = Axes(robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"mounting": mounting})}))
    before = axes.sensed_acceleration()
    assert float(np.linalg.norm(before)) == pytest.approx(9.81, rel=1e-12)
    axes.advance(8)
    np.testing.assert_allclose(axes.sensed_acceleration(), before, atol=1e-9)
