"""Emergencies: named causes, the register, the history, the frames."""

import pytest

from drive_profiles.standard.cia301 import ErrorRegister, NmtCommand, SdoAbortCode

MS = 1_000_000
CURRENT, PROFILE, TEMPERATURE = ErrorRegister.CURRENT, ErrorRegister.PROFILE, ErrorRegister.TEMPERATURE


def test_a_cause_sends_its_code_and_the_register(bench):
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    assert bench.slave.due == bench.now
    assert bench.slave.take_frames() == [(0x085, bytes.fromhex("1023 03 0000000000"))]
    assert bench.slave.due is None


def test_the_frame_comes_with_the_next_return_value(bench):
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    assert [frame.can_id for frame in bench.slave.advance(bench.now)] == [0x085]
    bench.slave.emergencies.clear_cause("short")
    assert [frame.can_id for frame in bench.sync()] == [0x085]


def test_a_cause_that_is_already_active_is_not_sent_again_unless_its_code_changes(bench):
    for code, frames in ((0x2310, 1), (0x2310, 0), (0x2320, 1)):
        bench.slave.emergencies.raise_cause("short", code, CURRENT)
        assert len(bench.slave.take_frames()) == frames
    assert bench.slave.emergencies.causes == ("short",)


def test_a_cause_joins_another_with_its_code_without_a_second_frame(bench):
    bench.slave.emergencies.raise_cause("of the node", 0x2310, CURRENT)
    bench.slave.take_frames()
    bench.slave.emergencies.join_cause("of the owner", 0x2310, CURRENT)
    assert bench.slave.take_frames() == []
    assert bench.slave.emergencies.causes == ("of the node", "of the owner")
    bench.slave.emergencies.clear_cause("of the node")
    assert bench.slave.take_frames() == []  # the owner still says so
    bench.slave.emergencies.join_cause("another", 0x2320, CURRENT)
    assert [frame.data[:2] for frame in bench.slave.take_frames()] == [b"\x20\x23"]


def test_error_code_0_is_sent_when_the_last_cause_has_gone_and_not_before(bench):
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    bench.slave.emergencies.raise_cause("hot", 0x4210, TEMPERATURE)
    bench.slave.take_frames()
    bench.slave.emergencies.clear_cause("short")
    assert bench.slave.take_frames() == []
    bench.slave.emergencies.clear_cause("hot")
    assert bench.slave.take_frames() == [(0x085, bytes(8))]
    bench.slave.emergencies.clear_cause("hot")
    assert bench.slave.take_frames() == []


def test_the_register_is_the_or_of_all_active_causes(bench):
    assert bench.read(0x1001) == b"\x00"
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    bench.slave.emergencies.raise_cause("follow", 0x8611, PROFILE)
    assert bench.read(0x1001) == b"\x23"
    bench.slave.emergencies.clear_cause("short")
    assert bench.read(0x1001) == b"\x21"
    bench.slave.emergencies.clear_cause("follow")
    assert bench.read(0x1001) == b"\x00"


def test_the_history_is_newest_first_and_bounded(bench):
    assert bench.read(0x1003, 0) == b"\x00"
    assert bench.read(0x1003, 1) is SdoAbortCode.NO_DATA
    for number in range(10):
        bench.slave.emergencies.raise_cause(f"cause {number}", 0xFF00 + number)
    assert bench.read(0x1003, 0) == b"\x08"
    codes = [int.from_bytes(bench.read(0x1003, subindex), "little") for subindex in range(1, 9)]
    assert codes == [0xFF00 + number for number in range(9, 1, -1)]
    assert bench.read(0x1003, 9) is SdoAbortCode.NO_SUBINDEX


def test_the_last_error_code_is_that_of_the_newest_entry_until_the_history_is_cleared(bench):
    assert bench.slave.emergencies.last_code == 0
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    bench.slave.emergencies.raise_cause("follow", 0x8611, PROFILE)
    bench.slave.emergencies.clear_cause("follow")
    assert bench.slave.emergencies.last_code == 0x8611  # the fault has gone, what it was has not
    bench.write_value(0x1003, 0, 0)
    assert bench.slave.emergencies.last_code == 0


def test_only_0_may_be_written_to_the_history_and_clears_it(bench):
    bench.slave.emergencies.raise_cause("short", 0x2310)
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
    bench.slave.emergencies.raise_cause("short", 0x2310)
    assert bench.slave.take_frames() == []
    assert bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL) == []
    assert bench.read(0x1001) == b"\x01"
    assert bench.read(0x1003, 1) == b"\x10\x23\x00\x00"


def test_an_error_that_the_owner_still_has_after_a_reset_follows_the_boot_up_message(bench):
    bench.slave.emergencies.raise_cause("hot", 0x4210, TEMPERATURE)
    bench.slave.take_frames()

    def on_reset(kind):
        assert bench.slave.emergencies.causes == ()
        bench.slave.emergencies.raise_cause("hot", 0x4210, TEMPERATURE)

    bench.slave.on_reset = on_reset
    assert [frame.can_id for frame in bench.nmt(NmtCommand.RESET_NODE)] == [0x705, 0x085]


def test_a_communication_reset_forgets_the_errors_of_communication_only(bench):
    bench.slave.emergencies.raise_cause("hot", 0x4210, TEMPERATURE)
    bench.slave.emergencies.raise_cause("lost", 0x8130, ErrorRegister.COMMUNICATION)
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bench.slave.emergencies.causes == ("hot",)
    bench.nmt(NmtCommand.RESET_NODE)
    assert bench.slave.emergencies.causes == ()


@pytest.mark.parametrize("code", [0, 0xFF, 0x10000])
def test_an_impossible_emergency_is_the_owners_mistake(bench, code):
    with pytest.raises(ValueError, match="emergency"):
        bench.slave.emergencies.raise_cause("x", code)


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
    bench.slave.emergencies.raise_cause("a", 0x1000)
    assert bench.slave.take_frames() == []
    bench.write_value(0x1014, 0, 0x00000090)
    bench.slave.emergencies.raise_cause("b", 0x1000)
    assert [frame.can_id for frame in bench.slave.take_frames()] == [0x090]


@pytest.mark.parametrize("kept", [0x2000_0085, 0x0000_0585])
def test_a_kept_cob_id_that_could_not_be_written_is_not_in_force(bench, kept):
    bench.dictionary.stored = {(0x1014, 0): kept}
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bench.read(0x1014) == b"\x85\0\0\0"
    bench.slave.emergencies.raise_cause("a", 0x1000)
    assert [frame.can_id for frame in bench.slave.take_frames()] == [0x085]


# -- inhibit time (CiA 301, 7.5.2.18) ----------------------------------------------------------------------------------


def inhibited(bench, multiple_of_100us=100):
    assert bench.write_value(0x1015, 0, multiple_of_100us) is None
    return bench.slave


def test_within_the_inhibit_time_emergencies_wait_and_none_is_lost(bench):
    """Golden transcript: 1015h = 100, 10 ms; the register of a frame is that of its event."""
    slave = inhibited(bench)
    slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    slave.emergencies.raise_cause("hot", 0x4210, TEMPERATURE)
    slave.emergencies.clear_cause("short")
    slave.emergencies.clear_cause("hot")
    assert slave.take_frames() == [(0x085, bytes.fromhex("1023 03 0000000000"))]
    assert slave.due == bench.now + 10 * MS
    assert bench.wait(30) == [
        (10 * MS, (0x085, bytes.fromhex("1042 0b 0000000000"))),
        (20 * MS, (0x085, bytes(8))),
    ]
    assert slave.due is None


def test_an_emergency_after_the_inhibit_time_goes_at_once(bench):
    slave = inhibited(bench)
    slave.emergencies.raise_cause("a", 0x1000)
    slave.take_frames()
    bench.wait(10)
    slave.advance(bench.now)
    slave.emergencies.raise_cause("b", 0x1000)
    assert len(slave.take_frames()) == 1


def test_of_too_many_that_wait_the_newest_are_sent(bench):
    slave = inhibited(bench)
    for number in range(12):
        slave.emergencies.raise_cause(f"cause {number}", 0xFF00 + number)
    assert len(slave.take_frames()) == 1
    codes = [frame.data[0] for _, frame in bench.wait(1000)]
    assert codes == list(range(4, 12))
    assert bench.read(0x1003, 0) == b"\x08"


def test_a_caller_who_comes_late_gets_one_and_the_next_a_whole_inhibit_time_later(bench):
    slave = inhibited(bench)
    for cause in "abc":
        slave.emergencies.raise_cause(cause, 0x1000)
    slave.take_frames()
    bench.now += 35 * MS
    assert len(slave.advance(bench.now)) == 1
    assert slave.due == 45 * MS


def test_without_an_inhibit_time_what_waits_goes_at_once(bench):
    slave = inhibited(bench)
    for cause in "abcd":
        slave.emergencies.raise_cause(cause, 0x1000)
    slave.take_frames()
    bench.write_value(0x1015, 0, 0)
    assert len(bench.wait(0)) == 3


def test_what_waits_while_the_object_does_not_exist_is_dropped(bench):
    slave = inhibited(bench)
    for cause in "abcd":
        slave.emergencies.raise_cause(cause, 0x1000)
    slave.take_frames()
    bench.write_value(0x1014, 0, 0x8000_0085)
    assert bench.wait(100) == []
    assert slave.due is None


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_what_waits_is_dropped_when_the_node_stops_or_is_reset(bench, command):
    slave = inhibited(bench)
    for cause in "ab":
        slave.emergencies.raise_cause(cause, 0x1000)
    slave.take_frames()
    bench.nmt(command)
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bench.wait(100) == []


def test_the_inhibit_time_is_stored_and_in_force_after_a_reset(bench):
    bench.dictionary.stored = {(0x1015, 0): 50}
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    for cause in "ab":
        bench.slave.emergencies.raise_cause(cause, 0x1000)
    bench.slave.take_frames()
    assert bench.slave.due == 5 * MS


def test_a_stranger_hears_the_error_and_its_end(stranger, bench):
    network = stranger.network
    bench.slave.emergencies.raise_cause("short", 0x2310, CURRENT)
    network.deliver(bench.slave.take_frames())
    assert [(e.code, e.register, e.data) for e in stranger.emcy.active] == [(0x2310, 3, bytes(5))]
    bench.slave.emergencies.clear_cause("short")
    network.deliver(bench.slave.take_frames())
    assert stranger.emcy.active == []
    assert len(stranger.emcy.log) == 2
