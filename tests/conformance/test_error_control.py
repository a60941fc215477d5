"""Heartbeats produced and watched, guarding, and what a lost connection leads to (CiA 301, 7.2.8.3 and 7.5.2.19 to .32)."""

import itertools

import pytest

from tests.conformance.device import OPERATIONAL, PRE_OP, START, STOPPED
from tests.conformance.sdo_client import INCOMPATIBLE, INVALID, TOO_HIGH, Abort

MASTER, PERIOD_MS = 126, 100
HEARTBEAT_LOST = 0x8130
GUARD_MS, LIFE = 100, 3


@pytest.mark.parametrize("period_ms", [10, 50, 200])
def test_heartbeats_come_at_their_period(device, needs, period_ms):
    needs(0x1017)
    device.beat(period_ms)
    heard = [f for f in device.port.during(10.2 * period_ms / 1000) if f.can_id == 0x700 + device.node_id]
    assert device.is_about(len(heard), 10)
    if device.is_emulated:
        gaps = {round(1000 * (b.at_s - a.at_s), 3) for a, b in itertools.pairwise(heard)}
        assert gaps == {period_ms}
    assert {f.data for f in heard} == {bytes((PRE_OP,))}


def test_a_heartbeat_period_changes_at_once_and_0_ends_them(device, needs):
    needs(0x1017)
    device.beat(200)
    device.port.during(0.3)
    device.beat(20)
    mark = len(device.port.seen)
    device.port.during(0.21)
    assert len(device.error_control(mark)) >= 8
    device.beat(0)
    mark = len(device.port.seen)
    device.port.during(0.5)
    assert device.error_control(mark) == []


def watch(device, node=MASTER, period_ms=PERIOD_MS, sub=1):
    return device.write(0x1016, sub, node << 16 | period_ms)


def beat(device, node=MASTER, state=OPERATIONAL):
    device.port.send(0x700 + node, bytes((state,)))


@pytest.fixture
def watched(device, permit, needs):
    """The device watches the heartbeat of a node that this suite plays."""
    permit("alone")
    needs((0x1016, 1), 0x1001)
    assert watch(device) is None
    return device


def test_a_node_that_was_never_heard_is_not_lost(watched):
    mark = len(watched.port.seen)
    watched.port.during(5 * PERIOD_MS / 1000)
    assert watched.emergencies(mark) == []


def test_a_heartbeat_that_stops_is_told_by_an_emergency_and_its_return_too(watched):
    mark = len(watched.port.seen)
    beat(watched)
    watched.port.during(0.8 * PERIOD_MS / 1000)
    beat(watched)
    watched.port.during(0.8 * PERIOD_MS / 1000)
    assert watched.emergencies(mark) == []
    assert watched.await_emergency(mark, 3 * PERIOD_MS / 1000) == HEARTBEAT_LOST
    assert watched.read(0x1001) & 0x11 == 0x11, "generic and communication error (CiA 301, 7.5.2.2)"
    mark = len(watched.port.seen)
    watched.port.during(5 * PERIOD_MS / 1000)
    assert watched.emergencies(mark) == [], "once is enough"
    beat(watched)
    assert watched.await_emergency(mark, PERIOD_MS / 1000 / 2) == 0
    assert watched.read(0x1001) == 0


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE_OP), (1, OPERATIONAL), (2, STOPPED)])
def test_a_lost_heartbeat_leads_where_1029h_says(watched, needs, behaviour, state):
    needs((0x1029, 1), 0x1017)
    watched.set(0x1029, 1, behaviour)
    watched.beat()
    watched.nmt(START)
    beat(watched)
    watched.port.during(3 * PERIOD_MS / 1000)
    assert watched.state() == state


def test_an_entry_of_1016h_that_says_nothing_watches_nobody(watched):
    beat(watched)
    assert watch(watched, period_ms=0) is None
    mark = len(watched.port.seen)
    watched.port.during(5 * PERIOD_MS / 1000)
    assert [code for code, _ in watched.emergencies(mark) if code] == []


def test_one_node_is_not_watched_twice(watched, needs):
    needs((0x1016, 2))
    assert watched.refused(watch(watched, sub=2), INCOMPATIBLE, INVALID)
    assert watch(watched, node=MASTER - 1, sub=2) is None


def test_the_reserved_bits_of_1016h_are_refused_or_ignored(device, needs):
    needs((0x1016, 1))
    device.is_touched = True
    answer = device.write(0x1016, 1, 0x0100_0000 | MASTER << 16 | PERIOD_MS)
    assert answer is None or device.refused(answer, INVALID, TOO_HIGH, INCOMPATIBLE)


# -- guarding ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def guarded(device, permit, needs):
    """The device may be guarded: its heartbeat is off."""
    permit("alone")
    needs(0x100C, 0x100D)
    if device.has(0x1017):
        device.set(0x1017, 0, 0)
    device.set(0x100C, 0, GUARD_MS)
    device.set(0x100D, 0, LIFE)
    return device


def guard(device):
    """Ask once; the answer's byte, or None."""
    mark = len(device.port.seen)
    device.port.send(0x700 + device.node_id, b"\0", remote=True)
    heard = device.port.expect(0x700 + device.node_id, 0.2, mark)
    return None if heard is None else heard.data[0]


def test_guarding_is_answered_by_the_state_with_a_toggle_bit_that_alternates(guarded):
    assert [guard(guarded) for _ in range(4)] == [0x7F, 0xFF, 0x7F, 0xFF]
    guarded.nmt(START)
    assert [guard(guarded) for _ in range(2)] == [0x05, 0x85]
    guarded.reset()
    assert guard(guarded) == 0x7F, "the first answer after a reset has the toggle bit 0"


def test_guarding_that_stops_is_told_by_an_emergency(guarded):
    mark = len(guarded.port.seen)
    guarded.port.during(2 * LIFE * GUARD_MS / 1000)
    assert guarded.emergencies(mark) == [], "life guarding begins with the first request"
    guard(guarded)
    assert guarded.await_emergency(mark, 2 * LIFE * GUARD_MS / 1000) == HEARTBEAT_LOST
    mark = len(guarded.port.seen)
    guard(guarded)
    assert guarded.await_emergency(mark) == 0


def test_a_heartbeat_takes_the_place_of_guarding(guarded, needs):
    needs(0x1017)
    guarded.beat(1000)
    mark = len(guarded.port.seen)
    guarded.port.send(0x700 + guarded.node_id, b"\0", remote=True)
    guarded.port.during(0.05)
    assert len(guarded.error_control(mark)) <= 1


def test_a_node_without_guarding_does_not_answer_a_remote_request(device, permit, needs):
    permit("alone")
    needs(0x1017)
    if device.has(0x100C):
        pytest.skip("the EDS has guarding")
    assert guard(device) is None
    assert not isinstance(device.sdo.upload(0x1000), Abort)
