"""The drive's limits, its filters, and whether what it tells of itself is true; all through frames, judged by the plant."""

import math
import struct

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.motion import record
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, POSITION, STATUS, TORQUE, revolutions

CSP, CST = Mode.CSP, Mode.CST
ENABLED = State.OPERATION_ENABLED
RATED_NM = round(1000 * ONE_AXIS.axis[AXIS].rated_torque) / 1000
TARGET_REACHED, INTERNAL_LIMIT, BIT_12, FOLLOWING_ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
NOTCH, NOTCH_STATE = 0x2110, 0x2112
MODE, ORDER, START_RPS, END_RPS = 1, 2, 3, 4


# -- limits ------------------------------------------------------------------------------------------------------------


def assert_tripped(rig, code):
    assert rig.emergencies()[-1] == code
    assert rig.read(Object.ERROR_CODE) == code
    rig.wait(1000)
    assert rig.state is State.FAULT
    assert rig.speed_rps == 0.0


def test_a_set_point_outside_607d_trips_with_8612(rig):
    rig.cyclic(CSP)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 500)
    rig.cycle(500)
    assert rig.state is ENABLED
    rig.cycle(501)
    assert_tripped(rig, 0x8612)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_motor_outside_607d_trips_with_8612(rig, direction):
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, revolutions(-0.5))
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, revolutions(0.5))
    rig.cyclic(CST, torque=True)
    for _ in range(500):
        rig.cycle(direction * 300, layout="<Hh")
        if rig.emergencies():
            break
    speed, way = abs(rig.speed_rps), direction * rig.position_rev
    assert way == pytest.approx(0.5, abs=0.002 * speed)
    assert_tripped(rig, 0x8612)
    assert direction * rig.position_rev < way + speed**2 / (2 * 50.0) + speed / 25.0 + 0.02


def test_a_set_point_faster_than_6080_trips_with_8612(rig):
    rig.set(Object.MAX_MOTOR_SPEED, 0, 600)  # 10 rev/s: 2621 counts in 2 ms
    rig.cyclic(CSP)
    rig.cycle(2620)
    assert rig.state is ENABLED
    rig.cycle(2620 + 2625)
    assert_tripped(rig, 0x8612)


def test_a_motor_faster_than_6080_trips_with_8400(rig):
    rig.set(Object.MAX_MOTOR_SPEED, 0, 300)
    rig.cyclic(CST, torque=True)
    for _ in range(500):
        rig.cycle(300, layout="<Hh")
        if rig.emergencies():
            break
    assert rig.speed_rps == pytest.approx(5.0, rel=0.1)
    assert_tripped(rig, 0x8400)


def test_a_following_error_outside_6065_for_6066_trips_with_8611(rig):
    rig.set(Object.FOLLOWING_ERROR_TIMEOUT, 0, 20)
    rig.cyclic(CSP)
    rig.turn(5.0, 0.6)  # 0.2 rev behind
    rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, revolutions(0.1))
    rig.turn(5.0, 0.016)
    assert rig.state is ENABLED
    assert rig.status & FOLLOWING_ERROR
    rig.turn(5.0, 0.006)
    assert_tripped(rig, 0x8611)
    assert not rig.status & FOLLOWING_ERROR


def test_a_following_error_that_ends_in_time_is_none(rig):
    rig.set(Object.FOLLOWING_ERROR_TIMEOUT, 0, 20)
    rig.cyclic(CSP)
    rig.turn(5.0, 0.6)
    for _ in range(3):
        rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, revolutions(0.1))
        rig.turn(5.0, 0.014)
        rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, revolutions(0.5))
        rig.turn(5.0, 0.004)
    assert rig.state is ENABLED
    assert rig.emergencies() == []


def test_6065_of_all_ones_watches_nothing(rig):
    rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, 0xFFFF_FFFF)
    rig.set(Object.FOLLOWING_ERROR_TIMEOUT, 0, 0)
    rig.cyclic(CSP)
    rig.turn(5.0, 0.6)
    assert rig.state is ENABLED


# -- what it tells is true ---------------------------------------------------------------------------------------------


def test_position_speed_torque_and_mode_are_those_of_the_plant(rig):
    rig.cyclic(CSP)
    for speed in (3.0, -6.0):
        rig.turn(speed, 1.0)
        assert abs(rig.read(Object.POSITION_ACTUAL) - rig.position_rev * COUNTS_PER_REV) <= 0.5
        # the speed is seen through the low-pass of the velocity loop and the encoder's ripple
        assert rig.read(Object.VELOCITY_ACTUAL) / COUNTS_PER_REV == pytest.approx(rig.speed_rps, abs=0.1)
        assert abs(rig.read(Object.TORQUE_ACTUAL) - 1000.0 * rig.plant["torque_nm"] / RATED_NM) <= 0.5
        assert rig.read(0x2130) == pytest.approx(float(rig.plant["torque_nm"]), rel=1e-6)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == CSP


def test_a_tpdo_shows_the_instant_of_its_sync(rig):
    rig.cyclic(CSP)
    rig.turn(5.0, 0.5)
    for _ in range(10):
        position, torque = rig.position_rev * COUNTS_PER_REV, 1000.0 * float(rig.plant["torque_nm"]) / RATED_NM
        status, shown, shown_torque = rig.cycle(int(rig.motion["target_counts"]) + 1311)
        assert abs(shown - position) <= 0.5
        assert abs(shown_torque - torque) <= 0.5
        assert status & 0x6F == 0x27


def test_a_braked_drive_tells_no_torque_at_once(rig):
    rig.cyclic(CSP)
    rig.turn(5.0, 0.5)
    rig.word(0x00)
    assert rig.read(Object.TORQUE_ACTUAL) == 0
    assert not rig.status & (TARGET_REACHED | INTERNAL_LIMIT | BIT_12 | FOLLOWING_ERROR)


@pytest.mark.parametrize("start", [2**31 - 1, -(2**31)])
def test_at_the_end_of_its_numbers_it_stays_there_and_trips(rig, start):
    rig.plant["motor_angle_rad"] = (start + math.copysign(1000, start)) / rig.motion["counts_per_rad"]
    rig.plant["arm_angle_rad"] = rig.plant["motor_angle_rad"] / ONE_AXIS.axis[AXIS].reduction_ratio
    rig.wait(1)
    rig.map_pdo(0x1800, (STATUS, POSITION, TORQUE))
    rig.enable(CSP)
    assert abs(rig.read(Object.TARGET_POSITION)) == 2**31 - 1
    assert abs(rig.read(Object.POSITION_ACTUAL)) == 2**31 - 1
    rig.sync(3)
    assert rig.emergencies() == [0x8612]


# -- notch filters -----------------------------------------------------------------------------------------------------


def test_a_filter_written_by_sdo_follows_the_motor_inside_the_drive(rig):
    """Range 4 to 9 rev/s, order 2: out below, at 2 f_m inside, out when the motor stands again."""
    rig.set(NOTCH, MODE, 1)
    rig.map_pdo(0x1801, ((NOTCH_STATE, 1, 8), (NOTCH_STATE, 2, 32)))
    rig.cyclic(CSP)
    shown = {}
    for speed in (2.0, 5.0, 7.0, 2.0):
        rig.turn(speed, 0.6)
        frame = next(f for f in rig.sync() if f.can_id == 0x280 + rig.node)
        shown[speed] = struct.unpack("<Bf", frame.data)
        active, frequency = shown[speed]
        if speed > 4.0:
            assert active == 1
            assert frequency == pytest.approx(2.0 * abs(rig.speed_rps), rel=0.05)
            assert rig.read(NOTCH_STATE, 3) == pytest.approx(0.1)
        else:
            assert (active, frequency) == (0, 0.0)
    assert shown[7.0][1] > shown[5.0][1]


def test_the_filter_is_moved_in_every_control_period(rig):
    rig.set(NOTCH, MODE, 1)
    rig.cyclic(CSP)
    rig.turn(6.0, 0.6)
    seen = []
    for _ in range(8):
        rig.world.axes.advance(1)
        seen.append(rig.read(NOTCH_STATE, 2))
    assert len(set(seen)) == 8


def test_both_filters_run_beside_each_other(rig):
    rig.set(NOTCH, MODE, 1)
    for sub, value in ((ORDER, 4), (START_RPS, 4.5), (END_RPS, 7.0), (MODE, 2)):
        rig.set(NOTCH + 1, sub, value)
    rig.cyclic(CSP)
    rig.turn(6.0, 0.6)
    first, second = rig.read(NOTCH_STATE, 2), rig.read(NOTCH_STATE + 1, 2)
    assert second == pytest.approx(2.0 * first)


def test_a_filter_may_be_switched_while_the_motor_turns_but_not_changed(rig):
    rig.cyclic(CSP)
    rig.turn(6.0, 0.6)
    assert rig.read(NOTCH_STATE, 1) == 0
    assert rig.write(NOTCH, ORDER, 4) is SdoAbortCode.DEVICE_STATE
    rig.set(NOTCH, MODE, 1)
    rig.turn(6.0, 0.1)
    assert rig.read(NOTCH_STATE, 1) == 1
    rig.set(NOTCH, MODE, 0)
    rig.turn(6.0, 0.1)
    assert rig.read(NOTCH_STATE, 1) == 0


@pytest.mark.parametrize(("start", "end"), [(9.0, 9.0), (9.0, 4.0), (0.1, 9.0)], ids=["empty", "falling", "below hysteresis"])
def test_a_filter_that_is_none_cannot_be_switched_on(rig, start, end):
    rig.set(NOTCH, START_RPS, start)
    rig.set(NOTCH, END_RPS, end)
    assert rig.write(NOTCH, MODE, 1) is SdoAbortCode.PARAMETER_INCOMPATIBLE
    assert rig.read(NOTCH, MODE) == 0
    assert rig.world.axes.notch_config[0, 0]["mode"] == 0


def test_a_filter_that_is_on_cannot_become_none(rig):
    rig.set(NOTCH, MODE, 1)
    assert rig.write(NOTCH, START_RPS, 9.5) is SdoAbortCode.PARAMETER_INCOMPATIBLE
    assert rig.write(NOTCH, END_RPS, 3.0) is SdoAbortCode.PARAMETER_INCOMPATIBLE
    assert rig.read(NOTCH, START_RPS) == 4.0
    assert rig.world.axes.notch_config[0, 0]["end_rps"] == 9.0


def test_the_brake_makes_the_filter_forget(rig):
    rig.set(NOTCH, MODE, 1)
    rig.cyclic(CSP)
    rig.turn(6.0, 0.6)
    rig.word(0x00)
    rig.wait(1)
    assert rig.read(NOTCH_STATE, 1) == 0
    assert rig.read(NOTCH_STATE, 2) == 0.0
    assert rig.motion["mode"] == record.BRAKED
