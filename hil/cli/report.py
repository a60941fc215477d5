"""hil report: the report of a directory once more."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.console import epilog
from hil.cli.console import ExitStatus, exit_on_error, say

REPORT_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.INTERRUPTED),
    {ExitStatus.FILE: "bad file, or no directory of results", ExitStatus.INTERRUPTED: "interrupted"},
)


def mount(app: typer.Typer) -> None:
    """Add the command to `hil`."""
    app.command(epilog=REPORT_EPILOG)(report)


def report(
    directory: Annotated[
        Path, typer.Argument(help="Directory of any command that has written a result.json.", exists=True, file_okay=False)
    ],
) -> None:
    """Write report.html of a directory anew, from its result.json and recordings.

    Example: hil report demo
    """
    with exit_on_error("interrupted"):
        if not (directory / "result.json").is_file():
            say(f"{directory} has no result.json; {_advice(directory)}")
            raise typer.Exit(ExitStatus.FILE)

        from hil.errors import HilError  # noqa: PLC0415
        from hil.report.writer import write_report_of  # noqa: PLC0415 - numpy and the figures, so that --help stays quick

        try:
            path = write_report_of(directory)
        except HilError:
            raise
        except (ValueError, OSError) as error:
            say(f"{directory}: {error}")
            raise typer.Exit(ExitStatus.FILE) from None
        typer.echo(str(path))


def _advice(directory: Path) -> str:
    if (directory / "design.json").is_file():
        return "it is that of a design, whose report (design.html) hil design notch writes: run that again"
    below = sorted((path.parent for path in directory.glob("*/result.json")), key=lambda each: each.stat().st_mtime)
    if below:
        count = "one below it has" if len(below) == 1 else f"{len(below)} below it have, of which the newest is named here"
        return f"{count}: hil report {below[-1]}"
    return "run, identify, learn, compare or demo make one: give their --out, or the directory in bench-out that they have named"
