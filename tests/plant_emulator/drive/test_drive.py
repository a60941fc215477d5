"""The drive's state machine, its stops, and what it does when the connection fails; all through frames."""

import itertools

import numpy as np
import pytest

from drive_profiles.standard.cia301 import NmtState, SdoAbortCode
from drive_profiles.standard.cia402 import TARGET_REACHED, WARNING, Mode, Object, State
from plant_emulator.motion import record
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.robots.robot import Robot
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, GAINS, NO_GAINS, ONE_AXIS, Rig

CSP, CST, HM, PP = Mode.CSP, Mode.CST, Mode.HM, Mode.PP
ENABLED = State.OPERATION_ENABLED
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
RAMP_RPS_S, QUICK_RPS_S = 20.0, 50.0  # what 6084h and 6085h hold when the drive leaves the factory


def moving(rig, speed_rps=5.0):
    """Enabled in cyclic position, at a steady speed."""
    rig.cyclic(CSP)
    rig.turn(speed_rps, 0.6)
    assert rig.speed_rps == pytest.approx(speed_rps, rel=0.05)
    return rig


def is_braked(rig):
    return rig.motion["mode"] == record.BRAKED


def speeds_until_rest(rig, milliseconds=1500):
    """Motor speed every millisecond, until the brake is closed or the time is up."""
    speeds = [rig.speed_rps]
    while len(speeds) < milliseconds and not is_braked(rig):
        rig.wait(1)
        speeds.append(rig.speed_rps)
    return np.array(speeds)


def deceleration(speeds):
    """Slope between 80 % and 20 % of the first speed, in rev/s²."""
    inside = np.flatnonzero((speeds < 0.8 * speeds[0]) & (speeds > 0.2 * speeds[0]))
    return -np.polyfit(1e-3 * inside, speeds[inside], 1)[0]


# -- enabling ----------------------------------------------------------------------------------------------------------


def test_it_wakes_up_disabled_and_braked(rig):
    assert rig.state is State.SWITCH_ON_DISABLED
    assert is_braked(rig)


def test_each_control_word_leads_one_state_further(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    states = [rig.word(word) for word in (0x06, 0x07, 0x0F)]
    assert states == [State.READY_TO_SWITCH_ON, State.SWITCHED_ON, ENABLED]
    assert not is_braked(rig)
    assert rig.status == 0x1237  # bit 12: it follows the command value; bit 9: remote; 37h: enabled, with voltage


@pytest.mark.parametrize("words", list(itertools.permutations((0x06, 0x07, 0x0F))))
def test_only_a_shutdown_before_enable_operation_enables(rig, words):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    rig.word(*words)
    assert (rig.state is ENABLED) == (words in {(0x06, 0x07, 0x0F), (0x07, 0x06, 0x0F)})
    assert is_braked(rig) == (rig.state is not ENABLED)


def test_switch_on_and_enable_in_one_word_is_transitions_3_and_4(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    assert rig.word(0x06, 0x0F) is ENABLED


@pytest.mark.parametrize("word", [0x07, 0x0F, 0x1F, 0x87, 0x8F])
def test_no_single_word_leads_out_of_switch_on_disabled_but_shutdown(rig, word):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    assert rig.word(word) is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x07, State.SWITCHED_ON),
        (0x06, State.READY_TO_SWITCH_ON),
        (0x00, State.SWITCH_ON_DISABLED),
    ],
)
def test_leaving_operation_enabled_closes_the_brake_at_once(rig, word, state):
    rig.enable(CSP)
    assert rig.word(word) is state
    assert is_braked(rig)
    rig.wait(2)
    assert rig.speed_rps == 0.0


@pytest.mark.parametrize("command", [None, STOP, PRE_OPERATIONAL], ids=["never started", "stopped", "pre-operational"])
def test_it_is_not_enabled_while_nmt_is_not_operational(rig, command):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    if command is not None:
        rig.start()
        rig.nmt(command)
        rig.nmt(PRE_OPERATIONAL)  # a stopped node hears no SDO
    assert rig.word(0x06, 0x07) is State.SWITCHED_ON
    assert rig.emergencies() == []
    assert rig.word(0x0F, 0x0F) is State.SWITCHED_ON
    assert is_braked(rig)
    assert rig.emergencies() == [0x6320]
    assert rig.status & WARNING


def test_the_start_of_the_node_ends_that_warning_and_a_word_from_before_does_not_enable(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    assert rig.word(0x06, 0x07, 0x0F) is State.SWITCHED_ON
    rig.start()
    assert rig.emergencies() == [0x6320, 0]
    assert rig.read(0x1001) == 0
    assert not rig.status & WARNING
    rig.wait(2)
    assert rig.state is State.SWITCHED_ON
    assert rig.word(0x0F) is ENABLED
    assert rig.emergencies() == [0x6320, 0]


@pytest.mark.ci
@pytest.mark.parametrize("mode", [None, *Mode])
def test_enabled_without_a_mode_it_holds_its_position_and_takes_the_one_that_comes(rig, mode):
    """Masters exist that enable first: 6061h is 0 until the mode is chosen, and no set-point from before moves the motor."""
    rig.set(Object.TARGET_POSITION, 0, 3 * COUNTS_PER_REV)
    rig.set(Object.TARGET_VELOCITY, 0, 0)
    rig.start()
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED
    rig.sync(400)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == 0
    assert rig.drive.mode is None
    assert not is_braked(rig)
    assert abs(rig.position_rev) < 0.003  # under gravity, and no set-point has moved it
    assert rig.read(Object.TARGET_POSITION) == 3 * COUNTS_PER_REV
    if mode is not None:
        rig.set(Object.MODES_OF_OPERATION, 0, mode)
        assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == mode
        assert rig.drive.mode is mode
        rig.wait(2)
    assert rig.state is ENABLED
    assert rig.emergencies() == []


def test_without_a_mode_halt_quick_stop_and_disable_act_as_in_every_mode(rig):
    rig.start()
    assert rig.word(0x06, 0x07, 0x10F) is ENABLED
    rig.wait(100)
    assert rig.status & TARGET_REACHED
    assert rig.word(0x0F) is ENABLED
    assert not rig.status & TARGET_REACHED
    assert rig.word(0x02) is State.QUICK_STOP_ACTIVE
    rig.wait(200)
    assert rig.word(0x0F) is State.SWITCH_ON_DISABLED
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED
    assert rig.word(0x07) is State.SWITCHED_ON
    assert is_braked(rig)


def test_outside_its_limits_a_drive_without_a_mode_is_held_so_that_it_can_be_homed(rig):
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 1, COUNTS_PER_REV)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, 2 * COUNTS_PER_REV)
    rig.start()
    assert rig.word(0x06, 0x07, 0x0F) is ENABLED
    rig.sync(20)
    rig.set(Object.MODES_OF_OPERATION, 0, HM)
    rig.sync(20)
    assert rig.state is ENABLED
    rig.set(Object.MODES_OF_OPERATION, 0, PP)
    rig.sync(20)
    assert rig.state is State.FAULT
    assert rig.emergencies() == [0x8612]


def test_a_drive_that_needs_a_mode_is_not_enabled_without():
    axis = ONE_AXIS.axis[AXIS].model_copy(update={"behaviour": Behaviour(needs_mode_to_enable=True)})
    rig = Rig(Robot(axis={AXIS: axis}))
    rig.start()
    assert rig.word(0x06, 0x07) is State.SWITCHED_ON
    assert rig.emergencies() == []
    assert rig.word(0x0F) is State.SWITCHED_ON
    assert rig.emergencies() == [0x6320]
    assert rig.status & WARNING
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    assert rig.word(0x0F) is ENABLED
    assert rig.emergencies() == [0x6320, 0]
    assert not rig.status & WARNING


@pytest.mark.parametrize("mode", [0, CSP])
def test_without_gains_it_reports_6320h_and_is_not_enabled(mode):
    rig = Rig(NO_GAINS)
    rig.set(Object.MODES_OF_OPERATION, 0, mode)
    rig.start()
    assert rig.word(0x06, 0x07, 0x0F) is State.SWITCHED_ON
    assert is_braked(rig)
    assert rig.emergencies() == [0x6320]
    rig.set(0x2100, 1, 25.0)
    rig.set(0x2101, 1, 0.0905)
    assert rig.word(0x0F) is ENABLED
    assert rig.emergencies() == [0x6320, 0]


@pytest.mark.parametrize(("value", "index"), [(1, -4), (3, -4), (1, -5)])
def test_an_unfit_interpolation_period_is_reported_and_not_enabled(rig, value, index):
    """0.1 ms is less than a control period of 0.25 ms, 0.3 ms is not a whole number of them."""
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.set(Object.INTERPOLATION_PERIOD, 1, value)
    rig.set(Object.INTERPOLATION_PERIOD, 2, index)
    rig.start()
    assert rig.word(0x06, 0x07, 0x0F) is State.SWITCHED_ON
    assert is_braked(rig)
    assert rig.emergencies() == [0x6320]
    rig.set(Object.INTERPOLATION_PERIOD, 1, 5)
    rig.set(Object.INTERPOLATION_PERIOD, 2, -4)
    assert rig.word(0x0F) is ENABLED


def test_the_brake_opens_without_a_jump_whatever_was_written_before(rig):
    """Target, offset and torque from before are no command: the set-point is where the motor stands."""
    rig.set(Object.TARGET_POSITION, 0, 10 * COUNTS_PER_REV)
    rig.set(Object.POSITION_OFFSET, 0, 5000)
    rig.enable(CSP)
    assert rig.read(Object.TARGET_POSITION) + 5000 == rig.read(Object.POSITION_ACTUAL)
    rig.sync(500)
    assert rig.state is ENABLED
    assert abs(rig.position_rev) < 100 / COUNTS_PER_REV


def test_cyclic_torque_starts_at_zero_whatever_was_written_before(rig):
    rig.set(Object.TARGET_TORQUE, 0, 1000)
    rig.enable(CST)
    assert rig.read(Object.TARGET_TORQUE) == 0
    rig.wait(1)
    assert rig.read(Object.TORQUE_ACTUAL) == 0


# -- fault -------------------------------------------------------------------------------------------------------------


def faulty(rig):
    """A drive in fault: a set-point far away."""
    rig.cyclic(CSP)
    rig.cycle(50 * COUNTS_PER_REV)
    rig.wait(500)
    assert rig.state is State.FAULT
    return rig


def test_a_fault_reset_leads_to_switch_on_disabled_and_never_further(rig):
    faulty(rig)
    assert rig.read(Object.ERROR_CODE) == 0x8612
    for word in (0x06, 0x07, 0x0F):
        assert rig.word(word) is State.FAULT
    assert rig.word(0x8F) is State.SWITCH_ON_DISABLED
    assert is_braked(rig)
    assert rig.read(Object.ERROR_CODE) == 0x8612  # the last error, as the history says
    assert rig.read(0x1001) == 0
    assert rig.emergencies() == [0x8612, 0]
    assert rig.word(0x0F) is State.SWITCH_ON_DISABLED


def test_603fh_is_the_last_error_of_the_history_until_that_is_cleared_or_the_node_reset(rig):
    """CiA 402-2: the lower half of 1003h:01h, so errors of communication and lacks count, and a fault reset clears neither."""

    def shown():
        newest = rig.read(0x1003, 1)
        assert rig.read(Object.ERROR_CODE) == (0 if newest is SdoAbortCode.NO_DATA else newest & 0xFFFF)
        return rig.read(Object.ERROR_CODE)

    assert shown() == 0
    faulty(rig)
    assert shown() == 0x8612
    assert rig.word(0x0F, 0x8F) is State.SWITCH_ON_DISABLED
    assert shown() == 0x8612
    rig.send(0x200 + rig.node, b"\x06")  # an RPDO that is too short
    assert shown() == 0x8210
    rig.nmt(RESET_COMMUNICATION)
    rig.start()
    assert shown() == 0x8210
    rig.set(0x1003, 0, 0)
    assert shown() == 0
    rig.set(0x2100, 1, 0.0)
    assert rig.word(0x06, 0x07, 0x0F) is State.SWITCHED_ON
    assert shown() == 0x6320
    rig.nmt(RESET_NODE)
    assert shown() == 0


def test_the_fault_reset_acts_on_the_rising_edge_only(rig):
    rig.cyclic(CSP)
    rig.word(0x8F)  # bit 7 is high before the fault
    rig.cycle(50 * COUNTS_PER_REV, word=0x8F)
    rig.wait(500)
    assert rig.state is State.FAULT
    for word in (0x80, 0x8F, 0x86):
        assert rig.word(word) is State.FAULT
    assert rig.word(0x00) is State.FAULT
    assert rig.word(0x80) is State.SWITCH_ON_DISABLED


def test_a_bit_7_that_stays_high_blocks_the_other_commands(rig):
    faulty(rig)
    assert rig.word(0x80) is State.SWITCH_ON_DISABLED
    assert rig.word(0x86, 0x87, 0x8F) is State.SWITCH_ON_DISABLED
    assert rig.word(0x06) is State.READY_TO_SWITCH_ON


def test_during_the_fault_reaction_no_word_is_heard(rig):
    moving(rig)
    rig.cycle(50 * COUNTS_PER_REV)
    rig.sync()
    assert rig.state is State.FAULT_REACTION_ACTIVE
    for word in (0x00, 0x80, 0x06, 0x0F):
        assert rig.word(word) is State.FAULT_REACTION_ACTIVE


@pytest.mark.parametrize(("option", "rate"), [(1, RAMP_RPS_S), (2, QUICK_RPS_S)])
def test_the_fault_reaction_brakes_on_the_ramp_of_605e(rig, option, rate):
    rig.set(Object.FAULT_REACTION_OPTION, 0, option)
    moving(rig)
    rig.cycle(50 * COUNTS_PER_REV)
    speeds = speeds_until_rest(rig)
    assert deceleration(speeds) == pytest.approx(rate, rel=0.15)
    assert rig.state is State.FAULT


def test_the_fault_reaction_0_closes_the_brake_at_once(rig):
    rig.set(Object.FAULT_REACTION_OPTION, 0, 0)
    moving(rig)
    rig.cycle(50 * COUNTS_PER_REV)
    assert len(speeds_until_rest(rig)) <= 2
    assert rig.state is State.FAULT


# -- quick stop --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("option", "rate"), [(1, RAMP_RPS_S), (2, QUICK_RPS_S)])
def test_a_quick_stop_ramps_down_and_disables(rig, option, rate):
    rig.set(Object.QUICK_STOP_OPTION, 0, option)
    moving(rig)
    assert rig.word(0x02) is State.QUICK_STOP_ACTIVE
    assert not is_braked(rig)
    speeds = speeds_until_rest(rig)
    assert deceleration(speeds) == pytest.approx(rate, rel=0.15)
    assert speeds.min() > -0.5
    assert rig.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(("option", "rate"), [(5, RAMP_RPS_S), (6, QUICK_RPS_S)])
def test_a_quick_stop_that_stays_holds_the_axis_until_it_is_told(rig, option, rate):
    rig.set(Object.QUICK_STOP_OPTION, 0, option)
    moving(rig)
    rig.word(0x02)
    speeds = speeds_until_rest(rig)
    assert deceleration(speeds) == pytest.approx(rate, rel=0.15)
    assert rig.state is State.QUICK_STOP_ACTIVE
    assert not is_braked(rig)
    held = rig.position_rev
    rig.wait(1000)
    assert rig.position_rev == pytest.approx(held, abs=0.001)
    assert rig.word(0x0F) is ENABLED  # transition 16: from where it stands
    rig.sync(200)
    assert rig.state is ENABLED
    assert rig.position_rev == pytest.approx(held, abs=0.001)


def test_a_quick_stop_0_closes_the_brake_at_once(rig):
    rig.set(Object.QUICK_STOP_OPTION, 0, 0)
    moving(rig)
    rig.word(0x02)
    rig.wait(1)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert is_braked(rig)


@pytest.mark.parametrize("option", [0, 1, 2])
def test_a_quick_stop_that_does_not_stay_cannot_be_taken_back(rig, option):
    rig.set(Object.QUICK_STOP_OPTION, 0, option)
    moving(rig)
    assert rig.word(0x02, 0x0F) is State.QUICK_STOP_ACTIVE


def test_a_closed_brake_is_not_opened_again_by_a_fault_within_the_same_instant():
    rig = Rig()
    rig.set(Object.QUICK_STOP_OPTION, 0, 0)
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, COUNTS_PER_REV)
    rig.enable(PP)
    rig.set(Object.TARGET_POSITION, 0, 9 * COUNTS_PER_REV)
    rig.word(0x1F)  # a set-point out of range, which the next period will find …
    rig.word(0x02)
    assert is_braked(rig)
    rig.wait(1)
    assert is_braked(rig)
    assert rig.state is State.FAULT


def test_a_stop_that_cannot_be_finished_ends_with_the_brake(rig):
    """Half a second after its ramp: here the motor has no torque left to stop with."""
    moving(rig)
    rig.set(Object.MAX_TORQUE, 0, 0)
    rig.word(0x02)
    speeds = speeds_until_rest(rig)
    assert len(speeds) == pytest.approx(500 + 1000 * 5.0 / QUICK_RPS_S, abs=20)
    assert rig.state is State.SWITCH_ON_DISABLED


def test_a_slow_ramp_is_given_its_time(rig):
    rig.set(Object.QUICK_STOP_DECELERATION, 0, 4 * COUNTS_PER_REV)
    moving(rig)
    rig.word(0x02)
    speeds = speeds_until_rest(rig, 3000)
    assert deceleration(speeds) == pytest.approx(4.0, rel=0.1)
    assert abs(speeds[-2]) * 2.0 * np.pi < record.STOPPED_RAD_S * 1.5  # it had come to rest by itself when the brake closed


# -- connection --------------------------------------------------------------------------------------------------------


def watch(rig, option, behaviour=1):
    """A drive that moves, and watches the heartbeat of node 127 for 30 ms."""
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, option)
    rig.set(0x1016, 1, 127 << 16 | 30)
    rig.set(0x1029, 1, behaviour)
    moving(rig)
    rig.heartbeat()
    rig.sync(14)
    assert rig.state is ENABLED
    return rig


REACTIONS = [
    (0, ENABLED, None),
    (1, State.FAULT_REACTION_ACTIVE, State.FAULT),
    (2, State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED),
    (3, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
]


@pytest.mark.parametrize("behaviour", [0, 1], ids=["1029h 0", "1029h 1"])
@pytest.mark.parametrize(("option", "first", "last"), REACTIONS)
def test_a_lost_heartbeat_is_answered_as_6007_says(rig, option, first, last, behaviour):
    watch(rig, option, behaviour)
    rig.sync(2)
    assert rig.state is first
    expected = NmtState.PRE_OPERATIONAL if behaviour == 0 else NmtState.OPERATIONAL
    assert rig.drive.slave.nmt_state is expected
    assert 0x8130 in rig.emergencies()
    rig.wait(1000)
    assert rig.state is (last or ENABLED)
    if last is not None:
        assert rig.speed_rps == 0.0


def test_while_heartbeats_come_the_drive_goes_on(rig):
    watch(rig, 3)
    for _ in range(10):
        rig.heartbeat()
        rig.sync(10)
    assert rig.state is ENABLED
    assert rig.emergencies() == []


def test_a_heartbeat_that_comes_back_moves_nothing(rig):
    watch(rig, 3)
    rig.wait(1000)
    rig.heartbeat()
    rig.word(0x0F)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert rig.emergencies() == [0x8130, 0]


@pytest.mark.parametrize(
    ("command", "option", "first", "last"),
    [
        *((command, *reaction) for command in (STOP, PRE_OPERATIONAL) for reaction in REACTIONS),
        (RESET_COMMUNICATION, 0, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
        *((RESET_COMMUNICATION, *reaction) for reaction in REACTIONS[1:]),
    ],
)
def test_nmt_that_leaves_operational_is_answered_as_6007_says(rig, option, first, last, command):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, option)
    moving(rig)
    rig.nmt(command)
    assert rig.drive.state is first
    rig.wait(1000)
    assert rig.drive.state is (last or ENABLED)
    if last is not None:
        assert rig.speed_rps == 0.0
        assert is_braked(rig)


@pytest.mark.parametrize("was_stopped", [False, True], ids=["moving", "held by a quick stop"])
def test_torque_does_not_outlast_a_communication_reset_where_6007_asks_for_nothing(rig, was_stopped):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, 0)
    rig.set(Object.QUICK_STOP_OPTION, 0, 6)
    moving(rig)
    if was_stopped:
        rig.word(0x02)
        rig.wait(300)
        assert not is_braked(rig)
    rig.nmt(RESET_COMMUNICATION)
    assert not is_braked(rig)  # it brakes on its ramp, and does not drop the load
    rig.wait(400)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert is_braked(rig)


def test_a_quick_stop_of_a_communication_reset_leaves_nothing_to_a_later_word(rig):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, 0)
    moving(rig)
    rig.word(0x07)
    rig.word(0x0F)
    rig.nmt(RESET_COMMUNICATION)
    rig.start()
    rig.wait(500)
    assert rig.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_a_node_reset_closes_the_brake_whatever_6007_says(rig, option):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, option)
    moving(rig)
    rig.nmt(RESET_NODE)
    assert is_braked(rig)
    assert rig.state is State.SWITCH_ON_DISABLED
    rig.wait(5)
    assert rig.speed_rps == 0.0
    assert rig.read(Object.ABORT_CONNECTION_OPTION) == 3
    assert rig.read(Object.MODES_OF_OPERATION) == 0


def test_a_node_reset_forgets_what_was_about_to_fail(rig):
    rig.set(Object.SOFTWARE_POSITION_LIMIT, 2, COUNTS_PER_REV)
    rig.enable(PP)
    rig.set(Object.TARGET_POSITION, 0, 9 * COUNTS_PER_REV)
    rig.word(0x1F)
    rig.nmt(RESET_NODE)
    rig.wait(5)
    assert rig.state is State.SWITCH_ON_DISABLED
    assert rig.emergencies() == []


def test_a_communication_reset_in_fault_leaves_the_error_register_saying_so(rig):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, 1)
    moving(rig)
    rig.nmt(RESET_COMMUNICATION)
    rig.wait(1000)
    assert rig.state is State.FAULT
    assert rig.read(Object.ERROR_CODE) == 0x8130
    assert rig.read(0x1001) == 0x11
    assert rig.word(0x80) is State.SWITCH_ON_DISABLED
    assert rig.read(0x1001) == 0


def test_a_communication_reset_in_fault_keeps_the_code_of_an_rpdo_that_failed_to_come(rig):
    rig.set(Object.ABORT_CONNECTION_OPTION, 0, 1)
    rig.set(0x1400, 5, 20)
    moving(rig)
    rig.wait(500)
    assert rig.state is State.FAULT
    assert rig.emergencies() == [0x8250]  # one failure, one emergency
    rig.nmt(RESET_COMMUNICATION)
    assert rig.state is State.FAULT
    assert rig.emergencies() == [0x8250, 0x8250]
    assert rig.read(0x1001) == 0x11
    rig.word(0x80)
    assert rig.read(0x1001) == 0
    assert rig.emergencies() == [0x8250, 0x8250, 0]


def test_a_lost_heartbeat_is_told_once_and_stays_told_when_it_comes_back_in_fault(rig):
    watch(rig, 1)
    rig.wait(500)
    assert rig.emergencies() == [0x8130]
    rig.heartbeat()
    assert rig.state is State.FAULT
    assert rig.emergencies() == [0x8130]
    assert rig.read(0x1001) == 0x11
    rig.word(0x80)
    assert rig.emergencies() == [0x8130, 0]


def test_a_node_reset_forgets_that_the_master_had_gone(rig):
    watch(rig, 1)
    rig.wait(500)
    rig.nmt(RESET_NODE)
    rig.cyclic(CSP)
    rig.drive.inputs.set_sto(True)
    assert rig.state is State.FAULT
    rig.nmt(RESET_COMMUNICATION)
    assert rig.emergencies()[-1] == 0x5441
    assert rig.read(0x1001) == 0x21


def test_a_node_reset_puts_factory_gains_back_into_the_loop(rig):
    rig.set(0x2100, 1, 99.0)
    assert rig.world.axes.cascade_config[0]["position_gain_per_s"] == 99.0
    rig.nmt(RESET_NODE)
    assert rig.world.axes.cascade_config[0]["position_gain_per_s"] == GAINS.position_gain_per_s


# -- what may change while the power stage is on -----------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0, *Mode])
def test_every_mode_is_taken_and_announced(rig, mode):
    rig.set(Object.MODES_OF_OPERATION, 0, mode)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == mode
    assert not mode or rig.read(Object.SUPPORTED_MODES) >> (mode - 1) & 1


@pytest.mark.parametrize("mode", [2, 5, 11, 127, -1, -128])
def test_a_mode_that_it_does_not_have_is_refused(rig, mode):
    assert rig.write(Object.MODES_OF_OPERATION, 0, mode) is SdoAbortCode.INVALID_VALUE
    assert not rig.read(Object.SUPPORTED_MODES) & 1 << (min(mode, 31) - 1 if mode > 0 else 31)


@pytest.mark.parametrize(("index", "sub"), [(0x2100, 1), (0x2101, 1), (0x2101, 2), (0x2101, 3)])
def test_gains_do_not_change_while_the_power_stage_is_on(rig, index, sub):
    before = rig.read(index, sub)
    rig.set(Object.QUICK_STOP_OPTION, 0, 6)
    moving(rig)
    for word, state in ((0x0F, ENABLED), (0x02, State.QUICK_STOP_ACTIVE)):
        assert rig.word(word) is state
        assert rig.write(index, sub, 42.0) is SdoAbortCode.DEVICE_STATE
        assert rig.read(index, sub) == before
    rig.word(0x00)
    rig.set(index, sub, 42.0)
    assert rig.read(index, sub) == 42.0


def test_status_word_follows_an_event_without_being_asked(rig):
    """TPDO 1 carries the status word and is event-driven: the end of a quick stop is news."""
    rig.enable(CSP)
    rig.word(0x02)
    rig.seen.clear()
    rig.wait(500)
    words = [int.from_bytes(frame.data, "little") for frame in rig.seen if frame.can_id == 0x180 + rig.node]
    assert words[-1] & 0x6F == 0x40
