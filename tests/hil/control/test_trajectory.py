"""Trajectories: what the motors are told is as smooth as it says, and the arm's kinematics invert."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import integrate

from hil.control.trajectory import ConstantAcceleration, Line, PlanarChain, Smooth, UnreachableError, sample_times

CHAIN = PlanarChain(0.050, 0.330, 0.440, (0.420, 0.035), 0.130)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_speed_rises_at_the_constant_rate_to_its_end_and_falls_to_rest(direction):
    move = ConstantAcceleration(4.0, 10.0, 20.0, dwell_s=0.2, tail_s=0.5, direction=direction)
    assert move.duration_s == pytest.approx(0.2 + 2.5 + 0.5 + 0.5)
    period = 1e-3
    revolutions = direction * move.motor_angle(sample_times(move.duration_s, period)) / (2.0 * math.pi)
    acceleration = np.diff(revolutions, 2) / period**2
    times = period * np.arange(1, len(revolutions) - 1)
    for begin, end, want in ((0.0, 0.2, 0.0), (0.2, 2.7, 4.0), (2.7, 3.2, -20.0), (3.2, 3.7, 0.0)):
        inside = (times > begin + 1.5 * period) & (times < end - 1.5 * period)
        np.testing.assert_allclose(acceleration[inside], want, atol=1e-6)
    assert np.max(np.diff(revolutions)) / period == pytest.approx(10.0, rel=1e-3)
    # the area under the speed's triangle
    assert revolutions[-1] == pytest.approx(0.5 * 10.0 * 3.0)


moves = st.floats(0.2, 10.0).flatmap(lambda duration: st.floats(0.02, 0.5).map(lambda share: Smooth(duration, share * duration)))


@given(moves)
def test_a_smooth_move_begins_at_0_ends_at_1_and_stays(move):
    t = np.array([-1.0, 0.0, 0.5 * move.duration_s, move.duration_s, move.duration_s + 5.0])
    np.testing.assert_allclose(move.position(t), [0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-12)


@given(moves)
def test_a_smooth_move_is_continuous_in_position_speed_and_acceleration(move):
    """Differences over a grid stay below the analytic maxima of speed, acceleration and jerk, from before to after."""
    v, r = move.peak_speed, move.ramp_s
    h = r / 200.0
    t = np.arange(-3.0 * h, move.duration_s + 4.0 * h, h)
    assume(len(t) < 50_000)
    s = move.position(t)
    tolerance = 1.0 + 1e-6
    rounding = 1e-15
    assert np.max(np.abs(np.diff(s))) <= tolerance * v * h
    assert np.max(np.abs(np.diff(s, 2))) <= tolerance * (2.0 * v / r) * h**2 + 4 * rounding
    # a step of the acceleration would show here as 2v/r h², a hundred times as much
    assert np.max(np.abs(np.diff(s, 3))) <= tolerance * (2.0 * math.pi * v / r**2) * h**3 + 8 * rounding
    assert np.min(np.diff(s)) >= -rounding


@given(moves, st.floats(0.0, 1.0))
def test_a_smooth_move_is_the_integral_of_its_raised_cosine(move, share):
    def speed(t):
        t = min(t, move.duration_s - t)
        rise = min(t / move.ramp_s, 1.0)
        return move.peak_speed * (rise - math.sin(2.0 * math.pi * rise) / (2.0 * math.pi))

    end = share * move.duration_s
    breaks = [b for b in (move.ramp_s, move.duration_s - move.ramp_s) if 0.0 < b < end]
    edges = [0.0, *breaks, end]
    want = sum(integrate.quad(speed, a, b)[0] for a, b in pairwise(edges))
    assert float(move.position(np.array(end))) == pytest.approx(want, abs=1e-7)


@pytest.mark.parametrize(("duration", "ramp"), [(1.0, 0.0), (1.0, 0.51), (1.0, -0.1), (0.0, 0.0)])
def test_ramps_that_do_not_fit_are_refused(duration, ramp):
    with pytest.raises(ValueError, match=f"ramps of {ramp} s"):
        Smooth(duration, ramp)


def test_sample_times_reach_the_end_and_no_further():
    assert sample_times(0.01, 0.002).tolist() == pytest.approx([0.0, 0.002, 0.004, 0.006, 0.008, 0.01])
    assert sample_times(0.0101, 0.002)[-1] == pytest.approx(0.012)
    assert len(sample_times(3.0, 250e-6)) == 12001


# elbow up: the line from elbow to wrist falls below the upper arm's own direction
BEND = math.atan2(0.035, 0.420)
joint_angles = st.tuples(st.floats(-0.5, 2.0), st.floats(-math.pi + 0.05, -0.05))


@given(joint_angles)
def test_the_inverse_kinematics_gives_back_the_joints_of_every_elbow_up_posture(angles):
    lean, fall = angles
    joints = np.array([lean, fall - BEND, 0.0])
    joints[2] = -0.5 * math.pi - CHAIN.link_angles(joints)[1]  # tool down
    again = CHAIN.joints(CHAIN.tip(joints))
    assert np.exp(1j * again) == pytest.approx(np.exp(1j * joints), abs=1e-7)


@pytest.mark.ci
@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.5))
def test_a_point_is_either_reached_exactly_or_refused_with_its_values(x, z):
    distance = math.hypot(x - 0.050, z + 0.130 - 0.330)
    reach, dead = 0.440 + math.hypot(0.420, 0.035), abs(0.440 - math.hypot(0.420, 0.035))
    assume(abs(distance - reach) > 1e-9)
    assume(abs(distance - dead) > 1e-9)
    if dead < distance < reach:
        joints = CHAIN.joints(np.array([x, z]))
        np.testing.assert_allclose(CHAIN.tip(joints), [x, z], atol=1e-7)
        assert CHAIN.link_angles(joints)[2] == pytest.approx(-0.5 * math.pi)
    else:
        with pytest.raises(UnreachableError) as caught:
            CHAIN.joints(np.array([x, z]))
        assert (caught.value.x_m, caught.value.z_m) == (x, z)
        assert caught.value.reach_m == pytest.approx(reach)
        assert f"x = {x:.3f} m" in str(caught.value)


def test_the_one_bad_point_of_a_path_is_named_and_nan_is_never_reached():
    with pytest.raises(UnreachableError) as caught:
        CHAIN.joints(np.array([[0.5, 0.45], [2.5, 0.3], [0.6, 0.45]]))
    assert (caught.value.x_m, caught.value.z_m) == (2.5, 0.3)
    with pytest.raises(UnreachableError):
        CHAIN.joints(np.array([math.nan, 0.45]))


@given(st.floats(-math.pi, math.pi))
def test_a_fully_stretched_arm_is_still_reached(angle):
    reach = 0.440 + math.hypot(0.420, 0.035)
    point = np.array([0.050 + (reach - 1e-16) * math.cos(angle), 0.2 + (reach - 1e-16) * math.sin(angle)])
    try:
        joints = CHAIN.joints(point)
    except UnreachableError:
        return  # rounding put it outside
    np.testing.assert_allclose(CHAIN.tip(joints), point, atol=1e-6)


def test_the_tip_follows_a_straight_line_at_the_moves_own_speed():
    line = Line(CHAIN, (0.50, 0.45), (0.75, 0.45), Smooth(2.2, 0.3), dwell_s=0.2, tail_s=0.6)
    assert line.duration_s == pytest.approx(3.0)
    t = sample_times(line.duration_s, 0.002)
    tip = CHAIN.tip(line.joints(t))
    np.testing.assert_allclose(tip[:, 1], 0.45, atol=1e-12)
    np.testing.assert_allclose(tip[:, 0], 0.50 + 0.25 * Smooth(2.2, 0.3).position(t - 0.2), atol=1e-12)
    assert np.ptp(tip[t <= 0.2], axis=0).tolist() == [0.0, 0.0]
    np.testing.assert_allclose(tip[t >= 2.4], [[0.75, 0.45]] * np.count_nonzero(t >= 2.4), atol=1e-12)


@given(st.floats(-20.0, 20.0), st.floats(0.1, 12.0), st.floats(0.5, 50.0))
def test_a_way_keeps_speed_and_acceleration_that_it_is_given(distance, speed, acceleration):
    way = Smooth.way(distance, speed, 0.3, acceleration)
    turned = distance * way.position(np.arange(0.0, way.duration_s + 0.01, 0.001))
    assert turned[-1] == pytest.approx(distance)
    assert np.max(np.abs(np.diff(turned))) <= 1.001e-3 * speed
    assert np.max(np.abs(np.diff(turned, 2))) <= 1.001e-6 * acceleration + 1e-12
