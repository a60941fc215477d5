"""What the dictionary says of limits, slopes, windows and demands, on the simulated motion; all through frames."""

import math
import struct

import numpy as np
import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.drive.dictionary.manufacturer_objects import SET_POINT_TIMEOUT
from plant_emulator.motion import record
from plant_emulator.robots.robot import with_drives
from tests.plant_emulator.rig import AXIS, ONE_AXIS, TURN, Rig, revolutions

RATED_NM = ONE_AXIS.axis[AXIS].rated_torque
PEAK_NM = ONE_AXIS.axis[AXIS].torque_limit_nm
INTERNAL_LIMIT, TARGET_REACHED = 1 << 11, 1 << 10
SPEED_IS_ZERO = 1 << 12


def watch(rig, milliseconds, *fields):
    """Columns of the process data, or of the plant, after each control period."""
    shown = []
    for _ in range(4 * milliseconds):
        rig.world.finish_period()
        rig.world.free_step(rig.world.now + 250_000)
        shown.append([float(rig.plant[f] if f in rig.plant.dtype.names else rig.motion[f]) for f in fields])
    return np.array(shown).T


# -- torque ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("index", "value", "high", "low"),
    [
        (Object.MAX_TORQUE, 200, 0.2, -0.2),
        (Object.MAX_CURRENT, 150, 0.15, -0.15),
        (Object.POSITIVE_TORQUE_LIMIT, 100, 0.1, -3.0),
        (Object.NEGATIVE_TORQUE_LIMIT, 120, 3.0, -0.12),
    ],
    ids=["6072", "6073", "60E0", "60E1"],
)
def test_a_torque_limit_acts_its_own_way_and_shows_in_bit_11(rig, index, value, high, low):
    rig.enable(Mode.CST)
    rig.set(index, 0, value)
    seen = []
    for target in (2900, -2900):
        rig.set(Object.TARGET_TORQUE, 0, target)
        (torques,) = watch(rig, 2, "torque_nm")
        seen.append(torques[-1] / RATED_NM)
        limit = high if target > 0 else low
        assert bool(rig.status & INTERNAL_LIMIT) == (abs(limit) < 2.9)
        assert rig.read(Object.TORQUE_DEMAND) == pytest.approx(1000.0 * seen[-1], abs=1.0)
        assert rig.read(Object.CURRENT_ACTUAL) == pytest.approx(1000.0 * seen[-1], abs=1.0)
    assert seen == pytest.approx([min(high, 2.9), max(low, -2.9)], rel=2e-3)


def test_the_motor_limits_the_torque_whatever_the_objects_say(rig):
    for index in (Object.MAX_TORQUE, Object.MAX_CURRENT, Object.POSITIVE_TORQUE_LIMIT, Object.NEGATIVE_TORQUE_LIMIT):
        rig.set(index, 0, 65535)
    rig.enable(Mode.CST)
    rig.set(Object.TARGET_TORQUE, 0, 32767)
    (torques,) = watch(rig, 2, "torque_nm")
    assert torques[-1] == PEAK_NM


def test_6087_is_the_slope_of_the_torque_in_profile_torque(rig):
    rig.set(Object.TORQUE_SLOPE, 0, 500)
    rig.enable(Mode.TQ)
    rig.set(Object.TARGET_TORQUE, 0, 100)
    (torques,) = watch(rig, 300, "torque_nm")
    assert np.max(np.diff(torques)) == pytest.approx(0.5 * RATED_NM * 250e-6)
    assert np.count_nonzero(np.diff(torques) > 0.0) == pytest.approx(800, abs=4)  # 0.2 s
    assert rig.status & TARGET_REACHED


def test_6087_is_no_slope_in_cyclic_torque(rig):
    rig.set(Object.TORQUE_SLOPE, 0, 1)
    rig.enable(Mode.CST)
    rig.set(Object.TARGET_TORQUE, 0, 100)
    (torques,) = watch(rig, 1, "torque_nm")
    assert torques[0] == pytest.approx(0.1 * RATED_NM, rel=1e-3)


# -- speed and acceleration --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("index", "value"), [(Object.MAX_PROFILE_VELOCITY, revolutions(2.0)), (Object.MAX_MOTOR_SPEED, 120)], ids=["607F", "6080"]
)
@pytest.mark.parametrize("mode", [Mode.PP, Mode.PV])
def test_607f_and_6080_limit_profile_modes_with_bit_11(rig, mode, index, value):
    rig.set(Object.PROFILE_VELOCITY, 0, revolutions(5.0))
    rig.set(index, 0, value)
    rig.enable(mode)
    if mode == Mode.PP:
        rig.set(Object.TARGET_POSITION, 0, revolutions(10.0))
        rig.word(0x1F)
    else:
        rig.set(Object.TARGET_VELOCITY, 0, revolutions(5.0))
    demands, speeds = watch(rig, 600, "demand_speed_rad_s", "motor_speed_rad_s")
    assert np.max(demands) == pytest.approx(2.0 * TURN)
    assert np.mean(speeds[-400:]) == pytest.approx(2.0 * TURN, rel=0.02)
    assert rig.status & INTERNAL_LIMIT
    assert rig.state is State.OPERATION_ENABLED
    assert rig.read(Object.VELOCITY_DEMAND) == pytest.approx(revolutions(2.0), abs=1)


def test_60c5_and_60c6_limit_6083_and_6084(rig):
    rig.set(Object.PROFILE_ACCELERATION, 0, revolutions(40.0))
    rig.set(Object.PROFILE_DECELERATION, 0, revolutions(40.0))
    rig.set(Object.MAX_ACCELERATION, 0, revolutions(5.0))
    rig.set(Object.MAX_DECELERATION, 0, revolutions(8.0))
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(2.0))
    (up,) = watch(rig, 500, "demand_speed_rad_s")
    rig.set(Object.TARGET_VELOCITY, 0, 0)
    (down,) = watch(rig, 500, "demand_speed_rad_s")
    assert np.max(np.diff(up)) / 250e-6 == pytest.approx(5.0 * TURN)
    assert np.min(np.diff(down)) / 250e-6 == pytest.approx(-8.0 * TURN)


def test_60c6_limits_the_quick_stop(rig):
    rig.set(Object.MAX_DECELERATION, 0, revolutions(8.0))
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(3.0))
    rig.wait(600)
    rig.set(Object.CONTROL_WORD, 0, 0x0B)
    (down,) = watch(rig, 200, "demand_speed_rad_s")
    assert np.min(np.diff(down)) / 250e-6 == pytest.approx(-8.0 * TURN)


@pytest.mark.parametrize("index", [Object.MOTION_PROFILE_TYPE, Object.TORQUE_PROFILE_TYPE])
@pytest.mark.parametrize("value", [-1, 1, 3])
def test_profiles_other_than_the_linear_one_are_refused(rig, index, value):
    assert isinstance(rig.write(index, 0, value), SdoAbortCode)
    assert rig.read(index) == 0


# -- position ----------------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("mode", [Mode.PV, Mode.TQ, Mode.CST])
def test_607d_stops_a_motor_in_velocity_and_torque_modes_with_8612(rig, mode):
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, revolutions(-1.0))
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, revolutions(1.0))
    rig.enable(mode)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(2.0))
    rig.set(Object.TARGET_TORQUE, 0, 250)
    rig.wait(2000)
    assert rig.emergencies() == [0x8612]
    assert rig.state is State.FAULT
    assert 1.0 < rig.position_rev < 2.5


# -- windows -----------------------------------------------------------------------------------------------------------


def test_target_reached_waits_for_6067_and_6068(rig):
    rig.set(Object.POSITION_WINDOW, 0, 2000)
    rig.set(Object.POSITION_WINDOW_TIME, 0, 40)
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, revolutions(0.5))
    rig.word(0x1F)
    near = 0
    while not rig.status & TARGET_REACHED:
        rig.wait(1)
        has_arrived = rig.motion["reference_speed_rad_s"] == 0.0
        near = near + 1 if has_arrived and abs(rig.read(Object.POSITION_ACTUAL) - revolutions(0.5)) <= 2000 else 0
        assert near < 45
    assert near >= 40


def test_6067_of_all_ones_takes_the_reference_for_the_motor(rig):
    rig.set(Object.POSITION_WINDOW, 0, 0xFFFF_FFFF)
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, revolutions(0.5))
    rig.word(0x1F)
    while not rig.status & TARGET_REACHED:
        rig.wait(1)
    assert abs(rig.read(Object.POSITION_ACTUAL) - revolutions(0.5)) > 200  # the motor is still on its way


def test_606d_to_6070_judge_the_speed(rig):
    rig.set(Object.VELOCITY_WINDOW, 0, revolutions(0.1))
    rig.set(Object.VELOCITY_WINDOW_TIME, 0, 30)
    rig.set(Object.VELOCITY_THRESHOLD, 0, revolutions(0.4))
    rig.set(Object.VELOCITY_THRESHOLD_TIME, 0, 20)
    rig.enable(Mode.PV)
    rig.wait(5)
    assert rig.status & SPEED_IS_ZERO
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(2.0))
    shown = []
    for _ in range(400):
        rig.wait(1)
        shown.append((rig.speed_rps, rig.status))
    moving = next(i for i, (_, word) in enumerate(shown) if not word & SPEED_IS_ZERO)
    above = next(i for i, (speed, _) in enumerate(shown) if speed > 0.4)
    assert moving - above == pytest.approx(20, abs=3)
    reached = next(i for i, (_, word) in enumerate(shown) if word & TARGET_REACHED)
    near = next(i for i, (speed, _) in enumerate(shown) if abs(speed - 2.0) < 0.1)
    assert reached - near >= 28
    assert shown[-1][1] & TARGET_REACHED


def test_a_speed_that_a_cyclic_rpdo_repeats_is_reached_all_the_same(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.TARGET_VELOCITY, 0, 32)))
    rig.set(Object.VELOCITY_WINDOW_TIME, 0, 20)
    rig.enable(Mode.PV)
    for _ in range(300):
        rig.command(0x0F, revolutions(1.0))
        rig.sync()
    assert rig.status & TARGET_REACHED
    rig.command(0x0F, revolutions(1.5))
    rig.sync()
    assert not rig.status & TARGET_REACHED


# -- demands -----------------------------------------------------------------------------------------------------------


def test_the_demands_of_cyclic_position_are_its_set_points(rig):
    rig.cyclic(Mode.CSP)
    target = rig.turn(3.0, 0.5)
    rig.wait(0)
    assert rig.read(Object.POSITION_DEMAND) == rig.read(Object.POSITION_DEMAND_INTERNAL) == target
    assert rig.read(Object.VELOCITY_DEMAND) == pytest.approx(revolutions(3.0), rel=2e-3)
    assert rig.read(Object.TORQUE_DEMAND) == rig.read(Object.TORQUE_ACTUAL) == rig.read(Object.CURRENT_ACTUAL)
    # K_pp times the distance of the set-point from the motor: the speed that the position loop asks for
    distance = target - rig.read(Object.POSITION_ACTUAL)
    gain = rig.world.axes.cascade_config[0]["position_gain_per_s"]
    assert rig.read(Object.CONTROL_EFFORT) == pytest.approx(gain * distance, rel=0.05)
    assert rig.read(Object.VELOCITY_SENSOR_ACTUAL) == rig.read(Object.VELOCITY_ACTUAL)


def test_a_braked_drive_demands_what_is(rig):
    rig.wait(5)
    assert rig.read(Object.POSITION_DEMAND) == rig.read(Object.POSITION_ACTUAL)
    assert [rig.read(index) for index in (Object.VELOCITY_DEMAND, Object.TORQUE_DEMAND, Object.CONTROL_EFFORT)] == [0, 0, 0]
    assert rig.read(Object.DC_LINK_VOLTAGE) == 48_000


# -- set-points that do not come ---------------------------------------------------------------------------------------


def test_without_a_time_out_an_enabled_drive_waits_for_its_master(rig):
    assert rig.read(SET_POINT_TIMEOUT) == 0
    rig.cyclic(Mode.CSP)
    rig.turn(2.0, 0.3)
    rig.wait(500)
    assert rig.state is State.OPERATION_ENABLED
    assert abs(rig.speed_rps) < 0.1


@pytest.mark.parametrize("periods", [1, 4])
def test_a_sync_that_stops_is_made_up_for_and_then_a_fault_8700(rig, periods):
    rig.set(SET_POINT_TIMEOUT, 0, periods)
    rig.cyclic(Mode.CSP)
    rig.wait(100)  # nothing is late before the first set-point
    assert rig.state is State.OPERATION_ENABLED
    rig.turn(3.0, 0.5)
    rig.wait(2 * periods)  # the period of the last SYNC has been waited for in `turn`
    assert rig.emergencies() == []
    assert rig.motion["demand_speed_rad_s"] == pytest.approx(3.0 * TURN, rel=2e-3)
    rig.wait(4)
    assert rig.emergencies() == [0x8700]
    rig.wait(1000)
    assert rig.state is State.FAULT


def test_a_repeated_set_point_is_on_time(rig):
    """SYNC that goes on without RPDOs repeats the last set-point: nothing is late for the drive, and the motor stands."""
    rig.set(SET_POINT_TIMEOUT, 0, 4)
    rig.cyclic(Mode.CSP)
    rig.turn(2.0, 0.3)
    rig.sync(100)
    assert rig.state is State.OPERATION_ENABLED
    assert abs(rig.speed_rps) < 0.2


def test_a_torque_that_is_no_longer_refreshed_is_a_fault_8700(rig):
    rig.set(SET_POINT_TIMEOUT, 0, 4)
    rig.cyclic(Mode.CST, torque=True)
    rig.wait(100)  # nothing is late before the first set-point
    for _ in range(50):
        rig.cycle(100, layout="<Hh")
    rig.wait(2 * 4)
    assert rig.emergencies() == []
    rig.wait(4)
    assert rig.emergencies() == [0x8700]
    rig.wait(1000)
    assert rig.state is State.FAULT


def test_without_a_time_out_a_torque_is_held(rig):
    rig.cyclic(Mode.CST, torque=True)
    for _ in range(10):
        rig.cycle(50, layout="<Hh")
    rig.wait(100)
    assert rig.read(Object.TORQUE_ACTUAL) == 50
    assert rig.state is State.OPERATION_ENABLED


# -- the interpolation period ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [Mode.CSP, Mode.CSV, Mode.CST, Mode.IP])
def test_60c2h_is_not_changed_under_a_mode_that_counts_in_it(rig, mode):
    rig.enable(mode)
    for sub, other in ((1, 10), (2, -4)):
        assert rig.write(Object.INTERPOLATION_PERIOD, sub, other) is SdoAbortCode.DEVICE_STATE
        rig.set(Object.INTERPOLATION_PERIOD, sub, rig.read(Object.INTERPOLATION_PERIOD, sub))
    rig.word(0x06)
    rig.wait(100)
    rig.set(Object.INTERPOLATION_PERIOD, 1, 10)


def test_60c2h_that_is_written_in_another_mode_is_in_force_with_the_next_one(rig):
    rig.enable(Mode.PP)
    rig.set(Object.INTERPOLATION_PERIOD, 1, 10)
    rig.set(Object.MODES_OF_OPERATION, 0, Mode.CSP)
    assert rig.motion["periods_per_set_point"] == 40


@pytest.mark.parametrize("mode", [Mode.PP, Mode.CSP])
@pytest.mark.parametrize(("exponent", "is_within"), [(-3, True), (36, False)])
def test_60c2h_beyond_what_a_drive_counts_keeps_the_modes_that_interpolate_from_acting(mode, exponent, is_within):
    rig = Rig(with_drives(ONE_AXIS, {AXIS: "maxon_epos4"}))
    for sub, value in ((1, 2), (2, exponent)):
        rig.set(Object.INTERPOLATION_PERIOD, sub, value)
    rig.set(Object.MODES_OF_OPERATION, 0, mode)
    rig.start()
    enabled = rig.word(0x06, 0x07, 0x0F) is State.OPERATION_ENABLED
    assert enabled == (is_within or mode is Mode.PP)


# -- position limits ---------------------------------------------------------------------------------------------------


def test_607dh_of_0_and_0_is_no_limit_and_any_other_pair_is_one(rig):
    for sub in (1, 2):
        rig.set(Object.SOFTWARE_POSITION_LIMIT, sub, 0)
    assert (rig.motion["low_counts"], rig.motion["high_counts"]) == (-math.inf, math.inf)
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, revolutions(0.5))
    rig.word(0x1F)
    rig.wait(500)
    assert rig.emergencies() == []
    assert rig.status & TARGET_REACHED
    for sub in (1, 2):
        rig.set(Object.SOFTWARE_POSITION_LIMIT, sub, revolutions(0.5))
    assert rig.motion["low_counts"] == rig.motion["high_counts"] == revolutions(0.5)


@pytest.mark.parametrize("jump_rev", [0.05, 0.5])
def test_a_position_loop_keeps_to_its_torque_limits_where_it_is_pulled_away(rig, jump_rev):
    rig.set(Object.NEGATIVE_TORQUE_LIMIT, 0, 300)
    rig.cyclic(Mode.CSP)
    rig.turn(2.0, 0.3)
    rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, 0xFFFF_FFFF)
    rig.motion["previous_counts"] = rig.motion["target_counts"] = rig.motion["target_counts"] - revolutions(jump_rev)
    (torques,) = watch(rig, 100, "torque_nm")
    assert np.min(torques) == pytest.approx(-0.3 * RATED_NM, rel=1e-3)
    assert math.isfinite(rig.plant["motor_angle_rad"])


def test_limits_of_unknown_scale_do_not_act():
    """What a profile states without a unit is there, and holds what is written; the motion knows nothing of it."""
    rig = Rig(with_drives(ONE_AXIS, {AXIS: "nanotec_cl4e"}))
    assert rig.read(Object.MAX_DECELERATION) == 5000
    before = float(rig.motion["torque_high_nm"])
    rig.set(Object.MAX_CURRENT, 0, 1)
    assert rig.motion["max_deceleration_rad_s2"] == math.inf
    assert rig.motion["torque_high_nm"] == before
    assert rig.motion["mode"] == record.BRAKED


def test_a_limit_in_a_vendors_own_unit_acts_in_that_unit():
    rig = Rig(with_drives(ONE_AXIS, {AXIS: "maxon_epos4"}))
    assert rig.motion["max_profile_speed_rad_s"] == pytest.approx(50_000 * TURN / 60.0)
    assert rig.download(Object.MAX_PROFILE_VELOCITY, 0, struct.pack("<I", 60)) is None
    assert rig.motion["max_profile_speed_rad_s"] == pytest.approx(TURN)


def test_a_vendors_object_at_the_place_of_our_time_out_is_none():
    rig = Rig(with_drives(ONE_AXIS, {AXIS: "harmonic_drive_yukondrive"}))
    rig.drive.slave.dictionary.cell(SET_POINT_TIMEOUT).value = 4.0  # there it is a sampling time
    rig.drive.data.apply()
    assert rig.motion["extrapolation_periods"] == 0
