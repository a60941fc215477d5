"""hil design notch: a variable notch for an axis, from its plant; nothing is sent, it needs no robot."""

# ruff: noqa: PLC0415 - numpy, scipy and the compiler are imported inside the command, so that --help stays quick

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hil.experiments.notch_design import Outcome, Request

EXIT_INTERNAL, EXIT_USAGE, EXIT_FILE, EXIT_INTERRUPTED = 1, 2, 3, 130
DESIGN_EXIT_STATUS = (
    "Exit status: 0 a filter that keeps all that is asked; 2 usage; 3 bad file, or a bench that lacks what a design needs; 9 no "
    "filter keeps all, with the reason; 130 interrupted."
)


class OrderName(StrEnum):
    """Which orders of the transmission error get a filter."""

    SECOND = "2"
    FOURTH = "4"
    BOTH = "both"


class ShapeName(StrEnum):
    """How the damping of the poles goes over the speed."""

    SWITCHED = "switched"
    TRAPEZOID = "trapezoid"
    BEST = "best"


ORDERS = {OrderName.SECOND: (2,), OrderName.FOURTH: (4,), OrderName.BOTH: (2, 4)}


def notch(
    bench_file: Annotated[str, typer.Option("--bench", help="Bench file (TOML), or `reference`.")],
    axis: Annotated[int, typer.Option("--axis", help="Axis whose notch is wanted.")],
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file of hil identify, before the bench file's model.")
    ] = None,
    order: Annotated[OrderName, typer.Option(help="Harmonic orders k.")] = OrderName.SECOND,
    shape: Annotated[
        ShapeName, typer.Option(help="switched: constant between f_s and f_e; trapezoid: scheduled.")
    ] = ShapeName.BEST,
    given: Annotated[bool, typer.Option("--given", help="Only judge the bench file's own notch.")] = False,
    max_sensitivity: Annotated[float, typer.Option(help="M_s at every speed, at most.")] = 1.7,
    phase_margin_deg: Annotated[float, typer.Option(help="At every speed, at least.")] = 35.0,
    gain_margin_db: Annotated[float, typer.Option(help="At every speed, at least.")] = 6.0,
    tip_mm: Annotated[float | None, typer.Option(help="A_acc; left out: the bench file's specification.")] = None,
    uncertainty_percent: Annotated[
        float | None, typer.Option(help="Of K_g and J_l; left out: the model file's standard errors, or 5. 0: none.")
    ] = None,
    period_s: Annotated[float | None, typer.Option(help="Sampling time of the loop; left out: the drive family's.")] = None,
    delay_samples: Annotated[int, typer.Option(min=0, max=20, help="Whole samples between measurement and torque.")] = 0,
    out: Annotated[Path, typer.Option("--out", help="Directory for design.json, design.html and the files below.")] = Path(
        "design"
    ),
    set_file: Annotated[
        Path | None, typer.Option("--set", help="Parameter set for drive-profiles upload; left out: notch-axisN.toml in --out.")
    ] = None,
    design_file: Annotated[
        Path | None, typer.Option("--design", help="Design file, this axis of it replaced; left out: design.toml in --out.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, max=256, help="Processes; left out: one per processor.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal filters.")] = 1,
    quick: Annotated[bool, typer.Option("--quick", help="Search a fifth as long.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print design.json on standard output, all else on standard error.")
    ] = False,
) -> None:
    """Design the variable notch of an axis: smallest tip peak on the ramp within all margins, for every plant of a set.

    Nothing is sent: it needs no robot. Example: hil design notch --bench bench.toml --axis 2 --model model.toml --out design
    """
    with _told():
        from hil.design.notch_design import Requirements
        from hil.design.notch_search import Effort
        from hil.errors import NotPossibleError
        from hil.experiments.notch_design import Request, check_drive
        from hil.master.bench import load_bench

        bench = load_bench(bench_file)
        if set_file is not None and axis in bench.axis:
            check_drive(bench, axis)
            if set_file.exists():
                raise NotPossibleError(f"{set_file} is there already, and is not replaced: choose another name")
        try:
            request = Request(
                axis=axis,
                orders=ORDERS[order],
                shapes=("switched", "trapezoid") if shape is ShapeName.BEST else (shape.value,),
                requirements=Requirements(
                    max_sensitivity, phase_margin_deg, gain_margin_db, bench.specification.tip_mm if tip_mm is None else tip_mm
                ),
                uncertainty_percent=uncertainty_percent,
                period_s=period_s,
                delay_samples=delay_samples,
                effort=Effort.quick(seed) if quick else Effort(seed=seed),
                jobs=jobs or _processors(),
                is_given=given,
            )
            outcome = _designed(bench_file, request, model)
        except ValueError as error:
            _say(str(error))
            raise typer.Exit(EXIT_USAGE) from None
        _keep(outcome, out, set_file, design_file, as_json=as_json)


def mount(app: typer.Typer) -> None:
    """Make it `hil design notch`."""
    group = typer.Typer(help="Filters and corrections from a plant; nothing is sent.", no_args_is_help=True)
    group.command("notch", epilog=DESIGN_EXIT_STATUS)(notch)

    @group.callback()
    def _group() -> None:
        """A group even while it has a single command."""

    app.add_typer(group, name="design", help="Filters and corrections from a plant; nothing is sent.")


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _told() -> Iterator[None]:
    """Turn errors into a message and an exit status; one that nobody expected keeps its traceback."""
    from hil.cli import exit_code_of

    try:
        yield
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        _say("interrupted")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except OSError as error:
        _say(f"{error.filename or 'output'}: {error.strerror or error}")
        raise typer.Exit(EXIT_FILE) from None
    except Exception as error:
        code = exit_code_of(error)
        if code == EXIT_INTERNAL:
            raise
        _say(str(error))
        raise typer.Exit(code) from None


def _designed(bench_file: str, request: "Request", model: Path | None) -> "Outcome":
    from hil.experiments.notch_design import design
    from hil.master.bench import load_bench
    from hil.master.identified import load_identified

    identified = None if model is None else load_identified(model)
    with _bar(f"axis {request.axis}") as progress:
        return design(load_bench(bench_file), request, identified, progress)


@contextmanager
def _bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on standard error, where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn(),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _keep(outcome: "Outcome", out: Path, set_file: Path | None, design_file: Path | None, *, as_json: bool) -> None:
    """Write what came out, say it, and leave with the right status."""
    from hil.errors import NotPossibleError
    from hil.experiments.notch_design import designed_axis, document, parameter_set
    from hil.experiments.runner import write_json
    from hil.master.designed import notch_table, snippet, update_designs
    from hil.report.design_page import write_design_report

    number, found = outcome.request.axis, outcome.best
    out.mkdir(parents=True, exist_ok=True)
    whole = document(outcome)
    write_json(out / "design.json", whole)
    report = write_design_report(outcome, out / "design.html")
    say: Callable[[str], None] = _say if as_json else typer.echo
    _summary(outcome, say)
    if as_json:
        typer.echo(json.dumps(whole, ensure_ascii=False, allow_nan=False))
    if outcome.failure is None:
        if not outcome.request.is_given:
            say("\n".join(["", *snippet(number, tuple(notch_table(one) for one in found.notches)), ""]))
            path = design_file or out / "design.toml"
            update_designs(path, outcome.bench.name, number, designed_axis(outcome))
            _say(f"design file: {path}")
        path = set_file or out / f"notch-axis{number}.toml"
        try:
            parameter_set(outcome.bench, number, found, outcome.f_al_hz).save(path, force=set_file is None)
            _say(f"parameter set: {path} (drive-profiles upload)")
        except NotPossibleError as error:
            if set_file is not None:
                raise
            _say(f"no parameter set: {error}")
    _say(f"report: {report}")
    if outcome.failure is not None:
        _say(str(outcome.failure))
        raise typer.Exit(outcome.failure.exit_code)


def _summary(outcome: "Outcome", say: Callable[[str], None]) -> None:
    """Filters, margins and predicted peaks, as text."""
    members = len(outcome.problem.members)
    say(
        f"axis {outcome.request.axis}, plant from {outcome.source}, loop every {1e6 * outcome.problem.period_s:g} µs with "
        f"{outcome.problem.delay_samples} samples of delay, {members} plants, {outcome.seconds:.1f} s"
    )
    say(f"{'filters':<12}{'k':<4}{'peak mm':<10}{'falling':<10}{'worst':<10}{'M_s':<7}{'phase °':<9}{'gain dB':<9}(5)")
    for name, found in (("none", outcome.none), ("given", outcome.given), ("designed", outcome.designed)):
        if found is None:
            continue
        worst = {check.name: check.value for check in found.checks}
        for row in found.peaks:
            line = worst[f"|G_al| on the line over constraint (5), k = {row.order},"]
            say(
                f"{name:<12}{row.order:<4}{row.rising_mm:<10.4f}{row.falling_mm:<10.4f}{row.worst_mm:<10.4f}{worst['M_s']:<7.3f}"
                f"{worst['phase margin']:<9.2f}{worst['gain margin']:<9.2f}{line:.3f}"
            )
