"""`hil design notch`: a variable notch for an axis, from its plant."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import Tool
from drive_profiles.cli.console import fail
from drive_profiles.processors import usable_processors
from hil.cli import console
from hil.cli.console import ExitStatus, RunProgress, epilog_without_motion, exit_on_error, exit_with, result_directory, say
from hil.cli.options import AXES, BenchOption, ForceOption, NewOutOption
from hil.errors import NotPossibleError

if TYPE_CHECKING:
    from hil.bench.bench import Bench
    from hil.experiments.notch_design import NotchDesignOutcome

DESIGN_EPILOG = epilog_without_motion({
    ExitStatus.DONE: "a filter meets every requirement",
    ExitStatus.FILE: "bad file, or a bench file without an entry that a design needs",
    ExitStatus.NOT_MET: "no filter meets every requirement, or the loop without a filter is better",
})  # fmt: skip


ModelOption = Annotated[Path | None, typer.Option("--model", help="Model file of hil identify; replaces the bench file's model.")]
UncertaintyOption = Annotated[
    float | None, typer.Option(help="Uncertainty of K_g and J_l; default: the model file's standard errors, else 5; 0: none.")
]
SetFileOption = Annotated[
    Path | None, typer.Option("--set", help="Parameter set for drive-profiles upload; default: notch-axisN.toml in --out.")
]
DesignFileOption = Annotated[
    Path | None,
    typer.Option(
        "--design", help="Design file in which this axis is replaced. Default: design.toml in --out, or none with --given."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print design.json on standard output, all else on standard error.")]


design_app = Tool("design", "Design filters for an identified plant; nothing is sent.", is_group=True)


@design_app.callback()
def _group() -> None:
    """Keep it a group while it has a single command."""


@design_app.command(epilog=DESIGN_EPILOG)
def notch(
    bench_file: BenchOption,
    axis: Annotated[int, typer.Option("--axis", help="Axis of the notch.", autocompletion=AXES.one)],
    model: ModelOption = None,
    order: Annotated[str, typer.Option(help="Harmonic order k: one such as 2, two such as 1,2, or `both` (2,4).")] = "2",
    shape: Annotated[
        Literal["switched", "trapezoid", "best"],
        typer.Option(help="Poles' damping from f_s to f_e: switched is constant, trapezoid has slopes, best is the better one."),
    ] = "best",
    given: Annotated[bool, typer.Option("--given", help="Only judge the bench file's own notch.")] = False,
    max_sensitivity: Annotated[float, typer.Option(help="Largest M_s at any speed.")] = 1.7,
    phase_margin_deg: Annotated[float, typer.Option(help="Least phase margin at any speed.")] = 35.0,
    gain_margin_db: Annotated[float, typer.Option(help="Least gain margin at any speed.")] = 6.0,
    tip_mm: Annotated[float | None, typer.Option(help="Limit of the tip peak, mm; default: the bench file's tip_mm.")] = None,
    uncertainty_percent: UncertaintyOption = None,
    period_s: Annotated[
        float | None, typer.Option(help="Sampling time of the loop; default: the drive family's, or 250 µs.")
    ] = None,
    delay_samples: Annotated[int, typer.Option(min=0, max=20, help="Whole samples between measurement and torque.")] = 0,
    out: NewOutOption = None,
    force: ForceOption = False,
    set_file: SetFileOption = None,
    design_file: DesignFileOption = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=256, help="Number of processes; default: one per processor, with --quick one.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search; equal seeds give equal filters.")] = 1,
    quick: Annotated[bool, typer.Option("--quick", help="Search for a fifth of the time.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Design the variable notch of an axis for a set of plants.

    It finds the filter with the smallest tip peak on the ramp within all margins. It sends nothing, and needs no robot.

    Example: hil design notch --bench bench.toml --axis 2 --model model.toml --out design
    """
    with exit_on_error(moves=False):
        from hil.bench.bench import load_bench

        bench = load_bench(bench_file)
        where = result_directory(out, f"design-axis{axis}", force=force)

        from hil.bench.design import Designs
        from hil.bench.model import load_identified
        from hil.design.notch_problem import Requirements
        from hil.design.notch_search import Effort
        from hil.experiments.notch_design import design
        from hil.experiments.notch_problem import NotchDesignRequest

        _check_set_file(bench, axis, set_file)
        if design_file is not None:
            Designs.check_file(design_file, bench.name)
        limit_mm = bench.specification.tip_mm if tip_mm is None else tip_mm
        try:
            request = NotchDesignRequest(
                axis=axis,
                orders=_orders(order),
                shapes=("switched", "trapezoid") if shape == "best" else (shape,),
                requirements=Requirements(max_sensitivity, phase_margin_deg, gain_margin_db, limit_mm),
                uncertainty_percent=uncertainty_percent,
                period_s=period_s,
                delay_samples=delay_samples,
                effort=Effort.quick(seed) if quick else Effort(seed=seed),
                jobs=jobs if jobs is not None else 0 if quick else usable_processors(),
                is_given=given,
            )
            identified = None if model is None else load_identified(model)
            with RunProgress(1) as progress:
                if progress.is_live:  # elsewhere a design has nothing to say before its result
                    progress.run(f"axis {axis}")
                outcome = design(bench, request, identified, progress)
        except ValueError as error:
            raise fail(str(error), ExitStatus.USAGE) from None
        _keep(outcome, where, set_file, design_file, as_json=as_json)


def _orders(text: str) -> tuple[int, ...]:
    """Return the orders of the option.

    Raises:
        ValueError: The text names no orders.
    """
    from hil.robot_tables import ORDERS

    if text == "both":
        return ORDERS[1:]
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts) or len(set(parts)) != len(parts):
        raise ValueError(f"--order {text!r}: expected one order such as 2, two such as 1,2, or `both` (2,4)")
    return tuple(int(part) for part in parts)


def _check_set_file(bench: "Bench", axis: int, path: Path | None) -> None:
    """Refuse a parameter set that could not be written, before the search.

    Raises:
        NotPossibleError: The file exists, or the drive has no room for the filter.
    """
    from hil.experiments.notch_design import check_drive

    if path is None or axis not in bench.axis:
        return
    check_drive(bench, axis)
    if path.exists():
        raise NotPossibleError(f"{path} already exists and is not replaced; choose another name")


def _keep(outcome: "NotchDesignOutcome", out: Path, set_file: Path | None, design_file: Path | None, *, as_json: bool) -> None:
    """Write the files, print the summary, and leave with the exit status."""
    from hil.bench.design import notch_table, snippet, update_designs
    from hil.experiments.notch_design import designed_axis, parameter_set, result_of
    from hil.report.pages.design import write_design_report

    number, best = outcome.request.axis, outcome.best
    out.mkdir(parents=True, exist_ok=True)
    result = result_of(outcome)
    result.write(out / "design.json")
    report = write_design_report(outcome, out / "design.html")
    show: Callable[[str], None] = say if as_json else typer.echo
    _summary(outcome, show, as_json=as_json)
    if as_json:
        typer.echo(result.dumps())
    if outcome.is_usable:
        if not outcome.request.is_given:
            show("\n".join(["", *snippet(number, tuple(notch_table(one) for one in best.notches)), ""]))
        path = design_file or (None if outcome.request.is_given else out / "design.toml")
        if path is not None:
            update_designs(path, outcome.bench.name, number, designed_axis(outcome))
            say(f"design file: {path}")
        path = set_file or out / f"notch-axis{number}.toml"
        try:
            parameter_set(outcome.bench, number, best, outcome.f_al_hz).save(path, force=set_file is None)
            say(f"parameter set: {path} (drive-profiles upload)")
            say(
                "the filter has not run on the robot yet: before the upload, run "
                f"hil run constant-acceleration --axis {number} --treatment notch-designed with the design file"
            )
        except NotPossibleError as error:
            if set_file is not None:
                raise
            say(f"no parameter set: {error}")
    else:
        say("no design file and no parameter set: no filter was found, or the filters break a margin or raise a peak")
    for note in outcome.notes:
        say(note)
    say(f"report: {report}")
    if outcome.failure is not None:
        raise exit_with(outcome.failure)


def _summary(outcome: "NotchDesignOutcome", show: Callable[[str], None], *, as_json: bool) -> None:
    """Print filters, margins and predicted peaks."""
    from hil.design.uncertainty import plants_words
    from hil.report.pages.design import peaks, requirements

    show(
        f"axis {outcome.request.axis}, plant from {outcome.source}, loop every {1e6 * outcome.problem.period_s:g} µs with "
        f"{outcome.problem.delay_samples} samples of delay, {plants_words(outcome.problem.members)}, {outcome.seconds:.1f} s"
    )
    console.show(peaks(outcome), requirements(outcome), err=as_json)
