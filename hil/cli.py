"""hil: run the paper's experiments on an emulated robot or a real one, and report on them."""

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil import cli_compare, cli_design, cli_identify, cli_learn, cli_plan
from hil.cli_plan import PlanLoop

if TYPE_CHECKING:  # --help must not wait for numpy, scipy and the compiler
    from hil.experiments.plan import Experiment
    from hil.experiments.runner import Outcome
    from hil.experiments.treatment import Knowledge
    from hil.master.bench import Bench

EXIT_INTERNAL, EXIT_USAGE, EXIT_FILE, EXIT_BUS = 1, 2, 3, 4
EXIT_SDO, EXIT_SAFETY_STOP, EXIT_CLAIM_FAILED, EXIT_INTERRUPTED = 6, 8, 9, 130

EXIT_STATUS = (
    "Exit status: 0 done; 2 usage; 3 bad file or a request beyond its limits; 4 no bus; 5 no answer, wrong device, or already "
    "moving; 6 SDO abort; 8 safety stop; 9 a claim does not hold; 130 interrupted, after a safe stop."
)

app = typer.Typer(
    name="hil",
    help="Hardware-in-the-loop bench for robots with harmonic drives.",
    epilog=EXIT_STATUS,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class ExperimentName(StrEnum):
    """What can be run."""

    CONSTANT_ACCELERATION = "constant-acceleration"
    LINE_MOTION = "line-motion"


class CompensationName(StrEnum):
    """What can act against the transmission error; `hil.experiments.treatment` says what each is."""

    NONE = "none"
    NOTCH = "notch"
    NOTCH_OPTIMISED = "notch-optimised"
    ATE = "ate"
    ATE_AND_NOTCH = "ate+notch"
    ATE_INSIDE = "ate-inside"
    ADAPTIVE = "adaptive"
    FIXED_NOTCH = "fixed-notch"
    LOW_GAINS = "low-gains"


class ClockName(StrEnum):
    """What time is on the bus."""

    LOCK_STEP = "lock-step"
    WALL = "wall"


OutOption = Annotated[Path, typer.Option("--out", help="Directory for recordings, result.json and report.html.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print result.json on standard output, all else on standard error.")]


def _say(message: str) -> None:
    typer.echo(message, err=True)


def exit_code_of(error: Exception) -> int:
    """The exit status that an error has; `EXIT_INTERNAL` for one that nobody expected."""
    from drive_profiles.address import AddressError  # noqa: PLC0415
    from drive_profiles.errors import DriveProfileError  # noqa: PLC0415
    from hil.can.channel import BusLostError, ChannelError  # noqa: PLC0415
    from hil.control.trajectory import UnreachableError  # noqa: PLC0415
    from hil.errors import HilError  # noqa: PLC0415

    if isinstance(error, HilError):
        return error.exit_code
    if isinstance(error, DriveProfileError | UnreachableError):
        return EXIT_FILE
    if isinstance(error, AddressError):
        return EXIT_USAGE
    if isinstance(error, BusLostError):
        return EXIT_SAFETY_STOP
    return EXIT_BUS if isinstance(error, ChannelError) else EXIT_INTERNAL


@contextmanager
def told() -> Iterator[None]:
    """Turn errors into a message and an exit status; one that nobody expected keeps its traceback."""
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        _say("interrupted before anything moved")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except BrokenPipeError:
        raise
    except OSError as error:
        _say(f"{error.filename or 'output'}: {error.strerror or error}")
        raise typer.Exit(EXIT_FILE) from None
    except Exception as error:
        code = exit_code_of(error)
        if code == EXIT_INTERNAL:
            raise
        _say(str(error))
        raise typer.Exit(code) from None


class RunProgress:
    """A bar on a terminal, a line per run elsewhere; on standard error, so that standard output stays for results.

    Not live, it has no thread, which would take the interpreter from a run in real time.
    """

    def __init__(self, total: int, *, is_live: bool = True) -> None:
        from rich.console import Console  # noqa: PLC0415
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: PLC0415

        self._console = Console(stderr=True)
        self._is_live = is_live and self._console.is_terminal
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn(),
            console=self._console, disable=not self._is_live,
        )  # fmt: skip
        self._task: Any = None
        self._total, self._count = total, 0

    def __enter__(self) -> "RunProgress":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def announce(self, experiment: "Experiment") -> None:
        """A run begins."""
        self._count += 1
        label = f"[{self._count}/{self._total}] {experiment.title}"
        if self._is_live:
            self._task = self._bar.add_task(label.replace("[", r"\["), total=1.0)
        else:
            _say(label)

    def share(self, value: float) -> None:
        """So much of it is done."""
        if self._task is not None:
            self._bar.update(self._task, completed=value)


def _run_and_report(
    bench: "Bench",
    experiments: list["Experiment"],
    out: Path,
    *,
    as_json: bool,
    is_paper: bool = False,
    reset_faults: bool = False,
    clock: ClockName | None = None,
    overload: bool = False,
    known: "Knowledge | None" = None,
    repeat: int = 1,
) -> int:
    """Run, write the report, say what came of it; the exit status."""
    from drive_profiles.address import LOCAL, parse_address  # noqa: PLC0415
    from hil.experiments.runner import run_experiments  # noqa: PLC0415

    is_lock_step = parse_address(bench.bus.address).interface == LOCAL and clock is not ClockName.WALL
    with RunProgress(len(experiments), is_live=is_lock_step) as progress:
        outcome = run_experiments(
            bench,
            experiments,
            out,
            is_paper=is_paper,
            reset_faults=reset_faults,
            clock=None if clock is None else clock.value,
            overload=overload,
            knowledge=known,
            repeat=repeat,
            announce=progress.announce,
            tell=_say,
            progress=progress.share,
        )
    _say("writing the report")
    from hil.report.page import write_report  # noqa: PLC0415

    report = write_report(out)
    if as_json:
        typer.echo(json.dumps(outcome.result, ensure_ascii=False))
    else:
        _summary(outcome, typer.echo)
    _say(f"report: {report}")
    return _status(outcome)


def _status(outcome: "Outcome") -> int:
    """The exit status of runs, and why."""
    for what in outcome.not_restored:
        _say(f"not put back as it was found: {what}")
    if outcome.stopped is not None:
        _say(str(outcome.stopped))
        return outcome.stopped.exit_code
    for reason in dict.fromkeys(outcome.invalid):
        _say(f"not judged: {reason}")
    if outcome.not_restored:
        return EXIT_SDO
    return EXIT_CLAIM_FAILED if outcome.failed_claims or outcome.invalid else 0


def _summary(outcome: "Outcome", say: Callable[[str], None]) -> None:
    """The runs and the verdict, as text."""
    from hil.master.lateness import timing_lines  # noqa: PLC0415

    limit = outcome.result["bench"]["file"]["specification"]["tip_mm"]
    say(f"{'experiment':<24}{'axis':<6}{'loop':<7}{'compensation':<17}{'order':<7}{'tip peak mm':<13}within ±{limit:g} mm")
    for run in outcome.result["runs"]:
        axis = "2,3,5" if run["axis"] is None else str(run["axis"])
        without = "not judged" if "invalid" in run else "stopped"
        peak = without if run["tip_peak_mm"] is None else f"{run['tip_peak_mm']:.4f}"
        order = "-" if run["order"] is None else str(run["order"])
        verdict = "yes" if run["within_spec"] else "no"
        say(f"{run['experiment']:<24}{axis:<6}{run['loop']:<7}{run['compensation']:<17}{order:<7}{peak:<13}{verdict}")
    for run in {run["recording"]: run for run in outcome.result["runs"]}.values():
        for words, number in run.get("bus_errors", {}).items():
            say(f"{run['recording']}: on the bus: {words} ({number} times)")
        if "discarded_positions" in run:
            say(f"{run['recording']}: {run['discarded_positions']} positions that cannot be were forgotten")
    for timing in {run["recording"]: run["timing"] for run in outcome.result["runs"] if "timing" in run}.values():
        for line in timing_lines(timing):
            say(line)
    for pair in outcome.result["comparisons"]:
        axis = "axes 2, 3, 5" if pair["axis"] is None else f"axis {pair['axis']}"
        peak, area = -pair["tip_peak_reduction_pct"], -pair["spectrum_area_reduction_pct"]
        text = f"tip peak {peak:+.1f} %, spectrum area {area:+.1f} %".replace("-", "−")
        say(f"{pair['experiment']}, {axis}, {pair['loop']}-closed, {pair['compensation']}: {text}")
    if outcome.result["paper"]:
        held = sum(claim["holds"] for claim in outcome.result["paper"])
        say(f"{held} of {len(outcome.result['paper'])} claims of the paper hold")
    for claim in outcome.failed_claims:
        say(f"does not hold: {claim['claim']} ({claim['source']}): {claim['bench']} {claim['unit']}, paper {claim['paper']}")


@app.command(epilog=EXIT_STATUS)
def demo(
    out: OutOption = Path("demo"),
    as_json: JsonOption = False,
    robot: Annotated[str, typer.Option("--robot", help="Robot file of the emulator, or `reference`.")] = "reference",
    no_story: Annotated[
        bool, typer.Option("--no-story", help="Only the paper's experiments, without the story of a robot of one's own.")
    ] = False,
) -> None:
    """Start an emulated robot, run the paper's experiments over CAN, and write the report; then the same for your own robot.

    The second part takes the same robot as somebody meets it who knows nothing of it: identify, design, upload, and run with
    nothing, the notch, the designed notch and cancellation side by side.

    Example: hil demo --out demo
    """
    with told():
        from hil.emulator import EmulatedRobot  # noqa: PLC0415

        with EmulatedRobot(robot) as emulator:
            from hil.experiments.plan import demo_experiments  # noqa: PLC0415
            from hil.master.bench import load_bench  # noqa: PLC0415

            bench = load_bench("reference")
            bus = bench.bus.model_copy(update={"address": str(emulator.address)})
            bench = bench.model_copy(update={"bus": bus})
            status = _run_and_report(bench, demo_experiments(bench), out, as_json=as_json, is_paper=True)
            if not no_story and status in {0, EXIT_CLAIM_FAILED}:
                status = _tell_story(str(emulator.address), out, as_json=as_json) or status
        if status:
            raise typer.Exit(status)


def _tell_story(address: str, out: Path, *, as_json: bool) -> int:
    """The demo's second part; the exit status. Whatever comes of it, the report of the first part stands, and links to it."""
    from hil import story  # noqa: PLC0415
    from hil.experiments.compare import summary  # noqa: PLC0415
    from hil.report.page import write_report  # noqa: PLC0415
    from hil.report.page_compare import write_compare_report  # noqa: PLC0415

    _say("your own robot: of which nothing is known")
    done = story.tell(address, out / "story", announce=_say, begins=lambda experiment: _say(experiment.title))
    page = write_compare_report(out / "story")
    write_report(out)
    for line in summary(done.result):
        typer.echo(line, err=as_json)
    _say(f"your own robot: {page}")
    for what in [] if done.compared is None else done.compared.unmet:
        _say(f"not compared: {what}")
    if done.failure is not None:
        code = exit_code_of(done.failure)
        if code == EXIT_INTERNAL:
            raise done.failure
        _say(f"your own robot: {done.failure}")
        return code
    return EXIT_CLAIM_FAILED if done.compared is not None and done.compared.unmet else 0


@app.command(epilog=EXIT_STATUS)
def run(
    experiment: Annotated[ExperimentName, typer.Argument(help="What is asked of the robot.")],
    bench_file: Annotated[str, typer.Option("--bench", help="Bench file (TOML), or `reference`.")],
    axis: Annotated[int | None, typer.Option("--axis", help="Axis of a constant-acceleration run.")] = None,
    compensation: Annotated[CompensationName, typer.Option(help="What acts against it.")] = CompensationName.NONE,
    model: Annotated[
        Path | None,
        typer.Option(help="Model file of hil identify, for ate, ate+notch, ate-inside; left out: the bench file's."),
    ] = None,
    design: Annotated[Path | None, typer.Option(help="Design file of hil design, for notch-optimised.")] = None,
    learnt: Annotated[Path | None, typer.Option(help="Model file of hil learn, for adaptive.")] = None,
    repeat: Annotated[
        int, typer.Option(min=1, max=100, help="Run it so often and judge the mean, in which the sensor's noise is less.")
    ] = 1,
    loop: Annotated[PlanLoop, typer.Option(help="Where the loop is closed.")] = PlanLoop.DRIVE,
    bus: Annotated[str | None, typer.Option("--bus", help="Bus address instead of the bench file's.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Directory; left out: a new one in bench-out.")] = None,
    as_json: JsonOption = False,
    clock: Annotated[
        ClockName | None, typer.Option(help="The clock that the bus must have; left out: whichever it has (docs/realtime.md).")
    ] = None,
    overload: Annotated[
        bool, typer.Option("--overload", help="Run even what does not fit on the bus at its bit rate (hil plan).")
    ] = False,
    reset_faults: Annotated[bool, typer.Option("--reset-faults", help="Reset drives that are in fault first.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
) -> None:
    """Run one experiment on the robot of a bench file.

    Example: hil run constant-acceleration --axis 2 --compensation notch --bench bench.toml
    """
    with told():
        from drive_profiles.address import LOCAL, parse_address  # noqa: PLC0415
        from hil.experiments.plan import Experiment  # noqa: PLC0415
        from hil.master.bench import load_bench  # noqa: PLC0415

        is_line = experiment is ExperimentName.LINE_MOTION
        if is_line != (axis is None):
            _say("a line-motion takes no --axis" if is_line else "a constant-acceleration run needs --axis")
            raise typer.Exit(EXIT_USAGE)
        bench = load_bench(bench_file)
        if bus is not None:
            parse_address(bus)
            bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": bus})})
        plan = Experiment(experiment.value, axis, compensation.value, loop.value)
        if parse_address(bench.bus.address).interface != LOCAL and not yes:
            confirm([(bench, plan)])
        where = out or _new_directory(plan)
        known = knowledge(model, design, learnt)
        status = _run_and_report(
            bench, [plan], where, as_json=as_json, reset_faults=reset_faults, clock=clock, overload=overload, known=known,
            repeat=repeat,
        )  # fmt: skip
        if status:
            raise typer.Exit(status)


def knowledge(model: Path | None, design: Path | None, learnt: Path | None) -> "Knowledge":
    """What has been found out about the robot, from its files."""
    from hil.experiments.treatment import Knowledge  # noqa: PLC0415
    from hil.master.designed import load_designs  # noqa: PLC0415
    from hil.master.identified import load_identified  # noqa: PLC0415

    return Knowledge(
        identified=None if model is None else load_identified(model),
        designs=None if design is None else load_designs(design),
        learnt=None if learnt is None else load_identified(learnt),
    )


def _new_directory(experiment: "Experiment") -> Path:
    """A directory of its own for every run, so that no recording is written over another."""
    import datetime  # noqa: PLC0415

    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    return Path("bench-out") / f"{stamp}-{Path(experiment.file_name).stem}"


def confirm(pairs: "Iterable[tuple[Bench, Experiment]]") -> None:
    """A robot that is not emulated moves only when someone says so; asked once for all motions.

    Raises:
        typer.Exit: Nobody says so.
    """
    for bench, experiment in pairs:
        motion = experiment.motion(bench)
        _say(f"This moves {experiment.title} on {bench.bus.address}:")
        for column, number in enumerate(motion.axes):
            limits, angle = bench.axis[number].limits, motion.motor_angle_rad[:, column] / 6.283185307179586
            _say(
                f"  axis {number}: {angle.min():+.2f} … {angle.max():+.2f} motor revolutions, at most {limits.speed_rps:g} rps "
                f"and {limits.torque_nm:g} N·m; positions {limits.position_min_rev:g} … {limits.position_max_rev:g} rev"
            )
    if not sys.stdin.isatty():
        _say("nobody can be asked here; --yes moves it without asking")
        raise typer.Exit(EXIT_USAGE)
    if not typer.confirm("Is everyone clear of the robot, and its emergency stop in reach?", err=True):
        raise typer.Exit(EXIT_USAGE)


@app.command(epilog=EXIT_STATUS)
def report(
    directory: Annotated[Path, typer.Argument(help="Directory of a demo or a run.", exists=True, file_okay=False)],
) -> None:
    """Write report.html of a directory anew, from its result.json and recordings."""
    with told():
        if not (directory / "result.json").is_file():
            _say(f"{directory} has no result.json; it is not the directory of a demo or a run")
            raise typer.Exit(EXIT_FILE)
        try:
            path = _report_of(directory)
        except (ValueError, KeyError, OSError) as error:
            _say(f"{directory}: {error}")
            raise typer.Exit(EXIT_FILE) from None
        typer.echo(str(path))


def _report_of(directory: Path) -> Path:
    """The page of a directory, by the kind of what it holds."""
    kept = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    kind = kept.get("kind") if isinstance(kept, dict) else None
    if kind == "identify plant":
        from hil.report.page_plant import write_plant_report  # noqa: PLC0415

        return write_plant_report(directory)
    if kind == "identify-ate":
        from hil.report.page_ate import write_ate_report  # noqa: PLC0415

        return write_ate_report(directory)
    if kind == "compare":
        from hil.report.page_compare import write_compare_report  # noqa: PLC0415

        return write_compare_report(directory)
    from hil.report.page import write_report  # noqa: PLC0415

    return write_report(directory)


cli_plan.mount(app)
cli_identify.mount(app)
cli_design.mount(app)
cli_learn.mount(app)
cli_compare.mount(app)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except BrokenPipeError:
        os._exit(141)  # the reader of the output has gone; there is nothing to tell it


if __name__ == "__main__":
    main()
