"""hil compare: treatments of the transmission error side by side, over experiments and robots, in one report."""

# ruff: noqa: PLC0415 - numpy, scipy and the compiler are imported inside the command, so that --help stays quick

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hil.experiments.compare import Compared, Plan, Selection
    from hil.master.bench import Bench

EXIT_INTERNAL, EXIT_USAGE, EXIT_SDO, EXIT_UNMET = 1, 2, 6, 9
COMPARE_EXIT_STATUS = (
    "Exit status: 0 compared; 2 usage; 3 bad file or a request beyond its limits; 4 no bus; 5 no answer, wrong device, or "
    "already moving; 6 SDO abort; 8 safety stop; 9 what was asked for by name was left out, a cancellation was refused by its "
    "trial, or a run could not be judged; 130 interrupted, after a safe stop."
)
EXPERIMENTS = ("constant-acceleration", "line-motion")


def compare(
    bench_file: Annotated[list[str], typer.Option("--bench", help="Bench file (TOML), or `reference`; again for more robots.")],
    experiment: Annotated[
        list[str] | None, typer.Option("--experiment", help="constant-acceleration or line-motion; left out: both.")
    ] = None,
    axis: Annotated[
        list[int] | None, typer.Option("--axis", help="Axes of constant-acceleration; left out: those with a filter or a model.")
    ] = None,
    compensation: Annotated[
        list[str] | None,
        typer.Option(
            help="Names with commas between: none, low-gains, fixed-notch, notch, notch-optimised, ate, ate+notch, adaptive. "
            "Left out: all that the given files allow."
        ),
    ] = None,
    model: Annotated[list[Path] | None, typer.Option(help="Model file of hil identify; one per robot.")] = None,
    design: Annotated[list[Path] | None, typer.Option(help="Design file of hil design; one per robot.")] = None,
    learnt: Annotated[list[Path] | None, typer.Option(help="Model file of hil learn; one per robot.")] = None,
    bus: Annotated[str | None, typer.Option("--bus", help="Bus address instead of the bench file's; for a single robot.")] = None,
    emulate: Annotated[
        list[str] | None,
        typer.Option(help="Start an emulated robot (its file, or `reference`) for each bench: one for all, or one each."),
    ] = None,
    repeat: Annotated[
        int, typer.Option(min=1, max=100, help="Run each so often and judge the mean, in which the sensor's noise is less.")
    ] = 1,
    out: Annotated[Path | None, typer.Option("--out", help="Directory; left out: a new one in bench-out.")] = None,
    overload: Annotated[
        bool, typer.Option("--overload", help="Run even what does not fit on the bus at its bit rate (hil plan).")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print result.json on standard output, all else on standard error.")
    ] = False,
) -> None:
    """Compare what can act against the transmission error: nothing, lower gains, filters, cancellation, in one table.

    Example: hil compare --bench bench.toml --model model.toml --design design.toml --out compared
    """
    from hil.cli import told

    with told():
        from hil.experiments.compare import Robot, knowledge_by_robot, plan
        from hil.master.bench import load_bench
        from hil.master.designed import load_designs
        from hil.master.identified import load_identified

        selection = _selection(experiment or [], axis or [], compensation or [])
        benches = [_at(load_bench(name), bus) for name in bench_file]
        robots = emulate or []
        _check_buses(benches, bus, robots)
        known = knowledge_by_robot(
            [load_identified(path) for path in model or []],
            [load_designs(path) for path in design or []],
            [load_identified(path) for path in learnt or []],
            [bench.name for bench in benches],
        )
        with ExitStack() as emulators:
            benches = _emulated(benches, robots, emulators)
            asked = [Robot(bench, known[bench.name], name) for bench, name in zip(benches, bench_file, strict=True)]
            plans = [plan(each, selection, overload=overload) for each in asked]
            _confirm(plans, yes=yes)
            _run(plans, selection, out or _new_directory(), repeat, overload=overload, as_json=as_json)


def mount(app: typer.Typer) -> None:
    """Make it a command of `hil`."""
    app.command(epilog=COMPARE_EXIT_STATUS)(compare)


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _usage(message: str) -> typer.Exit:
    _say(message)
    return typer.Exit(EXIT_USAGE)


def _selection(experiments: list[str], axes: list[int], compensations: list[str]) -> "Selection":
    """What is asked for, every name looked at.

    Raises:
        typer.Exit: A name that is none, or axes of an experiment that is not run.
    """
    from hil.experiments.compare import Selection
    from hil.experiments.treatment import TREATMENTS

    for name in experiments:
        if name not in EXPERIMENTS:
            raise _usage(f"--experiment {name}: expected {' or '.join(EXPERIMENTS)}")
    wanted = tuple(name for name in EXPERIMENTS if name in experiments) or EXPERIMENTS
    if axes and EXPERIMENTS[0] not in wanted:
        raise _usage("--axis is for constant-acceleration, which is not among the experiments")
    names = [name.strip() for text in compensations for name in text.split(",") if name.strip()]
    for name in names:
        if name not in TREATMENTS:
            raise _usage(f"--compensation {name}: expected of {', '.join(TREATMENTS)}")
    treatments = tuple(name for name in TREATMENTS if not names or name in names)
    if set(treatments) == {"none"}:
        raise _usage("--compensation none: there is nothing to compare it with")
    return Selection(wanted, tuple(dict.fromkeys(axes)), treatments, frozenset(names))


def _at(bench: "Bench", bus: str | None) -> "Bench":
    from drive_profiles.address import parse_address

    if bus is None:
        return bench
    parse_address(bus)
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": bus})})


def _check_buses(benches: list["Bench"], bus: str | None, robots: list[str]) -> None:
    if bus is not None and len(benches) > 1:
        raise _usage("--bus is for a single robot; of several each bench file names its own")
    if robots and bus is not None:
        raise _usage("--emulate starts a bus of its own; it takes no --bus")
    if len(robots) not in {0, 1, len(benches)}:
        raise _usage(f"{len(robots)} times --emulate for {len(benches)} bench files: give one for all, or one each")


def _emulated(benches: list["Bench"], robots: list[str], emulators: ExitStack) -> list["Bench"]:
    """The benches, each on the bus of an emulator of its own where that is wanted."""
    if not robots:
        return benches
    from hil.emulator import EmulatedRobot

    each = robots * len(benches) if len(robots) == 1 else robots
    return [
        _at(bench, str(emulators.enter_context(EmulatedRobot(robot)).address)) for bench, robot in zip(benches, each, strict=True)
    ]


def _confirm(plans: list["Plan"], *, yes: bool) -> None:
    """Real robots move only when someone says so: asked once, each motion named once."""
    from drive_profiles.address import LOCAL, parse_address
    from hil.cli import confirm

    real = [each for each in plans if parse_address(each.robot.bench.bus.address).interface != LOCAL]
    if not real or yes:
        return
    motions = {
        (place, experiment.name, experiment.axis, experiment.loop): (each.robot.bench, experiment)
        for place, each in enumerate(real)
        for experiment in each.experiments
    }
    count = sum(len(each.experiments) for each in real)
    _say(f"{count} runs, and before each cancellation its trial, of these motions:")
    confirm(motions.values())


def _new_directory() -> Path:
    """A directory of its own for every comparison."""
    import datetime

    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    return Path("bench-out") / f"{stamp}-compare"


def _run(plans: list["Plan"], selection: "Selection", out: Path, repeat: int, *, overload: bool, as_json: bool) -> None:
    """Run, write the report, say what came of it, and leave with the right status."""
    from hil.cli import RunProgress
    from hil.experiments.compare import compare as run_all
    from hil.experiments.compare import summary
    from hil.report.page_compare import write_compare_report

    for each in plans:
        for reason in dict.fromkeys(left.reason for left in each.left_out):
            _say(f"left out of {each.robot.bench.name}: {reason}")
    total = sum(len(each.experiments) for each in plans)
    with RunProgress(total, is_live=_is_lock_step(plans)) as progress:
        done = run_all(
            plans,
            selection,
            out,
            overload=overload,
            repeat=repeat,
            announce=progress.announce,
            tell=_say,
            progress=progress.share,
        )
    report = write_compare_report(out)
    if as_json:
        typer.echo(json.dumps(done.result, ensure_ascii=False))
    else:
        for line in summary(done.result):
            typer.echo(line)
    _say(f"report: {report}")
    _leave(done)


def _is_lock_step(plans: list["Plan"]) -> bool:
    """Whether a bar may move: its thread must not take the interpreter from a run in real time."""
    from drive_profiles.address import LOCAL, parse_address

    return all(parse_address(each.robot.bench.bus.address).interface == LOCAL for each in plans)


def _leave(done: "Compared") -> None:
    """The right exit status, and why."""
    from hil.cli import exit_code_of

    for what in done.not_restored:
        _say(f"not put back as it was found: {what}")
    if done.failure is not None:
        code = exit_code_of(done.failure)
        if code == EXIT_INTERNAL:
            raise done.failure
        _say(str(done.failure))
        raise typer.Exit(code)
    for what in dict.fromkeys(done.unmet):
        _say(f"not compared: {what}")
    if done.not_restored:
        raise typer.Exit(EXIT_SDO)
    if done.unmet:
        raise typer.Exit(EXIT_UNMET)
