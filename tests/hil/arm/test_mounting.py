"""A sensor on a link: what it feels is read back into the base frame, and its levers are what an axis moves it by."""

import math

import numpy as np
import pinocchio as pin
import pytest

from drive_profiles.errors import FileError
from drive_profiles.files.toml import loads
from hil.arm.kinematics import Kinematics
from hil.arm.mounting import Mounting, along_lever, in_base
from tests.hil.arm.arms import any_arm
from tests.hil.arm.oracles import acceleration as acceleration_of

MOUNTING = "origin_m = [0.03, -0.02, 0.05]\nrpy_deg = [20.0, -40.0, 110.0]\nmisalignment_deg = [0.5, -1.0, 0.7]"
GRAVITY = np.array([0.3, -0.2, -9.81])


def moving(arm, count: int, rows: int = 300):
    """Angles of a smooth motion, and their derivatives."""
    generator = np.random.default_rng(9)
    time, rate = np.linspace(0.0, 1.0, rows)[:, np.newaxis], generator.uniform(2.0, 6.0, count)
    size, phase = generator.uniform(0.2, 1.0, count), generator.uniform(0.0, 6.0, count)
    q = size * np.sin(rate * time + phase)
    return q, size * rate * np.cos(rate * time + phase), -size * rate**2 * np.sin(rate * time + phase)


@pytest.mark.parametrize("axis", [None, 2])
def test_what_pinocchio_makes_a_sensor_feel_is_read_back_into_the_base_frame(axis):
    arm = any_arm(3, 5)
    mounting = loads(MOUNTING + (f"\naxis = {arm.axes[axis]}" if axis is not None else ""), Mounting)
    kinematics, of = Kinematics.of(arm), mounting.frame(arm)
    model, parent = pin.Model(), 0
    for origin, frame, direction in zip(kinematics.origins_m, kinematics.frames, kinematics.axes, strict=True):
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(*direction), pin.SE3(frame, origin), f"joint{parent + 1}")
    sensor = model.addFrame(pin.Frame("sensor", of.link, 0, pin.SE3(of.frame, of.origin_m), pin.FrameType.SENSOR))
    data = model.createData()
    angles, speeds, rates = moving(arm, 5)
    felt, true = np.empty((len(angles), 3)), np.empty((len(angles), 3))
    for i in range(len(angles)):
        pin.forwardKinematics(model, data, angles[i], speeds[i], rates[i])
        true[i] = pin.getFrameClassicalAcceleration(model, data, sensor, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED).linear
        pin.updateFramePlacements(model, data)
        felt[i] = data.oMf[sensor].rotation.T @ (true[i] - GRAVITY)
    np.testing.assert_allclose(in_base(kinematics, of, angles, felt, GRAVITY), true, rtol=0.0, atol=1e-10)
    assert float(np.max(np.abs(felt - true))) > 5.0  # what a reader without kinematics would be wrong by


def test_an_axis_that_moves_alone_shows_its_lever_times_its_acceleration():
    arm = any_arm(4, 5)
    mounting = loads(MOUNTING, Mounting)
    kinematics, of = Kinematics.of(arm), mounting.frame(arm)
    angles, speeds, rates = moving(arm, 5)
    for joint in range(5):
        still = np.tile(angles[0], (len(angles), 1))
        still[:, joint] = angles[:, joint]
        only = np.zeros_like(speeds)
        only[:, joint] = 1.0
        acceleration = acceleration_of(kinematics, still, speeds * only, rates * only, of)
        lever = float(np.linalg.norm(kinematics.jacobian(still[0], of)[:3, joint]))
        found = along_lever(kinematics, of, still, joint, acceleration)
        np.testing.assert_allclose(found, lever * rates[:, joint], rtol=0.0, atol=1e-10)


def test_a_joint_that_does_not_move_the_sensor_shows_nothing():
    arm = any_arm(4, 5)
    mounting = loads(f"axis = {arm.axes[1]}", Mounting)
    kinematics, of = Kinematics.of(arm), mounting.frame(arm)
    angles, _, _ = moving(arm, 5)
    assert not np.any(along_lever(kinematics, of, angles, 3, np.ones((len(angles), 3))))


def test_a_mounting_on_a_link_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="the accelerometer sits on axis 99; the arm has axes"):
        loads("axis = 99", Mounting).check_arm(any_arm(4, 5))
    with pytest.raises(FileError):
        loads("axis = 0", Mounting)


def test_a_misaligned_sensor_takes_its_weight_for_motion_and_a_known_misalignment_does_not():
    arm = any_arm(6, 3)
    kinematics, angles = Kinematics.of(arm), np.zeros((1, 3))
    true, believed = loads("misalignment_deg = [1.0, 0.0, 0.0]", Mounting), loads("", Mounting)
    _, frame = kinematics.pose(angles[0], true.frame(arm))
    felt = (frame.T @ -GRAVITY)[np.newaxis]
    assert float(np.linalg.norm(in_base(kinematics, true.frame(arm), angles, felt, GRAVITY))) < 1e-12
    wrong = float(np.linalg.norm(in_base(kinematics, believed.frame(arm), angles, felt, GRAVITY)))
    assert 0.0 < wrong <= 2.0 * math.sin(math.radians(0.5)) * float(np.linalg.norm(GRAVITY)) * (1.0 + 1e-9)
