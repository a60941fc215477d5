"""The option codes: how the drive brakes, and where it ends; all through frames, judged by the plant."""

import numpy as np
import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.motion import record
from tests.plant_emulator.drive.test_drive import (
    QUICK_RPS_S,
    RAMP_RPS_S,
    deceleration,
    faulty,
    is_braked,
    moving,
    speeds_until_rest,
)
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, TURN

CSP, CSV, CST, PP, PV, TQ = Mode.CSP, Mode.CSV, Mode.CST, Mode.PP, Mode.PV, Mode.TQ
ENABLED = State.OPERATION_ENABLED
TARGET_REACHED, INTERNAL_LIMIT, BIT_12 = 1 << 10, 1 << 11, 1 << 12
LIMIT_PER_MILLE = 800


def track(rig, milliseconds):
    """Speed and torque of the plant every millisecond."""
    speeds, torques = [], []
    for _ in range(milliseconds):
        rig.wait(1)
        speeds.append(rig.speed_rps)
        torques.append(float(rig.plant["torque_nm"]))
    return np.array(speeds), np.array(torques)


def assert_braked_with_full_torque(rig, speed_rps):
    """Until it is nearly at rest all the torque that 6072h leaves works against the motion."""
    limit_nm = LIMIT_PER_MILLE * rig.drive.scaling.torque_quantum_nm
    axis = ONE_AXIS.axis[AXIS]
    speeds, torques = [], []
    while abs(rig.speed_rps) > 0.5 * speed_rps and len(torques) < 400:
        rig.world.axes.advance(1)
        speeds.append(rig.speed_rps)
        torques.append(float(rig.plant["torque_nm"]))
    assert np.median(torques) == pytest.approx(-limit_nm)
    rate = -np.polyfit(np.arange(len(speeds)) * ONE_AXIS.control_period_s, speeds, 1)[0]
    assert rate > 2.0 * QUICK_RPS_S
    inertia = axis.motor_inertia_kg_m2 + axis.arm_inertia_kg_m2 / axis.reduction_ratio**2
    assert rate < 2.0 * limit_nm / axis.motor_inertia_kg_m2 / TURN
    assert rate > 0.3 * limit_nm / inertia / TURN


# -- quick stop and fault reaction with full torque --------------------------------------------------------------------


@pytest.mark.parametrize(("option", "stays"), [(3, False), (4, False), (7, True), (8, True)])
def test_a_quick_stop_at_the_current_or_voltage_limit_brakes_with_full_torque(rig, option, stays):
    rig.set(Object.QUICK_STOP_OPTION, 0, option)
    rig.set(Object.MAX_TORQUE, 0, LIMIT_PER_MILLE)
    moving(rig)
    assert rig.word(0x02) is State.QUICK_STOP_ACTIVE
    assert_braked_with_full_torque(rig, 5.0)
    rig.wait(800)
    assert abs(rig.speed_rps) < 0.01
    assert rig.state is (State.QUICK_STOP_ACTIVE if stays else State.SWITCH_ON_DISABLED)
    assert is_braked(rig) is not stays
    assert bool(rig.status & TARGET_REACHED) is stays  # bit 10: the quick stop is finished, and the motor held
    if stays:
        assert rig.word(0x0F) is ENABLED


@pytest.mark.parametrize("option", [3, 4])
def test_the_fault_reaction_at_the_current_or_voltage_limit_brakes_with_full_torque(rig, option):
    rig.set(Object.FAULT_REACTION_OPTION, 0, option)
    rig.set(Object.MAX_TORQUE, 0, LIMIT_PER_MILLE)
    moving(rig)
    rig.command(0x0F, 50 * COUNTS_PER_REV)
    rig.sync()
    assert rig.state is State.FAULT_REACTION_ACTIVE
    assert_braked_with_full_torque(rig, 5.0)
    rig.wait(800)
    assert rig.state is State.FAULT


# -- disable operation and shutdown ------------------------------------------------------------------------------------

LEAVE = [
    (0x07, Object.DISABLE_OPERATION_OPTION, State.SWITCHED_ON),
    (0x06, Object.SHUTDOWN_OPTION, State.READY_TO_SWITCH_ON),
]


@pytest.mark.parametrize(("word", "option", "target"), LEAVE)
def test_with_option_1_the_motor_ramps_down_and_only_then_the_state_changes(rig, word, option, target):
    rig.set(option, 0, 1)
    moving(rig)
    assert rig.word(word) is ENABLED
    assert not rig.status & BIT_12  # it follows no set-point any more
    speeds = [rig.speed_rps]
    while rig.state is ENABLED and len(speeds) < 1000:
        assert not is_braked(rig)
        rig.wait(1)
        speeds.append(rig.speed_rps)
    speeds = np.array(speeds)
    assert deceleration(speeds) == pytest.approx(RAMP_RPS_S, rel=0.15)
    assert abs(speeds[-2]) * TURN < 2.0 * record.STOPPED_RAD_S
    assert rig.state is target
    assert is_braked(rig)


@pytest.mark.parametrize(("word", "option", "target"), LEAVE)
def test_with_option_0_the_brake_closes_at_once(rig, word, option, target):
    rig.set(option, 0, 0)
    moving(rig)
    assert rig.word(word) is target
    assert is_braked(rig)


def test_enable_operation_does_not_take_a_ramp_to_disable_operation_back(rig):
    moving(rig)
    rig.word(0x07)
    rig.wait(50)
    assert rig.word(0x0F) is ENABLED
    rig.cycle(rig.read(Object.TARGET_POSITION))
    speeds = speeds_until_rest(rig)
    assert deceleration(speeds) == pytest.approx(RAMP_RPS_S, rel=0.2)
    assert rig.state is ENABLED  # by the word that came since the ramp began
    rig.sync(20)
    assert abs(rig.speed_rps) < 0.02
    assert not is_braked(rig)


def stopping(rig, word):
    """At 5 rev/s in profile velocity, then the word that begins a ramp."""
    for each in (Object.SHUTDOWN_OPTION, Object.DISABLE_OPERATION_OPTION):
        rig.set(each, 0, 1)
    turning(rig, PV)
    rig.word(word)
    rig.wait(5)


@pytest.mark.parametrize(
    ("word", "target"), [(0x07, State.SWITCHED_ON), (0x06, State.READY_TO_SWITCH_ON), (0x02, State.SWITCH_ON_DISABLED)]
)
def test_the_word_that_began_a_stop_does_not_act_again(rig, word, target):
    stopping(rig, word)
    rig.wait(500)
    assert rig.state is target


@pytest.mark.parametrize(
    ("stop", "word", "state"),
    [
        (0x07, 0x0F, ENABLED),
        (0x07, 0x06, State.READY_TO_SWITCH_ON),
        (0x06, 0x0F, ENABLED),  # by transitions 3 and 4
        (0x06, 0x07, State.SWITCHED_ON),
        (0x02, 0x0F, State.SWITCH_ON_DISABLED),  # no word leads out of it but shutdown
        (0x02, 0x06, State.READY_TO_SWITCH_ON),
    ],
)
def test_a_control_word_that_comes_during_a_stop_acts_when_the_motor_stands(rig, stop, word, state):
    stopping(rig, stop)
    before = rig.state
    assert rig.word(word) is before
    rig.wait(500)
    assert rig.state is state
    if state is ENABLED:
        assert rig.speed_rps > 0.1  # the velocity that 60FFh still asks for
    else:
        assert is_braked(rig)


def test_a_control_word_that_came_during_a_stop_does_not_outlast_a_fault(rig):
    stopping(rig, 0x07)
    rig.word(0x0F)
    rig.motion["trip"] = record.OVERSPEED
    rig.wait(500)
    assert rig.state is State.FAULT
    assert rig.word(0x8F) is State.SWITCH_ON_DISABLED
    rig.wait(50)
    assert rig.state is State.SWITCH_ON_DISABLED


def test_a_control_word_that_came_during_a_stop_does_not_outlast_a_change_of_the_nmt_state(rig):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, 0)
    stopping(rig, 0x07)
    rig.word(0x0F)
    rig.nmt(128)
    rig.start()
    rig.wait(500)
    assert rig.state is State.SWITCHED_ON
    assert rig.word(0x0F) is ENABLED  # a second word does it


@pytest.mark.parametrize(("word", "state"), [(0x00, State.SWITCH_ON_DISABLED), (0x02, State.QUICK_STOP_ACTIVE)])
def test_disable_voltage_and_quick_stop_come_through_that_ramp(rig, word, state):
    moving(rig)
    rig.word(0x07)
    rig.wait(20)
    assert rig.word(word) is state
    assert is_braked(rig) == (word == 0x00)
    rig.wait(500)
    assert rig.state is State.SWITCH_ON_DISABLED


# -- halt --------------------------------------------------------------------------------------------------------------


def turning(rig, mode):
    """Enabled, at 5 rev/s."""
    if mode is CSP:
        return moving(rig)
    if mode is PV:
        rig.set(Object.TARGET_VELOCITY, 0, 5 * COUNTS_PER_REV)
        rig.enable(PV)
        rig.wait(600)
    elif mode is CSV:
        rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.TARGET_VELOCITY, 0, 32)))
        rig.enable(CSV)
        for speed in np.linspace(0.0, 5.0, 150):
            rig.command(0x0F, round(speed * COUNTS_PER_REV))
            rig.sync()
        rig.sync(150)
    elif mode is PP:
        rig.enable(PP)
        rig.set(Object.TARGET_POSITION, 0, 40 * COUNTS_PER_REV)
        rig.word(0x1F)
        rig.wait(600)
    else:
        moving(rig)
        rig.set(Object.MODES_OF_OPERATION, 0, mode)
    assert rig.speed_rps == pytest.approx(5.0, rel=0.1)
    return rig


@pytest.mark.parametrize("mode", [CSP, CSV, CST, PP, PV, TQ])
@pytest.mark.parametrize(("option", "rate"), [(1, RAMP_RPS_S), (2, QUICK_RPS_S)])
def test_halt_ramps_down_as_605d_says_and_holds_the_motor_enabled(rig, mode, option, rate):
    rig.set(Object.HALT_OPTION, 0, option)
    turning(rig, mode)
    word = 0x11F if mode is PP else 0x10F
    assert rig.word(word) is ENABLED
    assert not rig.status & TARGET_REACHED
    speeds, _ = track(rig, 600)
    assert deceleration(np.array([5.0, *speeds])) == pytest.approx(rate, rel=0.2)
    assert abs(speeds[-1]) < 0.02
    assert rig.status & TARGET_REACHED  # with halt it says: stands
    assert bool(rig.status & BIT_12) is (mode in (PP, PV))  # PP: acknowledged, PV: speed 0; cyclic: it does not follow
    assert rig.state is ENABLED
    assert not is_braked(rig)


@pytest.mark.parametrize("mode", [CSP, PP, PV, TQ])
@pytest.mark.parametrize("option", [3, 4])
def test_halt_at_the_current_or_voltage_limit_brakes_with_full_torque(rig, mode, option):
    rig.set(Object.HALT_OPTION, 0, option)
    rig.set(Object.MAX_TORQUE, 0, LIMIT_PER_MILLE)
    turning(rig, mode)
    rig.word(0x11F if mode is PP else 0x10F)
    assert_braked_with_full_torque(rig, 5.0)
    rig.wait(500)
    assert abs(rig.speed_rps) < 0.02
    assert rig.state is ENABLED
    assert rig.status & TARGET_REACHED


def test_after_a_halt_cyclic_position_begins_where_the_motor_stands(rig):
    moving(rig)
    rig.word(0x10F)
    rig.wait(600)
    held = rig.position_rev
    rig.word(0x0F)
    assert rig.status & BIT_12
    assert rig.read(Object.TARGET_POSITION) / COUNTS_PER_REV == pytest.approx(held, abs=0.001)
    rig.sync(200)
    assert rig.state is ENABLED
    assert rig.position_rev == pytest.approx(held, abs=0.002)


def test_set_points_that_come_during_a_halt_are_not_followed(rig):
    moving(rig)
    rig.word(0x10F)
    rig.wait(600)
    held = rig.position_rev
    for step in range(50):
        rig.command(0x10F, round((held + 0.01 * step) * COUNTS_PER_REV))
        rig.sync()
    assert rig.position_rev == pytest.approx(held, abs=0.001)


@pytest.mark.parametrize("mode", [PP, PV])
@pytest.mark.parametrize("option", [1, 2, 3])
def test_a_profile_goes_on_when_the_halt_ends(rig, mode, option):
    rig.set(Object.HALT_OPTION, 0, option)
    turning(rig, mode)
    rig.word(0x11F if mode is PP else 0x10F)
    rig.wait(500)
    rig.word(0x1F if mode is PP else 0x0F)
    rig.wait(600)
    assert rig.speed_rps == pytest.approx(5.0, rel=0.05)


def test_a_drive_that_is_enabled_with_halt_set_does_not_move(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, PV)
    rig.set(Object.TARGET_VELOCITY, 0, 5 * COUNTS_PER_REV)
    rig.start()
    assert rig.word(0x106, 0x107, 0x10F) is ENABLED
    rig.wait(300)
    assert abs(rig.speed_rps) < 0.02
    rig.word(0x0F)
    rig.wait(600)
    assert rig.speed_rps == pytest.approx(5.0, rel=0.05)


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "supported"),
    [
        (Object.ABORT_CONNECTION_OPTION, range(4)),
        (Object.QUICK_STOP_OPTION, range(9)),
        (Object.SHUTDOWN_OPTION, range(2)),
        (Object.DISABLE_OPERATION_OPTION, range(2)),
        (Object.HALT_OPTION, range(1, 5)),
        (Object.FAULT_REACTION_OPTION, range(5)),
        (Object.POSITIONING_OPTION, range(3)),
    ],
)
def test_an_option_that_is_not_supported_is_refused_as_beyond_its_limits(rig, option, supported):
    low = 0 if option is Object.POSITIONING_OPTION else -(2**15)
    for value in {low, *range(max(low, -2), 12), 2**15 - 1}:
        before = rig.read(option)
        if value in supported:
            rig.set(option, 0, value)
        else:
            refusal = SdoAbortCode.VALUE_TOO_LOW if value < min(supported) else SdoAbortCode.VALUE_TOO_HIGH
            assert rig.write(option, 0, value) is refusal
            assert rig.read(option) == before


# -- a fault in a fault, a word that is held ---------------------------------------------------------------------------


def test_a_control_word_that_is_held_over_a_fault_enables_nothing(rig):
    faulty(rig)
    for _ in range(20):
        rig.cycle(0, word=0x0F)
    assert rig.state is State.FAULT
    rig.cycle(0, word=0x8F)
    for _ in range(20):
        rig.cycle(0, word=0x0F)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert is_braked(rig)


def test_a_fault_in_a_fault_changes_the_error_code_and_nothing_else(rig):
    faulty(rig)
    rig.motion["trip"] = record.OVERSPEED
    rig.wait(2)
    assert rig.state is State.FAULT
    assert rig.read(Object.ERROR_CODE) == 0x8400
    assert rig.emergencies() == [0x8612, 0x8400]
    rig.word(0x80)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert rig.read(0x1001) == 0
