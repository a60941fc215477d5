"""Emergencies, the error register and the error history (CiA 301, 7.2.7 and 7.5.2.2, .4, .17, .18)."""

import pytest

from tests.conformance.device import START
from tests.conformance.sdo_client import DEVICE_STATE, INVALID, NO_DATA, NO_SUBINDEX, TOO_HIGH, UNSUPPORTED, Abort

PDO_TOO_SHORT = 0x8210
RECORD, MAPPING = 0x1400, 0x1600
RESTRICTED = (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x7FF)


class Trouble:
    """An RPDO of two place holder bytes: nothing moves, and a frame that is too short is an error."""

    def __init__(self, device):
        self.device = device
        cob_id = device.read(RECORD, 1)
        self.can_id = cob_id & 0x7FF or 0x200 + device.node_id
        device.set(RECORD, 1, self.can_id | 1 << 31)
        device.set(MAPPING, 0, 0)
        refused = device.write(MAPPING, 1, 0x0006_0010)
        if refused is not None:
            pytest.skip(f"no place holder of 16 bits can be mapped: {refused!r}")
        device.set(MAPPING, 0, 1)
        device.set(RECORD, 2, 255)
        device.set(RECORD, 1, self.can_id)
        device.nmt(START)

    def cause(self):
        """The error, once; the error code that came."""
        mark = len(self.device.port.seen)
        self.device.port.send(self.can_id, b"\0")
        return self.device.await_emergency(mark)

    def mend(self):
        """What ends it; the error code that came."""
        mark = len(self.device.port.seen)
        self.device.port.send(self.can_id, b"\0\0")
        return self.device.await_emergency(mark)


@pytest.fixture
def trouble(device, needs, permit):
    permit("alone")
    needs((RECORD, 1), (MAPPING, 0), (MAPPING, 1), 0x1001)
    return Trouble(device)


def test_an_rpdo_that_is_too_short_is_told_with_register_and_end(device, trouble):
    assert trouble.cause() == PDO_TOO_SHORT
    assert device.emergencies()[-1][1] & 0x11 == 0x11
    assert device.read(0x1001) & 0x11 == 0x11
    assert trouble.mend() == 0
    assert device.emergencies()[-1] == (0, 0)
    assert device.read(0x1001) == 0


def test_an_emergency_has_eight_bytes(device, trouble):
    trouble.cause()
    assert {len(f.data) for f in device.port.seen if f.can_id == 0x080 + device.node_id} == {8}


def test_an_error_that_goes_on_is_told_once(device, trouble):
    trouble.cause()
    mark = len(device.port.seen)
    for _ in range(3):
        device.port.send(trouble.can_id, b"\0")
    device.port.during(0.1)
    assert device.emergencies(mark) == []


def test_the_history_has_the_newest_error_first_and_is_cleared_by_0(device, trouble, needs):
    needs((0x1003, 0), (0x1003, 1))
    device.set(0x1003, 0, 0)
    assert device.read(0x1003, 0) == 0
    assert device.refused(device.sdo.upload(0x1003, 1), NO_DATA, NO_SUBINDEX)
    trouble.cause()
    assert device.read(0x1003, 0) == 1
    assert device.read(0x1003, 1) & 0xFFFF == PDO_TOO_SHORT
    trouble.mend()
    trouble.cause()
    assert device.read(0x1003, 0) in {1, 2}
    assert device.refused(device.write(0x1003, 0, 1), INVALID, UNSUPPORTED, TOO_HIGH)
    device.set(0x1003, 0, 0)
    assert device.read(0x1003, 0) == 0


def test_the_identifier_of_the_emergency_is_1014h_and_changes_while_it_is_off_only(device, trouble, needs):
    needs(0x1014)
    cob_id = device.read(0x1014)
    assert cob_id == 0x080 + device.node_id
    other = 0x6C0 + (device.node_id & 0x0F)
    assert device.refused(device.write(0x1014, 0, other), INVALID, DEVICE_STATE, UNSUPPORTED)
    device.set(0x1014, 0, cob_id | 1 << 31)
    mark = len(device.port.seen)
    device.port.send(trouble.can_id, b"\0")
    device.port.during(0.1)
    assert device.emergencies(mark) == []
    trouble.device.port.send(trouble.can_id, b"\0\0")
    device.set(0x1014, 0, other)
    device.port.send(trouble.can_id, b"\0")
    heard = device.port.expect(other, 1.0, mark)
    assert heard is not None
    assert int.from_bytes(heard.data[:2], "little") == PDO_TOO_SHORT


@pytest.mark.parametrize("can_id", RESTRICTED)
def test_a_restricted_identifier_is_refused(device, needs, can_id):
    needs(0x1014)
    device.is_touched = True
    device.set(0x1014, 0, device.read(0x1014) | 1 << 31)
    answer = device.write(0x1014, 0, can_id)
    assert device.refused(answer, INVALID, DEVICE_STATE, TOO_HIGH), f"{can_id:03X}h: {answer!r}"


def test_emergencies_keep_their_distance_and_the_last_state_is_told(device, trouble, needs):
    needs(0x1015)
    mark = len(device.port.seen)
    device.set(0x1015, 0, 1000)  # in units of 100 us: 100 ms
    for _ in range(3):
        device.port.send(trouble.can_id, b"\0")
        device.port.send(trouble.can_id, b"\0\0")
    device.port.during(2.0)
    frames = [frame for frame in device.port.seen[mark:] if frame.can_id == 0x080 + device.node_id]
    assert len(frames) >= 2
    assert device.are_apart(frames, 0.1)
    assert device.emergencies(mark)[-1] == (0, 0)


def test_a_reset_forgets_the_error(device, trouble):
    trouble.cause()
    mark = len(device.port.seen)
    device.reset()
    device.port.during(0.1)
    assert device.read(0x1001) == 0
    assert [code for code, _ in device.emergencies(mark) if code == PDO_TOO_SHORT] == []
    assert not isinstance(device.sdo.upload(0x1000), Abort)
