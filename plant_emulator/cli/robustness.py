"""plant-emulator robustness: many plants against the specification."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, print_json
from hil.control.treatments import PlainTreatmentName
from hil.control.treatments import treatment as treatment_named
from plant_emulator.cli.console import (
    AXES,
    EmulatorExitStatus,
    JsonOption,
    RobotOption,
    axis_numbers,
    ends,
    exit_on_error,
    exit_on_value_error,
    show,
)
from plant_emulator.cli.pool import JobsOption, OnOption, executors_of, trials

if TYPE_CHECKING:
    from hil.control.notch import Notch
    from hil.report.report_table import ReportTable
    from plant_emulator.robots.tuning import TunedAxis
    from plant_emulator.studies.robustness import Study
    from plant_emulator.studies.summary import Summary
    from plant_emulator.trials.executors import Executors

ROBUSTNESS_EPILOG = ends(
    EmulatorExitStatus.BUS,
    DONE="done, whatever the fractions",
    FILE="bad file, or a path that cannot be written",
    BUS="no scheduler, or it is lost",
)
ExperimentName = Literal["constant-acceleration", "line-motion"]

AxesOption = Annotated[
    str | None,
    typer.Option(
        "--axis",
        metavar="N[,N]",
        help="Axes, one study each; default: those that have a filter.",
        autocompletion=AXES.several,
    ),
]
ExperimentOption = Annotated[ExperimentName, typer.Option("--experiment", help="Motion of the robot.")]
TreatmentOption = Annotated[PlainTreatmentName, typer.Option("--treatment", help="none: the same plants without filters.")]
TuningOption = Annotated[
    Path | None,
    typer.Option("--tuning", help="Gains and filters: a bench, robot or tuning file; default: the robot file's own."),
]
NotchOption = Annotated[Path | None, typer.Option("--notch", help="Filters from a design file of hil design notch instead.")]
SpreadOption = Annotated[
    Path | None, typer.Option("--spread", help="Spread of the unknowns (TOML file); see docs/robustness.md.")
]
RunsOption = Annotated[int, typer.Option("--runs", min=1, max=100_000, help="Number of plants in each study.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Equal seeds give equal plants.")]
TipOption = Annotated[float, typer.Option("--tip-mm", help="Specification: largest permitted tip peak.")]
AreaOption = Annotated[
    float,
    typer.Option(
        "--area-percent", help="Specification of a line motion with filters: smallest reduction of the spectrum's area."
    ),
]
OnlyOption = Annotated[int | None, typer.Option("--only", min=0, metavar="INDEX", help="Only this plant, in detail.")]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for report.html, robustness.json and draws.csv; with --only, for a CSV of the run."),
]


@command(epilog=ROBUSTNESS_EPILOG)
def robustness(
    robot: RobotOption = "reference",
    axis: AxesOption = None,
    experiment: ExperimentOption = "constant-acceleration",
    treatment: TreatmentOption = "notch",
    tuning: TuningOption = None,
    notch: NotchOption = None,
    spread: SpreadOption = None,
    runs: RunsOption = 1000,
    seed: SeedOption = 1,
    jobs: JobsOption = None,
    on: OnOption = None,
    tip_mm: TipOption = 0.05,
    area_percent: AreaOption = 26.0,
    only: OnlyOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate many plants that differ in their unknowns.

    The result is the fraction that meets the specification, and the unknowns that matter.

    It needs no bus. It runs in one process per processor, or on the workers of a Dask scheduler. The drives' law, the
    set-points and the plant are those of `plant-emulator simulate`.

    Examples:
        plant-emulator robustness --axis 2,3 --out robustness

        plant-emulator robustness --treatment none

        plant-emulator robustness --axis 2 --notch design/design.toml --spread spread.toml --seed 7

        plant-emulator robustness --axis 2 --only 417 --out robustness
    """
    is_line, with_filters = experiment == "line-motion", treatment_named(treatment).filters != ""
    if not 0.0 < tip_mm < float("inf"):
        raise fail(f"--tip-mm {tip_mm}: expected more than 0", EmulatorExitStatus.USAGE)
    if not area_percent < 100.0:  # NaN is not below either
        raise fail(f"--area-percent {area_percent}: expected less than 100", EmulatorExitStatus.USAGE)
    if not with_filters and notch is not None:
        raise fail(f"--notch: --treatment {treatment} has no filter", EmulatorExitStatus.USAGE)
    if is_line and axis is not None:
        raise fail("--axis: the line motion moves all axes of the arm", EmulatorExitStatus.USAGE)
    with exit_on_error():
        from drive_profiles.files.safefile import make_writable
        from drive_profiles.files.toml import load
        from plant_emulator.robots.robot import load_robot
        from plant_emulator.robots.tuning import load_tuning, own_tuning
        from plant_emulator.studies.robustness import Study
        from plant_emulator.studies.spread import PlantSpread

        model = load_robot(robot)
        tuned = own_tuning(robot, model) if tuning is None else dict(load_tuning(tuning).axis)
        filters = _filters(tuned, notch)
        numbers: list[int | None] = [None]
        if not is_line and axis is not None:
            numbers = [*axis_numbers(axis, model)]
        elif not is_line:
            numbers = [number for number in sorted(model.axis) if number in filters] or [*sorted(model.axis)]
        if with_filters:
            _check_filters(numbers, filters, notch)
        controls = {number: each.control for number, each in tuned.items() if each.control is not None}
        reach = PlantSpread() if spread is None else load(spread, PlantSpread)
        with exit_on_value_error():
            studies = [
                Study(model, number, controls, filters if with_filters else {}, reach, seed, tip_mm, area_percent)
                for number in numbers
            ]
        if out is not None:  # what cannot be written is refused before hours of simulation
            make_writable(out, "robustness.json")
        if only is not None:
            _one(studies, only, out, as_json=as_json)
        else:
            options = {"--robot": robot, "--treatment": treatment, "--tuning": tuning, "--notch": notch, "--spread": spread}
            _many(studies, runs, executors_of(on, jobs), options, out, as_json=as_json)


def _filters(tuned: Mapping[int, "TunedAxis"], designed: Path | None) -> dict[int, tuple["Notch", ...]]:
    from plant_emulator.robots.tuning import load_tuning

    tables = {number: each.notch for number, each in tuned.items()}
    if designed is not None:
        tables |= {number: each.notch for number, each in load_tuning(designed).axis.items()}
    return {number: tuple(table.notch() for table in each) for number, each in tables.items() if each}


def _check_filters(numbers: Sequence[int | None], filters: Mapping[int, object], designed: Path | None) -> None:
    """Refuse a run with filters of an axis that has none."""
    if not filters:
        raise fail("no axis has a filter; give --tuning or --notch, or --treatment none", EmulatorExitStatus.USAGE)
    for number in numbers:
        if number is not None and number not in filters:
            where = "" if designed is None else f" in {designed}"
            raise fail(f"axis {number} has no filter{where}; give --treatment none to run it without", EmulatorExitStatus.USAGE)


def _many(
    studies: Sequence["Study"],
    runs: int,
    executors: "Executors",
    options: Mapping[str, object],
    out: Path | None,
    *,
    as_json: bool,
) -> None:
    """Run many plants of each study; `options` are those that choose the plants."""
    from plant_emulator.studies.robustness import judge_all
    from plant_emulator.studies.summary import document, summarise
    from plant_emulator.studies.tables import tables

    try:
        with trials("plants", runs * len(studies), executors) as step:
            judged = judge_all(studies, runs, executors, step)
    except typer.Exit:  # is a RuntimeError too; it has its own message
        raise
    except RuntimeError as error:
        raise fail(f"{error}; run it alone with --only", EmulatorExitStatus.INTERNAL) from None
    summaries = [summarise(study, each, study.judge(-1)) for study, each in zip(studies, judged, strict=True)]
    made = [(summary, tables(summary, shlex.join(_repeat(summary, options)))) for summary in summaries]
    whole = {"studies": [document(summary) for summary in summaries]}
    if out is not None:
        _keep(out, made, whole)
    if as_json:
        print_json(whole)
    else:
        for summary, each in made:
            typer.echo(f"\n{summary.title}")
            for one in each:
                show(one)


def _repeat(summary: "Summary", options: Mapping[str, object]) -> list[str]:
    """Return the command that repeats the worst plant: the options that were given, and the plant."""
    study = summary.study
    chosen: dict[str, object] = {"--experiment": "line-motion"} if study.axis is None else {"--axis": study.axis}
    given = {name: value for name, value in options.items() if value is not None}
    words = given | chosen | {"--seed": study.seed, "--only": summary.worst["index"]}
    return ["plant-emulator", "robustness", *(str(word) for pair in words.items() for word in pair)]


def _keep(out: Path, made: "Sequence[tuple[Summary, list[ReportTable]]]", whole: Mapping[str, object]) -> None:
    """Write page and JSON document, and each study's table of draws."""
    from drive_profiles.files.safefile import write_atomically, write_json
    from plant_emulator.studies.page import write_page
    from plant_emulator.studies.summary import draws_csv

    write_json(out / "robustness.json", whole, force=True)
    for summary, _ in made:
        name = "draws.csv" if len(made) == 1 else f"draws-{summary.study.name}.csv"
        write_atomically(out / name, draws_csv(summary).encode(), force=True)
    write_page(out / "report.html", made)
    typer.echo(f"files in {out}", err=True)


def _one(studies: Sequence["Study"], index: int, out: Path | None, *, as_json: bool) -> None:
    """Simulate one plant again, and save its run to a folder."""
    from drive_profiles.files.safefile import write_atomically
    from plant_emulator.studies.summary import run_document
    from plant_emulator.studies.tables import plant

    documents = []
    for study in studies:
        row = study.judge(index)
        documents.append({"axis": study.axis, "seed": study.seed, **run_document(study, row)})
        if out is not None:
            path = out / f"run-{study.name}-{index}.csv"
            write_atomically(path, _run_csv(study, index).encode(), force=True)
            typer.echo(f"run in {path}", err=True)
        if not as_json:
            show(plant(study, row, study.unknowns))
    if as_json:
        print_json({"runs": documents})


def _run_csv(study: "Study", index: int) -> str:
    """Return the signals of one run as CSV, one line per SYNC."""
    from plant_emulator.studies.simulate import axis_columns
    from plant_emulator.trials.rows import columns_csv

    motion = study.run(*study.draw(index))
    tip = {"tip_z_m_s2": motion.run.tip_m_s2[:, 2], "measured_z_m_s2": motion.measured_m_s2}
    return columns_csv({"time_s": study.times} | axis_columns(study.axes, study.set_points, motion.run) | tip)
