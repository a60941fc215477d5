"""Exit statuses, errors, progress and questions of all `hil` commands."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from drive_profiles.address import LOCAL, AddressError, choose_bus, parse_address
from drive_profiles.cli.console import ToolExitStatus, epilog, table
from drive_profiles.cli.entry import interrupted
from drive_profiles.errors import DriveProfileError
from hil.errors import HilError, not_restored_words
from hil.reporter import Reporter

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.measurement import MeasurementOutcome
    from hil.experiments.plan import Experiment
    from hil.report.pages.page import PageVerdict
    from hil.report.report_table import ReportTable
    from hil.results.base import Result
    from hil.results.comparison import TreatmentTable

SHOWN_LEFT_OUT = 10


class ExitStatus(ToolExitStatus):
    """Exit statuses of `hil`."""

    DONE = 0, "done"
    INTERNAL = 1, "internal error"
    USAGE = 2, "usage"
    FILE = 3, "bad file or a request beyond its limits"
    BUS = 4, "no bus"
    NODE = 5, "no answer, wrong device, or already moving"
    SDO = 6, "SDO abort"
    SAFETY_STOP = 8, "safety stop, or an interrupt after which not every drive has confirmed that it is disabled"
    NOT_MET = 9, "the tip exceeded tip_mm, a claim does not hold, or a run could not be judged"
    INTERRUPTED = 130, "interrupted, after a confirmed stop"


def epilog_of_runs(own: dict[ToolExitStatus, str] | None = None, *, is_judged: bool = True) -> str:
    """Return the exit statuses of a motion command for its help.

    `own` replaces sentences; one that judges nothing has `is_judged` False.
    """
    never = {ExitStatus.INTERNAL} if is_judged else {ExitStatus.INTERNAL, ExitStatus.NOT_MET}
    return epilog((status for status in ExitStatus if status not in never), own)


def epilog_without_motion(own: dict[ToolExitStatus, str]) -> str:
    """Return the exit statuses of a judging command that moves nothing, for its help."""
    statuses = (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.NOT_MET, ExitStatus.INTERRUPTED)
    return epilog(statuses, {**own, ExitStatus.INTERRUPTED: "interrupted"})


EPILOG = epilog_of_runs()
"""Exit statuses of the tool, and of commands that have no sentences of their own."""


def say(message: str) -> None:
    """Print a line on standard error."""
    typer.echo(message, err=True)


def exit_status_of(error: Exception) -> int:
    """Return the exit status of an error; `ExitStatus.INTERNAL` for an unexpected one."""
    from hil.arm.straight_line import LineError
    from hil.can.errors import BusLostError, ChannelError
    from hil.control.trajectory import UnreachableError

    if isinstance(error, HilError | DriveProfileError):
        return error.exit_code
    if isinstance(error, LineError | UnreachableError | OSError):
        return ExitStatus.FILE
    if isinstance(error, AddressError):
        return ExitStatus.USAGE
    if isinstance(error, BusLostError):
        return ExitStatus.SAFETY_STOP
    return ExitStatus.BUS if isinstance(error, ChannelError) else ExitStatus.INTERNAL


def message_of(error: Exception) -> str:
    """Return an error's message; of a file error file, reason and notes."""
    if isinstance(error, OSError):
        return "; ".join([f"{error.filename or 'output'}: {error.strerror or error}", *getattr(error, "__notes__", ())])
    return str(error)


def exit_with(error: Exception) -> typer.Exit:
    """Print the message of an error, and return the exit to raise.

    Raises:
        Exception: The error itself, if it is unexpected, with its traceback; or if standard output is closed.
    """
    status = exit_status_of(error)
    if status == ExitStatus.INTERNAL or isinstance(error, BrokenPipeError):
        raise error
    say(message_of(error))
    return typer.Exit(status)


@contextmanager
def exit_on_error(*, moves: bool = True) -> Iterator[None]:
    """Turn errors into a message and an exit status.

    An unexpected error keeps its traceback. A command that moves a robot prints after an interrupt what has moved.
    """
    from hil.master.whereabouts import LastPositions  # hil.master loads nothing else with it

    LastPositions.note((), have_moved=False)
    try:
        yield
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt as error:
        say(f"{interrupted(error)} {LastPositions.when()}" if moves else interrupted(error))
        raise typer.Exit(ExitStatus.INTERRUPTED) from None
    except Exception as error:  # noqa: BLE001 - an unexpected one is raised again
        if isinstance(error, OSError) and moves and LastPositions.words:
            error.add_note(LastPositions.rest())
        raise exit_with(error) from None


def say_not_restored(objects: Iterable[str]) -> None:
    """Print the objects that could not be restored in the nodes."""
    for name in objects:
        say(not_restored_words(name))


def write_page(directory: Path) -> Path | None:
    """Write the report of a directory.

    An interrupt or a full disk leaves that to `hil report`, so that the end of the runs is printed all the same.

    Returns:
        Path of the page; None if it was not written.
    """
    try:
        from hil.report.writer import write_report_of

        return write_report_of(directory)
    except KeyboardInterrupt:
        say(f"interrupted while the report was written; hil report {directory} writes it")
    except OSError as error:
        say(f"{message_of(error)}; hil report {directory} writes the report once there is room")
    return None


def say_page(page: Path | None) -> None:
    """Print the path of a report that was written."""
    if page is not None:
        say(f"report: {page}")


def say_left_out(files: Sequence[str], what: str) -> None:
    """Print the first of the files that were not read, and the number of the others."""
    for each in files[:SHOWN_LEFT_OUT]:
        say(f"left out: {each}")
    if len(files) > SHOWN_LEFT_OUT:
        say(f"left out: {len(files) - SHOWN_LEFT_OUT} more {what}")


def echo_lines(lines: Iterable[str], *, err: bool = False) -> None:
    """Print lines on standard output, or on standard error."""
    for line in lines:
        typer.echo(line, err=err)


def show(*tables: "ReportTable | None", err: bool = False) -> None:
    """Print tables of a report that have rows."""
    for made in tables:
        if made is not None and made.rows:
            header, *rows = made.texts()
            table(made.title, header, rows, err=err)


def show_page(verdict: "PageVerdict", *tables: "ReportTable | None", provenance: Iterable[tuple[str, str]] = ()) -> None:
    """Print the verdict of a page, some of its tables, and where its numbers come from."""
    echo_lines((verdict.headline, *filter(None, verdict.details)))
    show(*tables)
    echo_lines(f"{name}: {text}" for name, text in provenance)


def show_comparison(result: "TreatmentTable", *, err: bool = False) -> None:
    """Print the tables of a comparison's report, a table for each experiment."""
    from hil.counting import axes_in_words
    from hil.report.tables import compare

    for robot in result.robots:
        line = f", line motion of {axes_in_words(robot.line_axes)}" if robot.line_axes else ""
        typer.echo(f"{robot.name} ({robot.bus}){line}", err=err)
    show(*(compare.experiment(result, *case) for case in compare.cases(result)), compare.left_out(result), err=err)


def tell_result(result: "Result", where: Path, summary: Callable[[], None], model: Path | None = None, *, as_json: bool) -> None:
    """Write the report, and print the result and the written files."""
    page = write_page(where)
    if as_json:
        typer.echo(result.dumps())
    else:
        summary()
    if model is not None:
        say(f"model file: {model}")
    say_page(page)


def tell_measurement(
    outcome: "MeasurementOutcome[Any]", where: Path, summary: Callable[[], None], model: Path | None, *, as_json: bool
) -> None:
    """Do as `tell_result`, and exit with a failure's status."""
    tell_result(outcome.result, where, summary, model, as_json=as_json)
    say_not_restored(outcome.not_restored)
    if outcome.failure is not None:
        raise exit_with(outcome.failure)
    if outcome.not_restored:
        raise typer.Exit(ExitStatus.SDO)


def bench_on(bench_file: str, bus: str | None) -> "Bench":
    """Return a bench on the chosen bus, and print the choice.

    `--bus` takes precedence over HIL_BUS, and HIL_BUS over the bench file.

    Raises:
        AddressError: The address cannot be read.
        FileError: The bench file cannot be used.
    """
    from hil.bench.bench import load_bench

    bench = load_bench(bench_file)
    choice = choose_bus(bus, (f"bench file {bench_file}", bench.bus.address))
    say(str(choice))
    return bench if choice is None else bench.on(choice.address)


def bench_on_emulator(bench: "Bench", address: str) -> "Bench":
    """Return a bench on the bus of a command's emulator; print it."""
    say(str(choose_bus(address, option_name="the emulator that this command has started")))
    return bench.on(address)


def is_on_local_bus(bench: "Bench") -> bool:
    """True for a bench on a local bus (all robots emulated).

    On any other bus, each node's hardware version (1009h) shows whether it is emulated.
    """
    return parse_address(bench.bus.address).interface == LOCAL


def result_directory(out: Path | None, name: str, *, force: bool) -> Path:
    """Return the directory for a command's files: `--out`, or a new one.

    Raises:
        NotPossibleError: It holds the files of another command, and `--force` is not given.
    """
    from hil.results import base

    return base.result_directory(out, name, force=force)


class SpokenReporter(Reporter):
    """Reporter that prints each run and each step on standard error."""

    def run(self, title: str) -> None:
        """Show that a run begins."""
        say(title)

    def step(self, sentence: str) -> None:
        """Show that a step begins."""
        say(sentence)


class RunProgress(SpokenReporter):
    """A bar on a terminal, a line per run elsewhere.

    It prints on standard error, so that standard output has only results. Without `is_live` it has no thread, which would
    take the interpreter from a run in real time.
    """

    def __init__(self, total: int, *, is_live: bool = True) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.table import Column

        self._console = Console(stderr=True)
        self.is_live = is_live and self._console.is_terminal
        title = Column(overflow="fold", max_width=max(20, self._console.width - 44))  # the time is never cut
        self._bar = Progress(
            TextColumn("{task.description}", table_column=title), BarColumn(bar_width=16),
            TextColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn(), TimeRemainingColumn(), console=self._console,
            disable=not self.is_live,
        )  # fmt: skip
        self._task: Any = None
        self._total, self._count = total, 0

    def __enter__(self) -> "RunProgress":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def run(self, title: str) -> None:
        """Show that a run begins."""
        self._count += 1
        label = f"[{self._count}/{self._total}] {title}"
        if self.is_live:
            self._task = self._bar.add_task(label.replace("[", r"\["), total=1.0)
        else:
            say(label)

    def progress(self, fraction: float) -> None:
        """Move the bar."""
        if self._task is not None:
            self._bar.update(self._task, completed=fraction)


def motion_lines(pairs: "Iterable[tuple[Bench, Experiment]]") -> Iterator[str]:
    """Return the lines on how experiments move a robot, for `confirm`."""
    for bench, experiment in pairs:
        motion = experiment.motion(bench)
        yield f"This moves {experiment.title} on {bench.bus.address}:"
        for column, number in enumerate(motion.axes):
            limits, angle = bench.axis[number].limits, motion.motor_angle_rad[:, column] / 6.283185307179586
            yield (
                f"  axis {number}: {angle.min():+.2f} … {angle.max():+.2f} motor revolutions, at most {limits.speed_rps:g} rev/s "
                f"and {limits.torque_nm:g} N·m; positions {limits.position_min_rev:g} … {limits.position_max_rev:g} rev"
            )


def confirm_motion(bench: "Bench", motions: Iterable[str], *, yes: bool) -> None:
    """Ask before a bench's robot moves, and check its bus first.

    Do not ask if the robot is emulated, or `--yes` is given.

    Raises:
        BusUnavailableError: The bus does not exist, or cannot be used.
        typer.Exit: The user does not agree, or cannot be asked.
    """
    if yes or is_on_local_bus(bench):
        return
    from hil.can.opening import open_channel

    open_channel(parse_address(bench.bus.address)).close()
    confirm(motions)


def confirm(motions: Iterable[str]) -> None:
    """Ask before a real robot moves, once for all motions.

    Raises:
        typer.Exit: The user does not agree, or cannot be asked.
    """
    for line in motions:
        say(line)
    if not sys.stdin.isatty():
        say("standard input is not a terminal; give --yes to move without confirmation")
        raise typer.Exit(ExitStatus.USAGE)
    if not typer.confirm("Is everyone clear of the robot, and its emergency stop in reach?", err=True):
        raise typer.Exit(ExitStatus.USAGE)
