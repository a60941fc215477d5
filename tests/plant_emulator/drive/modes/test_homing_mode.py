"""Homing mode: bit 4, the bits of the status word, and what becomes of the position; all through frames."""

import math

import pytest

from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.motion import record
from plant_emulator.robots.behaviour import Switches
from plant_emulator.robots.robot import Robot
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, Rig

HM, PP, CSP = Mode.HM, Mode.PP, Mode.CSP
ENABLED = State.OPERATION_ENABLED
ATTAINED, ERROR, TARGET_REACHED = 1 << 12, 1 << 13, 1 << 10
BITS = ATTAINED | ERROR | TARGET_REACHED
RATIO = ONE_AXIS.axis[AXIS].reduction_ratio
SWITCHES = Switches(negative_limit_deg=-12.0, positive_limit_deg=12.0, home_deg=(3.0, 6.0), index_deg=90.0)


def rig_with(switches):
    return Rig(Robot(axis={AXIS: ONE_AXIS.axis[AXIS].model_copy(update={"switches": switches})}))


@pytest.fixture
def rig():
    """A drive whose axis is 24 degrees of the joint wide, and whose switches are found at 4 rev/s and 0.5 rev/s."""
    rig = rig_with(SWITCHES)
    rig.set(Object.HOMING_SPEEDS, 1, 4 * COUNTS_PER_REV)
    rig.set(Object.HOMING_SPEEDS, 2, COUNTS_PER_REV // 2)
    return rig


def counts_at(joint_deg):
    return joint_deg / 360.0 * RATIO * COUNTS_PER_REV


def home(rig, method, patience_s=20):
    """Start, and wait until it is no longer under way; the bits that have been seen meanwhile, and the last."""
    rig.set(Object.HOMING_METHOD, 0, method)
    if rig.state is not ENABLED:
        rig.enable(HM)
    rig.word(0x0F)
    rig.word(0x1F)
    seen = set()
    for _ in range(200 * patience_s):
        bits = rig.status & BITS
        if bits & TARGET_REACHED:
            break
        seen.add(bits)
        rig.wait(5)
    return seen, rig.status & BITS


def test_before_its_start_homing_is_not_attained(rig):
    rig.enable(HM)
    assert rig.status & BITS == TARGET_REACHED
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == HM


def test_bit_4_that_is_set_already_when_the_drive_is_enabled_starts_nothing(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, HM)
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.start()
    rig.word(0x06, 0x07, 0x1F)
    rig.wait(200)
    assert abs(rig.position_rev) < 0.02


@pytest.mark.parametrize("method", [35, 37])
def test_the_present_place_becomes_607ch(rig, method):
    rig.set(Object.HOME_OFFSET, 0, 12345)
    _, bits = home(rig, method)
    assert bits == ATTAINED | TARGET_REACHED
    assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(12345, abs=3)


@pytest.mark.parametrize(("method", "joint_deg"), [(17, -12.0), (18, 12.0), (19, 3.0), (23, 3.0)])
def test_the_edge_of_a_switch_becomes_607ch(rig, method, joint_deg):
    rig.set(Object.HOME_OFFSET, 0, 5000)
    seen, bits = home(rig, method)
    assert seen == {0}
    assert bits == ATTAINED | TARGET_REACHED
    zero = counts_at(joint_deg)
    assert rig.position_rev * COUNTS_PER_REV == pytest.approx(zero, abs=200)
    assert rig.read(Object.POSITION_ACTUAL) - 5000 == pytest.approx(rig.position_rev * COUNTS_PER_REV - zero, abs=3)
    assert rig.state is ENABLED


@pytest.mark.parametrize(("method", "turn"), [(33, -1), (34, 0)])
def test_the_index_pulse_becomes_607ch(method, turn):
    rig = rig_with(Switches(index_deg=90.0))
    _, bits = home(rig, method)
    assert bits == ATTAINED | TARGET_REACHED
    zero = (turn + 0.25) * COUNTS_PER_REV
    assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(rig.position_rev * COUNTS_PER_REV - zero, abs=3)
    assert rig.position_rev * COUNTS_PER_REV == pytest.approx(zero, abs=200)


@pytest.mark.parametrize("method", [0, 1, 19])
def test_without_a_method_or_its_switch_it_is_an_error(method):
    rig = Rig()
    _, bits = home(rig, method)
    assert bits == ERROR | TARGET_REACHED
    assert abs(rig.position_rev) < 0.02
    assert rig.state is ENABLED


def test_software_limits_do_not_act_while_it_runs_and_count_from_the_zero_afterwards(rig):
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, -2 * COUNTS_PER_REV)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 2 * COUNTS_PER_REV)
    _, bits = home(rig, 19)
    assert bits == ATTAINED | TARGET_REACHED
    zero = counts_at(3.0)
    assert rig.motion["low_counts"] == pytest.approx(zero - 2 * COUNTS_PER_REV, abs=3)
    assert rig.motion["high_counts"] == pytest.approx(zero + 2 * COUNTS_PER_REV, abs=3)


def test_halt_interrupts_and_its_end_goes_on(rig):
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.enable(HM)
    rig.word(0x1F)
    rig.wait(300)
    assert rig.status & BITS == 0
    rig.word(0x11F)
    rig.wait(500)
    assert rig.status & BITS == TARGET_REACHED
    held = rig.position_rev
    rig.wait(100)
    assert rig.position_rev == pytest.approx(held, abs=0.002)
    rig.word(0x1F)
    rig.wait(12_000)
    assert rig.status & BITS == ATTAINED | TARGET_REACHED


def test_a_start_during_a_halt_is_none(rig):
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.enable(HM)
    rig.word(0x10F, 0x11F, 0x1F)
    rig.wait(300)
    assert abs(rig.position_rev) < 0.02
    assert rig.status & BITS == TARGET_REACHED
    rig.word(0x0F, 0x1F)
    rig.wait(300)
    assert rig.position_rev < -0.5


def test_bit_4_taken_back_interrupts_and_the_motor_comes_to_rest(rig):
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.enable(HM)
    rig.word(0x1F)
    rig.wait(300)
    rig.word(0x0F)
    rig.wait(500)
    assert rig.status & BITS == TARGET_REACHED
    assert abs(rig.speed_rps) < 0.05
    assert rig.motion["edge_mask"] == 0
    assert math.isfinite(rig.motion["low_counts"])
    rig.wait(300)
    assert rig.motion["mode"] == record.PROFILE


@pytest.mark.parametrize("word", [0x00, 0x02, 0x07])
def test_homing_that_is_disabled_is_over(rig, word):
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.enable(HM)
    rig.word(0x1F)
    rig.wait(300)
    rig.word(word)
    rig.wait(600)
    assert rig.motion["edge_mask"] == 0
    assert math.isfinite(rig.motion["low_counts"])
    assert rig.state in {State.SWITCH_ON_DISABLED, State.SWITCHED_ON}
    assert rig.emergencies() == []


def test_a_homed_axis_goes_to_its_zero_in_profile_position(rig):
    home(rig, 19)
    rig.set(Object.MODES_OF_OPERATION, 0, PP)
    rig.set(Object.TARGET_POSITION, 0, COUNTS_PER_REV)
    rig.word(0x0F, 0x1F)
    rig.wait(1500)
    assert rig.position_rev * COUNTS_PER_REV == pytest.approx(counts_at(3.0) + COUNTS_PER_REV, abs=300)
    assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(COUNTS_PER_REV, abs=300)


def test_a_homed_axis_begins_cyclic_position_where_it_stands(rig):
    home(rig, 35)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    assert rig.read(Object.TARGET_POSITION) == pytest.approx(rig.read(Object.POSITION_ACTUAL), abs=3)
    rig.sync(100)
    assert rig.state is ENABLED


# -- limits ------------------------------------------------------------------------------------------------------------


def test_a_limit_switch_behind_the_home_switch_ends_homing_on_the_ramp_of_6085h():
    rig = rig_with(Switches(home_deg=(3.0, 360.0), positive_limit_deg=4.0))
    rig.set(Object.HOMING_SPEEDS, 1, 4 * COUNTS_PER_REV)
    rig.set(Object.HOMING_ACCELERATION, 0, 4 * COUNTS_PER_REV)
    _, bits = home(rig, 19)
    assert bits == ERROR | TARGET_REACHED
    # on 609Ah alone it would come to rest 2 rev behind the home switch
    entered = 4.0 / 360.0 * RATIO
    assert entered < rig.position_rev < entered + 4.0**2 / 2.0 / 50.0 + 4.0 / 25.0 + 0.02
    assert rig.state is ENABLED


def limited_to_one_revolution(rig):
    for sub, limit in ((1, -COUNTS_PER_REV), (2, COUNTS_PER_REV)):
        rig.set(Object.SOFTWARE_POSITION_LIMIT, sub, limit)
    rig.set(Object.HOMING_METHOD, 0, 17)
    rig.enable(HM)
    rig.word(0x1F)
    rig.wait(500)
    assert rig.position_rev < -1.2


def test_a_software_limit_that_is_written_while_homing_runs_does_not_act_yet(rig):
    limited_to_one_revolution(rig)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, COUNTS_PER_REV // 2)
    rig.wait(20)
    assert rig.state is ENABLED
    assert rig.status & BITS == 0


def test_homing_that_is_interrupted_outside_the_software_limits_is_no_fault_and_can_be_begun_again(rig):
    limited_to_one_revolution(rig)
    rig.word(0x0F)
    rig.wait(400)
    assert rig.state is ENABLED
    assert rig.status & BITS == TARGET_REACHED
    rig.word(0x00)
    rig.wait(20)
    rig.word(0x06, 0x07, 0x0F)
    rig.wait(20)
    assert home(rig, 17)[1] == ATTAINED | TARGET_REACHED
    assert rig.emergencies() == []


def test_software_limits_come_back_when_the_motor_stands_within_them(rig):
    limited_to_one_revolution(rig)
    rig.word(0x0F)
    rig.wait(400)
    assert rig.motion["low_counts"] == -math.inf
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, -20 * COUNTS_PER_REV)
    rig.wait(5)
    assert rig.motion["low_counts"] == -20 * COUNTS_PER_REV
    assert rig.motion["high_counts"] == COUNTS_PER_REV


def test_another_mode_outside_the_software_limits_is_a_fault(rig):
    limited_to_one_revolution(rig)
    rig.word(0x0F)
    rig.wait(400)
    rig.set(Object.MODES_OF_OPERATION, 0, PP)
    rig.wait(5)
    assert rig.emergencies() == [0x8612]
