"""Emergencies: named causes, the register, the history, the frames."""

import pytest

from drive_profiles.cia301 import ErrorRegister, NmtCommand, SdoAbortCode

CURRENT, PROFILE, TEMPERATURE = ErrorRegister.CURRENT, ErrorRegister.PROFILE, ErrorRegister.TEMPERATURE


def test_a_cause_sends_its_code_the_register_and_the_vendors_bytes(bench):
    bench.slave.raise_emergency("short", 0x2310, CURRENT, b"\x0a\x0b\x0c\x0d\x0e")
    assert bench.slave.due == bench.now
    assert bench.slave.take_frames() == [(0x085, bytes.fromhex("1023 03 0a0b0c0d0e"))]
    assert bench.slave.due is None


def test_the_frame_comes_with_the_next_return_value(bench):
    bench.slave.raise_emergency("short", 0x2310, CURRENT)
    assert [frame.can_id for frame in bench.slave.advance(bench.now)] == [0x085]
    bench.slave.clear_emergency("short")
    assert [frame.can_id for frame in bench.sync()] == [0x085]


def test_a_cause_that_is_already_active_is_not_sent_again_unless_its_code_changes(bench):
    for code, frames in ((0x2310, 1), (0x2310, 0), (0x2320, 1)):
        bench.slave.raise_emergency("short", code, CURRENT)
        assert len(bench.slave.take_frames()) == frames
    assert bench.slave.emergency_causes == ("short",)


def test_error_code_0_is_sent_when_the_last_cause_has_gone_and_not_before(bench):
    bench.slave.raise_emergency("short", 0x2310, CURRENT)
    bench.slave.raise_emergency("hot", 0x4210, TEMPERATURE)
    bench.slave.take_frames()
    bench.slave.clear_emergency("short")
    assert bench.slave.take_frames() == []
    bench.slave.clear_emergency("hot")
    assert bench.slave.take_frames() == [(0x085, bytes(8))]
    bench.slave.clear_emergency("hot")
    assert bench.slave.take_frames() == []


def test_the_register_is_the_or_of_all_active_causes(bench):
    assert bench.read(0x1001) == b"\x00"
    bench.slave.raise_emergency("short", 0x2310, CURRENT)
    bench.slave.raise_emergency("follow", 0x8611, PROFILE)
    assert bench.read(0x1001) == b"\x23"
    bench.slave.clear_emergency("short")
    assert bench.read(0x1001) == b"\x21"
    bench.slave.clear_emergency("follow")
    assert bench.read(0x1001) == b"\x00"


def test_the_history_is_newest_first_and_bounded(bench):
    assert bench.read(0x1003, 0) == b"\x00"
    assert bench.read(0x1003, 1) is SdoAbortCode.NO_DATA
    for number in range(10):
        bench.slave.raise_emergency(f"cause {number}", 0xFF00 + number, vendor_bytes=b"\x34\x12")
    assert bench.read(0x1003, 0) == b"\x08"
    codes = [int.from_bytes(bench.read(0x1003, subindex), "little") for subindex in range(1, 9)]
    assert codes == [0x1234FF00 + number for number in range(9, 1, -1)]
    assert bench.read(0x1003, 9) is SdoAbortCode.NO_SUBINDEX


def test_only_0_may_be_written_to_the_history_and_clears_it(bench):
    bench.slave.raise_emergency("short", 0x2310)
    bench.slave.take_frames()
    for count in (1, 8, 255):
        assert bench.write_value(0x1003, 0, count) is SdoAbortCode.INVALID_VALUE
    assert bench.write_value(0x1003, 1, 0) is SdoAbortCode.READ_ONLY
    assert bench.read(0x1003, 0) == b"\x01"
    assert bench.write_value(0x1003, 0, 0) is None
    assert bench.read(0x1003, 0) == b"\x00"
    assert bench.read(0x1001) == b"\x01"


def test_a_stopped_node_keeps_the_error_and_sends_nothing(bench):
    bench.nmt(NmtCommand.STOP)
    bench.slave.raise_emergency("short", 0x2310)
    assert bench.slave.take_frames() == []
    assert bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL) == []
    assert bench.read(0x1001) == b"\x01"
    assert bench.read(0x1003, 1) == b"\x10\x23\x00\x00"


def test_an_error_that_the_owner_still_has_after_a_reset_follows_the_boot_up_message(bench):
    bench.slave.raise_emergency("hot", 0x4210, TEMPERATURE)
    bench.slave.take_frames()

    def on_reset(kind):
        assert bench.slave.emergency_causes == ()
        bench.slave.raise_emergency("hot", 0x4210, TEMPERATURE)

    bench.slave.on_reset = on_reset
    assert [frame.can_id for frame in bench.nmt(NmtCommand.RESET_NODE)] == [0x705, 0x085]


def test_a_communication_reset_forgets_the_errors_of_communication_only(bench):
    bench.slave.raise_emergency("hot", 0x4210, TEMPERATURE)
    bench.slave.raise_emergency("lost", 0x8130, ErrorRegister.COMMUNICATION)
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bench.slave.emergency_causes == ("hot",)
    bench.nmt(NmtCommand.RESET_NODE)
    assert bench.slave.emergency_causes == ()


@pytest.mark.parametrize(("code", "vendor"), [(0, b""), (0xFF, b""), (0x10000, b""), (0x1000, bytes(6))])
def test_an_impossible_emergency_is_the_owners_mistake(bench, code, vendor):
    with pytest.raises(ValueError, match="emergency"):
        bench.slave.raise_emergency("x", code, vendor_bytes=vendor)


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ((0x80000085, 0x00000090), None),
        ((0x80000090, 0x00000090), None),
        ((0x00000085,), None),
        ((0x00000090,), SdoAbortCode.INVALID_VALUE),
        ((0x80000085, 0x20000085), SdoAbortCode.INVALID_VALUE),
        ((0x80000085, 0x40000085), SdoAbortCode.INVALID_VALUE),
        ((0x80000085, 0x00000800), SdoAbortCode.INVALID_VALUE),
        ((0x80000085, 0x00000585), SdoAbortCode.INVALID_VALUE),
        ((0x80000085, 0x00000000), SdoAbortCode.INVALID_VALUE),
    ],
)
def test_the_cob_id_changes_only_while_the_object_does_not_exist(bench, values, code):
    *before, last = values
    for value in before:
        assert bench.write_value(0x1014, 0, value) is None
    assert bench.write_value(0x1014, 0, last) is code


def test_the_cob_id_decides_where_and_whether_frames_are_sent(bench):
    bench.write_value(0x1014, 0, 0x80000085)
    bench.slave.raise_emergency("a", 0x1000)
    assert bench.slave.take_frames() == []
    bench.write_value(0x1014, 0, 0x00000090)
    bench.slave.raise_emergency("b", 0x1000)
    assert [frame.can_id for frame in bench.slave.take_frames()] == [0x090]


def test_a_stranger_hears_the_error_and_its_end(stranger, bench):
    network = stranger.network
    bench.slave.raise_emergency("short", 0x2310, CURRENT, b"\x01")
    network.deliver(bench.slave.take_frames())
    assert [(e.code, e.register, e.data) for e in stranger.emcy.active] == [(0x2310, 3, b"\x01\0\0\0\0")]
    bench.slave.clear_emergency("short")
    network.deliver(bench.slave.take_frames())
    assert stranger.emcy.active == []
    assert len(stranger.emcy.log) == 2
