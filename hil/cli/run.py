"""hil run: one experiment on the robot of a bench file."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, table
from hil.cli import console, options
from hil.cli.console import ExitStatus, say
from hil.cli.live import LiveCommand, LiveOption, shown_live
from hil.counting import times

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.measurement import ClockName
    from hil.experiments.plan import Experiment
    from hil.experiments.runner import ExperimentsOutcome
    from hil.experiments.treatment import Knowledge

RUN_EPILOG = console.epilog_of_runs({
    ExitStatus.DONE: "done, and with a treatment the tip stayed within tip_mm",
    ExitStatus.NOT_MET: "the tip exceeded tip_mm, a trial refused a cancellation, or the run could not be judged",
})  # fmt: skip


@command(cls=LiveCommand, epilog=RUN_EPILOG)
def run(
    experiment: Annotated[
        Literal["constant-acceleration", "line-motion", "point-to-point"],
        typer.Argument(show_choices=False, help="constant-acceleration, line-motion or point-to-point."),
    ],
    bench_file: options.BenchOption,
    axis: Annotated[int | None, typer.Option("--axis", help="Axis that moves alone.", autocompletion=options.AXES.one)] = None,
    treatment: options.TreatmentOption = "none",
    model: Annotated[
        Path | None,
        typer.Option(help=f"Model file of hil identify, for {options.names_of('model')}; default: the bench file's plant."),
    ] = None,
    design: Annotated[Path | None, typer.Option(help=f"Design file of hil design, for {options.names_of('design')}.")] = None,
    learnt: Annotated[Path | None, typer.Option(help=f"Model file of hil learn, for {options.names_of('learnt')}.")] = None,
    repeat: Annotated[
        int, typer.Option(min=1, max=100, help="Number of runs; their mean is judged, with less sensor noise.")
    ] = 1,
    loop: options.LoopOption = "drive",
    bus: options.BusOption = None,
    out: options.NewOutOption = None,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
    without_report: Annotated[bool, typer.Option("--no-report", help="Write no page; hil report writes it later.")] = False,
    clock: Annotated[
        Literal["lock-step", "wall"] | None, typer.Option(help="Required clock of the bus; default: any (docs/realtime.md).")
    ] = None,
    overload: options.OverloadOption = False,
    reset_faults: Annotated[bool, typer.Option("--reset-faults", help="Reset drives that are in fault first.")] = False,
    live: LiveOption = None,
    yes: options.YesOption = False,
) -> None:
    """Run one experiment on the robot of a bench file.

    Example: hil run constant-acceleration --axis 2 --treatment notch --bench bench.toml
    """
    with console.exit_on_error():
        is_line = experiment == "line-motion"
        if is_line != (axis is None):
            raise fail("a line-motion takes no --axis" if is_line else f"a {experiment} run needs --axis", ExitStatus.USAGE)
        bench = console.bench_on(bench_file, bus)

        from hil.experiments.plan import Experiment
        from hil.experiments.treatment import known_from

        known_robot = known_from(bench_file, bench, model=model, design=design, learnt=learnt)

        plan = Experiment(experiment, axis, treatment, loop)
        where = console.result_directory(out, Path(plan.file_name).stem, force=force)
        console.confirm_motion(bench, console.motion_lines([(bench, plan)]), yes=yes)
        with shown_live(live, bench.bus.address, bench_file):
            status = run_and_report(
                bench, [plan], where, as_json=as_json, reset_faults=reset_faults, clock=clock, overload=overload,
                knowledge=known_robot, repeat=repeat, has_report=not without_report,
            )  # fmt: skip
        if status:
            raise typer.Exit(status)


def run_and_report(
    bench: "Bench",
    experiments: list["Experiment"],
    out: Path,
    *,
    as_json: bool,
    is_paper: bool = False,
    reset_faults: bool = False,
    clock: "ClockName | None" = None,
    overload: bool = False,
    knowledge: "Knowledge | None" = None,
    repeat: int = 1,
    has_report: bool = True,
) -> int:
    """Run experiments, write the report, and return the exit status.

    Print the result. The paper's claims are all judged if `is_paper`; without a report `hil report` writes it later.
    """
    from hil.experiments.runner import run_experiments

    is_lock_step = console.is_on_local_bus(bench) and clock != "wall"
    with console.RunProgress(len(experiments), is_live=is_lock_step) as progress:
        outcome = run_experiments(
            bench,
            experiments,
            out,
            is_paper=is_paper,
            reset_faults=reset_faults,
            clock=clock,
            overload=overload,
            knowledge=knowledge,
            repeat=repeat,
            reporter=progress,
        )
    page = None
    if has_report and outcome.result.runs:
        say("writing the report")
        page = console.write_page(out)
    if as_json:
        typer.echo(outcome.result.dumps())
    elif outcome.result.runs:
        _summary(outcome, typer.echo)
    console.say_page(page)
    if outcome.failure is not None and outcome.stopped is None:
        raise outcome.failure
    return _status(outcome)


def _status(outcome: "ExperimentsOutcome") -> int:
    """Return the exit status of runs, and print the reason."""
    console.say_not_restored(outcome.not_restored)
    if outcome.stopped is not None:
        say(str(outcome.stopped))
        return outcome.stopped.exit_code
    for remark in outcome.remarks:
        say(remark)
    for reason in dict.fromkeys(outcome.invalid):
        say(f"not judged: {reason}")
    refused_in_part = [part for trial in outcome.trials if trial.is_good for part in trial.refused]
    for part in refused_in_part:
        say(f"not cancelled: {part.words}")
    if outcome.not_restored:
        return ExitStatus.SDO
    is_judged = not outcome.unjudged and not refused_in_part
    is_met = not outcome.failed_claims and is_judged and (outcome.result.paper or not outcome.outside)
    return ExitStatus.DONE if is_met else ExitStatus.NOT_MET


def _summary(outcome: "ExperimentsOutcome", say: Callable[[str], None]) -> None:
    """Print the runs, the comparisons and the claims."""
    from hil.master.lateness import timing_lines

    bench = outcome.result.bench.file
    limit, chain = bench.specification.tip_mm, ",".join(map(str, bench.chain_axes))
    if outcome.result.emulated:
        parts = outcome.result.emulated_parts
        say("emulated robot" if parts is None else f"emulated: {', '.join(parts)}")
    rows = []
    for run in outcome.result.runs:
        axis = chain if run.axis is None else str(run.axis)
        without = "stopped" if run.invalid is None else "not judged"
        peak = without if run.tip_peak_mm is None else f"{run.tip_peak_mm:.4f}"
        order = "-" if run.order is None else str(run.order)
        verdict = "-" if run.within_spec is None else "yes" if run.within_spec else "no"
        rows.append((run.experiment, axis, run.loop, run.treatment, order, peak, verdict))
    table("", ("experiment", "axis", "loop", "treatment", "order", "tip peak mm", f"within ±{limit:g} mm"), rows)
    _say_directions(outcome, say)
    for run in {run.recording: run for run in outcome.result.runs}.values():
        for words, number in (run.bus_errors or {}).items():
            say(f"{run.recording}: on the bus: {words} ({times(number)})")
        if run.discarded_positions is not None:
            say(f"{run.recording}: {run.discarded_positions} implausible position readings were discarded")
    for timing in {run.recording: run.timing for run in outcome.result.runs if run.timing is not None}.values():
        for line in timing_lines(asdict(timing)):
            say(line)
    for trial in outcome.trials:
        for part in trial.parts:
            say(f"trial: {part.words}" + ("" if part.verdict == "accepted" else f": {part.verdict}, not cancelled"))
    for pair in outcome.result.comparisons:
        axis = f"axes {chain}" if pair.axis is None else f"axis {pair.axis}"
        tip_pct, area_pct = -pair.tip_peak_reduction_pct, -pair.spectrum_area_reduction_pct
        text = f"tip peak {tip_pct:+.1f} %, spectrum area {area_pct:+.1f} %".replace("-", "−")
        say(f"{pair.experiment}, {axis}, {pair.loop}-closed, {pair.treatment}: {text}")
    if outcome.result.paper:
        held = sum(bool(claim.holds) for claim in outcome.result.paper)
        say(f"{held} of {len(outcome.result.paper)} claims of the paper hold")
    for claim in outcome.failed_claims:
        say(f"does not hold: {claim.claim} ({claim.source}): {claim.bench} {claim.unit}, paper {claim.paper}")


def _say_directions(outcome: "ExperimentsOutcome", say: Callable[[str], None]) -> None:
    """Print the tip along x, y and z of each window."""
    for run in outcome.result.runs:
        found = {name: each.tip_peak_mm for name, each in (run.directions or {}).items() if each.tip_peak_mm is not None}
        if found:
            window = "" if run.order is None else f", order {run.order}"
            say(f"{run.recording}{window}: tip along x {found['x']:.4f}, y {found['y']:.4f}, z {found['z']:.4f} mm")
