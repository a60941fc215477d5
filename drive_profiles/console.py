"""What the commands of ``drive-profiles`` share: tables, JSON, errors and exit status, progress, a question before writing."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Annotated, Any, Self

import typer

EXIT_USAGE, EXIT_FILE, EXIT_NODE, EXIT_DIFFERS, EXIT_UNKNOWN, EXIT_INTERRUPTED = 2, 3, 5, 7, 8, 130
EXITS = (
    "Exit codes: 0 done, 2 usage, 3 a bad file, or what it asks for is refused, 4 no bus, 5 no answer, the wrong device or "
    "one that is enabled, 6 an SDO abort or a failed read-back (all is put back), 7 differs, 8 it is not known what the drive "
    "holds, 9 not realisable, 130 interrupted (all is put back)."
)

AsJson = Annotated[bool, typer.Option("--json", help="One JSON document instead of text.")]


@contextlib.contextmanager
def reported() -> Iterator[None]:
    """Turn the package's errors into their message and exit status; never a traceback for what the user can mend."""
    from drive_profiles.address import AddressError  # noqa: PLC0415
    from drive_profiles.errors import DriveProfileError, ProfileNotFoundError  # noqa: PLC0415

    try:
        yield
    except (AddressError, ProfileNotFoundError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(EXIT_USAGE) from None
    except DriveProfileError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None


def fail(message: str, code: int) -> typer.Exit:
    """Say what is wrong; the exit to raise."""
    typer.echo(message, err=True)
    return typer.Exit(code)


def print_json(document: Any) -> None:
    """One document on standard output."""
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def table(title: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, err: bool = False) -> None:
    """A rich table on a terminal; elsewhere plain columns, tab-separated, for cut and awk; ``err``: on standard error."""
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    console = Console(stderr=err)
    if not console.is_terminal:
        if title:
            typer.echo(f"\n# {title}", err=err)
        for row in (header, *rows):
            typer.echo("\t".join(row), err=err)
        return
    shown = Table(title=title or None, title_justify="left")
    for column in header:
        shown.add_column(column, overflow="fold")
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))  # a name is not markup
    console.print(shown)


@contextlib.contextmanager
def progress(label: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on standard error, where that is a terminal; what it gives is called with the number of steps made."""
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield lambda count: None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda count: bar.advance(task, count)


def confirm(question: str, *, yes: bool) -> None:
    """Ask before something is written; without a terminal ``--yes`` is needed.

    Raises:
        typer.Exit: The answer is no.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise fail("nothing has been written: give --yes, or answer on a terminal", EXIT_USAGE)
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort:  # Ctrl-C, or the end of the input
        raise fail("\nnothing has been written", EXIT_INTERRUPTED) from None
    if not agreed:
        raise fail("nothing has been written", EXIT_USAGE)


class Interrupts:
    """Ctrl-C, SIGTERM and SIGHUP while a drive is written to: from `hold` to the end they are remembered, and end nothing.

    Attributes:
        event: Set when one of them has come.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self.event = threading.Event()
        self._came = False
        self._before: dict[signal.Signals, Any] = {}
        self._said = b""

    def __enter__(self) -> Self:
        """Nothing is held yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """Everything is as it was."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def hold(self, said: str) -> None:
        """Remember from now on.

        Args:
            said: What the user is told when one comes.
        """
        self._said = f"\n{said}\n".encode()
        for number in self.SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup stays nohup
                self._before[number] = signal.signal(number, self._remember)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        if self._came:  # an event's lock is not to be taken twice by one thread
            return
        self._came = True
        self.event.set()
        with contextlib.suppress(OSError):  # the terminal may have gone
            os.write(2, self._said)
