"""The process data of a cycle: its bytes are those of frames, and a message has the values of a cycle frame by frame."""

import math
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
from drive_profiles.standard.units import Scaling
from hil.bench.bench import load_bench
from hil.can.frame import Frame, pack
from hil.can.local import LocalChannel
from hil.core.library import CORE
from hil.master.cyclic import (
    FEEDBACK,
    FILTER_STATE,
    JOINT_POSITION,
    OFFSET_COMMAND,
    POSITION_COMMAND,
    TIP_ACCELERATION,
    TORQUE_COMMAND,
    CyclicExchange,
)
from hil.master.network import SYNC
from hil.recording import BusLog, LoggedCycles, LoggedFrame, LoggedMessage

FORMATS = {POSITION_COMMAND: "<Hi", TORQUE_COMMAND: "<Hh", OFFSET_COMMAND: "<Hih"}
ANSWER = struct.Struct("<Hih")
WORD, SMALL, LARGE = st.integers(0, 0xFFFF), st.integers(-0x8000, 0x7FFF), st.integers(-(1 << 31), (1 << 31) - 1)
TIP_ID, FILTER_ID, JOINT_ID = 0x100, 0x281, 0x381
TABLE = load_bench("reference").axis[2].model_copy(update={"load_encoder": SimpleNamespace(rad_per_count=0.25)})


def exchange_of(commands, answers=()):
    """An exchange with axes of these commands, which awaits their feedback and these answers; nothing listens."""
    axis = SimpleNamespace(
        scaling=Scaling(1000, 2.0), profile=SimpleNamespace(supported_modes=(), position_mode=None), table=TABLE
    )
    axes = [SimpleNamespace(**vars(axis)) for _ in commands]
    made = CyclicExchange(None, axes, None, 0.002, loop="drive", with_notch_state=False)
    for number, (slot, command) in enumerate(zip(made.slots, commands, strict=True), 1):
        slot.send_command_as(0x200 + number, command)
        slot.feedback_id = 0x180 + number
    made.expect({slot.feedback_id: (FEEDBACK, row) for row, slot in enumerate(made.slots)} | dict(answers))
    return made


def take(exchange, message):
    """True if the exchange has taken a message."""
    return bool(CORE.call.take_message(exchange.data, message, len(message)))


def counted(exchange):
    """How many answers are missing, after a cycle has been counted."""
    CORE.call.count_answers(exchange.data)
    return exchange.missing_answers


@given(st.lists(st.tuples(st.sampled_from(list(FORMATS)), WORD, SMALL, SMALL), max_size=6))
def test_the_command_has_the_bytes_of_its_frames(commands):
    exchange = exchange_of([command for command, *_ in commands])
    frames = []
    for slot, (command, *values) in zip(exchange.slots, commands, strict=True):
        slot.control_word, slot.target, slot.torque_offset = values
        frames.append(Frame(slot.command_id, struct.pack(FORMATS[command], *values[: len(FORMATS[command]) - 1])))
    assert exchange.command() == b"".join(map(pack, (*frames, SYNC)))
    assert exchange.commands() == frames


@pytest.mark.ci
@given(
    st.lists(st.tuples(WORD, LARGE, SMALL), min_size=1, max_size=6),
    st.tuples(SMALL, SMALL, SMALL),
    st.tuples(st.integers(0, 255), st.floats(width=32)),
    LARGE,
)
def test_the_answers_are_those_of_their_frames(values, tip, state, joint):
    others = {TIP_ID: (TIP_ACCELERATION, 0), FILTER_ID: (FILTER_STATE, 0), JOINT_ID: (JOINT_POSITION, 0)}
    whole, single = (exchange_of([POSITION_COMMAND] * len(values), others) for _ in range(2))
    frames = [Frame(slot.feedback_id, ANSWER.pack(*value)) for slot, value in zip(whole.slots, values, strict=True)]
    more = Frame(FILTER_ID, struct.pack("<Bf", *state)), Frame(JOINT_ID, struct.pack("<i", joint))
    frames = [Frame(TIP_ID, struct.pack("<hhh", *tip)), *frames, *more]
    whole.data.tip_scale = single.data.tip_scale = 1e-3
    assert take(whole, b"".join(map(pack, frames)))
    assert all(single.take(frame) for frame in reversed(frames))
    active, frequency_hz = state
    for each in (whole, single):
        assert [(slot.status_word, slot.position_counts, slot.torque_per_mille) for slot in each.slots] == values
        assert each.tip_m_s2 == tuple(value * 1e-3 for value in tip)
        assert each.slots[0].notch_hz == (frequency_hz if active and math.isfinite(frequency_hz) else 0.0)
        assert counted(each) == each.missed_cycles == 0
        assert each.encoders[0].angle_rad == joint * 0.25


@pytest.mark.parametrize(
    "spoilt",
    [
        [Frame(0x182, bytes(8)), Frame(0x181, bytes(8)), Frame(JOINT_ID, bytes(4))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(8))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(7)), Frame(JOINT_ID, bytes(4))],
        [Frame(0x181, bytes(8)), Frame(0x182, bytes(8)), Frame(JOINT_ID, bytes(4)), Frame(0x702, b"\5")],
        [],
    ],
    ids=["another order", "one too few", "a wrong length", "one more", "nothing"],
)
def test_what_is_not_all_answers_in_their_order_is_left_alone(spoilt):
    exchange = exchange_of([POSITION_COMMAND] * 2, {JOINT_ID: (JOINT_POSITION, 1)})
    for slot in exchange.slots:
        slot.position_counts = 7
    exchange.encoders[1].data.counts = 7
    assert not take(exchange, b"".join(map(pack, spoilt)))
    assert not take(exchange, bytes(13))
    assert [slot.position_counts for slot in exchange.slots] == [7, 7]
    assert exchange.encoders[1].data.counts == 7


def test_an_answer_of_another_content_with_a_wrong_length_is_missing():
    exchange = exchange_of([POSITION_COMMAND], {JOINT_ID: (JOINT_POSITION, 0)})
    assert take(exchange, pack(Frame(0x181, bytes(8))) + pack(Frame(JOINT_ID, bytes(5))))
    assert counted(exchange) == 1
    assert take(exchange, pack(Frame(0x181, bytes(8))) + struct.pack("=IB3x8s", JOINT_ID, 9, bytes(8)))
    assert counted(exchange) == 1
    assert math.isnan(exchange.encoders[0].angle_rad)
    assert (exchange.slots[0].missing, exchange.missed_cycles, exchange.cycles) == (0, 2, 2)


def test_an_axis_is_missing_for_as_many_cycles_as_its_answer_lacks():
    exchange = exchange_of([POSITION_COMMAND] * 2)
    found = []
    for data in (bytes(7), bytes(7), bytes(8)):
        CORE.call.await_answers(exchange.data)
        assert exchange.take(Frame(0x182, data))
        assert exchange.take(Frame(0x181, bytes(8)))
        assert not exchange.take(Frame(0x183, bytes(8)))
        found.append((counted(exchange), *(slot.missing for slot in exchange.slots)))
    assert found == [(1, 0, 1), (1, 0, 2), (0, 0, 0)]


def test_a_message_is_logged_as_its_frames_are(tmp_path):
    frames = [Frame(0x201, b"\1\2\3"), Frame(0x80, b""), Frame(0x181, bytes(range(8)))]
    logs = {name: BusLog(tmp_path / name) for name in ("frames", "messages")}
    for is_received in (False, True):
        for can_id, data in frames:
            logs["frames"].add(LoggedFrame(0.25, can_id, data, is_received))
        logs["messages"].add(LoggedMessage(0.25, b"".join(map(pack, frames)), is_received))
        logs["frames"].add(LoggedFrame(0.5, 0x702, b"\5", is_received=True))
        logs["messages"].add(LoggedFrame(0.5, 0x702, b"\5", is_received=True))
    for log in logs.values():
        log.write()
    assert Path(tmp_path / "messages").read_text() == Path(tmp_path / "frames").read_text()
    assert len(Path(tmp_path / "messages").read_text().splitlines()) == 8


def test_cycles_are_logged_as_their_messages_are(tmp_path):
    sent = [pack(Frame(0x201, bytes([cycle]))) + pack(Frame(0x80, b"")) for cycle in range(3)]
    came = [pack(Frame(0x181, bytes([cycle] * 8))) for cycle in range(3)]
    one_by_one, together = BusLog(tmp_path / "messages"), BusLog(tmp_path / "cycles")
    for cycle in range(3):
        one_by_one.add(LoggedMessage(0.5 + 0.25 * cycle, sent[cycle], is_received=False))
        one_by_one.add(LoggedMessage(0.75 + 0.25 * cycle, came[cycle], is_received=True))
    records = b"".join(there + back for there, back in zip(sent, came, strict=True))
    together.add(LoggedCycles(0.5, 0.25, records, len(sent[0]), len(sent[0]) + len(came[0])))
    for log in (one_by_one, together):
        log.write()
    assert (tmp_path / "cycles").read_text() == (tmp_path / "messages").read_text()
    assert len((tmp_path / "cycles").read_text().splitlines()) == 9


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


def test_from_the_second_cycle_on_the_core_runs_a_cycle_to_its_end(tmp_path, monkeypatch):
    def echo(listener):
        sock, _ = listener.accept()
        with sock:
            serve(sock, 2, until_peer_leaves=True)

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(tmp_path / "bus"))
        listener.listen()
        node = threading.Thread(target=echo, args=[listener])
        node.start()
        channel = LocalChannel(Address("local", str(tmp_path / "bus")))
        mine = ours(channel, 2)
        mine.cycle()
        for name in ("send_message", "receive_message", "put_back", "receive_all", "send_all"):
            monkeypatch.delattr(LocalChannel, name)
        monkeypatch.setattr("hil.master.run._end_cycle", None)
        for _ in range(5):
            mine.cycle()
        channel.close()
        node.join()
