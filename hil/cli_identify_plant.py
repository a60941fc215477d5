"""hil identify plant: inertias, stiffness, damping, friction and gravity of one axis, from no knowledge of it."""

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.experiments.plant_motion import PlantRequest
    from hil.master.bench import Bench

EXIT_INTERNAL, EXIT_USAGE, EXIT_FILE, EXIT_SDO, EXIT_INTERRUPTED = 1, 2, 3, 6, 130
PLANT_EXIT_STATUS = (
    "Exit status: 0 identified; 2 usage; 3 bad file, or a request beyond its limits; 4 no bus; 5 no answer, wrong device, or "
    "already moving; 6 SDO abort; 8 safety stop; 9 not identified, with what is wrong and what is needed; 130 interrupted, after "
    "a safe stop."
)

ROWS = (
    ("motor_inertia_kg_m2", "J_m", "kg·m²"),
    ("arm_inertia_kg_m2", "J_l", "kg·m²"),
    ("gear_stiffness_nm_rad", "K_g", "N·m/rad"),
    ("gear_damping_nm_s_rad", "D_g", "N·m·s/rad"),
    ("motor_damping_nm_s_rad", "D_m", "N·m·s/rad"),
    ("arm_damping_nm_s_rad", "D_l", "N·m·s/rad"),
    ("viscous_damping_nm_s_rad", "D_m + D_l/N²", "N·m·s/rad"),
    ("antiresonance_hz", "f_a", "Hz"),
    ("resonance_hz", "f_r", "Hz"),
    ("damping", "ζ", ""),
    ("friction_coulomb_nm", "τ_C", "N·m"),
    ("friction_viscous_nm_s_rad", "friction slope", "N·m·s/rad"),
    ("gravity_moment_nm", "m g l", "N·m"),
    ("gravity_phase_deg", "q_0", "°"),
    ("lever_ratio", "lever seen / bench file's", ""),
    ("torque_age_s", "age of the torque", "s"),
    ("accelerometer_delay_s", "accelerometer delay", "s"),
)
"""What is shown: name in result.json, symbol, unit."""


class PlantExcitation(StrEnum):
    """Where the excitation is added."""

    AUTO = "auto"
    TORQUE = "torque"
    REFERENCE = "reference"


class PlantShape(StrEnum):
    """Its form."""

    MULTISINE = "multisine"
    CHIRP = "chirp"


def plant(
    bench_file: Annotated[str, typer.Option("--bench", help="Bench file (TOML), or `reference`.")],
    axis: Annotated[int, typer.Option("--axis", help="The axis that is moved.")],
    bus: Annotated[str | None, typer.Option("--bus", help="Bus address instead of the bench file's.")] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file to put it into. Left out: model.toml in the directory.")
    ] = None,
    amplitude_nm: Annotated[
        float | None, typer.Option(help="Peak of the excitation, as a torque at the motor; left out: found by a pilot run.")
    ] = None,
    low_hz: Annotated[float, typer.Option(help="Lower end of the band.")] = 3.0,
    high_hz: Annotated[float, typer.Option(help="Upper end of the band.")] = 60.0,
    bias_rps: Annotated[float, typer.Option(help="Motor speed under the excitation, out of the friction.")] = 2.0,
    periods: Annotated[int, typer.Option(help="Periods to average over, at least.")] = 10,
    excitation: Annotated[
        PlantExcitation, typer.Option(help="Torque offset (60B2h), or reference; auto: torque where the drive takes it.")
    ] = PlantExcitation.AUTO,
    shape: Annotated[PlantShape, typer.Option(help="Form of the excitation.")] = PlantShape.MULTISINE,
    no_accelerometer: Annotated[
        bool, typer.Option("--no-accelerometer", help="Leave the accelerometer out of the fit and its checks.")
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
    """Identify the plant of one axis: K_g, J_m, J_l, dampings, f_a, f_r, ζ, friction and gravity, with standard errors.

    Nothing needs to be known but the bench file. Example: hil identify plant --bench bench.toml --axis 2 --model model.toml
    """
    from hil.cli import exit_code_of  # noqa: PLC0415 - cli mounts this module
    from hil.experiments.plant_motion import PlantRequest  # noqa: PLC0415

    request = PlantRequest(
        axis, amplitude_nm, low_hz, high_hz, bias_rps, periods, excitation.value, shape.value,
        with_accelerometer=not no_accelerometer,
    )  # fmt: skip
    try:
        _plant(bench_file, request, bus, model, out, overload=overload, yes=yes, as_json=as_json)
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        _say("interrupted before anything moved")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except Exception as error:
        code = EXIT_FILE if isinstance(error, OSError) else exit_code_of(error)
        if code == EXIT_INTERNAL:
            raise
        _say(str(error))
        raise typer.Exit(code) from None


def mount(app: typer.Typer) -> None:
    """Make it a command of `hil identify`."""
    app.command(epilog=PLANT_EXIT_STATUS)(plant)


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _plant(
    bench_file: str,
    request: "PlantRequest",
    bus: str | None,
    model: Path | None,
    out: Path | None,
    *,
    overload: bool,
    yes: bool,
    as_json: bool,
) -> None:
    from drive_profiles.address import LOCAL, parse_address  # noqa: PLC0415
    from hil.errors import HilError  # noqa: PLC0415
    from hil.experiments.identify_plant import run_identify_plant  # noqa: PLC0415
    from hil.experiments.plant_motion import axis_table  # noqa: PLC0415
    from hil.master.bench import load_bench  # noqa: PLC0415
    from hil.report.page_plant import write_plant_report  # noqa: PLC0415

    bench = load_bench(bench_file)
    if bus is not None:
        parse_address(bus)
        bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": bus})})
    axis_table(bench, request.axis)
    if parse_address(bench.bus.address).interface != LOCAL and not yes:
        _confirm(bench, request)
    where = out or _new_directory(request.axis)
    file = model or where / "model.toml"
    try:
        result = run_identify_plant(bench, request, where, model=file, overload=overload, announce=_say)
    except HilError:
        if (where / "result.json").is_file():
            _say(f"report: {write_plant_report(where)}")
        raise
    report = write_plant_report(where)
    if as_json:
        typer.echo(json.dumps(result, ensure_ascii=False))
    else:
        _summary(result)
    _say(f"model file: {file}")
    _say(f"report: {report}")
    for what in result.get("not_restored", []):
        _say(f"not put back as it was found: {what}")
    if result.get("not_restored"):
        raise typer.Exit(EXIT_SDO)


def _summary(result: dict[str, Any]) -> None:
    """What was found, as text."""
    plan, found = result["plan"], result["parameters"]
    typer.echo(
        f"axis {result['axis']}: {plan['periods']} periods of {plan['period_s']:g} s, {plan['excitation']} excitation of "
        f"{plan['amplitude_nm']:.3g} N·m at {plan['bias_rps']:.3g} rps"
    )
    for name, symbol, unit in ROWS:
        if name in found:
            value, error = found[name]["value"], found[name]["standard_error"]
            typer.echo(f"  {symbol:<26}{value:>12.5g} ± {error:<10.2g}{unit}")
    for remark in result["remarks"]:
        typer.echo(f"  note: {remark}")
    for line in result["cannot_tell"]:
        typer.echo(f"  cannot tell: {line}")


def _new_directory(axis: int) -> Path:
    """A directory of its own for every run."""
    import datetime  # noqa: PLC0415

    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    return Path("bench-out") / f"{stamp}-identify-plant-axis{axis}"


def _confirm(bench: "Bench", request: "PlantRequest") -> None:
    """A robot that is not emulated moves only when someone says so."""
    limits = bench.axis[request.axis].limits
    amplitude = "found by a pilot run" if request.amplitude_nm is None else f"{request.amplitude_nm:g} N·m"
    _say(f"This moves axis {request.axis} on {bench.bus.address}:")
    _say(
        f"  to and fro within {limits.position_min_rev:g} … {limits.position_max_rev:g} motor revolutions at up to "
        f"{max(bench.approach_rps, request.bias_rps):g} rps, shaken at {request.low_hz:g} … {request.high_hz:g} Hz with an "
        f"amplitude {amplitude}; at most {limits.speed_rps:g} rps and {limits.torque_nm:g} N·m"
    )
    if not sys.stdin.isatty():
        _say("nobody can be asked here; --yes moves it without asking")
        raise typer.Exit(EXIT_USAGE)
    if not typer.confirm("Is everyone clear of the robot, and its emergency stop in reach?", err=True):
        raise typer.Exit(EXIT_USAGE)
