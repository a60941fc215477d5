"""The reader of candump's logs: what python-can writes it reads, what is not a frame it counts."""

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import LogError
from hil.logs import candump
from hil.logs.opening import open_log

FRAMES = st.lists(
    st.tuples(
        st.integers(0, 2_000_000_000_000_000),
        st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF),
        st.booleans(),
        st.binary(max_size=8),
        st.booleans(),
    ),
    min_size=1,
    max_size=20,
)


def messages(frames):
    stamps = sorted(stamp for stamp, *_ in frames)
    return [
        can.Message(
            timestamp=stamp * 1e-6, arbitration_id=can_id, is_extended_id=can_id > 0x7FF or wide, data=data, is_rx=received,
            channel="can0",
        )
        for stamp, (_, can_id, wide, data, received) in zip(stamps, frames, strict=True)
    ]  # fmt: skip


def rows(log):
    found = [
        (int(stream.position[row]), can_id, stream.bytes_of(row), int(stream.stamp_ns[row]))
        for can_id, stream in log.streams.items()
        for row in range(len(stream))
    ]
    return sorted(found)


@given(FRAMES)
@settings(max_examples=60)
def test_what_python_can_writes_is_read(tmp_path_factory, frames):
    path = tmp_path_factory.mktemp("log") / "bus.log"
    written = messages(frames)
    with can.CanutilsLogWriter(str(path)) as writer:
        for message in written:
            writer.on_message_received(message)
    found = rows(open_log(path))
    assert [(can_id & 0x1FFFFFFF, data) for _, can_id, data, _ in found] == [
        (message.arbitration_id, bytes(message.data)) for message in written
    ]
    assert [can_id > 0x7FF or bool(can_id & 0x80000000) for _, can_id, _, _ in found] == [
        message.is_extended_id for message in written
    ]
    first = written[0].timestamp
    for (_, _, _, stamp_ns), message in zip(found, written, strict=True):
        assert stamp_ns * 1e-9 == pytest.approx(message.timestamp - first, abs=2e-6)


@pytest.mark.parametrize(
    "line",
    [
        "(1.500000) can0 182#0102",
        " (1.500000)  can0  182   [2]  01 02",
        " (2026-11-23 12:00:01.500000)  can0  182   [2]  01 02   '..'",
        "(1.500000)  can0  RX - -  182   [2]  01 02",
        "(1.500000) can0 182#0102 R",
        "(1.500000) vcan0 182#0102 T\r",
    ],
)
def test_each_way_in_which_candump_prints_a_frame_is_read(tmp_path, line):
    (tmp_path / "one.log").write_text(f"{line}\n")
    [(_, can_id, data, _)] = rows(open_log(tmp_path / "one.log"))
    assert (can_id, data) == (0x182, b"\x01\x02")


def test_frames_of_the_shortest_lines_fill_no_more_room_than_there_is(tmp_path, monkeypatch):
    monkeypatch.setattr(candump, "CHUNK_BYTES", 1 << 12)
    (tmp_path / "bus.log").write_text("a 080#\n" * 5000)
    counters = np.zeros(candump.COUNTED, np.int64)
    read = list(candump.chunks(tmp_path / "bus.log", counters, lambda _: None))
    assert sum(len(ids) for _, ids, _, _ in read) == counters[candump.READ_LINES] == 5000


def test_a_date_is_the_seconds_that_it_stands_for(tmp_path):
    (tmp_path / "a.log").write_text("(2026-11-23 12:00:01.5) can0 182#\n")
    assert open_log(tmp_path / "a.log").began_s == pytest.approx(1_795_435_201.5)


@pytest.mark.parametrize(
    "line", ["nonsense", "(1.5) can0", "(1.5) can0 18#00", "(x) can0 182#00", "(1.5) can0 182#0",
        "(1.5) can0 182#001122334455667788",
        "(1.5) can0  182  [3]  01 02", "(1.5"],
)  # fmt: skip
def test_a_line_that_is_no_frame_is_counted_with_its_place(tmp_path, line):
    (tmp_path / "a.log").write_text(f"(1.0) can0 080#\n{line}\n(2.0) can0 080#\n")
    log = open_log(tmp_path / "a.log")
    assert (len(log), log.damage.unreadable, log.damage.first_unreadable) == (2, 1, 2)


@given(st.binary(max_size=400))
@settings(max_examples=100)
def test_no_bytes_make_the_reader_fail(tmp_path_factory, junk):
    path = tmp_path_factory.mktemp("log") / "junk.log"
    path.write_bytes(b"(1.0) can0 080#\n" + junk)
    assert open_log(path).count(0x080) >= 1


def test_a_log_that_is_longer_than_a_chunk_is_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(candump, "CHUNK_BYTES", 4096)
    lines = [f"({k * 0.001:.6f}) can0 {0x180 + k % 3:03X}#{k.to_bytes(4, 'little').hex()}\n" for k in range(2000)]
    (tmp_path / "a.log").write_text("".join(lines).rstrip("\n"))
    found = rows(open_log(tmp_path / "a.log"))
    assert [int.from_bytes(data, "little") for _, _, data, _ in found] == list(range(2000))
    assert np.array_equal([stamp for *_, stamp in found], np.arange(2000) * 1_000_000)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.log", b"", "no frame in it"),
        ("a.log", b"can0  182   [2]  01 02\n", "no time stamp"),
        ("a.blf", b"(1.0) can0 080#\n", "is not BLF data"),
        ("a.mf4", b"nothing", "is not MF4 data"),
        ("a.asc", b"nothing\n", "no frame in it"),
        ("a.trc", b"nothing\n", "no frame in it"),
    ],
)
def test_a_file_without_frames_is_refused_with_the_reason(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=words):
        open_log(tmp_path / name)


def test_a_log_of_two_interfaces_is_read_one_at_a_time(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("".join(f"({k}.0) can{k % 2} {0x181 + k % 2:03X}#0{k}\n" for k in range(8)))
    first, second = open_log(path), open_log(path, interface="can1")
    assert (list(first.streams), first.damage.elsewhere) == ([0x181], 4)
    assert (list(second.streams), second.damage.elsewhere) == ([0x182], 4)
    with pytest.raises(LogError, match="no frame of interface can7, but 8 of others"):
        open_log(path, interface="can7")


def test_stamps_that_run_backwards_are_counted_and_time_goes_on(tmp_path):
    (tmp_path / "a.log").write_text("(5.0) can0 080#\n(6.0) can0 080#\n(2.0) can0 080#\n(2.5) can0 080#\n(7.0) can0 080#\n")
    log = open_log(tmp_path / "a.log")
    assert (log.damage.backwards, log.damage.first_backwards) == (1, 2)
    assert np.array_equal(log.of(0x080).stamp_ns, np.array([0, 1, 1, 1, 2]) * 1_000_000_000)


@pytest.mark.parametrize("suffix", ["blf", "asc", "trc"])
def test_other_formats_hold_the_same_frames(tmp_path, suffix):
    sent = [can.Message(timestamp=100.0 + k * 0.01, arbitration_id=0x182, is_extended_id=False, data=[k], channel=1)
        for k in range(30)]  # fmt: skip
    path = tmp_path / f"a.{suffix}"
    with can.Logger(str(path)) as writer:
        for message in sent:
            writer.on_message_received(message)
    found = open_log(path).of(0x182)
    assert found.byte(0).tolist() == list(range(30))
    assert np.diff(found.stamp_ns) == pytest.approx(10_000_000, abs=1_000_000)


@pytest.mark.ci
def test_a_log_that_is_cut_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "a.blf"
    with can.Logger(str(path)) as writer:
        for k in range(20_000):
            writer.on_message_received(
                can.Message(timestamp=100.0 + k * 0.001, arbitration_id=0x182, is_extended_id=False, data=[1])
            )
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 5])
    log = open_log(path)
    assert 100 < len(log) < 20_000
