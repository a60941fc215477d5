"""Console of the commands of ``drive-profiles``."""

import contextlib
import json
import math
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import IntEnum
from types import FrameType
from typing import Any, ClassVar, Self

import typer

from drive_profiles.address import AddressError
from drive_profiles.cli.entry import interrupted
from drive_profiles.cli.tables import lines
from drive_profiles.errors import DriveProfileError, ProfileNotFoundError, UnknownProductError
from drive_profiles.standard.shown import numbers_of
from drive_profiles.upload.interrupt import InterruptWindow


class ToolExitStatus(IntEnum):
    """Exit statuses of one tool, each with its sentence in the help."""

    sentence: str

    def __new__(cls, number: int, sentence: str) -> Self:
        """Keep the sentence beside the number."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.sentence = sentence
        return member


class ExitStatus(ToolExitStatus):
    """Exit statuses of `drive-profiles`."""

    DONE = 0, "done"
    INTERNAL = 1, "internal error"
    USAGE = 2, "usage"
    FILE = 3, "invalid file or refused request"
    BUS = 4, "no bus"
    NODE = 5, "no answer, the wrong device or one that is enabled"
    SDO = 6, "an SDO abort or a failed read-back (all values are restored)"
    DIFFERS = 7, "differs"
    UNKNOWN = 8, "the values in the drive are uncertain; the message lists them"
    NOT_REALISABLE = 9, "not realisable; the message gives the reasons"
    INTERRUPTED = 130, "interrupted (all values are restored)"


def epilog(statuses: Iterable[ToolExitStatus], own: Mapping[ToolExitStatus, str] | None = None) -> str:
    """Return a command's exit statuses for its help, some with own sentences."""
    sentences = own or {}
    return f"Exit status: {'; '.join(f'{status:d} {sentences.get(status, status.sentence)}' for status in statuses)}."


SAID_EVERY_S = 60.0
"""Time between two lines of progress where there is no terminal."""
RATE_OVER_S = 600.0
"""Time over which a bar takes the rate: a step may take many seconds, and some many more."""

_FILES = (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE)
_READING = (*_FILES, ExitStatus.BUS, ExitStatus.NODE, ExitStatus.SDO)
_NOTHING_WRITTEN: dict[ToolExitStatus, str] = {ExitStatus.SDO: "an SDO abort", ExitStatus.INTERRUPTED: "interrupted"}
_ANY_STATE: dict[ToolExitStatus, str] = {**_NOTHING_WRITTEN, ExitStatus.NODE: "no answer, or the wrong device"}

# Ends of the help: of the tool, and of commands that need no bus, realise values, read a drive in any state, clear faults of one
# that is not enabled, compare with a drive, write to it, and let it store.
EPILOG = epilog(status for status in ExitStatus if status is not ExitStatus.INTERNAL)
FILE_EPILOG = epilog((*_FILES, ExitStatus.INTERRUPTED), _NOTHING_WRITTEN)
REALISE_EPILOG = epilog((*_FILES, ExitStatus.NOT_REALISABLE, ExitStatus.INTERRUPTED), _NOTHING_WRITTEN)
READ_EPILOG = epilog((*_READING, ExitStatus.INTERRUPTED), _ANY_STATE)
CLEAR_EPILOG = epilog((*_READING, ExitStatus.INTERRUPTED), _NOTHING_WRITTEN)
COMPARE_EPILOG = epilog((*_READING, ExitStatus.DIFFERS, ExitStatus.INTERRUPTED), _ANY_STATE)
WRITE_EPILOG = epilog((*_READING, ExitStatus.UNKNOWN, ExitStatus.INTERRUPTED))
STORE_EPILOG = epilog(
    (*_READING, ExitStatus.UNKNOWN, ExitStatus.INTERRUPTED),
    {**_NOTHING_WRITTEN, ExitStatus.UNKNOWN: "unknown whether the drive has stored its values"},
)


@contextlib.contextmanager
def exit_on_error(*, writes: bool = False) -> Iterator[None]:
    """Turn the package's errors into a message and an exit status.

    From the first write of a command that `writes` on, `Interrupts` holds the signals.
    """
    try:
        yield
    except (AddressError, ProfileNotFoundError, UnknownProductError) as error:
        raise fail(str(error), ExitStatus.USAGE) from None
    except DriveProfileError as error:
        raise fail(str(error), error.exit_code) from None
    except KeyboardInterrupt as error:
        when = " before anything was written" if writes else ""
        raise fail(f"{interrupted(error)}{when}", ExitStatus.INTERRUPTED) from None


def fail(message: str, code: int) -> typer.Exit:
    """Print what is wrong, and return the exit to raise."""
    typer.echo(message, err=True)
    return typer.Exit(code)


def numbered(option: str, given: Iterable[str] | None, form: str = "AXIS=VALUE") -> dict[int, str]:
    """Return the values of an option such as AXIS=VALUE, by number.

    Raises:
        typer.Exit: One is not of that form, or a number is given twice.
    """
    values: dict[int, str] = {}
    what, _, kind = form.partition("=")
    for text in given or ():
        number, _, value = text.strip().partition("=")
        if not (number.isascii() and number.isdigit() and value):
            begin, rest = [*re.split(r"\W", text, maxsplit=1), ""][:2]  # 3:x is meant as 3=x
            meant = f"{begin if begin.isdigit() else 2}={rest or kind}"
            raise fail(f"{option} {text}: expected {form}, such as {meant}", ExitStatus.USAGE)
        if int(number) in values:
            raise fail(f"{option}: {what.lower()} {number} is given twice; give it once", ExitStatus.USAGE)
        values[int(number)] = value
    return values


def listed(option: str, text: str, what: str) -> tuple[int, ...]:
    """Return the node-IDs or axes of an option such as 2,3 or 1-40, from 1 to 127.

    Raises:
        typer.Exit: See `numbers_of`.
    """
    try:
        return numbers_of(text, what, 1, 127)
    except ValueError as error:
        raise fail(f"{option}: {error}", ExitStatus.USAGE) from None


def print_json(document: Any) -> None:
    """Print one document on standard output."""
    is_unicode = (sys.stdout.encoding or "").lower().startswith("utf")
    typer.echo(json.dumps(document, indent=2, ensure_ascii=not is_unicode, allow_nan=False))


def finite(value: Any) -> Any:
    """Return data with None for NaN and infinity, which JSON does not have."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    return [finite(part) for part in value] if isinstance(value, list | tuple) else value


def table(title: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, err: bool = False) -> None:
    """Print a table in aligned columns, as wide as a terminal is."""
    if title:
        typer.echo(f"\n{title}", err=err)
    for line in lines(header, rows, terminal_width(err=err)):
        typer.echo(line, err=err)


def terminal_width(*, err: bool = False) -> int | None:
    """Return the terminal's columns, or None if the stream is not one."""
    return shutil.get_terminal_size().columns if (sys.stderr if err else sys.stdout).isatty() else None


@contextlib.contextmanager
def progress(label: str, total: int) -> Iterator[Callable[..., None]]:
    """Show a progress bar on standard error; if it is not a terminal, a line a minute.

    Call the context's function with each number of finished steps, and with words about all of them if there are any.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        begin = said = time.monotonic()
        done = 0

        def tell(count: int, words: str = "") -> None:
            nonlocal done, said
            done, now = done + count, time.monotonic()
            if now - said >= SAID_EVERY_S:
                said = now
                left_min = (total - done) / max(done, 1) * (now - begin) / 60.0
                typer.echo(", ".join(filter(None, (f"{label}: {done} of {total}", words, f"{left_min:.0f} min left"))), err=True)

        yield tell
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, speed_estimate_period=RATE_OVER_S) as bar:
        task = bar.add_task(label, total=total)
        yield lambda count, words="": bar.update(task, advance=count, description=words or label)


def confirm(question: str, *, yes: bool) -> None:
    """Ask before something is written; without a terminal ``--yes`` is needed.

    Raises:
        typer.Exit: The answer is no.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise fail("nothing has been written: give --yes, or answer on a terminal", ExitStatus.USAGE)
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort:  # Ctrl-C, or the end of the input
        raise fail("\nnothing has been written", ExitStatus.INTERRUPTED) from None
    if not agreed:
        raise fail("nothing has been written", ExitStatus.USAGE)


class Interrupts:
    """Hold of signals while a command writes to a drive.

    The signals are Ctrl-C, SIGTERM, SIGHUP (the terminal has closed) and, on Windows, Ctrl-Break. If a Windows console
    closes, it may end the program at once; the journal then shows what was written. In the process of a tool the signals are
    held until it ends, so that none can change the exit status of a finished command.

    Attributes:
        window: Window in which a signal counts; the writing command closes it, and a later signal only prints an answer.
        owns_process: True in the process of a tool (`Tool.run`).
        is_held_to_the_end: True if signals are held although the context has ended.
    """

    SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
    owns_process: ClassVar[bool] = False
    is_held_to_the_end: ClassVar[bool] = False

    def __init__(self, *, is_last: bool = True) -> None:
        """Prepare to hold signals; `is_last`: the command ends with this context."""
        self.window = InterruptWindow()
        self._is_last = is_last
        self._before: dict[signal.Signals, Any] = {}
        self._messages: dict[bool, bytes] = {}

    def __enter__(self) -> Self:
        """Keep the signals' handlers; nothing is held yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the handlers, unless this ends a tool's process."""
        if self._before and self._is_last and Interrupts.owns_process:
            Interrupts.is_held_to_the_end = True
            return
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def hold(self, in_time: str, too_late: str) -> None:
        """Hold signals from now on.

        One that comes while the window is open prints `in_time`, a later one `too_late`.
        """
        self._messages = {True: f"\n{in_time}\n".encode(), False: f"\n{too_late}\n".encode()}
        for number in self.SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup stays nohup
                self._before[number] = signal.signal(number, self._remember)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        message = self._messages.pop(self.window.interrupt(), b"")  # each is said once
        with contextlib.suppress(OSError):  # the terminal may have gone
            os.write(2, message)
