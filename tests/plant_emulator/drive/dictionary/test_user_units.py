"""The factor group over CAN: what a user's units make of positions, velocities and accelerations, and what is refused."""

import math

import pytest

from drive_profiles.standard import unit_codes
from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from drive_profiles.standard.unit_codes import DEGREE, MINUTE, REVOLUTION, RPM, SECOND
from tests.plant_emulator.drive.test_inputs import go
from tests.plant_emulator.rig import COUNTS_PER_REV, Rig

TURN = 2.0 * math.pi
GEAR = 100


def in_millidegrees(rig):
    """Thousandths of a degree at the joint, behind a gear of 1:100; speeds in rev/min, accelerations in rev/min per second."""
    rig.set(Object.GEAR_RATIO, 1, GEAR)
    rig.set(Object.SI_UNIT_POSITION, 0, unit_codes.code(DEGREE, prefix=-3))
    rig.set(Object.SI_UNIT_VELOCITY, 0, unit_codes.code(REVOLUTION, MINUTE, -3))
    rig.set(Object.SI_UNIT_ACCELERATION, 0, unit_codes.code(RPM, SECOND))


def test_a_drive_counts_increments_of_the_encoder_when_it_leaves_the_factory(rig):
    assert [rig.read(Object.FEED_CONSTANT, sub) for sub in (1, 2)] == [COUNTS_PER_REV, 1]
    assert [rig.read(Object.GEAR_RATIO, sub) for sub in (1, 2)] == [1, 1]
    assert rig.drive.scaling.counts_are_increments


def test_a_feed_constant_and_a_gear_scale_positions_and_all_that_is_one(rig):
    rig.set(Object.GEAR_RATIO, 1, GEAR)
    rig.set(Object.FEED_CONSTANT, 1, 36000)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, -720)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 1080)
    assert (rig.motion["low_counts"], rig.motion["high_counts"]) == (-2 * COUNTS_PER_REV, 3 * COUNTS_PER_REV)
    rig.set(Object.FOLLOWING_ERROR_WINDOW, 0, 180)
    assert rig.motion["following_window_rad"] == pytest.approx(0.5 * TURN)
    rig.set(Object.PROFILE_VELOCITY, 0, 1800)
    rig.set(Object.PROFILE_ACCELERATION, 0, 7200)
    rig.set(Object.PROFILE_DECELERATION, 0, 7200)
    rig.set(Object.QUICK_STOP_DECELERATION, 0, 18000)
    assert rig.motion["profile_speed_rad_s"] == pytest.approx(5 * TURN)
    assert rig.motion["profile_acceleration_rad_s2"] == pytest.approx(20 * TURN)
    rig.set(Object.POSITION_WINDOW, 0, 1)
    rig.enable(Mode.PP)
    rig.wait(300)
    go(rig, 540 / COUNTS_PER_REV)
    assert rig.position_rev == pytest.approx(1.5, abs=0.005)
    assert abs(rig.read(Object.POSITION_ACTUAL) - 540) <= 1
    assert abs(rig.read(Object.POSITION_ACTUAL_INTERNAL) - 1.5 * COUNTS_PER_REV) < 0.005 * COUNTS_PER_REV
    assert rig.read(Object.POSITION_DEMAND) == 540


def test_angles_and_revolutions_per_minute_are_counted_as_their_codes_say(rig):
    in_millidegrees(rig)
    rig.set(Object.PROFILE_ACCELERATION, 0, 12)
    rig.set(Object.PROFILE_DECELERATION, 0, 12)
    assert rig.motion["profile_acceleration_rad_s2"] == pytest.approx(12 / 60 * GEAR * TURN)
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, 600)  # 0.6 rev/min of the joint: 1 rev/s of the motor
    rig.wait(1000)
    assert rig.speed_rps == pytest.approx(1.0, abs=0.08)
    assert rig.read(Object.VELOCITY_ACTUAL) == pytest.approx(600, abs=60)
    assert rig.read(Object.VELOCITY_DEMAND) == 600
    assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(rig.position_rev / GEAR * 360_000, abs=2)


def test_the_polarity_turns_positions_and_velocities_round_each_for_itself(rig):
    rig.set(Object.POLARITY, 0, 0xC0)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, -COUNTS_PER_REV)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 2 * COUNTS_PER_REV)
    assert (rig.motion["low_counts"], rig.motion["high_counts"]) == (-2 * COUNTS_PER_REV, COUNTS_PER_REV)
    rig.enable(Mode.PP)
    rig.wait(200)
    go(rig, 1.0)
    assert rig.position_rev == pytest.approx(-1.0, abs=0.005)
    assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(COUNTS_PER_REV, abs=500)
    rig.set(Object.MODES_OF_OPERATION, 0, Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, -COUNTS_PER_REV)
    rig.wait(500)
    assert rig.speed_rps == pytest.approx(1.0, abs=0.08)
    assert rig.read(Object.VELOCITY_ACTUAL) < 0


@pytest.mark.parametrize(
    ("index", "sub", "value"),
    [
        (Object.GEAR_RATIO, 1, 3),
        (Object.FEED_CONSTANT, 1, 1000),
        (Object.POLARITY, 0, 0x80),
        (Object.SI_UNIT_POSITION, 0, unit_codes.code(DEGREE)),
    ],
)
def test_units_do_not_change_under_torque(rig, index, sub, value):
    rig.enable(Mode.PP)
    assert rig.write(index, sub, value) is SdoAbortCode.DEVICE_STATE
    assert rig.word(0x00) is State.SWITCH_ON_DISABLED
    assert rig.write(index, sub, value) is None


@pytest.mark.parametrize(
    ("index", "sub", "value", "code"),
    [
        (Object.POLARITY, 0, 0x01, SdoAbortCode.INVALID_VALUE),
        (Object.SI_UNIT_POSITION, 0, 0x00550000, SdoAbortCode.INVALID_VALUE),
        (Object.SI_UNIT_VELOCITY, 0, 0x00B40000, SdoAbortCode.INVALID_VALUE),
        (Object.SI_UNIT_ACCELERATION, 0, 0x00B40300, SdoAbortCode.INVALID_VALUE),
        (Object.GEAR_RATIO, 1, 0, SdoAbortCode.VALUE_TOO_LOW),
        (Object.FEED_CONSTANT, 2, 0, SdoAbortCode.VALUE_TOO_LOW),
        (Object.ENCODER_RESOLUTION, 1, 4096, SdoAbortCode.INVALID_VALUE),
        (Object.VELOCITY_ENCODER_RESOLUTION, 2, 2, SdoAbortCode.INVALID_VALUE),
    ],
)
def test_what_makes_no_unit_is_refused_and_changes_nothing(rig, index, sub, value, code):
    before = rig.drive.scaling
    assert rig.write(index, sub, value) is code
    assert rig.drive.scaling == before


def test_units_survive_a_loss_of_power_where_they_were_stored(rig):
    in_millidegrees(rig)
    scaling = rig.drive.scaling
    assert rig.save() is None
    rig.power_cycle()
    assert rig.drive.scaling == scaling
    assert rig.save(0x1011, 1, b"load") is None
    rig.power_cycle()
    assert rig.drive.scaling.counts_are_increments


def test_a_drive_whose_units_are_not_emulated_keeps_those_that_it_has():
    axis = Rig().world.robot.axis[3]
    robot = Rig().world.robot.model_copy(update={"axis": {3: axis.model_copy(update={"profile": "kollmorgen_akd"})}})
    rig = Rig(robot)
    assert rig.write(Object.POLARITY, 0, 0x80) is SdoAbortCode.INVALID_VALUE
    assert rig.write(Object.POLARITY, 0, 0) is None
