"""The compiled modes beside cyclic position: velocity, torque and profiles, their limits, their stops, and changes of mode."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_emulator.motion.record import (
    IN_POSITION,
    IN_SPEED,
    LIMITED_SPEED,
    LIMITED_TORQUE,
    MOVING,
    OUT_OF_RANGE,
    OVERSPEED,
    POSITION,
    PROFILE,
    PROFILE_TORQUE,
    PROFILE_VELOCITY,
    SET_POINT_LATE,
    STOPPED_RAD_S,
    STOPPING,
    TORQUE,
    VELOCITY,
)
from tests.plant_emulator.motion.test_period import COUNTS_PER_REV, NOTCHES, ROBOT, T, drive_at, energised, speed

TURN = 2.0 * math.pi
LIMIT_NM = ROBOT.axis[2].torque_limit_nm
POWERED = (POSITION, TORQUE, PROFILE, VELOCITY, PROFILE_VELOCITY, PROFILE_TORQUE)


def run(axes, periods, *fields):
    """Columns of what a row of the process data, or the plant's speed, was after each control period."""
    shown = np.empty((periods, len(fields)))
    for period in range(periods):
        axes.advance(1)
        shown[period] = [speed(axes) if field == "speed" else float(axes.motion[0][field]) for field in fields]
    return shown.T


def turning(mode, rps, **fields):
    """An axis at a speed in a mode."""
    axes = energised(PROFILE_VELOCITY)
    axes.motion[0]["target_speed_rad_s"] = TURN * rps
    axes.advance(4000)
    if mode != PROFILE_VELOCITY:
        axes.change_mode(0, mode, 8)
    for field, value in fields.items():
        axes.motion[0][field] = value
    return axes


# -- velocity ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rps", [3.0, -5.0])
def test_cyclic_velocity_turns_at_its_set_points(rps):
    axes = energised(VELOCITY)
    for step in range(400):
        axes.set_speed(0, TURN * rps * min(1.0, step / 200))
        axes.advance(8)
    (speeds,) = run(axes, 2000, "speed")
    assert np.mean(speeds) / TURN == pytest.approx(rps, abs=0.02)
    assert axes.motion[0]["following_error_rad"] == 0.0


def test_a_velocity_set_point_is_reached_in_a_straight_line_with_the_last_period_of_its_interval():
    axes = energised(VELOCITY, periods=4)
    shown = []
    for target in (4.0, 8.0, 8.0):
        axes.set_speed(0, target)
        shown += list(run(axes, 4, "demand_speed_rad_s")[0])
    assert shown == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 8.0, 8.0, 8.0, 8.0]


def test_an_early_velocity_set_point_leads_on_from_where_the_reference_is():
    axes = energised(VELOCITY, periods=4)
    axes.set_speed(0, 4.0)
    axes.advance(2)
    axes.set_speed(0, 10.0)
    assert axes.motion[0]["previous_speed_rad_s"] == 2.0


def test_the_velocity_offset_is_added_to_the_set_point_and_6080_limits_the_sum():
    axes = energised(VELOCITY)
    motion = axes.motion[0]
    motion["max_speed_rad_s"], motion["velocity_offset_rad_s"] = TURN * 4.0, TURN * 1.0
    for wanted, limited in ((2.0, 0), (5.0, LIMITED_SPEED), (-9.0, LIMITED_SPEED)):
        for step in range(1, 251):
            axes.set_speed(0, TURN * wanted * step / 250)
            axes.advance(8)
        want = math.copysign(min(4.0, abs(wanted + 1.0)), wanted)
        assert speed(axes) / TURN == pytest.approx(want, abs=0.15)
        assert motion["limited"] & LIMITED_SPEED == limited
        assert motion["mode"] == VELOCITY  # the loop's overshoot is no overspeed
        axes.set_speed(0, -TURN)
        axes.advance(2000)


@pytest.mark.parametrize("rps", [4.0, -4.0])
def test_profile_velocity_ramps_with_its_acceleration_and_deceleration(rps):
    axes = energised(PROFILE_VELOCITY)
    motion = axes.motion[0]
    motion["profile_acceleration_rad_s2"], motion["profile_deceleration_rad_s2"] = TURN * 10.0, TURN * 40.0
    motion["target_speed_rad_s"] = TURN * rps
    up, torques = run(axes, 4000, "demand_speed_rad_s", "torque_nm")
    assert np.count_nonzero(np.abs(np.diff(up)) > 1e-9) * T == pytest.approx(0.4, abs=2 * T)
    assert speed(axes) / TURN == pytest.approx(rps, abs=0.1)
    motion["target_speed_rad_s"] = -0.5 * TURN * rps
    down, _ = run(axes, 4000, "demand_speed_rad_s", "torque_nm")
    rates = np.diff(np.abs(down)) / T
    assert np.min(rates) == pytest.approx(-TURN * 40.0)
    assert np.max(rates) == pytest.approx(TURN * 10.0)
    assert speed(axes) / TURN == pytest.approx(-0.5 * rps, abs=0.1)
    assert np.max(np.abs(torques)) < LIMIT_NM


@pytest.mark.parametrize(
    ("field", "limit"),
    [("max_profile_speed_rad_s", TURN * 3.0), ("max_speed_rad_s", TURN * 3.0)],
    ids=["607F", "6080"],
)
@pytest.mark.parametrize("mode", [PROFILE, PROFILE_VELOCITY])
def test_607f_and_6080_limit_profiles_and_say_so(mode, field, limit):
    axes = energised(mode)
    motion = axes.motion[0]
    motion[field] = limit
    motion["target_speed_rad_s"], motion["target_counts"] = TURN * 6.0, 20 * COUNTS_PER_REV
    demands, limited, speeds = run(axes, 4000, "demand_speed_rad_s", "limited", "speed")
    assert np.max(demands) == pytest.approx(limit)
    assert np.max(speeds) < 1.1 * limit
    assert limited[-1] == LIMITED_SPEED
    assert motion["mode"] == mode
    motion["target_speed_rad_s"] = TURN * 2.0
    motion["target_counts"] = motion["reference_rad"] * motion["counts_per_rad"]
    axes.advance(4000)
    assert not motion["limited"] & LIMITED_SPEED


def test_60c5_and_60c6_limit_the_ramps_of_profiles_and_the_quick_stop():
    axes = energised(PROFILE_VELOCITY)
    motion = axes.motion[0]
    motion["max_acceleration_rad_s2"], motion["max_deceleration_rad_s2"] = TURN * 5.0, TURN * 8.0
    motion["target_speed_rad_s"] = TURN * 4.0
    (demands,) = run(axes, 4000, "demand_speed_rad_s")
    assert np.max(np.diff(demands)) / T == pytest.approx(TURN * 5.0)
    axes.change_mode(0, PROFILE)
    motion["target_counts"] += 4 * COUNTS_PER_REV
    (demands,) = run(axes, 6000, "demand_speed_rad_s")
    moving = demands[demands > 0.0][:-2]  # the last period may take up the rest of the way
    assert np.min(np.diff(moving)) / T >= -TURN * 8.0 * 1.001
    axes = turning(PROFILE_VELOCITY, 4.0, max_deceleration_rad_s2=TURN * 8.0)
    axes.stop(0, TURN * 50.0)
    (demands,) = run(axes, 3000, "demand_speed_rad_s")
    assert np.min(np.diff(demands)) / T == pytest.approx(-TURN * 8.0)
    assert axes.motion[0]["stopped"] == 1


@pytest.mark.parametrize("mode", [VELOCITY, PROFILE_VELOCITY, TORQUE, PROFILE_TORQUE])
def test_the_position_range_holds_in_velocity_and_torque_modes(mode):
    axes = energised(mode)
    motion = axes.motion[0]
    motion["low_counts"], motion["high_counts"] = -COUNTS_PER_REV, COUNTS_PER_REV
    motion["target_torque_nm"], motion["torque_slope_nm_s"] = 0.5, 10.0
    motion["target_speed_rad_s"] = motion["previous_speed_rad_s"] = TURN * 3.0
    axes.advance(4000)
    assert motion["trip"] == OUT_OF_RANGE
    assert motion["mode"] == STOPPING
    axes.advance(4000)
    assert motion["stopped"] == 1
    assert abs(axes.counts(0)) < 4 * COUNTS_PER_REV


def test_overspeed_trips_a_velocity_mode_only_beyond_the_overshoot_of_its_loop():
    axes = turning(VELOCITY, 4.0)
    axes.motion[0]["max_speed_rad_s"] = TURN * 3.8
    axes.advance(1)
    assert axes.motion[0]["trip"] == 0
    axes.motion[0]["max_speed_rad_s"] = TURN * 3.0
    axes.advance(1)
    assert axes.motion[0]["trip"] == OVERSPEED


# -- torque ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", POWERED)
def test_the_torque_keeps_to_its_own_limit_either_way(mode):
    """60E0h and 60E1h: the motor is asked for more than either."""
    axes = energised(mode)
    motion = axes.motion[0]
    motion["torque_high_nm"], motion["torque_low_nm"] = 0.5, -0.25
    motion["profile_acceleration_rad_s2"] = motion["profile_deceleration_rad_s2"] = TURN * 500.0
    seen = []
    for sign in (1.0, -1.0):
        motion["target_torque_nm"], motion["torque_slope_nm_s"] = sign * 3.0, 1e3
        motion["target_counts"] = motion["previous_counts"] = sign * 5 * COUNTS_PER_REV
        motion["target_speed_rad_s"] = motion["previous_speed_rad_s"] = sign * TURN * 6.0
        torques, limited = run(axes, 200, "torque_nm", "limited")
        seen += [np.max(torques), np.min(torques)]
        at_limit = (torques == 0.5) | (torques == -0.25)
        assert np.array_equal(limited.astype(int) & LIMITED_TORQUE != 0, at_limit)
    assert max(seen) == 0.5
    assert min(seen) == -0.25


def test_the_integrator_does_not_wind_up_at_a_one_sided_limit():
    axes = energised(PROFILE_VELOCITY)
    motion = axes.motion[0]
    motion["torque_high_nm"], motion["profile_acceleration_rad_s2"] = 0.3, TURN * 500.0
    motion["target_speed_rad_s"] = TURN * 6.0
    axes.advance(200)
    assert motion["limited"] & LIMITED_TORQUE
    assert axes.cascade_state[0]["integral_nm"] <= 0.3


def test_profile_torque_rises_with_its_slope():
    axes = energised(PROFILE_TORQUE)
    motion = axes.motion[0]
    motion["target_torque_nm"], motion["torque_slope_nm_s"], motion["torque_offset_nm"] = 0.4, 2.0, 5.0
    torques, demands = run(axes, 1000, "torque_nm", "torque_demand_nm")
    assert np.array_equal(torques, demands)
    assert np.diff(torques)[:790] == pytest.approx(2.0 * T)  # 0.2 s
    assert torques[-1] == 0.4
    motion["target_torque_nm"] = -0.1
    (torques,) = run(axes, 1100, "torque_nm")
    assert np.min(np.diff(torques)) == pytest.approx(-2.0 * T)
    assert torques[-1] == -0.1


@settings(max_examples=25)
@given(data=st.data())
def test_no_set_point_breaks_the_torque_limits_the_slope_or_the_numbers(data):
    wild = st.floats(-1e9, 1e9) | st.sampled_from([0.0, 2.0**31 - 1, -(2.0**31)])
    axes = energised(data.draw(st.sampled_from(POWERED)), notches=NOTCHES)
    motion = axes.motion[0]
    high, low = data.draw(st.floats(0.0, LIMIT_NM)), -data.draw(st.floats(0.0, LIMIT_NM))
    slope = data.draw(st.floats(1e-3, 1e4))
    motion["torque_high_nm"], motion["torque_low_nm"], motion["torque_slope_nm_s"] = high, low, slope
    motion["max_speed_rad_s"] = data.draw(st.sampled_from([math.inf, TURN * 5.0]))
    motion["extrapolation_periods"] = data.draw(st.sampled_from([0, 16]))
    for _ in range(4):
        for field in ("target_torque_nm", "torque_offset_nm", "velocity_offset_rad_s"):
            motion[field] = data.draw(wild)
        match int(motion["mode"]):
            case 1:
                axes.set_point(0, round(data.draw(wild)))
            case 5:
                axes.set_speed(0, data.draw(wild))
            case 3:
                motion["target_counts"] = round(data.draw(wild))
            case 6:
                motion["target_speed_rad_s"] = data.draw(wild)
        before = float(motion["torque_demand_nm"])
        is_sloped = motion["mode"] == PROFILE_TORQUE
        for _ in range(30):
            axes.advance(1)
            torque = float(motion["torque_nm"])
            assert low <= torque <= high
            if is_sloped and motion["mode"] == PROFILE_TORQUE and low <= before <= high:
                assert abs(torque - before) <= slope * T * (1.0 + 1e-9) + 1e-12
            before = torque
        if motion["mode"] != STOPPING:
            axes.change_mode(0, data.draw(st.sampled_from(POWERED)), 8)
        for array in (axes.plant_state, axes.cascade_state):
            assert all(np.all(np.isfinite(array[name])) for name in array.dtype.names)
        shown = ("demand_rad", "demand_speed_rad_s", "torque_demand_nm", "following_error_rad", "reference_rad")
        assert all(math.isfinite(motion[name]) for name in shown)


# -- going over from one mode to another -------------------------------------------------------------------------------


@pytest.mark.parametrize("rps", [0.0, 4.0, -4.0])
@pytest.mark.parametrize("after", POWERED)
@pytest.mark.parametrize("before", POWERED)
def test_a_mode_begins_without_a_jump_of_the_torque(before, after, rps):
    axes = turning(before, rps) if rps else energised(before)
    motion = axes.motion[0]
    axes.advance(2)
    torque = float(motion["torque_nm"])
    axes.change_mode(0, after, 8)
    axes.advance(1)
    # the encoder's ripple in the velocity loop is 0.03 N·m; K_vp v would be 4.9 N·m
    assert motion["torque_nm"] == pytest.approx(torque, abs=0.1)
    assert motion["mode"] == after


@pytest.mark.parametrize("before", [VELOCITY, PROFILE_VELOCITY, TORQUE, PROFILE_TORQUE, POSITION])
def test_profile_position_begins_with_a_stop_on_its_own_ramp(before):
    axes = turning(before, 4.0)
    axes.change_mode(0, PROFILE)
    demands, angles = run(axes, 4000, "demand_speed_rad_s", "demand_rad")
    assert np.min(demands) >= -TURN * 0.05  # it does not come back
    assert demands[-1] == 0.0
    assert np.max(np.diff(angles)) / T <= TURN * 4.4
    assert axes.motion[0]["reached"] & IN_POSITION


def test_profile_velocity_goes_on_at_the_present_demand():
    axes = turning(PROFILE_VELOCITY, 4.0)
    axes.change_mode(0, PROFILE)
    axes.advance(10)
    demand = float(axes.motion[0]["demand_speed_rad_s"])
    axes.change_mode(0, PROFILE_VELOCITY)
    assert axes.motion[0]["target_speed_rad_s"] == demand
    (demands,) = run(axes, 100, "demand_speed_rad_s")
    assert demands == pytest.approx(demand)


def test_cyclic_position_begins_where_the_motor_stands():
    axes = turning(PROFILE_VELOCITY, 4.0)
    axes.change_mode(0, POSITION, 8)
    assert axes.motion[0]["target_counts"] == pytest.approx(axes.counts(0), abs=300)
    drive_at(axes, 4.0, 0.4, rate_rps_s=1e6)  # a master that leads on from there is followed
    assert axes.motion[0]["trip"] == 0
    assert speed(axes) / TURN == pytest.approx(4.0, rel=0.05)


def test_a_closed_brake_is_no_mode_to_change_from():
    axes = energised(PROFILE)
    axes.motion[0]["mode"] = 0
    with pytest.raises(ValueError, match="brake"):
        axes.change_mode(0, POSITION)


# -- stops -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", POWERED)
@pytest.mark.parametrize("rps", [4.0, -4.0])
def test_a_stop_with_all_torque_takes_as_long_as_the_inertia_makes_it(mode, rps):
    axes = turning(mode, rps)
    motion = axes.motion[0]
    motion["torque_high_nm"], motion["torque_low_nm"] = 1.0, -0.8
    axes.stop(0, math.inf)
    torques, directions, speeds = run(axes, 3000, "torque_nm", "stop_direction", "speed")
    braking = int(np.count_nonzero(directions))
    assert 4 < braking < 1000
    assert np.all(torques[: braking - 1] == (-0.8 if rps > 0.0 else 1.0))
    assert np.all(np.sign(speeds[: braking - 3]) == np.sign(rps))
    assert motion["stopped"] == 1
    assert abs(speeds[-1]) < STOPPED_RAD_S
    assert motion["demand_speed_rad_s"] == 0.0
    assert motion["stop_periods"] < 8000
    assert np.max(torques) <= 1.0
    assert np.min(torques) >= -0.8


def test_a_stop_with_all_torque_is_shorter_than_one_on_the_ramp():
    ways = []
    for deceleration in (math.inf, TURN * 50.0):
        axes = turning(PROFILE_VELOCITY, 6.0)
        start = axes.counts(0)
        axes.stop(0, deceleration)
        axes.advance(3000)
        assert axes.motion[0]["stopped"] == 1
        ways.append(abs(axes.counts(0) - start))
    assert ways[0] < 0.7 * ways[1]


def test_a_standing_motor_that_is_stopped_with_all_torque_stays_where_it_is():
    axes = energised(PROFILE)
    axes.advance(400)
    start = axes.counts(0)
    axes.stop(0, math.inf)
    (torques,) = run(axes, 400, "torque_nm")
    assert np.max(np.abs(torques)) < 0.2
    assert abs(axes.counts(0) - start) < 100
    assert axes.motion[0]["stopped"] == 1


def test_a_stop_for_which_the_limits_leave_no_torque_counts_its_patience():
    axes = turning(PROFILE_VELOCITY, 4.0, torque_high_nm=0.0, torque_low_nm=0.0)
    axes.plant["coulomb_friction_nm"] = axes.plant["static_friction_nm"] = axes.plant["motor_damping_nm_s_rad"] = 0.0
    axes.stop(0, math.inf)
    axes.advance(4000)
    assert axes.motion[0]["stopped"] == 0
    assert axes.motion[0]["stop_periods"] > 1000


# -- windows -----------------------------------------------------------------------------------------------------------


def test_a_position_is_reached_after_it_has_been_within_its_window_for_its_time():
    axes = energised(PROFILE)
    motion = axes.motion[0]
    motion["position_window_rad"], motion["position_window_periods"] = 0.01, 40
    motion["target_counts"] = COUNTS_PER_REV
    reached, references = [], []
    near = 0
    for _ in range(6000):
        angle = axes.counts(0) / motion["counts_per_rad"]
        axes.advance(1)
        reached.append(bool(motion["reached"] & IN_POSITION))
        references.append(float(motion["reference_rad"]))
        is_near = references[-1] == pytest.approx(TURN, abs=1e-9) and abs(angle - TURN) <= 0.01
        near = near + 1 if is_near else 0
        assert reached[-1] == (near > 40)
    assert reached[-1]
    assert not reached[references.index(references[-1]) + 20]


def test_a_speed_is_reached_and_a_motor_stands_after_their_times():
    axes = energised(PROFILE_VELOCITY)
    motion = axes.motion[0]
    motion["velocity_window_rad_s"], motion["velocity_window_periods"] = 1.0, 80
    motion["velocity_threshold_rad_s"], motion["velocity_threshold_periods"] = 3.0, 20
    motion["target_speed_rad_s"] = TURN * 3.0
    near = above = 0
    for _ in range(3000):
        axes.advance(1)
        shown = float(axes.cascade_state[0]["speed_rad_s"])
        near = near + 1 if abs(shown - TURN * 3.0) <= 1.0 else 0
        above = above + 1 if abs(shown) > 3.0 else 0
        assert bool(motion["reached"] & IN_SPEED) == (near > 80)
        assert bool(motion["reached"] & MOVING) == (above > 20)
    assert motion["reached"] == IN_SPEED | MOVING
    motion["target_speed_rad_s"] = 0.0
    axes.advance(4000)
    assert motion["reached"] == IN_SPEED


# -- set-points that do not come ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [POSITION, VELOCITY])
def test_a_missing_set_point_is_made_up_for_with_the_last_velocity_and_then_trips(mode):
    axes = energised(mode)
    motion = axes.motion[0]
    motion["extrapolation_periods"] = 32
    if mode == POSITION:
        drive_at(axes, 4.0, 0.5)
    else:
        for step in range(250):
            axes.set_speed(0, TURN * 4.0 * min(1.0, step / 125))
            axes.advance(8)
    assert (motion["trip"], motion["late_periods"]) == (0, 0)
    demands, late, trips = run(axes, 33, "demand_speed_rad_s", "late_periods", "trip")
    assert demands[:32] == pytest.approx(TURN * 4.0, rel=2e-3)
    assert list(late) == list(range(1, 34))
    assert not np.any(trips[:32])
    assert trips[32] == SET_POINT_LATE
    axes.advance(2000)
    assert motion["stopped"] == 1


@pytest.mark.parametrize("mode", [POSITION, VELOCITY])
def test_nothing_is_late_before_the_first_set_point(mode):
    axes = energised(mode)
    axes.motion[0]["extrapolation_periods"] = 8
    axes.advance(4000)
    assert axes.motion[0]["trip"] == 0
    (axes.set_point if mode == POSITION else axes.set_speed)(0, 0)
    axes.advance(17)
    assert axes.motion[0]["trip"] == SET_POINT_LATE


def test_a_late_set_point_leads_on_from_where_the_reference_has_been_led():
    axes = energised(periods=8)
    axes.motion[0]["extrapolation_periods"] = 16
    axes.set_point(0, 800)
    axes.advance(12)
    assert axes.motion[0]["demand_rad"] * axes.motion[0]["counts_per_rad"] == pytest.approx(1200.0)
    axes.set_point(0, 1600)
    assert axes.motion[0]["previous_counts"] == 1200.0


def test_without_a_time_out_the_last_set_point_is_held_for_ever():
    axes = energised(VELOCITY)
    axes.set_speed(0, TURN)
    axes.advance(8000)
    assert axes.motion[0]["trip"] == 0
    assert speed(axes) / TURN == pytest.approx(1.0, abs=0.1)
