"""Modes that change in Operation enabled, and what the status word says in each; all through frames, judged by the plant."""

import numpy as np
import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.motion import record
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.robots.robot import Robot
from tests.plant_emulator.drive.test_drive import moving
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, NO_GAINS, ONE_AXIS, Rig

PP, PV, TQ, HM, IP, CSP, CSV, CST = Mode
ENABLED = State.OPERATION_ENABLED
RATED_NM = round(1000 * ONE_AXIS.axis[AXIS].rated_torque) / 1000
TARGET_REACHED, BIT_12, BIT_13 = 1 << 10, 1 << 12, 1 << 13


def behaving(**behaviour):
    """A rig whose drive behaves so."""
    axis = ONE_AXIS.axis[AXIS].model_copy(update={"behaviour": Behaviour(**behaviour)})
    return Rig(Robot(axis={AXIS: axis}))


def change(rig, mode):
    rig.set(Object.MODES_OF_OPERATION, 0, mode)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == mode


def follow(rig, periods):
    """Torque and speed of the plant in each control period."""
    torques, speeds = [], []
    for _ in range(periods):
        rig.world.axes.advance(1)
        torques.append(float(rig.plant["torque_nm"]))
        speeds.append(rig.speed_rps)
    return np.array(torques), np.array(speeds)


# -- without a jump ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", set(Mode) - {CSP})
def test_a_mode_that_is_entered_while_the_motor_turns_begins_from_its_motion(rig, mode):
    moving(rig)
    before = float(rig.plant["torque_nm"])
    rig.set(Object.TARGET_VELOCITY, 0, 5 * COUNTS_PER_REV)  # where a velocity is asked for, this one
    change(rig, mode)
    torques, speeds = follow(rig, 4)
    assert abs(torques[0] - before) < 0.05 * RATED_NM
    assert speeds[-1] == pytest.approx(5.0, rel=0.1)
    rig.wait(1)
    assert rig.state is ENABLED
    assert rig.emergencies() == []


@pytest.mark.parametrize("mode", set(Mode) - {CSP})
def test_from_each_mode_cyclic_position_takes_over_without_a_fault(rig, mode):
    moving(rig)
    rig.set(Object.TARGET_VELOCITY, 0, 5 * COUNTS_PER_REV)
    change(rig, mode)
    rig.wait(20)
    before = float(rig.plant["torque_nm"])
    change(rig, CSP)
    torques, _ = follow(rig, 1)
    assert abs(torques[0] - before) < 0.05 * RATED_NM
    held = rig.read(Object.TARGET_POSITION) / COUNTS_PER_REV
    rig.sync(300)
    assert rig.state is ENABLED
    assert rig.position_rev == pytest.approx(held, abs=0.002)


def test_through_all_modes_at_rest_the_motor_stays_where_it_is(rig):
    rig.enable(CSP)
    rig.sync(400)
    held = rig.position_rev
    for mode in (PV, PP, IP, HM, CSV, PP, CSP, PV, CSV, IP, CSP, HM):
        change(rig, mode)
        rig.sync(20)
        assert rig.state is ENABLED
    assert rig.position_rev == pytest.approx(held, abs=0.003)


def test_profile_position_entered_in_motion_comes_to_rest_on_6084h(rig):
    moving(rig)
    change(rig, PP)
    _, speeds = follow(rig, 2400)
    inside = np.flatnonzero((speeds < 4.0) & (speeds > 1.0))
    assert -np.polyfit(ONE_AXIS.control_period_s * inside, speeds[inside], 1)[0] == pytest.approx(20.0, rel=0.15)
    assert abs(speeds[-1]) < 0.05
    assert speeds.min() > -0.5


# -- what 6060h takes --------------------------------------------------------------------------------------------------


def test_no_mode_changes_nothing_while_enabled_and_is_taken_with_the_next_enabling(rig):
    rig.enable(CSP)
    rig.set(Object.MODES_OF_OPERATION, 0, 0)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == CSP
    rig.word(0x06)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == 0
    assert rig.word(0x07, 0x0F) is ENABLED
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == 0


def test_a_mode_that_is_not_there_changes_nothing_while_enabled(rig):
    rig.enable(PV)
    assert rig.write(Object.MODES_OF_OPERATION, 0, 2) is SdoAbortCode.INVALID_VALUE
    assert rig.read(Object.MODES_OF_OPERATION) == rig.read(Object.MODES_OF_OPERATION_DISPLAY) == PV


def test_a_mode_that_closes_a_loop_is_not_entered_without_gains():
    rig = Rig(NO_GAINS)
    rig.enable(CST)
    assert rig.write(Object.MODES_OF_OPERATION, 0, PV) is SdoAbortCode.DEVICE_STATE
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == CST
    assert rig.emergencies() == [0x6320]
    assert rig.status & 1 << 7  # warning: something is wrong, and the drive goes on
    change(rig, TQ)
    assert rig.emergencies() == [0x6320, 0]
    assert not rig.status & 1 << 7


@pytest.mark.parametrize("mode", [CSP, CSV, IP])
def test_a_mode_that_interpolates_is_not_entered_with_an_unfit_period(rig, mode):
    rig.set(Object.INTERPOLATION_PERIOD, 2, -5)
    rig.enable(PP)
    assert rig.write(Object.MODES_OF_OPERATION, 0, mode) is SdoAbortCode.DEVICE_STATE
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == PP


def test_a_mode_that_is_written_during_a_stop_acts_with_the_next_enabling(rig):
    rig.set(Object.QUICK_STOP_OPTION, 0, 6)
    moving(rig)
    rig.word(0x02)
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == CSP
    rig.wait(500)
    assert rig.word(0x0F) is ENABLED
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == PV


def test_a_drive_whose_halt_blocks_a_mode_change_takes_it_when_the_halt_ends():
    rig = behaving(halt_blocks_mode_change=True)
    rig.enable(CSP)
    rig.word(0x10F)
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == CSP
    rig.word(0x0F)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == PV


def test_else_a_halt_blocks_no_mode_change(rig):
    rig.enable(CSP)
    rig.word(0x10F)
    change(rig, PV)
    rig.set(Object.TARGET_VELOCITY, 0, 5 * COUNTS_PER_REV)
    rig.wait(200)
    assert abs(rig.speed_rps) < 0.05  # and holds in the new mode


# -- other behaviours --------------------------------------------------------------------------------------------------


def test_a_drive_that_takes_its_time_is_in_each_state_for_so_long():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    for word, state in ((0x06, State.READY_TO_SWITCH_ON), (0x07, State.SWITCHED_ON), (0x0F, ENABLED)):
        before = rig.state
        assert rig.word(word) is before
        rig.wait(15)
        assert rig.state is before
        rig.wait(10)
        assert rig.state is state
    assert rig.word(0x00) is State.SWITCH_ON_DISABLED  # to take the torque away needs no time


def test_of_the_words_that_come_during_a_transition_the_last_counts():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    rig.word(0x06)
    rig.wait(5)
    rig.word(0x07, 0x0F)
    rig.wait(100)
    assert rig.state is ENABLED


def test_an_enabling_that_takes_its_time_and_is_taken_back_does_not_open_the_brake():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    for word in (0x06, 0x07):
        rig.word(word)
        rig.wait(30)
    rig.word(0x0F)
    rig.wait(5)
    rig.word(0x00)
    for _ in range(60):
        rig.wait(1)
        assert rig.motion["mode"] == record.BRAKED
    assert rig.state is State.SWITCH_ON_DISABLED


def test_transition_16_takes_its_time_too():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.QUICK_STOP_OPTION, 0, 6)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    for word in (0x06, 0x07, 0x0F, 0x02):
        rig.word(word)
        rig.wait(300)
    assert rig.word(0x0F) is State.QUICK_STOP_ACTIVE
    rig.wait(30)
    assert rig.state is ENABLED


def test_a_fault_overtakes_a_transition_that_takes_its_time():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    rig.word(0x06)
    rig.wait(30)
    rig.word(0x0F)
    rig.drive.inputs.set_sto(True)
    rig.wait(100)
    assert rig.state is State.SWITCH_ON_DISABLED


def about_to_be_enabled(*objects):
    """A drive that takes its time, 5 ms after enable operation."""
    rig = behaving(transition_delay_ms=20.0)
    for place, value in ((Object.MODES_OF_OPERATION, PV), *objects):
        rig.set(*(place if isinstance(place, tuple) else (place, 0)), value)
    rig.start()
    for word in (0x06, 0x07):
        rig.word(word)
        rig.wait(30)
    rig.word(0x0F)
    rig.wait(5)
    return rig


def assert_only_a_new_word_enables(rig):
    rig.wait(50)
    assert rig.state is State.SWITCHED_ON
    assert rig.motion["mode"] == record.BRAKED
    rig.word(0x0F)
    rig.wait(30)
    assert rig.state is ENABLED


@pytest.mark.parametrize("commands", [(2, 1), (128, 1), (130, 1)], ids=["stop", "pre-operational", "reset"])
def test_an_enabling_that_takes_its_time_does_not_survive_another_nmt_state(commands):
    rig = about_to_be_enabled()
    for command in commands:
        rig.nmt(command)
    assert_only_a_new_word_enables(rig)


@pytest.mark.parametrize("option", [0, 1])
def test_an_enabling_that_takes_its_time_does_not_survive_a_lost_heartbeat(option):
    rig = about_to_be_enabled((Object.ABORT_CONNECTION_OPTION, option), ((0x1029, 1), 1), ((0x1016, 1), 127 << 16 | 8))
    rig.heartbeat()
    rig.wait(10)
    assert rig.emergencies() == [0x8130]
    assert_only_a_new_word_enables(rig)


def test_an_enabling_that_takes_its_time_does_not_survive_an_rpdo_that_fails_to_come():
    rig = behaving(transition_delay_ms=20.0)
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16),), transmission=255)
    rig.set(0x1400, 5, 10)
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    rig.start()
    for word in (0x06, 0x07):
        rig.word(word)
        rig.wait(30)
    rig.send(0x200 + rig.node, b"\x0f\0")
    rig.wait(15)
    assert rig.emergencies() == [0x8250]
    assert_only_a_new_word_enables(rig)


def test_an_enabling_whose_word_came_before_nmt_operational_needs_another_one():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    rig.word(0x06)
    rig.wait(30)
    rig.word(0x07)
    rig.wait(5)
    rig.word(0x0F)
    rig.start()
    assert_only_a_new_word_enables(rig)


def test_safe_torque_off_for_a_moment_ends_what_was_to_come_of_a_transition():
    rig = behaving(transition_delay_ms=20.0)
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    rig.start()
    rig.word(0x06)
    rig.wait(5)
    rig.word(0x0F)
    rig.drive.inputs.set_sto(True)
    rig.drive.inputs.set_sto(False)
    rig.wait(100)
    assert rig.state is State.READY_TO_SWITCH_ON


@pytest.mark.parametrize("option", [2, 6])
def test_a_drive_that_ends_its_quick_stop_by_itself_does_not_stay(option):
    rig = behaving(quick_stop_ends_disabled_at_once=True)
    rig.set(Object.QUICK_STOP_OPTION, 0, option)
    moving(rig)
    assert rig.word(0x02) is State.QUICK_STOP_ACTIVE
    rig.wait(500)
    assert rig.state is State.SWITCH_ON_DISABLED
    rig.word(0x06, 0x07, 0x0F)
    assert rig.word(0x02) is State.SWITCH_ON_DISABLED  # and at rest the state that was commanded is never seen


def test_a_drive_that_is_operational_at_boot_needs_no_start():
    rig = behaving(operational_at_boot=True)
    rig.wait(2)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED
    rig.nmt(129)
    rig.wait(2)
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED


# -- safe torque off ---------------------------------------------------------------------------------------------------


def test_safe_torque_off_takes_the_torque_at_once_and_is_a_fault(rig):
    moving(rig)
    rig.drive.inputs.set_sto(True)
    assert rig.motion["mode"] == record.BRAKED
    rig.wait(1)
    assert rig.plant["torque_nm"] == 0.0
    assert rig.state is State.FAULT
    assert rig.read(Object.ERROR_CODE) == 0x5441
    assert not rig.status & 1 << 4  # voltage enabled
    assert rig.word(0x0F, 0x8F) is State.SWITCH_ON_DISABLED
    assert rig.word(0x06) is State.SWITCH_ON_DISABLED
    rig.drive.inputs.set_sto(False)
    assert rig.status & 1 << 4
    rig.cycle(0, word=0x0F)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED
    assert rig.emergencies() == [0x5441, 0]


def test_safe_torque_off_without_torque_only_disables(rig):
    rig.enable(CSP)
    rig.word(0x07)
    rig.drive.inputs.set_sto(True)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert rig.emergencies() == []


# -- connection --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "state"), [(0, ENABLED), (1, State.FAULT), (2, State.SWITCH_ON_DISABLED), (3, State.SWITCH_ON_DISABLED)]
)
def test_an_rpdo_that_is_missing_is_answered_as_6007h_says(rig, option, state):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, option)
    rig.set(0x1400, 5, 20)
    moving(rig)
    rig.send(0x200 + rig.node, b"\x0f\0" + bytes(4))
    rig.wait(15)
    assert rig.state is ENABLED
    rig.wait(500)
    assert rig.state is state
    assert 0x8250 in rig.emergencies()
    assert rig.read(Object.ERROR_CODE) == 0x8250
