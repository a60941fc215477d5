"""A straight line of any arm's tip: exact, held against the planar chain, and refused where the arm cannot follow it."""

import math

import numpy as np
import pytest

from hil.arm.kinematics import Kinematics, LinkFrame
from hil.arm.rotation import turn
from hil.arm.straight_line import JointLimits, LineError, Pose, StraightLine
from hil.control.trajectory import Line, PlanarChain, Smooth, sample_times

CHAIN = PlanarChain(0.05, 0.33, 0.44, (0.42, 0.035), 0.13)
X, Y, Z = np.eye(3)
NAMES = tuple(f"axis {number}" for number in range(1, 7))
START, END = (0.50, 0.45), (0.75, 0.45)


def six_axes() -> Kinematics:
    """The planar chain's links with a turning base, a turning forearm and a turning tool."""
    places = np.array([[0, 0, 0], [0.05, 0, 0.33], [0, 0, 0.44], [0.2, 0, 0.035], [0.22, 0, 0], [0.06, 0, 0]])
    return Kinematics(
        places, np.stack([np.eye(3)] * 6), np.array([Z, Y, -Y, X, -Y, X]), LinkFrame(6, np.array([0.07, 0, 0]), np.eye(3))
    )


def in_six(planar: np.ndarray) -> np.ndarray:
    """Angles of the six axes for those of the chain, which counts the elbow from the upper arm."""
    q = np.zeros((*planar.shape[:-1], 6))
    q[..., 1], q[..., 2], q[..., 4] = planar[..., 0], planar[..., 1] + 0.5 * math.pi, planar[..., 2]
    return q


HOME = in_six(CHAIN.joints(np.array(START)))
DOWN = six_axes().pose(HOME)[1]


def line(end: tuple[float, float, float], *, is_free: bool = False, end_frame: np.ndarray | None = None) -> StraightLine:
    frame = None if is_free else DOWN
    start = Pose(np.array([START[0], 0.0, START[1]]), frame)
    finish = Pose(np.array(end), None if is_free else DOWN if end_frame is None else end_frame)
    return StraightLine(six_axes(), HOME, start, finish, Smooth(2.2, 0.3), 0.2, 0.6, NAMES)


@pytest.mark.ci
def test_a_line_in_the_arms_plane_is_that_of_the_planar_chain():
    planar = Line(CHAIN, START, END, Smooth(2.2, 0.3), 0.2, 0.6)
    times = sample_times(planar.duration_s, 0.002)
    found = line((END[0], 0.0, END[1])).joints(times)
    assert float(np.max(np.abs(found - in_six(planar.joints(times))))) < 1e-12


@pytest.mark.ci
@pytest.mark.parametrize("is_free", [False, True])
def test_the_tip_stays_on_the_line_and_its_axes_as_they_were(is_free):
    wanted = line((0.55, 0.22, 0.38), is_free=is_free)
    times = sample_times(wanted.duration_s, 0.002)
    position, frame = wanted.arm.pose(wanted.joints(times))
    along = wanted.end.position_m - wanted.start.position_m
    s = wanted.move.position(times - wanted.dwell_s)
    assert float(np.max(np.abs(position - (wanted.start.position_m + s[:, None] * along)))) < 1e-9
    assert is_free or float(np.max(np.abs(frame - DOWN))) < 1e-9


def test_the_joints_accelerate_smoothly_between_the_steps_of_the_walk():
    wanted = line((0.55, 0.22, 0.38))
    times = sample_times(wanted.duration_s, 0.0005)
    jerk = np.diff(wanted.joints(times), 3, axis=0) / 0.0005**3
    assert float(np.max(np.abs(jerk))) < 400.0  # a raised cosine over 0.3 s has 23 rad/s³ for each rad/s² of its peak


def test_a_tool_turns_at_the_pace_of_the_way():
    turned = turn(Z, np.float64(0.8)) @ DOWN
    wanted = line((0.6, 0.1, 0.45), end_frame=turned)
    half = wanted.angles(np.array([0.0, 0.5, 1.0]))
    frames = wanted.arm.pose(half)[1]
    assert np.allclose(frames[1], turn(Z, np.float64(0.4)) @ DOWN, rtol=0.0, atol=1e-7)
    assert np.allclose(frames[2], turned, rtol=0.0, atol=1e-7)


@pytest.mark.slow
def test_a_line_out_of_the_workspace_is_refused_where_it_leaves_it():
    with pytest.raises(LineError, match=r"does not bring its tip to x = 0\.87") as caught:
        line((1.2, 0.0, 0.45)).joints(np.zeros(1))
    reach = 0.05 + math.sqrt((0.44 + math.hypot(0.42, 0.035)) ** 2 - (0.45 + 0.13 - 0.33) ** 2)
    assert math.isclose(caught.value.at_m, reach - 0.5, abs_tol=0.003)
    assert f"{100.0 * caught.value.fraction:.3g} %" in str(caught.value)
    assert "mm" in str(caught.value)


@pytest.mark.slow
def test_a_line_through_a_singular_posture_is_refused_with_the_joints_that_would_whirl():
    with pytest.raises(LineError, match="axis 1 and axis 6 would turn without moving the tip") as caught:
        line((-0.5, 0.0, 0.45)).joints(np.zeros(1))  # through the axis of the base
    assert 0.45 < caught.value.fraction < 0.5


def test_an_arm_with_too_few_joints_cannot_hold_its_tool():
    six = six_axes()
    arm = Kinematics(six.origins_m[:3], six.frames[:3], six.axes[:3], LinkFrame(3, np.array([0.5, 0.0, 0.0]), np.eye(3)))
    angles = np.radians([0.0, 20.0, -30.0])
    position, frame = arm.pose(angles)

    def to(end: np.ndarray, frame: np.ndarray | None) -> StraightLine:
        return StraightLine(arm, angles, Pose(position, frame), Pose(end, frame), Smooth(1.0, 0.2), 0.0, 0.0, NAMES)

    with pytest.raises(LineError, match="in the required direction"):
        to(position + np.array([-0.1, 0.1, 0.0]), frame).joints(np.zeros(1))
    end = to(position + np.array([-0.1, 0.1, 0.0]), None).angles(np.ones(1))
    assert np.allclose(arm.pose(end[0])[0], position + np.array([-0.1, 0.1, 0.0]), rtol=0.0, atol=1e-9)


FREE = JointLimits(-10.0, 10.0, 100.0)


@pytest.mark.ci
def test_a_joint_beyond_its_limit_is_refused_with_its_name_and_place():
    wanted = line((0.75, 0.0, 0.45))
    end = float(wanted.angles(np.ones(1))[0, 1])
    limits = [FREE, JointLimits(-10.0, 0.5 * (float(HOME[1]) + end), 100.0), *[FREE] * 4]
    with pytest.raises(LineError, match=r"axis 2 would be at .*°; its limits are") as caught:
        wanted.check_limits(limits, 0.002)
    assert 0.0 < caught.value.fraction < 1.0
    wanted.check_limits([FREE] * 6, 0.002)


@pytest.mark.ci
def test_a_joint_that_is_too_fast_is_refused_with_a_duration_that_is_not():
    wanted = line((0.75, 0.0, 0.45))
    times = sample_times(wanted.duration_s, 0.002)
    most = float(np.max(np.abs(np.gradient(wanted.joints(times)[:, 1], 0.002))))
    limits = [FREE, JointLimits(-10.0, 10.0, 0.8 * most), *[FREE] * 4]
    with pytest.raises(LineError, match=r"axis 2 would turn at up to .* duration_s 2\.8 or more"):
        wanted.check_limits(limits, 0.002)
