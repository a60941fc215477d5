"""A disk that is full: the message names the file, says whether anything moved, and where the axes stand."""

from pathlib import Path

import numpy as np
import pytest
import typer

from hil.cli.console import exit_on_error, message_of, write_page
from hil.errors import NOT_DISABLED
from hil.master.whereabouts import AT_REST, LastPositions
from hil.recording import BusLog, LoggedFrame, Recording

FULL = Path("/dev/full")
"""A file of Linux into which no byte goes."""
NO_ROOM = "/dev/full: No space left on device"


@pytest.fixture
def recording() -> Recording:
    return Recording({"time_s": np.arange(10_000.0)})


def test_a_recording_that_finds_no_room_is_named(recording: Recording) -> None:
    with pytest.raises(OSError, match="No space left on device") as caught:
        recording.save(FULL)
    assert message_of(caught.value) == NO_ROOM


def test_a_log_that_finds_no_room_is_named() -> None:
    log = BusLog(FULL)
    log.add(LoggedFrame(0.0, 0x80, b"", is_received=False))
    with pytest.raises(OSError, match="No space left on device") as caught:
        log.write()
    assert message_of(caught.value) == NO_ROOM


@pytest.mark.parametrize(
    ("positions", "have_moved", "are_disabled", "end"),
    [
        ((), False, True, ""),
        (("axis 2 is at 0 rev",), False, True, "; nothing has moved; axis 2 is at 0 rev"),
        (("axis 2 is at 15 rev",), True, True, f"; {AT_REST}; axis 2 is at 15 rev"),
        (("the position of axis 2 is not known",), True, False, f"; {NOT_DISABLED}"),
    ],
)
def test_a_command_that_finds_no_room_says_how_the_arm_stands(
    recording: Recording,
    capsys: pytest.CaptureFixture[str],
    positions: tuple[str, ...],
    have_moved: bool,
    are_disabled: bool,
    end: str,
) -> None:
    def command() -> None:
        with exit_on_error():
            LastPositions.note(positions, have_moved=have_moved, are_disabled=are_disabled)
            recording.save(FULL)

    with pytest.raises(typer.Exit) as caught:
        command()
    assert caught.value.exit_code == 3
    assert capsys.readouterr().err == f"{NO_ROOM}{end}\n"


def test_a_report_that_finds_no_room_does_not_hide_the_end_of_the_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(directory: Path) -> Path:
        raise OSError(28, "No space left on device", str(directory / "report.html"))

    monkeypatch.setattr("hil.report.writer.write_report_of", refuse)
    assert write_page(Path("out")) is None
    said = capsys.readouterr().err
    assert said == "out/report.html: No space left on device; hil report out writes the report once there is room\n"
