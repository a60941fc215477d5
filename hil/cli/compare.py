"""`hil compare`: treatments side by side, over experiments and robots."""

import os
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.address import BUS_VARIABLE
from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_list, complete_reference
from drive_profiles.cli.console import fail
from hil.cli import console, options
from hil.cli.console import ExitStatus
from hil.cli.live import LiveCommand, MotionOptions, shown_live

if TYPE_CHECKING:
    from hil.bench.bench import Bench
    from hil.experiments.comparison.plan import ComparisonPlan, ComparisonRequest
    from hil.experiments.treatment import Knowledge

COMPARE_EPILOG = console.epilog_of_runs({
    ExitStatus.DONE: "compared",
    ExitStatus.NOT_MET: "a requested treatment was left out, a trial refused a cancellation, or a run could not be judged",
})  # fmt: skip
EXPERIMENTS = ("constant-acceleration", "line-motion", "point-to-point")
DEFAULT_EXPERIMENTS = EXPERIMENTS[:2]


ExperimentListOption = Annotated[
    list[str] | None,
    typer.Option(
        "--experiment",
        help="constant-acceleration, line-motion or point-to-point; repeatable; default: the first two.",
        autocompletion=complete_list(lambda: EXPERIMENTS),
    ),
]
AxisListOption = Annotated[
    list[int] | None,
    typer.Option(
        "--axis",
        help="Axis that moves alone; repeatable; default: those with a filter or a model.",
        autocompletion=options.AXES.one,
    ),
]


@command(cls=LiveCommand, epilog=COMPARE_EPILOG)
def compare(
    bench_file: Annotated[
        list[str],
        typer.Option(
            "--bench", help="Bench file (TOML), or `reference`; repeatable, for more robots.", autocompletion=complete_reference
        ),
    ],
    given: MotionOptions,
    experiment: ExperimentListOption = None,
    axis: AxisListOption = None,
    treatment: options.TreatmentListOption = None,
    model: Annotated[list[Path] | None, typer.Option(help="Model file of hil identify; repeatable, one per robot.")] = None,
    design: Annotated[list[Path] | None, typer.Option(help="Design file of hil design; repeatable, one per robot.")] = None,
    learnt: Annotated[list[Path] | None, typer.Option(help="Model file of hil learn; repeatable, one per robot.")] = None,
    bus: options.BusOption = None,
    emulate: Annotated[
        list[str] | None,
        typer.Option(
            help="Start an emulated robot (its file, or `reference`) for each bench; repeatable: one for all, or one each.",
            autocompletion=complete_reference,
        ),
    ] = None,
    repeat: Annotated[
        int, typer.Option(min=1, max=100, help="Number of runs of each motion; their mean is judged, with less sensor noise.")
    ] = 1,
) -> None:
    """Compare treatments of the transmission error in one table.

    The treatments are: none, lower gains, filters, cancellation, input shapers.

    Example: hil compare --bench bench.toml --model model.toml --design design.toml --out compared
    """
    with console.exit_on_error():
        from hil.bench.bench import load_bench

        _check_buses(bench_file, bus, emulate or [])
        if given.live is not None and len(bench_file) > 1:
            raise fail("--live shows one robot; give one --bench", ExitStatus.USAGE)
        where = console.result_directory(given.out, "compare", force=given.force)
        benches = [load_bench(name) if emulate else console.bench_on(name, bus) for name in bench_file]
        for number in axis or ():
            if not any(number in each.axis for each in benches):
                benches[0].check_axis(number)

        from hil.experiments.comparison.plan import KnownRobot, plan

        request = _request(experiment or [], axis or [], treatment or [])
        knowledge = _knowledge(dict(zip(bench_file, benches, strict=True)), model or [], design or [], learnt or [])
        with ExitStack() as emulators:
            benches = _emulated(benches, emulate or [], emulators)
            robots = [KnownRobot(bench, knowledge[bench.name], name) for bench, name in zip(benches, bench_file, strict=True)]
            plans = [plan(each, request, overload=given.overload) for each in robots]
            if not given.yes:
                _confirm(plans)
            with shown_live(given.live, benches[0].bus.address, bench_file[0]):
                _run(plans, request, where, repeat, given)


def _request(experiments: list[str], axes: list[int], treatments: list[str]) -> "ComparisonRequest":
    """Return the request of the options, every name checked.

    Raises:
        typer.Exit: A name is unknown, or axes are given for an experiment that is not run.
    """
    from hil.experiments.comparison.plan import ComparisonRequest
    from hil.experiments.treatment import TREATMENTS

    for name in experiments:
        if name not in EXPERIMENTS:
            raise fail(f"--experiment {name}: expected {' or '.join(EXPERIMENTS)}", ExitStatus.USAGE)
    wanted = tuple(name for name in EXPERIMENTS if name in experiments) or DEFAULT_EXPERIMENTS
    if axes and wanted == (EXPERIMENTS[1],):
        raise fail("--axis is for constant-acceleration and point-to-point; neither is among the experiments", ExitStatus.USAGE)
    names = [name.strip() for text in treatments for name in text.split(",") if name.strip()]
    for name in names:
        if name not in TREATMENTS:
            raise fail(f"--treatment {name}: expected one of {', '.join(TREATMENTS)}", ExitStatus.USAGE)
    chosen = tuple(name for name in TREATMENTS if not names or name in names)
    if set(chosen) == {"none"}:
        raise fail("--treatment none: expected a second --treatment to compare it with", ExitStatus.USAGE)
    return ComparisonRequest(wanted, tuple(dict.fromkeys(axes)), chosen, frozenset(names))


def _knowledge(
    benches: dict[str, "Bench"], models: list[Path], designs: list[Path], learnt: list[Path]
) -> dict[str, "Knowledge"]:
    """Return the knowledge of each robot from its files, by name."""
    from hil.bench.design import load_designs
    from hil.bench.model import load_identified
    from hil.experiments.comparison.plan import knowledge_by_robot
    from hil.results.acted import SourceFile, bench_files

    identified, designed, taught = (
        list(map(load_identified, models)), list(map(load_designs, designs)), list(map(load_identified, learnt)),
    )  # fmt: skip
    found = knowledge_by_robot(identified, designed, taught, [bench.name for bench in benches.values()])
    given = [
        *((each.robot, SourceFile.of("model", path)) for each, path in zip(identified, models, strict=True)),
        *((each.robot, SourceFile.of("design", path)) for each, path in zip(designed, designs, strict=True)),
        *((each.robot, SourceFile.of("learnt", path)) for each, path in zip(taught, learnt, strict=True)),
    ]
    files = {bench.name: bench_files(name, bench) for name, bench in benches.items()}
    return {
        name: replace(known, files=(*files[name], *(file for robot, file in given if robot == name)))
        for name, known in found.items()
    }


def _check_buses(benches: list[str], bus: str | None, robots: list[str]) -> None:
    if bus is not None and len(benches) > 1:
        raise fail("--bus is for one robot; with several robots, each bench file has its own bus", ExitStatus.USAGE)
    if len(benches) > 1 and not robots and os.environ.get(BUS_VARIABLE):
        raise fail(
            f"{BUS_VARIABLE} is for one robot; with several robots, each bench file has its own bus: unset it", ExitStatus.USAGE
        )
    if robots and bus is not None:
        raise fail("--emulate starts a bus of its own; leave --bus out", ExitStatus.USAGE)
    if len(robots) not in {0, 1, len(benches)}:
        raise fail(
            f"{len(robots)} times --emulate for {len(benches)} bench files; give one for all, or one for each", ExitStatus.USAGE
        )


def _emulated(benches: list["Bench"], robots: list[str], emulators: ExitStack) -> list["Bench"]:
    """Benches, each on the bus of its emulator if --emulate is given."""
    if not robots:
        return benches
    from hil.emulator import EmulatorProcess

    each = robots * len(benches) if len(robots) == 1 else robots
    addresses = [str(emulators.enter_context(EmulatorProcess(robot)).address) for robot in each]
    return [console.bench_on_emulator(bench, address) for bench, address in zip(benches, addresses, strict=True)]


def _confirm(plans: list["ComparisonPlan"]) -> None:
    """Ask once before real robots move, and name each motion once."""
    real = [each for each in plans if not console.is_on_local_bus(each.robot.bench)]
    if not real:
        return
    motions = {
        (number, experiment.name, experiment.axis, experiment.loop): (each.robot.bench, experiment)
        for number, each in enumerate(real)
        for experiment in each.experiments
    }
    count = sum(len(each.experiments) for each in real)
    console.say(f"{count} runs of these motions, and a trial before each cancellation:")
    console.confirm(console.motion_lines(motions.values()))


def _run(plans: list["ComparisonPlan"], request: "ComparisonRequest", out: Path, repeat: int, given: MotionOptions) -> None:
    """Run, write the report, print the table, exit with the status."""
    from hil.experiments.comparison.run import compare as run_all

    for each in plans:
        for reason in dict.fromkeys(left.reason for left in each.left_out):
            console.say(f"left out of {each.robot.bench.name}: {reason}")
        for remark in each.remarks:
            console.say(f"{each.robot.bench.name}: {remark}")
    total = sum(len(each.experiments) for each in plans)
    with console.RunProgress(total, is_live=all(console.is_on_local_bus(each.robot.bench) for each in plans)) as progress:
        done = run_all(plans, request, out, overload=given.overload, repeat=repeat, reporter=progress)
    console.tell_result(done.result, out, lambda: console.show_comparison(done.result), as_json=given.as_json)
    console.say_not_restored(done.not_restored)
    if done.failure is not None:
        raise console.exit_with(done.failure)
    for what in dict.fromkeys(done.unmet):
        console.say(f"not compared: {what}")
    if done.not_restored:
        raise typer.Exit(ExitStatus.SDO)
    if done.unmet:
        raise typer.Exit(ExitStatus.NOT_MET)
