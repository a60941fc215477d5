"""The state machine against a reference written from the standard's tables, not from the code."""

import pytest

from drive_profiles.standard import cia402
from drive_profiles.standard.cia402 import Command, Event, Mode, QuickStopOption, State

# The standard's status word table, as it is printed: x is any.
STATUS_TABLE = {
    State.NOT_READY_TO_SWITCH_ON: "xxxx xxxx x0xx 0000",
    State.SWITCH_ON_DISABLED: "xxxx xxxx x1xx 0000",
    State.READY_TO_SWITCH_ON: "xxxx xxxx x01x 0001",
    State.SWITCHED_ON: "xxxx xxxx x01x 0011",
    State.OPERATION_ENABLED: "xxxx xxxx x01x 0111",
    State.QUICK_STOP_ACTIVE: "xxxx xxxx x00x 0111",
    State.FAULT_REACTION_ACTIVE: "xxxx xxxx x0xx 1111",
    State.FAULT: "xxxx xxxx x0xx 1000",
}


def reads_as(pattern, word):
    bits = f"{word:016b}"
    return all(p in ("x", b) for p, b in zip(pattern.replace(" ", ""), bits, strict=True))


def reference_next(state, word, previous, option):  # noqa: PLR0912 - one branch per arrow
    """The arrows of the state diagram, by hand: bits of the control word and where they lead."""
    bit0, bit1, bit2, bit3, bit7 = (bool(word & 1 << n) for n in (0, 1, 2, 3, 7))
    was7 = bool(previous & 0x80)
    if state is State.FAULT:
        return State.SWITCH_ON_DISABLED if bit7 and not was7 else State.FAULT
    if bit7 or state in (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE):
        return state
    voltage_off = not bit1
    quick_stop = bit1 and not bit2
    shutdown = bit1 and bit2 and not bit0
    all_on = bit0 and bit1 and bit2
    if state is State.SWITCH_ON_DISABLED:
        return State.READY_TO_SWITCH_ON if shutdown else state
    if state is State.READY_TO_SWITCH_ON:
        if voltage_off or quick_stop:
            return State.SWITCH_ON_DISABLED
        return State.SWITCHED_ON if all_on else state
    if state is State.SWITCHED_ON:
        if voltage_off or quick_stop:
            return State.SWITCH_ON_DISABLED
        if shutdown:
            return State.READY_TO_SWITCH_ON
        return State.OPERATION_ENABLED if bit3 else state
    if state is State.OPERATION_ENABLED:
        if voltage_off:
            return State.SWITCH_ON_DISABLED
        if quick_stop:
            return State.QUICK_STOP_ACTIVE
        if shutdown:
            return State.READY_TO_SWITCH_ON
        return state if bit3 else State.SWITCHED_ON
    if voltage_off:
        return State.SWITCH_ON_DISABLED
    return State.OPERATION_ENABLED if all_on and bit3 and option in (5, 6, 7, 8) else state


@pytest.mark.slow
@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize(("previous", "option"), [(0x0000, 2), (0x0080, 2), (0x000F, 6)])
def test_every_control_word_in_every_state_does_what_the_diagram_says(state, previous, option):
    wrong = [
        hex(word)
        for word in range(0x10000)
        if cia402.next_state(state, word, previous, option) is not reference_next(state, word, previous, option)
    ]
    assert not wrong


@pytest.mark.parametrize("option", range(-2, 10))
@pytest.mark.parametrize("state", State)
def test_every_quick_stop_option_with_every_command_bit(state, option):
    for word in range(0x100):
        for previous in (0x00, 0x80, 0x0F, 0x8F):
            expected = reference_next(state, word, previous, option)
            assert cia402.next_state(state, word, previous, option) is expected, (hex(word), hex(previous))


def test_every_status_word_shows_the_state_of_the_printed_table():
    # Bits 7 to 15 are x in every row, so the rows are compared over the low byte and the rest is shown to be ignored.
    low = [next((s for s, row in STATUS_TABLE.items() if reads_as(row, word)), None) for word in range(0x80)]
    assert all(cia402.state_of(word) is low[word & 0x7F] for word in range(0x10000))
    assert all(row.startswith("xxxx xxxx x") for row in STATUS_TABLE.values())


@pytest.mark.parametrize("state", State)
def test_status_bits_show_their_state_whatever_the_other_bits(state):
    other = cia402.VOLTAGE_ENABLED | cia402.WARNING | cia402.REMOTE | cia402.TARGET_REACHED | cia402.INTERNAL_LIMIT
    assert cia402.state_of(cia402.status_bits(state)) is state
    assert cia402.state_of(cia402.status_bits(state) | other) is state


@pytest.mark.parametrize("command", Command)
def test_each_pattern_is_its_command_and_no_other(command):
    mask, bits = cia402.PATTERNS[command]
    same_bits = {c for c in Command if cia402.PATTERNS[c] == (mask, bits)}
    assert all(cia402.commands(word, 0) in same_bits for word in range(0x10000) if word & mask == bits)
    assert not any(cia402.commands(word, 0) in same_bits for word in range(0x10000) if word & mask != bits)
    assert cia402.commands(cia402.control_word(command), 0) in same_bits


def test_equal_bits_are_told_apart_by_the_state():
    assert cia402.commands(0x07, 0, State.OPERATION_ENABLED) is Command.DISABLE_OPERATION
    assert cia402.commands(0x07, 0, State.READY_TO_SWITCH_ON) is Command.SWITCH_ON
    assert cia402.commands(0x0F, 0, State.READY_TO_SWITCH_ON) is Command.SWITCH_ON_AND_ENABLE
    assert cia402.commands(0x0F, 0, State.SWITCHED_ON) is Command.ENABLE_OPERATION


def test_the_table_has_the_standards_seventeen_arrows():
    arrows = {n: ({o.name for o in t.origins}, t.target.name) for n, t in cia402.TRANSITIONS.items()}
    assert sorted(arrows) == list(range(17))
    assert arrows[2] == ({"SWITCH_ON_DISABLED"}, "READY_TO_SWITCH_ON")
    assert arrows[8] == ({"OPERATION_ENABLED"}, "READY_TO_SWITCH_ON")
    assert arrows[10] == ({"SWITCHED_ON"}, "SWITCH_ON_DISABLED")
    assert arrows[13] == ({s.name for s in State} - {"FAULT", "FAULT_REACTION_ACTIVE"}, "FAULT_REACTION_ACTIVE")


@pytest.mark.parametrize("held", [0x80, 0x8F, 0x86])
def test_fault_reset_is_an_edge_and_never_goes_beyond_switch_on_disabled(held):
    state, previous, seen = State.FAULT, 0x00, []
    for word in [held] * 5:
        state = cia402.next_state(state, word, previous, QuickStopOption.QUICK_STOP_RAMP_AND_STAY)
        previous = word
        seen.append(state)
    assert set(seen) == {State.SWITCH_ON_DISABLED}
    assert cia402.next_state(State.FAULT, held, held) is State.FAULT
    assert cia402.next_state(State.SWITCH_ON_DISABLED, 0x0F, held) is State.SWITCH_ON_DISABLED


def test_the_master_comes_up_in_three_words_and_passes_every_state():
    state, previous, path = State.SWITCH_ON_DISABLED, 0, []
    while state is not State.OPERATION_ENABLED:
        word = cia402.control_word_towards(state)
        assert word is not None
        state, previous = cia402.next_state(state, word, previous), word
        path.append((word, state))
    assert path == [
        (0x06, State.READY_TO_SWITCH_ON),
        (0x07, State.SWITCHED_ON),
        (0x0F, State.OPERATION_ENABLED),
    ]
    assert cia402.control_word_towards(State.OPERATION_ENABLED) == 0x0F


@pytest.mark.parametrize(
    "state",
    [State.FAULT, State.FAULT_REACTION_ACTIVE, State.NOT_READY_TO_SWITCH_ON, State.QUICK_STOP_ACTIVE],
)
def test_the_master_has_no_word_where_it_must_wait_or_decide(state):
    assert cia402.control_word_towards(state) is None


def test_switch_on_and_enable_takes_two_cycles_of_the_same_word():
    first = cia402.next_state(State.READY_TO_SWITCH_ON, 0x0F, 0x06)
    assert first is State.SWITCHED_ON
    assert cia402.next_state(first, 0x0F, 0x0F) is State.OPERATION_ENABLED


@pytest.mark.parametrize("state", State)
def test_events_follow_the_diagram(state):
    fault_lands = {State.FAULT: State.FAULT, State.FAULT_REACTION_ACTIVE: State.FAULT_REACTION_ACTIVE}
    assert cia402.state_after(state, Event.FAULT_DETECTED) is fault_lands.get(state, State.FAULT_REACTION_ACTIVE)
    assert cia402.state_after(state, Event.POWERED) is State.NOT_READY_TO_SWITCH_ON
    done = State.FAULT if state is State.FAULT_REACTION_ACTIVE else state
    assert cia402.state_after(state, Event.FAULT_REACTION_COMPLETED) is done
    ready = State.SWITCH_ON_DISABLED if state is State.NOT_READY_TO_SWITCH_ON else state
    assert cia402.state_after(state, Event.INITIALISED) is ready


@pytest.mark.parametrize("option", QuickStopOption)
def test_a_completed_quick_stop_disables_or_stays_as_605a_says(option):
    after = cia402.state_after(State.QUICK_STOP_ACTIVE, Event.QUICK_STOP_COMPLETED, option)
    assert after is (State.QUICK_STOP_ACTIVE if option >= 5 else State.SWITCH_ON_DISABLED)


def test_supported_modes_are_bits_of_6502h():
    assert cia402.supported_modes_bits([Mode.PP, Mode.CSP, Mode.CST]) == 0b10_1000_0001
    assert cia402.supported_modes(0x3ED) == set(Mode)  # 0x3ED as EPOS-like drives announce it, VL not in it
    for mode in Mode:
        assert cia402.supported_modes(cia402.supported_modes_bits([mode, mode])) == {mode}


def test_indices_are_the_standards():
    assert (cia402.Object.CONTROL_WORD, cia402.Object.STATUS_WORD) == (0x6040, 0x6041)
    assert len({int(o) for o in cia402.Object}) == len(cia402.Object.__members__)
