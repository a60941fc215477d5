"""A disk that is full: the message names the file and says that the axes stand."""

from pathlib import Path

import numpy as np
import pytest

from hil.cli.console import message_of
from hil.master.session import AT_REST
from hil.recording import BusLog, LoggedFrame, Recording

FULL = Path("/dev/full")
"""A file of Linux into which no byte goes."""


def test_a_recording_that_finds_no_room_is_named_with_what_is_noted_of_the_robot() -> None:
    with pytest.raises(OSError, match="No space left on device") as caught:
        Recording({"time_s": np.arange(10_000.0)}).save(FULL)
    assert message_of(caught.value) == "/dev/full: No space left on device"
    caught.value.add_note(AT_REST)
    assert message_of(caught.value) == f"/dev/full: No space left on device; {AT_REST}"


def test_a_log_that_finds_no_room_is_named() -> None:
    log = BusLog(FULL)
    log.add(LoggedFrame(0.0, 0x80, b"", is_received=False))
    with pytest.raises(OSError, match="No space left on device") as caught:
        log.write()
    assert message_of(caught.value) == "/dev/full: No space left on device"
