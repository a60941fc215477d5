"""When a PDO is sent and when it comes into force: SYNC, its counter, events, timers, remote requests (CiA 301, 7.2.2)."""

import itertools

import pytest

from tests.conformance.device import PRE_OPERATIONAL, START
from tests.conformance.sdo_client import DEVICE_STATE, INVALID, TOO_HIGH, Abort

TPDO, MAPPING = 0x1800, 0x1A00
INVALID_BIT, NO_RTR = 1 << 31, 1 << 30
SYNC_LENGTH = 0x8240


class Tpdo:
    """TPDO 1 with 1001h in it, where that can be mapped, else with what the EDS lists first."""

    def __init__(self, device):
        self.device = device
        cob_id = device.read(TPDO, 1)
        self.can_id = cob_id & 0x7FF or 0x180 + device.node_id
        self.flags = cob_id & NO_RTR
        device.set(TPDO, 1, self.can_id | self.flags | INVALID_BIT)
        device.set(MAPPING, 0, 0)
        variable = next((v for _, v in sorted(device.entries.items()) if v.pdo_mappable and v.access_type == "ro"), None)
        if variable is None:
            pytest.skip("the EDS has nothing that a TPDO could carry")
        self.place = variable.index, variable.subindex
        self.size = device.size(*self.place)
        device.set(MAPPING, 1, self.place[0] << 16 | self.place[1] << 8 | 8 * self.size)
        device.set(MAPPING, 0, 1)

    def begin(self, kind, *, flags=None, **times):
        """Make it valid and the node operational; times: inhibit (100 us), event (ms), start (SYNC start value)."""
        device = self.device
        refused = device.write(TPDO, 2, kind)
        if refused is not None:
            pytest.skip(f"transmission type {kind}: {refused!r}")
        for name, sub in (("inhibit", 3), ("event", 5), ("start", 6)):
            if name in times:
                if not device.has(TPDO, sub):
                    pytest.skip(f"the EDS has no 1800h:{sub:02X}h")
                device.set(TPDO, sub, times[name])
        device.set(TPDO, 1, self.can_id | (self.flags if flags is None else flags))
        device.nmt(START)

    def heard(self, seconds, since=None):
        """The frames of the PDO in a span of time."""
        place = len(self.device.port.seen) if since is None else since
        self.device.port.during(seconds)
        return [frame for frame in self.device.port.seen[place:] if frame.can_id == self.can_id]

    def per_sync(self, count, counter=None):
        """For each of so many SYNCs, how many frames it brought."""
        found = []
        for number in range(count):
            mark = len(self.device.port.seen)
            self.device.sync(b"" if counter is None else bytes((counter(number),)))
            found.append(len(self.heard(0.02, mark)))
        return found


@pytest.fixture
def tpdo(device, permit, needs):
    permit("alone")
    needs((TPDO, 1), (TPDO, 2), (MAPPING, 0), (MAPPING, 1))
    return Tpdo(device)


@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_a_cyclic_pdo_comes_with_each_nth_sync(tpdo, every):
    tpdo.begin(every)
    assert tpdo.per_sync(21) == [int(number % every == every - 1) for number in range(21)]


def test_a_cyclic_pdo_carries_its_object(device, tpdo):
    tpdo.begin(1)
    mark = len(device.port.seen)
    device.sync()
    (frame,) = tpdo.heard(0.02, mark)
    assert len(frame.data) == tpdo.size


def test_an_acyclic_pdo_comes_with_a_sync_only_and_without_an_event_once_at_most(device, tpdo):
    tpdo.begin(0)
    assert tpdo.heard(0.1) == []
    counts = tpdo.per_sync(5)
    assert set(counts) <= {0, 1}
    if tpdo.place == (0x1001, 0):
        assert sum(counts) <= 1


@pytest.mark.parametrize("kind", [254, 255])
def test_an_event_driven_pdo_does_not_come_with_sync(device, tpdo, kind):
    tpdo.begin(kind)
    tpdo.heard(0.1)
    if tpdo.place == (0x1001, 0):
        assert tpdo.per_sync(5) == [0] * 5


@pytest.mark.parametrize("kind", [254, 255])
def test_the_event_timer_sends_it_at_its_period(device, tpdo, kind):
    tpdo.begin(kind, event=50)
    tpdo.heard(0.06)
    frames = tpdo.heard(0.52)
    assert device.is_about(len(frames), 10)
    if device.is_emulated:
        assert {round(1000 * (b.at_s - a.at_s)) for a, b in itertools.pairwise(frames)} == {50}


def test_the_inhibit_time_keeps_frames_apart(device, tpdo):
    tpdo.begin(255, inhibit=1000, event=10)  # 100 ms
    frames = tpdo.heard(1.0)
    assert len(frames) >= 2
    assert device.are_apart(frames, 0.1)


def test_a_pdo_that_is_not_valid_is_not_sent(device, tpdo):
    tpdo.begin(1)
    device.set(TPDO, 1, tpdo.can_id | tpdo.flags | INVALID_BIT)
    assert tpdo.per_sync(3) == [0, 0, 0]


def test_a_pdo_is_not_sent_outside_of_operational(device, tpdo):
    tpdo.begin(1)
    device.nmt(PRE_OPERATIONAL)
    assert tpdo.per_sync(3) == [0, 0, 0]
    device.nmt(START)
    assert tpdo.per_sync(1) == [1]


def test_a_sync_on_another_identifier_takes_its_place(device, tpdo, needs):
    needs(0x1005)
    device.set(0x1005, 0, 0x6B0)
    tpdo.begin(1)
    assert tpdo.per_sync(2) == [0, 0]
    mark = len(device.port.seen)
    device.port.send(0x6B0)
    assert len(tpdo.heard(0.02, mark)) == 1


@pytest.mark.parametrize("can_id", [0x001, 0x07F, 0x101, 0x180, 0x581, 0x601, 0x701, 0x7FF])
def test_a_sync_takes_no_restricted_identifier(device, needs, can_id):
    needs(0x1005)
    device.is_touched = True
    assert device.refused(device.write(0x1005, 0, can_id), INVALID, DEVICE_STATE, TOO_HIGH)


# -- remote requests ---------------------------------------------------------------------------------------------------


def ask(device, tpdo):
    mark = len(device.port.seen)
    device.port.send(tpdo.can_id, bytes(tpdo.size), remote=True)
    return len(tpdo.heard(0.02, mark))


def test_a_pdo_that_allows_none_does_not_answer_a_remote_request(device, tpdo):
    tpdo.begin(1, flags=NO_RTR)
    assert ask(device, tpdo) == 0


def test_a_pdo_that_waits_for_remote_requests_answers_each(device, tpdo):
    tpdo.begin(253, flags=0)
    tpdo.heard(0.1)
    assert [ask(device, tpdo) for _ in range(3)] == [1, 1, 1]
    assert tpdo.per_sync(3) == [0, 0, 0]


def test_a_synchronous_pdo_that_waits_for_remote_requests_answers_with_what_sync_sampled(device, tpdo):
    tpdo.begin(252, flags=0)
    assert tpdo.per_sync(3) == [0, 0, 0]
    assert ask(device, tpdo) == 1


# -- the counter of SYNC -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("overflow", [1, 241, 255])
def test_an_overflow_value_of_the_sync_counter_that_the_standard_reserves_is_refused(device, needs, overflow):
    needs(0x1019)
    device.is_touched = True
    assert device.refused(device.write(0x1019, 0, overflow), INVALID, TOO_HIGH)


def test_a_sync_of_the_wrong_length_is_an_error_when_they_are_counted(device, tpdo, needs):
    needs(0x1019)
    if device.has(0x1006):
        device.set(0x1006, 0, 0)
    device.set(0x1019, 0, 10)
    tpdo.begin(1)
    mark = len(device.port.seen)
    device.sync()
    assert device.await_emergency(mark) == SYNC_LENGTH
    device.sync(b"\x01")
    device.port.during(0.02)
    assert device.emergencies(mark)[-1] == (0, 0)


@pytest.mark.parametrize("start", [1, 3, 10])
def test_a_pdo_with_a_start_value_begins_at_the_sync_that_carries_it(device, tpdo, needs, start):
    needs(0x1019, (TPDO, 6))
    if device.has(0x1006):
        device.set(0x1006, 0, 0)
    device.set(0x1019, 0, 10)
    tpdo.begin(2, start=start)
    found = tpdo.per_sync(20, lambda number: number % 10 + 1)
    first = found.index(1)
    # the SYNC that carries the start value counts as the first (CiA 301, 7.5.2.37)
    assert first + 1 in {start, start + 1}
    assert found[first:] == [int(number % 2 == 0) for number in range(20 - first)]
    assert not isinstance(device.sdo.upload(0x1000), Abort)
