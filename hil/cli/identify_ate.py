"""`hil identify ate`: the transmission error of one axis."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from hil.cli import console, options
from hil.cli import identify_recording as recorded
from hil.cli.console import ExitStatus
from hil.cli.live import LiveCommand, MotionOptions, shown_live

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.ate.on_bus import AteOutcome
    from hil.experiments.ate.ramp import Ramp
    from hil.experiments.ate.request import AteRequest

ATE_EPILOG = console.epilog_of_runs({
    ExitStatus.DONE: "identified within the requested standard errors",
    ExitStatus.FILE: "bad file, or limits that leave no room for a ramp",
    ExitStatus.NOT_MET: "not identified, or with larger standard errors than requested",
})  # fmt: skip


@command(cls=LiveCommand, epilog=ATE_EPILOG)
def ate(
    axis: options.MovedAxisOption,
    words: recorded.RecordingOptions,
    given: MotionOptions,
    bench_file: options.OptionalBenchOption = None,
    bus: options.BusOption = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model file: read if it exists, and written. Default: model.toml in the directory."),
    ] = None,
    acceleration_rps_s: Annotated[
        float | None,
        typer.Option(
            help="Acceleration of the first pass; later ones are slower. Default: chosen from f_a of the model file, or 4."
        ),
    ] = None,
    passes: Annotated[int, typer.Option(help="Largest number of passes, each forwards and back.")] = 6,
    sensorless: Annotated[
        bool, typer.Option("--sensorless", help="Use motor torque and encoder only; needs J_m and J_l.")
    ] = False,
    encoder: Annotated[
        bool, typer.Option("--encoder", help="Use the axis' second encoder, on the joint, instead of the accelerometer.")
    ] = False,
    orders: options.OrdersOption = "1,2,4",
    recording: Annotated[
        list[Path] | None,
        typer.Option("--recording", metavar="FILE", help="Recording to identify from, repeatable; nothing moves."),
    ] = None,
) -> None:
    """Identify the angular transmission error of one axis from ramps.

    The ramps pass the speeds at which orders 4 and 2 meet the resonance, forwards and back. You need only the bench file.
    With --recording nothing moves: the error comes from existing files.

    Example: hil identify ate --bench bench.toml --axis 2 --model model.toml
    """
    with console.exit_on_error():
        if recording:
            if encoder:
                raise typer.BadParameter("with --recording, the columns name the encoders; leave it out", param_hint="--encoder")
            recorded.from_recordings(recording, words, axis, orders, bench_file, model, given, sensorless=sensorless)
            return
        words.refuse_without_recording()
        if bench_file is None:
            raise typer.BadParameter(
                "no bench file is given; give one, or give --recording to read a file instead of moving", param_hint="--bench"
            )
        bench = console.bench_on(bench_file, bus)

        from hil.bench.load_encoder import by_load_encoders
        from hil.bench.model import Identified, load_identified, update_file
        from hil.experiments.ate.on_bus import identify_ate
        from hil.experiments.ate.request import AteRequest, axis_knowledge, first_ramp

        if model is not None:
            Identified.check_file(model, bench.name)
        bench = by_load_encoders(bench, [axis]) if encoder else bench
        identified = load_identified(model) if model is not None and model.exists() else None
        request = AteRequest(axis, acceleration_rps_s, passes, sensorless, orders=options.orders_from(orders))
        knowledge = axis_knowledge(bench, axis, identified, sensorless=sensorless)
        ramp = first_ramp(bench, request, knowledge)
        where = console.result_directory(given.out, f"identify-ate-axis{axis}", force=given.force)
        console.confirm_motion(bench, [_motion_line(bench, request, ramp)], yes=given.yes)
        with shown_live(given.live, bench.bus.address, bench_file):
            outcome = identify_ate(bench, request, where, identified, overload=given.overload, reporter=console.SpokenReporter())
        file = model or where / "model.toml"
        if outcome.part is not None:
            update_file(file, bench.name, axis, outcome.part)
        written = None if outcome.part is None else file
        console.tell_measurement(outcome, where, lambda: _summary(outcome, where), written, as_json=given.as_json)
        if not outcome.result.is_within_goal:
            raise typer.Exit(ExitStatus.NOT_MET)


def _summary(outcome: "AteOutcome", where: Path) -> None:
    """Print the tables of the result's page, and the notes."""
    from hil.report.figures import ate as figures

    material = figures.AteMaterial(where, outcome.result)
    if material.part is None:
        return
    typer.echo(f"axis {material.axis}, {len(outcome.result.passes)} passes, {material.part.learnt_by}")
    error = figures.errors(material.axis, material.part, is_sensorless=material.is_sensorless)
    console.show(error, figures.arm(material), figures.agreement(material))
    for note in outcome.result.notes or ():
        typer.echo(f"  note: {note}")


def _motion_line(bench: "Bench", request: "AteRequest", ramp: "Ramp") -> str:
    """Return the line on how the robot is moved."""
    limits = bench.axis[request.axis].limits
    return (
        f"This moves axis {request.axis} on {bench.bus.address}: at most {request.passes} passes forwards and back, to "
        f"{ramp.end_rps:.2f} rev/s at {ramp.acceleration_rps_s:g} rev/s² or slower, anywhere within {limits.position_min_rev:g} "
        f"… {limits.position_max_rev:g} motor revolutions; at most {limits.speed_rps:g} rev/s and {limits.torque_nm:g} N·m."
    )
