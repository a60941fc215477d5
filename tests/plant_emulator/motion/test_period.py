"""The drive's control period: set-points, the very law of the host, limits that trip into a ramp to rest."""

import math

import numpy as np
import pytest

from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import Servo, ServoConfig
from hil.control.trajectory import ConstantAcceleration
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import (
    BRAKED,
    FOLLOWING,
    OUT_OF_RANGE,
    OVERSPEED,
    POSITION,
    PROFILE,
    SET_POINT_RANGE,
    SET_POINT_STEP,
    STOPPED_RAD_S,
    STOPPING,
    TORQUE,
)
from plant_emulator.robots.robot import load_robot

ROBOT = load_robot("reference")
T = ROBOT.control_period_s
GAINS = {2: (25.0, 0.196, 3.92, 300.0), 3: (25.0, 0.0905, 1.81, 300.0), 5: (25.0, 0.0188, 0.376, 300.0)}
COUNTS_PER_REV = 131072
STUCK = 20  # counts: where friction leaves the axis until the integrator has gathered its torque
NOTCHES = (Notch(), Notch(order=4, start_rps=2.2, end_rps=3.6, offset_hz=0.6))


def energised(mode=POSITION, periods=8, numbers=(2,), notches=()):
    """Axes with their brakes open, and limits as a drive has them."""
    axes = Axes(ROBOT)
    for number in numbers:
        row = axes.row(number)
        Cascade(*GAINS[number]).write(axes.cascade_config[row])
        for column, notch in enumerate(notches):
            notch.write(axes.notch_config[row, column])
        motion = axes.motion[row]
        motion["stop_deceleration_rad_s2"] = 2.0 * math.pi * 50.0
        motion["profile_speed_rad_s"], motion["profile_acceleration_rad_s2"] = 2.0 * math.pi * 6.0, 2.0 * math.pi * 20.0
        motion["profile_deceleration_rad_s2"] = 2.0 * math.pi * 40.0
        axes.open_brake(row, mode, periods)
    return axes


def drive_at(axes, speed_rps, seconds, row=0, rate_rps_s=20.0):
    """Cyclic set-points up to a constant speed, for some time; returns the revolutions reached."""
    periods = int(axes.motion[row]["periods_per_set_point"])
    revolutions = float(axes.motion[row]["target_counts"]) / COUNTS_PER_REV
    speed = 0.0
    for _ in range(round(seconds / (periods * T))):
        speed = math.copysign(min(abs(speed_rps), abs(speed) + rate_rps_s * periods * T), speed_rps)
        revolutions += speed * periods * T
        axes.set_point(row, round(revolutions * COUNTS_PER_REV))
        axes.advance(periods)
    return revolutions


def speed(axes, row=0):
    return float(axes.plant_state[row]["motor_speed_rad_s"])


@pytest.mark.parametrize("notches", [(), NOTCHES], ids=["bare", "two notches"])
@pytest.mark.parametrize("number", [2, 3])
def test_the_drive_computes_the_very_bits_of_the_hosts_law(number, notches):
    axes = energised(numbers=(number,), periods=1, notches=notches)
    row, k = axes.row(number), COUNTS_PER_REV / (2.0 * math.pi)
    host = Servo(ServoConfig(Cascade(*GAINS[number]), ROBOT.axis[number].torque_limit_nm, notches), T)
    host.start(axes.counts(row) / k)
    # fast through both ranges, up and down again
    move = ConstantAcceleration(10.0, 10.0, 10.0, 0.02, 0.1)
    targets = np.round(move.motor_angle(T * np.arange(round(move.duration_s / T))) * k)
    acted = 0
    for i, target in enumerate(targets):
        velocity_offset, torque_offset = 0.5 * math.sin(0.01 * i), 0.1 * math.cos(0.003 * i)
        axes.motion[row]["velocity_offset_rad_s"] = velocity_offset
        axes.motion[row]["torque_offset_nm"] = torque_offset
        axes.set_point(row, int(target))
        angle = axes.counts(row) / axes.motion[row]["counts_per_rad"]
        axes.advance(1)
        position = target / axes.motion[row]["counts_per_rad"]
        want = host.step(position, angle, velocity_offset, torque_offset)
        assert axes.motion[row]["torque_nm"] == want, i
        acted += int(host.notch_state["active"].any())
    assert (acted > 1000) == bool(notches)


@pytest.mark.parametrize("row", [0, 1])
def test_the_encoder_shows_the_nearest_count(row):
    axes = energised(numbers=(2, 3))
    k = float(axes.motion["counts_per_rad"][row])
    for angle in np.linspace(-9.0, 9.0, 721):
        axes.plant_state["motor_angle_rad"][row] = angle
        assert abs(axes.counts(row) / k - angle) <= 0.5 / k * (1.0 + 1e-9)


def test_a_set_point_is_reached_in_a_straight_line_with_the_last_period_of_its_interval():
    axes = energised(periods=4)
    axes.motion[0]["following_window_rad"] = 1e-9
    shown = []
    for target in (400, 800, 800):
        axes.set_point(0, target)
        for _ in range(4):
            angle = axes.counts(0) / axes.motion[0]["counts_per_rad"]
            axes.advance(1)
            position = axes.motion[0]["following_error_rad"] + angle
            shown.append(round(float(position * axes.motion[0]["counts_per_rad"]), 6))
    assert shown == [100, 200, 300, 400, 500, 600, 700, 800, 800, 800, 800, 800]


def test_without_a_new_set_point_the_axis_holds_the_last():
    axes = energised()
    axes.set_point(0, 2000)
    axes.advance(8000)
    assert axes.counts(0) == pytest.approx(2000, abs=STUCK)
    assert axes.motion[0]["trip"] == 0


def test_an_early_set_point_leads_on_from_where_the_reference_is():
    axes = energised(periods=8)
    axes.set_point(0, 800)
    axes.advance(4)
    axes.set_point(0, 1600)
    assert axes.motion[0]["previous_counts"] == 400.0


def test_in_torque_mode_the_torque_is_the_target_and_the_offset_within_the_limit():
    axes = energised(TORQUE)
    for target, offset, want in ((0.5, 0.2, 0.7), (100.0, 0.0, 7.1), (-100.0, 1.0, -7.1)):
        axes.motion[0]["target_torque_nm"], axes.motion[0]["torque_offset_nm"] = target, offset
        axes.advance(1)
        assert axes.motion[0]["torque_nm"] == pytest.approx(want)


@pytest.mark.parametrize("revolutions", [3.0, -3.0, 0.01])
def test_a_profile_reaches_its_target_within_its_speed_and_accelerations_and_stops(revolutions):
    axes = energised(PROFILE)
    motion = axes.motion[0]
    motion["target_counts"] = round(revolutions * COUNTS_PER_REV)
    references = []
    for _ in range(8000):
        axes.advance(1)
        references.append(float(motion["reference_rad"]))
    rates = np.diff(references) / T
    assert np.max(np.abs(rates)) <= 2.0 * math.pi * 6.0 * (1.0 + 1e-9)
    # the last period may take up the rest of the way
    accelerations = np.diff(rates[np.abs(rates) > 0.0])[:-2] / T
    assert np.max(np.abs(accelerations), initial=0.0) <= 2.0 * math.pi * 40.0 * 1.05
    assert np.min(np.sign(revolutions) * rates) >= 0.0  # never backwards
    assert references[-1] == pytest.approx(2.0 * math.pi * revolutions, abs=1e-4)
    assert axes.counts(0) == pytest.approx(revolutions * COUNTS_PER_REV, abs=STUCK)


def test_a_closed_brake_forgets_what_the_law_had_learnt():
    axes = energised(notches=NOTCHES)
    drive_at(axes, 6.0, 1.0)
    assert axes.notch_state[0, 0]["active"] == 1
    axes.motion[0]["mode"] = BRAKED
    axes.advance(1)
    assert speed(axes) == 0.0
    assert axes.motion[0]["torque_nm"] == 0.0
    assert not axes.notch_state["active"].any()
    assert axes.cascade_state[0]["integral_nm"] == 0.0


def comes_to_rest(axes, row=0, decay_rps_s=50.0):
    """Whether an axis that stops does so along its ramp; the speeds on the way."""
    start = speed(axes, row)
    seconds = abs(start) / (2.0 * math.pi * decay_rps_s)
    speeds = []
    for _ in range(round((seconds + 1.0) / T)):
        axes.advance(1)
        speeds.append(speed(axes, row))
        assert axes.motion[row]["mode"] == STOPPING
    assert axes.motion[row]["stopped"] == 1
    assert axes.motion[row]["reference_speed_rad_s"] == 0.0
    assert abs(speeds[-1]) < STOPPED_RAD_S
    # the way of the ramp, and what the position loop's lag of v/K_pp adds
    travelled = abs(float(np.sum(speeds))) * T
    assert travelled == pytest.approx(0.5 * abs(start) * seconds + abs(start) / 25.0, rel=0.1, abs=0.05)
    return speeds


def test_a_following_error_that_lasts_trips_into_a_ramp_to_rest():
    axes = energised()
    drive_at(axes, 5.0, 0.6)
    motion = axes.motion[0]
    assert motion["trip"] == 0
    # in steady motion the axis runs v/K_pp = 0.2 rev behind: a window below that is a following error
    motion["following_window_rad"], motion["following_periods"] = 2.0 * math.pi * 0.1, 40
    periods = 0
    while not motion["trip"] and periods < 100:
        periods += 1
        axes.motion[0]["target_counts"] += 5.0 * T * COUNTS_PER_REV
        axes.motion[0]["previous_counts"] = axes.motion[0]["target_counts"]
        axes.advance(1)
    assert motion["trip"] == FOLLOWING
    assert periods == 41  # not before its time-out
    comes_to_rest(axes)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_overspeed_trips_into_a_ramp_to_rest(direction):
    axes = energised(TORQUE)
    axes.motion[0]["max_speed_rad_s"] = 2.0 * math.pi * 8.0
    axes.motion[0]["target_torque_nm"] = direction * 1.0
    for _ in range(4000):
        axes.advance(1)
        if axes.motion[0]["trip"]:
            break
    assert axes.motion[0]["trip"] == OVERSPEED
    assert direction * speed(axes) == pytest.approx(2.0 * math.pi * 8.0, rel=0.1)
    speeds = comes_to_rest(axes)
    assert max(direction * s for s in speeds) < 2.0 * math.pi * 8.0 * 1.1


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_leaving_the_position_range_trips_into_a_ramp_to_rest(direction):
    axes = energised()
    axes.motion[0]["low_counts"], axes.motion[0]["high_counts"] = -1.0 * COUNTS_PER_REV, 1.0 * COUNTS_PER_REV
    axes.motion[0]["mode"] = TORQUE
    axes.motion[0]["target_torque_nm"] = direction * 0.5
    for _ in range(8000):
        axes.advance(1)
        if axes.motion[0]["trip"]:
            break
    assert axes.motion[0]["trip"] == OUT_OF_RANGE
    comes_to_rest(axes)


def test_a_set_point_out_of_range_trips_at_once_and_is_not_followed():
    axes = energised()
    motion = axes.motion[0]
    motion["low_counts"], motion["high_counts"] = -2.0 * COUNTS_PER_REV, 2.5 * COUNTS_PER_REV
    motion["max_speed_rad_s"] = 2.0 * math.pi * 12.0
    drive_at(axes, 4.0, 0.4)
    axes.set_point(0, 3 * COUNTS_PER_REV)
    axes.advance(1)
    assert motion["trip"] == SET_POINT_RANGE
    assert motion["target_counts"] < 2.5 * COUNTS_PER_REV
    comes_to_rest(axes)


@pytest.mark.parametrize("jump_rev", [0.05, -0.3])
def test_a_set_point_too_far_away_trips_at_once_and_is_not_followed(jump_rev):
    axes = energised()
    motion = axes.motion[0]
    motion["max_speed_rad_s"] = 2.0 * math.pi * 12.0
    revolutions = drive_at(axes, 5.0, 0.5)
    assert motion["trip"] == 0
    axes.set_point(0, round((revolutions + jump_rev) * COUNTS_PER_REV))
    axes.advance(1)
    assert motion["trip"] == SET_POINT_STEP
    comes_to_rest(axes)


def test_a_sync_that_falls_a_control_period_early_at_the_greatest_speed_does_not_trip():
    axes = energised()
    axes.motion[0]["max_speed_rad_s"] = 2.0 * math.pi * 12.0
    step = math.floor(12.0 * 8 * T * COUNTS_PER_REV)
    for number, periods in enumerate([8, 8, 7, 9, 7, 8], start=1):
        axes.set_point(0, number * step)
        axes.advance(periods)
    assert not axes.motion[0]["trip"] & SET_POINT_STEP


def test_a_set_point_at_the_greatest_speed_does_not_trip():
    axes = energised()
    axes.motion[0]["max_speed_rad_s"] = 2.0 * math.pi * 12.0
    axes.set_point(0, math.floor(12.0 * 8 * T * COUNTS_PER_REV))
    assert axes.motion[0]["trip"] == 0


def test_a_stop_begins_without_a_jump_of_the_torque():
    axes = energised()
    drive_at(axes, 6.0, 1.0)
    before = float(axes.motion[0]["torque_nm"])
    axes.stop(0, 1e-3)  # a ramp so slow that nothing changes
    torques = []
    for _ in range(20):
        axes.advance(1)
        torques.append(float(axes.motion[0]["torque_nm"]))
    # the encoder's own ripple is 0.03 N·m; a ramp that began at the motor would brake with K_vp v = 7.4 N·m
    assert np.max(np.abs(np.array(torques) - before)) < 0.06


def test_a_stop_takes_over_the_torque_offset():
    """60B2h ends with the stop; what it held up, the integrator holds."""
    axes = energised()
    drive_at(axes, 2.0, 0.5)
    axes.motion[0]["torque_offset_nm"] = 1.0
    drive_at(axes, 2.0, 0.5, rate_rps_s=1e6)
    before = float(axes.motion[0]["torque_nm"])
    axes.stop(0, 1e-3)
    axes.advance(1)
    assert abs(float(axes.motion[0]["torque_nm"]) - before) < 0.06


def test_a_stop_out_of_a_torque_mode_is_not_met_by_a_filter_that_followed_another_torque():
    axes = energised(mode=TORQUE, notches=NOTCHES)
    motion = axes.motion[0]
    for _ in range(8000):  # a hold on the speed by torque alone, within the band of the first filter
        motion["target_torque_nm"] = 0.4 + 0.05 * (2.0 * math.pi * 6.0 - speed(axes))
        axes.advance(1)
    assert 4.0 < speed(axes) / (2.0 * math.pi) < 9.0
    assert axes.notch_state[0, 0]["active"] == 1
    before = float(motion["torque_nm"])
    axes.stop(0, 1e-3)
    torques = []
    for _ in range(8):
        axes.advance(1)
        torques.append(float(motion["torque_nm"]))
    assert np.max(np.abs(np.array(torques) - before)) < 0.1


def test_one_axis_that_trips_leaves_the_others_alone():
    axes = energised(numbers=(2, 3))
    axes.motion[0]["max_speed_rad_s"] = 0.0
    axes.set_point(0, 1000)
    axes.set_point(1, 100)
    axes.advance(80)
    assert axes.motion[0]["mode"] == STOPPING
    assert (axes.motion[1]["mode"], axes.motion[1]["trip"]) == (POSITION, 0)


def test_a_run_of_many_periods_is_the_same_as_many_runs_of_one():
    one, many = energised(numbers=(2, 3, 5), notches=NOTCHES), energised(numbers=(2, 3, 5), notches=NOTCHES)
    for axes in (one, many):
        for row in range(3):
            axes.set_point(row, 500)
    one.advance(400)
    for _ in range(400):
        many.advance(1)
    for name in ("plant_state", "motion", "cascade_state", "notch_state"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()
