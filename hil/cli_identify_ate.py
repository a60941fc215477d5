"""hil identify ate: the transmission error of one axis, from ramps in both directions."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.experiments.identify_ate import Outcome, Request
    from hil.master.bench import Bench

EXIT_INTERNAL, EXIT_USAGE, EXIT_SDO, EXIT_NOT_WITHIN, EXIT_INTERRUPTED = 1, 2, 6, 9, 130
ATE_EXIT_STATUS = (
    "Exit status: 0 identified as well as asked; 2 usage; 3 bad file, or limits that leave no room; 4 no bus; 5 no answer, wrong "
    "device, or already moving; 6 SDO abort; 8 safety stop; 9 not identified, or less well than asked; 130 interrupted, after a "
    "safe stop."
)


def ate(
    bench_file: Annotated[str, typer.Option("--bench", help="Bench file (TOML), or `reference`.")],
    axis: Annotated[int, typer.Option("--axis", help="The axis that is moved.")],
    bus: Annotated[str | None, typer.Option("--bus", help="Bus address instead of the bench file's.")] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model file: read where it is there, and written. Left out: model.toml in the directory."),
    ] = None,
    acceleration_rps_s: Annotated[float, typer.Option(help="Of the first pass; later ones are slower.")] = 4.0,
    passes: Annotated[int, typer.Option(help="How many passes there may be, each forwards and back.")] = 6,
    sensorless: Annotated[
        bool, typer.Option("--sensorless", help="From motor torque and encoder only; needs J_m and J_l.")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Directory; left out: a new one in bench-out.")] = None,
    overload: Annotated[
        bool, typer.Option("--overload", help="Run even what does not fit on the bus at its bit rate (hil plan).")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print result.json on standard output, all else on standard error.")
    ] = False,
) -> None:
    """Identify the angular transmission error of one axis: ramps through f_m4 and f_m2, forwards and back.

    Nothing needs to be known but the bench file. Example: hil identify ate --bench bench.toml --axis 2 --model model.toml
    """
    from hil.cli import exit_code_of  # noqa: PLC0415 - cli mounts this module

    try:
        _ate(bench_file, axis, bus, model, acceleration_rps_s, passes, sensorless, out, overload, yes, as_json)
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        _say("interrupted before anything moved")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except Exception as error:
        code = 3 if isinstance(error, OSError) else exit_code_of(error)
        if code == EXIT_INTERNAL:
            raise
        _say(str(error))
        raise typer.Exit(code) from None


def mount(app: typer.Typer) -> None:
    """Make it a command of `hil identify`."""
    app.command(epilog=ATE_EXIT_STATUS)(ate)


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _ate(
    bench_file: str,
    axis: int,
    bus: str | None,
    model: Path | None,
    acceleration_rps_s: float,
    passes: int,
    sensorless: bool,
    out: Path | None,
    overload: bool,
    yes: bool,
    as_json: bool,
) -> None:
    from drive_profiles.address import LOCAL, parse_address  # noqa: PLC0415
    from hil.experiments.identify_ate import Request, first_end_speed, identify_ate, what_is_known  # noqa: PLC0415
    from hil.master.bench import load_bench  # noqa: PLC0415
    from hil.master.identified import load_identified, update_file  # noqa: PLC0415
    from hil.report.page_ate import write_ate_report  # noqa: PLC0415

    bench = load_bench(bench_file)
    if bus is not None:
        parse_address(bus)
        bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": bus})})
    identified = load_identified(model) if model is not None and model.exists() else None
    request = Request(axis, acceleration_rps_s, passes, sensorless)
    known = what_is_known(bench, axis, identified, sensorless=sensorless)
    end_rps = first_end_speed(bench, request, known)
    if parse_address(bench.bus.address).interface != LOCAL and not yes:
        _confirm(bench, request, end_rps)
    where = out or _new_directory(axis)
    outcome = identify_ate(bench, request, where, identified, overload=overload, announce=_say)
    file = model or where / "model.toml"
    if outcome.part is not None:
        update_file(file, bench.name, axis, outcome.part)
    report = write_ate_report(where)
    if as_json:
        typer.echo(json.dumps(outcome.result, ensure_ascii=False))
    else:
        _summary(outcome)
    if outcome.part is not None:
        _say(f"model file: {file}")
    _say(f"report: {report}")
    _leave(outcome)


def _leave(outcome: "Outcome") -> None:
    """The right exit status, and why."""
    from hil.cli import exit_code_of  # noqa: PLC0415

    for what in outcome.not_restored:
        _say(f"not put back as it was found: {what}")
    if outcome.failure is not None:
        code = exit_code_of(outcome.failure)
        if code == EXIT_INTERNAL:
            raise outcome.failure
        _say(str(outcome.failure))
        raise typer.Exit(code)
    if outcome.not_restored:
        raise typer.Exit(EXIT_SDO)
    if not outcome.result["is_within_goal"]:
        raise typer.Exit(EXIT_NOT_WITHIN)


def _summary(outcome: "Outcome") -> None:
    """What was found, as text."""
    part, result = outcome.part, outcome.result
    if part is None:
        return
    values, errors, fit = part.values.model_dump(), part.standard_error, result["fit"]
    typer.echo(f"axis {result['axis']}, {len(result['passes'])} passes, {part.learnt_by}")
    for name, unit, form in (("a2", "arcsec", ".3f"), ("phi2", "deg", ".2f"), ("a4", "arcsec", ".3f"), ("phi4", "deg", ".2f")):
        key = f"{name}_{unit}"
        typer.echo(f"  {key:<12}{values[key]:>9{form}} ± {errors[key]:{form}}")
    typer.echo(f"  {'arm_hz':<12}{part.arm_hz:>9.3f} ± {errors['arm_hz']:.3f}")
    typer.echo(f"  {'damping':<12}{part.damping:>9.4f} ± {errors['damping']:.4f}")
    late = "torque" if result["sensorless"] else "accelerometer"
    typer.echo(f"  the {late} lags the motor angle by {1e3 * fit['delay_s']:.2f} ± {1e3 * fit['delay_error_s']:.2f} ms")
    worst = max(fit["agreement"], key=lambda each: float(each["sigma"]))
    typer.echo(f"  forwards and backwards differ by {worst['sigma']:.1f} standard errors at most ({worst['name']})")
    typer.echo(f"  the transmission error explains {100.0 * fit['explained_by_error']:.1f} % of the vibration")
    for note in result["notes"]:
        typer.echo(f"  note: {note}")


def _new_directory(axis: int) -> Path:
    """A directory of its own for every identification."""
    import datetime  # noqa: PLC0415

    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    return Path("bench-out") / f"{stamp}-identify-ate-axis{axis}"


def _confirm(bench: "Bench", request: "Request", end_rps: float) -> None:
    """A robot that is not emulated moves only when someone says so."""
    limits = bench.axis[request.axis].limits
    _say(
        f"This moves axis {request.axis} on {bench.bus.address}: at most {request.passes} passes forwards and back, to "
        f"{end_rps:.2f} rps at {request.acceleration_rps_s:g} rps/s or slower, anywhere within {limits.position_min_rev:g} … "
        f"{limits.position_max_rev:g} motor revolutions; at most {limits.speed_rps:g} rps and {limits.torque_nm:g} N·m."
    )
    if not sys.stdin.isatty():
        _say("nobody can be asked here; --yes moves it without asking")
        raise typer.Exit(EXIT_USAGE)
    if not typer.confirm("Is everyone clear of the robot, and its emergency stop in reach?", err=True):
        raise typer.Exit(EXIT_USAGE)
