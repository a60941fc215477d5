"""The pure state machine against a reference that is written down from the standard's tables of bits, as literal numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia402 import State
from plant_emulator.drive.state_machine import (
    POWERED,
    Action,
    Options,
    Power,
    Step,
    Stop,
    commanded,
    disconnected,
    failed,
    initialised,
    restarted,
    stop_of_fault_reaction,
    stop_of_halt,
    stop_of_quick_stop,
    stopped,
    torque_lost,
)

# 0 not ready, 1 switch on disabled, 2 ready, 3 switched on, 4 operation enabled, 5 quick stop active, 6 reaction, 7 fault
STATES = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
    State.QUICK_STOP_ACTIVE,
    State.FAULT_REACTION_ACTIVE,
    State.FAULT,
)
NOT_READY, DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT = STATES
NUMBER = {state: number for number, state in enumerate(STATES)}

# Commands of the control word (6040h): mask and value of bits 7, 3, 2, 1, 0 as printed, and the transitions they cause,
# each by its number, origin and target.
ARROWS = [
    # shutdown 0 x 1 1 0: 2, 6, 8
    (0b1000_0111, 0b0000_0110, [(2, 1, 2), (6, 3, 2), (8, 4, 2)]),
    # switch on 0 0 1 1 1: 3; disable operation has the same bits: 5
    (0b1000_1111, 0b0000_0111, [(3, 2, 3), (5, 4, 3)]),
    # switch on and enable operation 0 1 1 1 1: 3, and then 4; enable operation has the same bits: 4, 16
    (0b1000_1111, 0b0000_1111, [(3, 2, 3), (4, 3, 4), (16, 5, 4)]),
    # disable voltage 0 x x 0 x: 7, 9, 10, 12
    (0b1000_0010, 0b0000_0000, [(7, 2, 1), (9, 4, 1), (10, 3, 1), (12, 5, 1)]),
    # quick stop 0 x 0 1 x: 7, 10, 11
    (0b1000_0110, 0b0000_0010, [(7, 2, 1), (10, 3, 1), (11, 4, 5)]),
]
WORDS = np.arange(0x10000)


def reference(state, previous, quick_stop_option):
    """The state after each of the 65 536 control words."""
    after = np.full(0x10000, NUMBER[state])
    for mask, bits, arrows in ARROWS:
        for number, origin, target in arrows:
            if origin == NUMBER[state] and (number != 16 or quick_stop_option in (5, 6, 7, 8)):
                after[WORDS & mask == bits] = target
    if state is FAULT and not previous & 0x80:
        after[WORDS & 0x80 == 0x80] = 1  # fault reset, a rising edge: 15
    return after


@pytest.mark.ci
@pytest.mark.parametrize(
    ("state", "previous", "option"), [*((state, 0x00, 2) for state in STATES), (QUICK, 0, 6), (FAULT, 0x8F, 2)]
)
def test_every_control_word_in_every_state_leads_where_the_standards_table_says(state, previous, option):
    before, options = Power(state, previous), Options(quick_stop=option)
    after = np.array([NUMBER[commanded(before, word, options).power.state] for word in range(0x10000)])
    assert np.flatnonzero(after != reference(state, previous, option)).tolist() == []


@pytest.mark.parametrize("option", range(9))
def test_every_quick_stop_option_decides_over_transition_16(option):
    for previous in (0x00, 0x80):
        before, options = Power(QUICK, previous), Options(quick_stop=option)
        after = [NUMBER[commanded(before, word, options).power.state] for word in range(0x100)]
        assert after == reference(QUICK, previous, option)[:0x100].tolist()


def held_word(power, word, options=Options()):  # noqa: B008 - a tuple of numbers
    """As a drive does it: the same word until it moves nothing more."""
    actions = []
    while True:
        step = commanded(power, word, options)
        actions.append(step.action)
        if step.power.state is power.state:
            return step.power, actions
        power = step.power


def test_switch_on_and_enable_in_one_word_passes_switched_on():
    power, actions = held_word(Power(READY, 0x06), 0x0F)
    assert power.state is ENABLED
    assert actions == [Action.RELEASE, Action.ENERGISE, Action.NONE]


def test_a_word_that_is_held_over_a_fault_and_its_reset_enables_nothing():
    power = Power(ENABLED, 0x0F)
    power = stopped(failed(power).power).power
    assert power.state is FAULT
    for word in (0x0F, 0x8F, 0x8F, 0x0F, 0x0F):
        power, actions = held_word(power, word)
        assert Action.ENERGISE not in actions
    assert power.state is DISABLED
    assert [held_word(power, word)[0].state for word in (0x07, 0x0F, 0x06)] == [DISABLED, DISABLED, READY]


def test_fault_reset_is_the_rising_edge_and_clears_the_faults():
    assert commanded(Power(FAULT, 0x00), 0x80) == Step(Power(DISABLED, 0x80), Action.CLEAR)
    assert commanded(Power(FAULT, 0x80), 0x8F) == Step(Power(FAULT, 0x8F))


@given(
    st.sampled_from(STATES),
    st.lists(st.integers(0, 0xFFFF), max_size=8),
    st.builds(Options, st.integers(-2, 8), st.integers(0, 1), st.integers(0, 1), st.integers(-2, 4), st.booleans()),
)
@settings(max_examples=60)
def test_only_enable_operation_energises_and_only_in_switched_on_or_a_quick_stop_that_stays(state, words, options):
    power = Power(state)
    for word in words:
        step = commanded(power, word, options)
        if step.action is Action.ENERGISE:
            assert word & 0x8F == 0x0F
            assert power.state is ON or (power.state is QUICK and options.quick_stop in (5, 6, 7, 8))
            assert not (power.state is QUICK and options.quick_stop_ends)
        # torque is left in states with torque only, and each way out of them takes it away
        if power.state in POWERED and step.power.state not in POWERED:
            assert step.action is Action.RELEASE
        power = step.power


# -- transitions 5 and 8 -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("word", "target", "field"), [(0x07, ON, "disable_operation"), (0x06, READY, "shutdown")])
def test_leaving_with_option_0_takes_the_torque_away_at_once(word, target, field):
    options = Options()._replace(**{field: 0})
    assert commanded(Power(ENABLED, 0x0F), word, options) == Step(Power(target, word), Action.RELEASE)


@pytest.mark.parametrize(("word", "target", "field"), [(0x07, ON, "disable_operation"), (0x06, READY, "shutdown")])
def test_leaving_with_option_1_is_done_when_the_motor_stands(word, target, field):
    options = Options()._replace(**{field: 1})
    step = commanded(Power(ENABLED, 0x0F), word, options)
    assert step == Step(Power(ENABLED, word, target), Action.STOP, Stop.SLOW_DOWN_RAMP)
    again = commanded(step.power, word, options)
    assert again == Step(Power(ENABLED, word, target), Action.NONE, Stop.SLOW_DOWN_RAMP)
    assert stopped(step.power, options) == Step(Power(target, word), Action.RELEASE)


LEAVING = Power(ENABLED, 0x07, ON)


@pytest.mark.parametrize("word", [0x0F, 0x8F, 0x80])
def test_enable_operation_does_not_take_the_ramp_back(word):
    assert commanded(LEAVING, word) == Step(Power(ENABLED, word, ON))


def test_of_shutdown_and_disable_operation_the_last_counts():
    options = Options(shutdown=1, disable_operation=1)
    step = commanded(LEAVING, 0x06, options)
    assert (step.power, step.action) == (Power(ENABLED, 0x06, READY), Action.NONE)
    assert commanded(LEAVING, 0x06, Options(shutdown=0, disable_operation=1)) == Step(Power(READY, 0x06), Action.RELEASE)


def test_quick_stop_and_disable_voltage_come_through_the_ramp():
    step = commanded(LEAVING, 0x02, Options(quick_stop=3))
    assert step == Step(Power(QUICK, 0x02), Action.STOP, Stop.FULL_TORQUE)
    assert commanded(LEAVING, 0x00) == Step(Power(DISABLED, 0x00), Action.RELEASE)


def test_a_fault_comes_through_the_ramp():
    assert failed(LEAVING).power == Power(REACTION, 0x07)


def test_an_enabled_axis_that_stands_stays_enabled():
    assert stopped(Power(ENABLED, 0x0F)) == Step(Power(ENABLED, 0x0F))


# -- option codes ------------------------------------------------------------------------------------------------------

AT_ONCE, SLOW, RAMP, FULL = Stop.AT_ONCE, Stop.SLOW_DOWN_RAMP, Stop.QUICK_STOP_RAMP, Stop.FULL_TORQUE


def test_each_option_code_brakes_as_the_standard_says():
    assert [stop_of_quick_stop(option) for option in range(9)] == [AT_ONCE, SLOW, RAMP, FULL, FULL, SLOW, RAMP, FULL, FULL]
    assert [stop_of_fault_reaction(option) for option in range(5)] == [AT_ONCE, SLOW, RAMP, FULL, FULL]
    assert [stop_of_halt(option) for option in range(1, 5)] == [SLOW, RAMP, FULL, FULL]


def test_a_makers_own_option_code_brakes_on_a_ramp():
    assert [stop_of_quick_stop(-1), stop_of_fault_reaction(-1), stop_of_halt(-1)] == [RAMP, RAMP, SLOW]


@pytest.mark.parametrize("option", range(9))
def test_a_finished_quick_stop_disables_with_0_to_4_and_stays_with_5_to_8(option):
    power = Power(QUICK, 0x02)
    step = stopped(power, Options(quick_stop=option))
    assert step == (Step(power) if option >= 5 else Step(Power(DISABLED, 0x02), Action.RELEASE))


@pytest.mark.parametrize("option", range(9))
def test_a_drive_that_ends_its_quick_stop_by_itself_does_so_whatever_605a_says(option):
    options = Options(quick_stop=option, quick_stop_ends=True)
    assert stopped(Power(QUICK, 0x02), options).power.state is DISABLED
    assert commanded(Power(QUICK, 0x02), 0x0F, options).power.state is QUICK
    assert commanded(Power(ENABLED, 0x0F), 0x02, options).stop is stop_of_quick_stop(option)


# -- events ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", STATES)
def test_power_and_reset_lead_to_switch_on_disabled_and_forget_the_word(state):
    assert initialised(Power(state, 0x8F, ON)) == Step(Power(DISABLED, 0), Action.RELEASE)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("option", range(5))
def test_a_fault_leads_through_its_reaction_where_there_is_a_motor_to_stop(state, option):
    step = failed(Power(state, 0x0F), Options(fault_reaction=option))
    if state in (ENABLED, QUICK):
        assert step == Step(Power(REACTION, 0x0F), Action.STOP, stop_of_fault_reaction(option))
        assert stopped(step.power) == Step(Power(FAULT, 0x0F), Action.RELEASE)
    elif state in (REACTION, FAULT):
        assert step == Step(Power(state, 0x0F))
    else:
        assert step == Step(Power(FAULT, 0x0F), Action.RELEASE)


@pytest.mark.parametrize("state", STATES)
def test_safe_torque_off_is_a_fault_under_torque_and_disables_else(state):
    target = {ENABLED: FAULT, QUICK: FAULT, REACTION: FAULT, READY: DISABLED, ON: DISABLED}.get(state)
    step = torque_lost(Power(state, 0x07))
    assert step == (Step(Power(state, 0x07)) if target is None else Step(Power(target, 0x07), Action.RELEASE))


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("option", range(4))
def test_a_lost_master_is_answered_as_6007_says(state, option):
    target = {
        (ENABLED, 1): REACTION, (ENABLED, 2): DISABLED, (ENABLED, 3): QUICK, (QUICK, 1): REACTION, (QUICK, 2): DISABLED,
    }.get((state, option), state)  # fmt: skip
    step = disconnected(Power(state, 0x0F), option, Options(quick_stop=1, fault_reaction=3))
    assert step.power == Power(target, 0x0F)
    assert step.action is {DISABLED: Action.RELEASE, state: Action.NONE}.get(target, Action.STOP)
    if step.action is Action.STOP:
        assert step.stop is (FULL if target is REACTION else SLOW)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("option", range(4))
def test_a_reset_of_communication_is_answered_as_6007_says_but_never_by_torque_that_stays(state, option):
    power, options = Power(state, 0x0F), Options(quick_stop=7)
    step = restarted(power, option, options)
    if option == 0 and state in (ENABLED, QUICK):
        assert step.power == Power(QUICK, 0x0F, DISABLED)
        assert (step.action, step.stop) == ((Action.STOP, FULL) if state is ENABLED else (Action.NONE, AT_ONCE))
        assert stopped(step.power, options) == Step(Power(DISABLED, 0x0F), Action.RELEASE)  # also with 605Ah from 5 to 8
    else:
        assert step == disconnected(power, option, options)
