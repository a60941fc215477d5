"""Exit statuses, options and error handling of ``plant-emulator``."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.completion import AxisCompleter, complete_reference
from drive_profiles.cli.console import ToolExitStatus, epilog, fail, listed, table
from drive_profiles.cli.entry import interrupted
from drive_profiles.errors import DriveProfileError

if TYPE_CHECKING:  # --help must not wait for it
    from hil.report.report_table import ReportTable
    from plant_emulator.robots.robot import Robot


class EmulatorExitStatus(ToolExitStatus):
    """Exit statuses of `plant-emulator`."""

    DONE = 0, "done"
    INTERNAL = 1, "internal error"
    USAGE = 2, "usage"
    FILE = 3, "bad robot file"
    BUS = 4, "the bus cannot be served, or is lost"
    NOT_MET = 9, "a goal is not reached"
    INTERRUPTED = 130, "interrupted"


EPILOG = epilog(status for status in EmulatorExitStatus if status is not EmulatorExitStatus.INTERNAL)
"""End of the tool's own help."""


def ends(*more: EmulatorExitStatus, **own: str) -> str:
    """Return a help's exit statuses: usual ones, more, and own sentences."""
    usual = {EmulatorExitStatus.DONE, EmulatorExitStatus.USAGE, EmulatorExitStatus.FILE, EmulatorExitStatus.INTERRUPTED}
    return epilog(sorted({*usual, *more}), {EmulatorExitStatus[name]: sentence for name, sentence in own.items()})


AXES = AxisCompleter(Path(__file__).parents[1] / "robots")
"""Completers of axes of the robot file."""

RobotOption = Annotated[
    str, typer.Option("--robot", help="Robot file (TOML), or `reference`, or `reference-arm`.", autocompletion=complete_reference)
]
DriveOption = Annotated[
    list[str] | None,
    typer.Option(
        "--drive",
        metavar="AXIS=PROFILE[/PRODUCT]",
        help="Drive of an axis: a profile by name or file; repeatable.",
        autocompletion=AXES.with_profile,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]


def show(made: "ReportTable") -> None:
    """Print a table of a report."""
    header, *rows = made.texts()
    table(made.title, header, rows)
    if made.caption:
        typer.echo(made.caption.replace("`", ""))


@contextmanager
def exit_on_error() -> Iterator[None]:
    """Turn file errors and interrupts into message and exit status.

    Any other error keeps its traceback.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        raise fail(interrupted(error), EmulatorExitStatus.INTERRUPTED) from None
    except DriveProfileError as error:
        raise fail(str(error), EmulatorExitStatus.FILE) from None
    except BrokenPipeError:
        raise
    except OSError as error:
        words = "is a file; expected a folder" if isinstance(error, FileExistsError) else error.strerror or error
        raise fail(f"{error.filename or 'output'}: {words}", EmulatorExitStatus.FILE) from None


@contextmanager
def exit_on_value_error(file: str | None = None) -> Iterator[None]:
    """Turn a `ValueError` into a message and an exit status.

    Args:
        file: The file whose contents are to blame; None: an option is.
    """
    try:
        yield
    except DriveProfileError:  # some are a ValueError as well, and name their file themselves
        raise
    except ValueError as error:
        status, where = (EmulatorExitStatus.USAGE, "") if file is None else (EmulatorExitStatus.FILE, f"{file}: ")
        raise fail(f"{where}{error}", status) from None


def axis_numbers(given: str, model: "Robot") -> list[int]:
    """Return the axes of a list such as 2,3.

    Raises:
        typer.Exit: It is not such a list, or the robot has no such axis.
    """
    numbers = listed("--axis", given, "axis")
    if strange := set(numbers) - set(model.axis):
        there = ", ".join(map(str, sorted(model.axis)))
        raise fail(f"--axis {given}: robot {model.name!r} has no axis {min(strange)}; it has {there}", EmulatorExitStatus.USAGE)
    return [*numbers]
