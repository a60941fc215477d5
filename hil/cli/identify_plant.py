"""`hil identify plant`: the plant of one axis, without prior knowledge."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, numbered
from hil.cli import console, options
from hil.cli.console import ExitStatus
from hil.cli.live import LiveCommand, MotionOptions, shown_live

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.plant.motion import PlantRequest
    from hil.results.plant import PlantResult

PLANT_EPILOG = console.epilog_of_runs({
    ExitStatus.DONE: "identified",
    ExitStatus.NOT_MET: "not identified; the message gives the reason and the remedy",
})  # fmt: skip


@command(cls=LiveCommand, epilog=PLANT_EPILOG)
def plant(
    bench_file: options.BenchOption,
    axis: options.MovedAxisOption,
    given: MotionOptions,
    bus: options.BusOption = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file for the plant. Default: model.toml in the directory.")
    ] = None,
    amplitude_nm: Annotated[
        float | None, typer.Option(help="Peak of the excitation, as a torque at the motor; default: found by a pilot run.")
    ] = None,
    low_hz: Annotated[float | None, typer.Option(help="Lower end of the band; default: found by a pilot run.")] = None,
    high_hz: Annotated[
        float | None, typer.Option(help="Upper end of the band; default: found by a pilot run, at most 0.4 of the SYNC rate.")
    ] = None,
    bias_rps: Annotated[
        float | None, typer.Option(help="Motor speed during the excitation; default: away from the gear's resonance.")
    ] = None,
    periods: Annotated[int, typer.Option(help="Least number of averaged periods.")] = 10,
    excitation: Annotated[
        Literal["auto", "torque", "reference"],
        typer.Option(help="What carries the excitation: torque (60B2h) or reference; auto: torque if the drive accepts it."),
    ] = "auto",
    shape: Annotated[Literal["multisine", "chirp"], typer.Option(help="Form of the excitation.")] = "multisine",
    no_accelerometer: Annotated[
        bool, typer.Option("--no-accelerometer", help="Leave the accelerometer out of the fit and its checks.")
    ] = False,
    posture_deg: Annotated[
        str | None,
        typer.Option(help="Joint angles of the arm, as 2=30,3=-90: it moves there first, joint by joint, and back."),
    ] = None,
) -> None:
    """Identify the plant of one axis, with standard errors.

    It finds K_g, J_m, J_l, dampings, f_a, f_r, ζ, friction and gravity. You need only the bench file.

    Example: hil identify plant --bench bench.toml --axis 2 --model model.toml
    """
    with console.exit_on_error():
        bench = console.bench_on(bench_file, bus)

        from hil.bench.model import Identified
        from hil.experiments.plant.motion import PlantRequest, axis_table
        from hil.experiments.plant.on_bus import run_identify_plant

        request = PlantRequest(
            axis, amplitude_nm, low_hz, high_hz, bias_rps, periods, excitation, shape,
            with_accelerometer=not no_accelerometer, posture_deg=_posture(posture_deg),
        )  # fmt: skip
        axis_table(bench, axis)
        if model is not None:
            Identified.check_file(model, bench.name)
        where = console.result_directory(given.out, f"identify-plant-axis{axis}", force=given.force)
        file = model or where / "model.toml"
        console.confirm_motion(bench, _motion_lines(bench, request), yes=given.yes)
        with shown_live(given.live, bench.bus.address, bench_file):
            outcome = run_identify_plant(
                bench, request, where, model=file, overload=given.overload, reporter=console.SpokenReporter()
            )
            written = None if outcome.result.model_file is None else file
            console.tell_measurement(outcome, where, lambda: _summary(outcome.result), written, as_json=given.as_json)


def _posture(text: str | None) -> dict[int, float]:
    """Joint angles of the option, by axis.

    Raises:
        typer.Exit: The text has none.
    """
    found = numbered("--posture-deg", text.split(",") if text else (), "AXIS=ANGLE")
    try:
        return {axis: float(angle) for axis, angle in found.items()}
    except ValueError:
        raise fail(f"--posture-deg {text!r}: give joint angles like 2=30,3=-90", ExitStatus.USAGE) from None


def _summary(result: "PlantResult") -> None:
    """Print verdict, tables and sources of the result's page."""
    from hil.report.pages import plant as page

    console.show_page(page.verdict(result), page.parameters(result), page.modes(result), provenance=page.provenance(result))
    console.echo_lines(f"cannot tell: {line}" for line in result.cannot_tell or ())


def _motion_lines(bench: "Bench", request: "PlantRequest") -> Iterator[str]:
    """Return the lines on how the robot is moved."""
    limits = bench.axis[request.axis].limits
    from hil.experiments.plant.bands import FASTEST_BIAS_RPS, pilot_band
    from hil.experiments.plant.motion import FAST_RPS

    band = pilot_band(request, bench.bus.sync_period_s)
    bias = FASTEST_BIAS_RPS if request.bias_rps is None else request.bias_rps
    amplitude = "found by a pilot run" if request.amplitude_nm is None else f"{request.amplitude_nm:g} N·m"
    if request.posture_deg:
        there = ", ".join(f"axis {number} to {angle:g}°" for number, angle in request.posture_deg.items())
        yield f"This brings the arm of {bench.bus.address} into a posture, joint by joint, and back: {there}. Is the way clear?"
    yield f"This moves axis {request.axis} on {bench.bus.address}:"
    yield (
        f"  back and forth within {limits.position_min_rev:g} … {limits.position_max_rev:g} motor revolutions at up to "
        f"{max(bench.approach_rps, FAST_RPS, bias):g} rev/s, excited at {band.low_hz:g} … {band.high_hz:g} Hz with an "
        f"amplitude {amplitude}; at most {limits.speed_rps:g} rev/s and {limits.torque_nm:g} N·m"
    )
