"""Kinematics of any arm, held against pinocchio: positions, Jacobians, accelerations, and the way back from a pose."""

import math

import numpy as np
import pinocchio as pin
import pytest

from hil.arm.kinematics import Kinematics, LinkFrame, rotation_vector
from hil.arm.rotation import rotation, turn
from tests.hil.arm.oracles import acceleration


def drawn(seed: int, count: int) -> Kinematics:
    """An arm with positions, frames and axes of its joints in any directions."""
    generator = np.random.default_rng(seed)
    axes = generator.standard_normal((count, 3))
    frames = np.stack([rotation(*generator.uniform(-3.0, 3.0, 3)) for _ in range(count)])
    tip = LinkFrame(count, generator.uniform(-0.2, 0.2, 3), rotation(*generator.uniform(-3.0, 3.0, 3)))
    return Kinematics(generator.uniform(-0.4, 0.4, (count, 3)), frames, axes / np.linalg.norm(axes, axis=1)[:, None], tip)


def in_pinocchio(arm: Kinematics):
    model, parent = pin.Model(), 0
    for position, frame, axis in zip(arm.origins_m, arm.frames, arm.axes, strict=True):
        joint = pin.JointModelRevoluteUnaligned(*axis)
        parent = model.addJoint(parent, joint, pin.SE3(frame, position), f"joint{parent + 1}")
    placement = pin.SE3(arm.tip.frame, arm.tip.origin_m)
    frame_id = model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.OP_FRAME))
    return model, model.createData(), frame_id


@pytest.mark.parametrize(("seed", "count"), [(1, 1), (2, 3), (3, 6), (4, 7)])
def test_pose_jacobian_and_acceleration_are_those_of_pinocchio(seed, count):
    arm = drawn(seed, count)
    model, data, tip = in_pinocchio(arm)
    generator = np.random.default_rng(100 + seed)
    angles, speeds, rates = generator.uniform(-3.0, 3.0, (3, 200, count))
    positions, frames = arm.pose(angles)
    jacobians, accelerations = arm.jacobian(angles), acceleration(arm, angles, speeds, rates)
    for i in range(200):
        pin.forwardKinematics(model, data, angles[i], speeds[i], rates[i])
        pin.updateFramePlacements(model, data)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        assert np.allclose(positions[i], data.oMf[tip].translation, rtol=0.0, atol=1e-12)
        assert np.allclose(frames[i], data.oMf[tip].rotation, rtol=0.0, atol=1e-12)
        expected = pin.computeFrameJacobian(model, data, angles[i], tip, world).reshape(6, count)
        assert np.allclose(jacobians[i], expected, rtol=0.0, atol=1e-12)
        pin.forwardKinematics(model, data, angles[i], speeds[i], rates[i])
        felt = pin.getFrameClassicalAcceleration(model, data, tip, world).linear
        assert np.allclose(accelerations[i], felt, rtol=1e-12, atol=1e-10)


def test_a_place_on_a_link_is_not_moved_by_the_joints_behind_it():
    arm = drawn(5, 6)
    position = LinkFrame(3, np.array([0.1, -0.2, 0.05]), np.eye(3))
    angles = np.random.default_rng(5).uniform(-2.0, 2.0, 6)
    jacobian = arm.jacobian(angles, position)
    assert not np.any(jacobian[:, 3:])
    assert np.all(np.linalg.norm(jacobian[:3, :3], axis=0) > 0.0)
    on_base = LinkFrame(0, np.array([1.0, 2.0, 3.0]), turn(np.array([0.0, 0.0, 1.0]), np.float64(0.3)))
    assert not np.any(arm.jacobian(angles, on_base))
    assert np.array_equal(arm.pose(angles, on_base)[0], on_base.origin_m)


def test_levers_stay_what_they_are_in_the_sensors_axes_while_one_joint_turns():
    arm = drawn(6, 6)
    angles = np.tile(np.random.default_rng(6).uniform(-2.0, 2.0, 6), (50, 1))
    for joint in range(6):
        turned = angles.copy()
        turned[:, joint] += np.linspace(-2.0, 2.0, 50)
        _, frames = arm.pose(turned)
        levers = (np.swapaxes(frames, -1, -2) @ arm.jacobian(turned)[:, :3])[:, :, joint]
        assert np.allclose(levers, levers[0], rtol=0.0, atol=1e-12)
        assert math.isclose(float(np.linalg.norm(levers[0])), float(np.linalg.norm(arm.jacobian(angles[0])[:3, joint])))


@pytest.mark.parametrize("count", [6, 7])
def test_poses_are_found_again_from_angles_that_are_near(count):
    arm = drawn(7, count)
    generator = np.random.default_rng(7)
    true = generator.uniform(-2.0, 2.0, (100, count))
    position, frame = arm.pose(true)
    angles, left = arm.solve(true + generator.uniform(-0.05, 0.05, true.shape), position, frame)
    is_regular = arm.condition(true, with_frame=True) < 100.0
    assert np.count_nonzero(is_regular) > 50
    assert float(np.max(np.abs(left[is_regular]))) < 1e-10
    if count == 6:
        assert float(np.max(np.abs(angles[is_regular] - true[is_regular]))) < 1e-7


def test_a_place_out_of_reach_leaves_the_distance_that_is_missing():
    arm = planar()
    wanted = np.array([1.5, 0.0, 0.0])
    angles, left = arm.solve(np.array([0.3, -0.5]), wanted, None, rounds=400)
    assert math.isclose(float(np.linalg.norm(left)), 0.5, rel_tol=1e-4)
    assert math.isclose(float(arm.pose(angles)[0][0]), 1.0, rel_tol=1e-4)


def planar() -> Kinematics:
    """Two links of 0.5 m whose axes are horizontal."""
    axes = np.array([[0.0, 1.0, 0.0]] * 2)
    return Kinematics(
        np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]),
        np.stack([np.eye(3)] * 2),
        axes,
        LinkFrame(2, np.array([0.5, 0.0, 0.0]), np.eye(3)),
    )


def test_a_stretched_arm_is_singular_and_a_planar_one_is_not_singular_everywhere():
    arm = planar()
    assert arm.rank(with_frame=False) == 2
    assert arm.rank(with_frame=True) == 2
    assert float(arm.condition(np.array([0.3, 1.0]), with_frame=False)) < 10.0
    assert float(arm.condition(np.array([0.3, 1e-9]), with_frame=False)) > 1e6


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, math.pi - 1e-4, math.pi - 1e-9, math.pi])
def test_a_rotation_gives_its_axis_times_its_angle(angle):
    axis = np.array([2.0, -1.0, 0.5]) / math.sqrt(5.25)
    found = rotation_vector(turn(axis, np.float64(angle)))
    assert np.allclose(turn_of(found), turn(axis, np.float64(angle)), rtol=0.0, atol=1e-7)
    assert math.isclose(float(np.linalg.norm(found)), angle, rel_tol=1e-6, abs_tol=1e-12)


def turn_of(vector: np.ndarray) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    return turn(vector / size if size else np.array([1.0, 0.0, 0.0]), np.float64(size))


def test_the_arm_as_a_line_goes_from_the_base_along_each_joints_axis_and_then_straight_to_the_tip():
    arm, angles = drawn(5, 4), np.random.default_rng(5).uniform(-3.0, 3.0, (7, 4))
    line = arm.skeleton(angles)
    assert line.shape == (7, 10, 3)
    rotations, origins = arm.links(angles)
    np.testing.assert_array_equal(line[:, 0], 0.0)
    np.testing.assert_allclose(line[:, 1:-1:2], origins, atol=1e-12)
    np.testing.assert_allclose(line[:, -1], arm.pose(angles)[0], atol=1e-12)
    for joint in range(4):
        axis = rotations[:, joint] @ arm.axes[joint]
        along, across = line[:, 2 * joint + 2] - line[:, 2 * joint + 1], line[:, 2 * joint + 3] - line[:, 2 * joint + 2]
        np.testing.assert_allclose(np.cross(along, axis), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.einsum("ij,ij->i", across, axis), 0.0, atol=1e-12)
