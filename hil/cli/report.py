"""`hil report`: the report of a directory, or of all runs."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import epilog, fail
from hil.cli.console import ExitStatus, exit_on_error, say, say_left_out
from hil.counting import counted
from hil.errors import HilError

REPORT_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.INTERRUPTED),
    {
        ExitStatus.FILE: "bad file, no directory of results, or results that cannot be compared",
        ExitStatus.INTERRUPTED: "interrupted",
    },
)


@command(epilog=REPORT_EPILOG)
def report(
    directory: Annotated[
        Path,
        typer.Argument(
            help="Directory of any command that has written a result.json; with --trend a folder of them.",
            exists=True,
            file_okay=False,
        ),
    ],
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Figures that can be zoomed, in the same single file, without internet.")
    ] = False,
    against: Annotated[
        Path | None,
        typer.Option(
            "--against",
            metavar="OLD",
            help="Write against.html: this result beside an older one of the same robot and motions.",
        ),
    ] = None,
    trend: Annotated[bool, typer.Option("--trend", help="Write trend.html: all runs below the folder by date.")] = False,
) -> None:
    """Write report.html of a directory anew, from its result.json and recordings.

    Examples:
      hil report demo
      hil report demo --interactive
      hil report demo --against older
      hil report demo --trend
    """  # fmt: skip
    with exit_on_error(moves=False):
        if trend and (interactive or against is not None):
            raise fail("--trend takes neither --interactive nor --against; give it alone", ExitStatus.USAGE)
        if trend:
            _write_trend(directory)
            return
        for each in (directory, against):
            if each is not None and not each.is_dir():
                say(f"{each}: there is no such folder")
                raise typer.Exit(ExitStatus.FILE)
            if each is not None and not (each / "result.json").is_file():
                say(f"{each} has no result.json; {_advice(each)}")
                raise typer.Exit(ExitStatus.FILE)
        _write(directory, against, is_interactive=interactive)


def _write(directory: Path, old_directory: Path | None, *, is_interactive: bool) -> None:
    from hil.report.against.page import write_against
    from hil.report.interactive.parts import check_interactive
    from hil.report.writer import write_report_of

    if is_interactive:
        check_interactive()
    try:
        if old_directory is None:
            path = write_report_of(directory, is_interactive=is_interactive)
        else:
            path = write_against(directory, old_directory, is_interactive=is_interactive)
    except HilError:
        raise
    except (ValueError, OSError) as error:
        say(f"{directory}: {error}")
        raise typer.Exit(ExitStatus.FILE) from None
    if is_interactive and '<div class="wide zoom"' not in path.read_text(encoding="utf-8"):
        say("this page has no figure that can be zoomed")
    typer.echo(str(path))


def _write_trend(folder: Path) -> None:
    from hil.report.trend.gather import gather_runs
    from hil.report.trend.page import write_trend

    gathered = gather_runs(folder)
    say_left_out(gathered.left_out, "results")
    say(f"{counted(gathered.results, 'result')} with runs")
    typer.echo(str(write_trend(folder, gathered)))


def _advice(directory: Path) -> str:
    if (directory / "design.json").is_file():
        return "it belongs to a design; hil design notch writes its report (design.html)"
    below = sorted((path.parent for path in directory.glob("*/result.json")), key=lambda each: each.stat().st_mtime)
    if below:
        count = "one of its folders has one" if len(below) == 1 else f"{len(below)} of its folders have one; for the newest"
        return f"{count}: hil report {below[-1]}"
    return "give the directory of a hil run, identify, learn, compare or demo: the one of --out, or a folder in bench-out"
