"""A cycle in two messages: the bytes and the values of one that is done frame by frame."""

import socket
import struct
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.echo import serve
from benchmarks.master_path import ours
from drive_profiles.address import Address
from hil.can.frame import Frame, pack
from hil.can.local import LocalChannel
from hil.master.cyclic import OFFSET_COMMAND, POSITION_COMMAND, TORQUE_COMMAND, Slot
from hil.master.network import SYNC
from hil.master.whole_cycle import WholeCycle
from hil.recording import BusLog, LoggedFrame, LoggedMessage

FEEDBACK = struct.Struct("<Hih")
SCALING = SimpleNamespace(position_rad=float, torque_nm=float)
WORD, SMALL, LARGE = st.integers(0, 0xFFFF), st.integers(-0x8000, 0x7FFF), st.integers(-(1 << 31), (1 << 31) - 1)


def slots_of(packers):
    made = []
    for number, packer in enumerate(packers, 1):
        slot = Slot(SimpleNamespace(scaling=SCALING))
        slot.send_command_as(0x200 + number, packer)
        slot.feedback_id = 0x180 + number
        made.append(slot)
    return made


def whole_of(slots, others=()):
    taken = {}

    def taker(can_id, length):
        def take(data):
            taken[can_id] = bytes(data)
            return len(data) == length

        return take

    handlers = {slot.feedback_id: slot.take_feedback for slot in slots} | {key: taker(key, size) for key, size in others}
    return WholeCycle(slots, handlers, FEEDBACK, SYNC), taken


@given(st.lists(st.tuples(st.sampled_from([POSITION_COMMAND, TORQUE_COMMAND, OFFSET_COMMAND]), WORD, SMALL, SMALL), max_size=6))
def test_the_command_has_the_bytes_of_its_frames(commands):
    slots = slots_of(packer for packer, *_ in commands)
    whole, _ = whole_of(slots)
    for slot, (_, *values) in zip(slots, commands, strict=True):
        slot.control_word, slot.target, slot.torque_offset = values
    assert whole.command() == b"".join(pack(frame) for frame in (*(slot.command() for slot in slots), SYNC))


@pytest.mark.ci
@given(st.lists(st.tuples(WORD, LARGE, SMALL), min_size=1, max_size=6), st.binary(min_size=5, max_size=5))
def test_the_answers_are_those_of_their_frames(values, more):
    slots = slots_of([POSITION_COMMAND] * len(values))
    whole, taken = whole_of(slots, [(0x181 + 0x40, 5), (0x100, 5)])
    frames = [Frame(slot.feedback_id, FEEDBACK.pack(*value)) for slot, value in zip(slots, values, strict=True)]
    message = b"".join(pack(frame) for frame in (Frame(0x100, more), *frames, Frame(0x1C1, more)))
    assert whole.take(message) == set()
    assert [(slot.status_word, slot.position_counts, slot.torque_per_mille) for slot in slots] == values
    assert taken == {0x100: more, 0x1C1: more}


@pytest.mark.parametrize(
    "spoilt",
    [
        [Frame(0x182, bytes(8)), Frame(0x181, bytes(8)), Frame(0x1C0, bytes(2))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(8))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(7)), Frame(0x1C0, bytes(2))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(8)), Frame(0x1C0, bytes(2)), Frame(0x702, b"\5")],
        [],
    ],
    ids=["another order", "one too few", "a wrong length", "one more", "nothing"],
)
def test_what_is_not_all_answers_in_their_order_is_left_alone(spoilt):
    slots = slots_of([POSITION_COMMAND] * 2)
    whole, taken = whole_of(slots, [(0x1C0, 2)])
    for slot in slots:
        slot.position_counts = 7
    assert whole.take(b"".join(map(pack, spoilt))) is None
    assert whole.take(bytes(13)) is None
    assert [slot.position_counts for slot in slots] == [7, 7]
    assert taken == {}


def test_an_answer_of_another_node_with_a_wrong_length_is_missing():
    slots = slots_of([POSITION_COMMAND])
    whole, _ = whole_of(slots, [(0x1C0, 5)])
    assert whole.take(pack(Frame(0x181, bytes(8))) + pack(Frame(0x1C0, bytes(4)))) == {0x1C0}
    too_long = struct.pack("=IB3x8s", 0x1C0, 9, bytes(8))
    assert whole.take(pack(Frame(0x181, bytes(8))) + too_long) == {0x1C0}


def test_a_message_is_logged_as_its_frames_are(tmp_path):
    frames = [Frame(0x201, b"\1\2\3"), Frame(0x80, b""), Frame(0x181, bytes(range(8)))]
    logs = {name: BusLog(tmp_path / name) for name in ("frames", "messages")}
    for is_received in (False, True):
        for can_id, data in frames:
            logs["frames"].add(LoggedFrame(0.25, can_id, data, is_received))
        logs["messages"].add_message(LoggedMessage(0.25, b"".join(map(pack, frames)), is_received))
        logs["frames"].add(LoggedFrame(0.5, 0x702, b"\5", is_received=True))
        logs["messages"].add(LoggedFrame(0.5, 0x702, b"\5", is_received=True))
    for log in logs.values():
        log.write()
    assert Path(tmp_path / "messages").read_text() == Path(tmp_path / "frames").read_text()
    assert len(Path(tmp_path / "messages").read_text().splitlines()) == 8


@pytest.mark.parametrize("count", [1, 3])
def test_cycles_in_messages_are_those_in_frames(count, tmp_path, monkeypatch):
    """The same nodes, laws and set-points, once each way: every set-point and every answer is the same."""

    def echo(listener):
        sock, _ = listener.accept()
        with sock:
            serve(sock, count, until_peer_leaves=True)

    def run(name):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
            listener.bind(str(tmp_path / name))
            listener.listen()
            node = threading.Thread(target=echo, args=[listener])
            node.start()
            channel = LocalChannel(Address("local", str(tmp_path / name)))
            found = ours(channel, count).path()
            channel.close()
            node.join()
            return found

    def refused(self):
        return False

    together = run("messages")
    monkeypatch.setattr(LocalChannel, "takes_messages", property(refused))
    assert run("frames") == together
    assert len({tuple(each) for each in together}) > 10
