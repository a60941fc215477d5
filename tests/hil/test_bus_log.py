"""The log of the bus: the lines that python-can's writer writes, for frames of every kind."""

import tempfile
from pathlib import Path

import can
from hypothesis import given
from hypothesis import strategies as st

from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from hil.recording import BusLog, LoggedFrame

IDENTIFIERS = st.one_of(
    st.integers(0, 0x7FF),
    st.integers(0, 0x1FFFFFFF).map(lambda number: number | CAN_EFF_FLAG),
    st.integers(0, 0x7FF).map(lambda number: number | CAN_RTR_FLAG),
    st.integers(1, 0x1FF).map(lambda number: number | CAN_ERR_FLAG),
)
FRAMES = st.builds(LoggedFrame, st.floats(0.0, 1e6), IDENTIFIERS, st.binary(max_size=8), st.booleans())


def messages_of(frames, channel):
    for time_s, can_id, data, is_received in frames:
        yield can.Message(
            timestamp=time_s, arbitration_id=can_id & 0x1FFFFFFF, is_extended_id=bool(can_id & CAN_EFF_FLAG),
            is_remote_frame=bool(can_id & CAN_RTR_FLAG), is_error_frame=bool(can_id & CAN_ERR_FLAG), data=data,
            is_rx=is_received, channel=channel,
        )  # fmt: skip


@given(st.lists(st.lists(FRAMES, max_size=8), max_size=3), st.sampled_from(["can", "0", "vcan0"]))
def test_the_lines_are_those_of_python_can(parts, channel):
    """Written in several parts, as between the motions of a run; no stamp is before the first of its part."""
    with tempfile.TemporaryDirectory() as folder:
        own, theirs = Path(folder, "own.log"), Path(folder, "theirs.log")
        log, is_new = BusLog(own, channel), True
        for frames in filter(None, parts):
            for frame in frames:
                log.add(frame)
            log.write()
            with can.CanutilsLogWriter(str(theirs), append=not is_new) as writer:
                for message in messages_of(frames, channel):
                    writer.on_message_received(message)
            is_new = False
        assert own.exists() == theirs.exists()
        assert is_new or own.read_text() == theirs.read_text()


def test_a_log_that_is_off_keeps_nothing_on_disk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = BusLog(None)
    log.add(LoggedFrame(0.0, 0x80, b"", is_received=False))
    log.write()
    assert not log.is_on
    assert list(tmp_path.iterdir()) == []
