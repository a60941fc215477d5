"""The NMT automaton: commands, states, addresses, and which services each state has (CiA 301, 7.2.8 and 7.3.2)."""

import pytest

from tests.conformance.device import (
    BEAT_MS,
    COMMANDS,
    OPERATIONAL,
    PRE_OP,
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    START,
    STATE_AFTER,
    STOP,
    STOPPED,
)
from tests.conformance.sdo_client import Abort

RESETS = (RESET_NODE, RESET_COMMUNICATION)
INITIALISATION = "initialisation"
STATES = {PRE_OP: (), OPERATIONAL: (START,), STOPPED: (STOP,)}
"""Commands that lead from Pre-operational, where a reset ends, into each state."""
UPLOAD_1000 = b"\x40\0\x10\0\0\0\0\0"
WAIT_S = 3 * BEAT_MS / 1000


def enter(device, state):
    device.beat()
    for command in STATES[state]:
        device.nmt(command)
    assert device.state(wanted=state) == state


@pytest.mark.parametrize("address", ["its own", "all nodes"])
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", STATES)
def test_a_command_leads_from_each_state_to_its_own(device, permit, needs, state, command, address):
    needs(0x1017)
    if address == "all nodes":
        permit("alone")
    enter(device, state)
    mark = len(device.port.seen)
    device.nmt(command, 0 if address == "all nodes" else None)
    if command in RESETS:
        assert device.port.expect(0x700 + device.node_id, device.boot_s, mark, b"\0") is not None
        device.beat()
        assert device.state() == PRE_OP
        assert device.error_control(mark).count(b"\0") == 1, "a boot-up message comes exactly once"
    else:
        assert device.state() == STATE_AFTER[command]
        assert b"\0" not in device.error_control(mark), "without a reset there is no boot-up message"


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", STATES)
def test_a_command_to_another_node_does_nothing(device, permit, needs, state, command):
    permit("alone")
    needs(0x1017)
    enter(device, state)
    mark = len(device.port.seen)
    device.nmt(command, device.node_id % 127 + 1)
    assert device.state() == state
    assert b"\0" not in device.error_control(mark)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("data", [b"", b"\x01", b"\x02", bytes((1, 0x80)), bytes((0x81,)), bytes((3,)), bytes((0xFF,))])
def test_what_is_no_command_does_nothing(device, needs, state, data):
    needs(0x1017)
    enter(device, state)
    mark = len(device.port.seen)
    device.port.send(0x000, data + bytes((device.node_id,)) if len(data) == 1 and data[0] not in {1, 2, 0x81} else data)
    assert device.state() == state
    assert b"\0" not in device.error_control(mark)


@pytest.mark.parametrize("command", RESETS)
def test_a_command_before_the_boot_up_message_is_not_needed_to_become_pre_operational(device, needs, command):
    """Initialisation ends by itself (CiA 301, 7.3.2.2.1): the fourth state is one in which nobody waits for a command."""
    needs(0x1017)
    device.reset(command)
    device.beat()
    assert device.state() == PRE_OP


@pytest.mark.parametrize("command", RESETS)
def test_two_resets_give_two_boot_up_messages(device, command):
    for _ in range(2):
        mark = len(device.port.seen)
        device.reset(command)
        device.port.during(WAIT_S)
        assert device.error_control(mark).count(b"\0") == 1


def test_a_reset_puts_communication_parameters_back(device, needs):
    needs(0x1017)
    before = device.sdo.upload(0x1017)
    for command in RESETS:
        device.set(0x1017, 0, 1234)
        device.reset(command)
        assert device.sdo.upload(0x1017) == before


@pytest.mark.parametrize("state", STATES)
def test_sdo_is_answered_in_every_state_but_stopped(device, needs, state):
    needs(0x1017)
    enter(device, state)
    answer = device.sdo.ask(UPLOAD_1000, 0.2 if state == STOPPED else None)
    assert (answer is None) == (state == STOPPED)


def test_a_transfer_that_stopped_has_cut_does_not_go_on_afterwards(device, needs):
    needs(0x1008)
    device.is_touched = True
    if len(device.sdo.upload(0x1008)) <= 4:
        pytest.skip("1008h is shorter than a segmented transfer")
    device.sdo.request(b"\x40\x08\x10\0")
    device.nmt(STOP)
    assert device.sdo.ask(b"\x60", 0.1) is None
    device.nmt(PRE_OPERATIONAL)
    assert device.sdo.request(b"\x60")[0] == 0x80
    assert not isinstance(device.sdo.upload(0x1008), Abort)


@pytest.mark.parametrize("state", STATES)
def test_pdos_are_sent_in_operational_only(device, permit, needs, state):
    permit("alone")
    needs((0x1800, 1), (0x1A00, 0), 0x1017)
    cob_id = device.read(0x1800, 1)
    if cob_id >> 31 or device.read(0x1A00, 0) == 0:
        pytest.skip("TPDO 1 carries nothing unless it is configured")
    device.set(0x1800, 2, 1)
    enter(device, state)
    mark = len(device.port.seen)
    device.sync()
    heard = device.port.expect(cob_id & 0x7FF, 0.2, mark)
    assert (heard is not None) == (state == OPERATIONAL)
