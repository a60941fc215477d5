"""hil identify ate: the transmission error of one axis, from ramps in both directions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.standard.shown import measured
from hil.cli.console import (
    ExitStatus,
    SpokenReporter,
    bench_on,
    confirm,
    epilog_of_runs,
    exit_on_error,
    exit_with,
    is_on_local_bus,
    new_directory,
    say,
    say_not_restored,
    say_page,
    write_page,
)
from hil.cli.options import (
    BenchOption,
    BusOption,
    JsonOption,
    MovedAxisOption,
    NewOutOption,
    OrdersOption,
    OverloadOption,
    YesOption,
    orders_from,
)

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.experiments.ate.on_bus import AteOutcome
    from hil.experiments.ate.request import AteRequest

ATE_EPILOG = epilog_of_runs({
    ExitStatus.DONE: "identified as well as asked",
    ExitStatus.FILE: "bad file, or limits that leave no room",
    ExitStatus.NOT_MET: "not identified, or less well than asked",
})  # fmt: skip


def mount(app: typer.Typer) -> None:
    """Add the command to `hil identify`."""
    app.command(epilog=ATE_EPILOG)(ate)


def ate(
    bench_file: BenchOption,
    axis: MovedAxisOption,
    bus: BusOption = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model file: read where it is there, and written. Left out: model.toml in the directory."),
    ] = None,
    acceleration_rps_s: Annotated[
        float | None,
        typer.Option(help="Of the first pass; later ones are slower. Left out: chosen from f_a of the model file, or 4."),
    ] = None,
    passes: Annotated[int, typer.Option(help="How many passes there may be, each forwards and back.")] = 6,
    sensorless: Annotated[
        bool, typer.Option("--sensorless", help="From motor torque and encoder only; needs J_m and J_l.")
    ] = False,
    orders: OrdersOption = "1,2,4",
    out: NewOutOption = None,
    overload: OverloadOption = False,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Identify the angular transmission error of one axis: ramps through f_m4 and f_m2, forwards and back.

    Nothing needs to be known but the bench file.

    Example: hil identify ate --bench bench.toml --axis 2 --model model.toml
    """
    with exit_on_error():
        bench = bench_on(bench_file, bus)

        from hil.bench.model import load_identified, update_file  # noqa: PLC0415
        from hil.experiments.ate.on_bus import identify_ate  # noqa: PLC0415
        from hil.experiments.ate.request import AteRequest, axis_knowledge, first_acceleration, first_end_speed  # noqa: PLC0415

        identified = load_identified(model) if model is not None and model.exists() else None
        request = AteRequest(axis, acceleration_rps_s, passes, sensorless, orders=orders_from(orders))
        knowledge = axis_knowledge(bench, axis, identified, sensorless=sensorless)
        end_rps = first_end_speed(bench, request, knowledge)
        if not yes and not is_on_local_bus(bench):
            first = first_acceleration(bench, request, knowledge)
            confirm([_motion_line(bench, request, first, end_rps)])
        where = out or new_directory(f"identify-ate-axis{axis}")
        outcome = identify_ate(bench, request, where, identified, overload=overload, reporter=SpokenReporter())
        file = model or where / "model.toml"
        if outcome.part is not None:
            update_file(file, bench.name, axis, outcome.part)
        _tell(outcome, where, file, as_json=as_json)


def _tell(outcome: "AteOutcome", where: Path, model: Path, *, as_json: bool) -> None:
    """Write the report, print the result, and leave with the exit status of a failure."""
    page = write_page(where)
    if as_json:
        typer.echo(outcome.result.dumps())
    else:
        _summary(outcome)
    if outcome.part is not None:
        say(f"model file: {model}")
    say_page(page)
    say_not_restored(outcome.not_restored)
    if outcome.failure is not None:
        raise exit_with(outcome.failure)
    if outcome.not_restored:
        raise typer.Exit(ExitStatus.SDO)
    if not outcome.result.is_within_goal:
        raise typer.Exit(ExitStatus.NOT_MET)


def _summary(outcome: "AteOutcome") -> None:
    """Print the identified numbers."""
    from hil.robot_tables import amplitude_key, phase_key  # noqa: PLC0415 - as at the top

    part, result = outcome.part, outcome.result
    fit = result.fit
    if part is None or fit is None:
        return
    errors, phases = part.standard_error, part.values.phases_deg()
    typer.echo(f"axis {result.axis}, {len(result.passes)} passes, {part.learnt_by}")
    rows: list[tuple[str, str, float | None, str]] = []
    for order, amplitude in part.values.amplitudes_arcsec().items():
        rows.append((amplitude_key(order), f"A_{order:g}", amplitude, "arcsec"))
        rows.append((phase_key(order), f"φ_{order:g}", phases[order], "°"))
    for name, symbol, value, unit in (*rows, ("arm_hz", "f_al", part.arm_hz, "Hz"), ("damping", "ζ", part.damping, "")):
        if value is not None:
            typer.echo(f"  {symbol:<6}{measured(value, errors[name])} {unit}".rstrip())
    late = "torque" if result.sensorless else "accelerometer"
    typer.echo(f"  the {late} lags the motor angle by {1e3 * fit.delay_s:.2f} ± {1e3 * fit.delay_error_s:.2f} ms")
    worst = max(fit.agreement, key=lambda each: each.sigma)
    typer.echo(f"  forwards and backwards differ by {worst.sigma:.1f} standard errors at most ({worst.name})")
    typer.echo(
        f"  the transmission error explains {100.0 * fit.explained_by_error:.1f} % of the vibration{_by_order(fit.carried)}"
    )
    for note in result.notes or ():
        typer.echo(f"  note: {note}")


def _by_order(carried: "Mapping[str, float] | None") -> str:
    """Return what each order carries of the vibration, the most first."""
    parts = sorted((carried or {}).items(), key=lambda each: -each[1])
    words = ", ".join(f"order {order} {100.0 * fraction:.0f} %" for order, fraction in parts if fraction >= 0.005)
    return f": {words}" if words else ""


def _motion_line(bench: "Bench", request: "AteRequest", acceleration_rps_s: float, end_rps: float) -> str:
    """Return the line on how the robot is moved."""
    limits = bench.axis[request.axis].limits
    return (
        f"This moves axis {request.axis} on {bench.bus.address}: at most {request.passes} passes forwards and back, to "
        f"{end_rps:.2f} rev/s at {acceleration_rps_s:g} rev/s² or slower, anywhere within {limits.position_min_rev:g} … "
        f"{limits.position_max_rev:g} motor revolutions; at most {limits.speed_rps:g} rev/s and {limits.torque_nm:g} N·m."
    )
