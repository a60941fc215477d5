"""Commands that realise a notch and gains, and write the families' pages."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import FILE_EPILOG, REALISE_EPILOG, exit_on_error, finite, print_json, table
from drive_profiles.cli.options import JsonOption, ProfileName

if TYPE_CHECKING:
    from drive_profiles.family.capability import LoopFacts, NotchFacts
    from drive_profiles.family.profile import Profile
    from drive_profiles.realisation import NotRealisableError, Realisation


SetOutOption = Annotated[
    Path | None, typer.Option("--out", help="Write the values as a parameter set, for `drive-profiles upload`.")
]


@command(epilog=REALISE_EPILOG)
def realise(
    name: ProfileName,
    *,
    order: Annotated[int, typer.Option(min=1, help="Harmonic order k of the transmission error.")] = 2,
    speed_rps: Annotated[float, typer.Option(help="Motor speed f_m, rev/s.")],
    offset_hz: Annotated[float, typer.Option(help="Offset of the poles above the zeros.")] = 0.5,
    zeta_rn: Annotated[float, typer.Option(help="Damping of the zeros.")] = 0.028,
    zeta_rd: Annotated[float, typer.Option(help="Damping of the poles.")] = 0.1,
    section: Annotated[int, typer.Option(min=1, help="Number of the drive's filter.")] = 1,
    period_us: Annotated[float | None, typer.Option(help="Period of the drive's filter, if the profile states none.")] = None,
    approximate: Annotated[bool, typer.Option("--approximate", help="Accept the nearest notch that the drive can hold.")] = False,
    out: SetOutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the notch that a drive would hold at one speed.

    The deviations from the target are shown, too.

    Example: drive-profiles realise harmonic_drive_yukondrive --speed-rps 5.92 --period-us 125
    """
    from drive_profiles.family.profile import Profile
    from drive_profiles.realisation import NotchTarget, NotRealisableError
    from drive_profiles.realisation import realise as realised

    with exit_on_error():
        profile = Profile.load(name)
    for value, option in ((speed_rps, "--speed-rps"), (period_us, "--period-us")):
        if value is not None and not value > 0.0:
            raise typer.BadParameter(f"{value:g} must be positive", param_hint=option)
    try:
        target = NotchTarget.at_speed(order, speed_rps, offset_hz, zeta_rn, zeta_rd)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    period_s = None if period_us is None else period_us * 1e-6
    try:
        realisation = realised(profile, target, section=section - 1, period_s=period_s, allow_approximate=approximate)
    except NotRealisableError as error:
        _refuse(error, as_json=as_json)
    _save(profile, realisation.values, out, profile.notch)
    if as_json:
        facts = dataclasses.asdict(realisation) | {
            "is_exact": realisation.is_exact,
            "verdict": realisation.verdict,
            "biquads": [b._asdict() for b in realisation.biquads],
        }
        print_json(finite(facts))
        return
    _show(profile, realisation)


def _show(profile: "Profile", realisation: "Realisation") -> None:
    target, held, off = realisation.target, realisation.held, realisation.deviations
    typer.echo(f"{realisation.profile}: {realisation.verdict}, filter period {1e6 * realisation.period_s:g} µs")
    for reason in realisation.reasons:
        typer.echo(f"  {reason}")
    if realisation.verdict == "lost":
        held_db, wanted_db = (shape.gain_db(target.zero_hz) for shape in (held, target.shape))
        typer.echo(f"  the notch is lost: {held_db:.1f} dB at its frequency instead of {wanted_db:.1f} dB")
    _doubt(profile.notch)
    rows = [
        ("zeros, Hz", f"{target.zero_hz:.4f}", f"{held.zero_hz:.4f}", f"{off.zero_hz:+z.4f}"),
        ("damping of the zeros", f"{target.zeta_zero:.5f}", f"{held.zeta_zero:.5f}", f"{100 * off.zeta_zero:+z.2f} %"),
        ("poles, Hz", f"{target.pole_hz:.4f}", f"{held.pole_hz:.4f}", f"{off.pole_hz:+z.4f}"),
        ("damping of the poles", f"{target.zeta_pole:.5f}", f"{held.zeta_pole:.5f}", f"{100 * off.zeta_pole:+z.2f} %"),
        ("gain at DC", "1", f"{held.dc_gain:.6f}", f"{off.dc_gain:+z.6f}"),
        (
            "gain at the requested zeros, dB",
            *(f"{s.gain_db(target.zero_hz):.2f}" for s in (target.shape, held)),
            f"{off.depth_db:+z.2f}",
        ),
    ]
    table("", ("quantity", "wanted", "held", "off"), rows)
    values = [(n, profile.parameter(n).written_address, f"{v:.9g}") for n, v in realisation.values.items()]
    table("values", ("parameter", "object", "value"), values)


@command(epilog=REALISE_EPILOG)
def gains(
    name: ProfileName,
    *,
    position_gain: Annotated[float, typer.Option(help="K_pp, 1/s.")],
    velocity_gain: Annotated[float, typer.Option(help="K_vp, N·m·s/rad, motor side.")],
    velocity_integral_gain: Annotated[float, typer.Option(help="K_vi, N·m/rad, motor side.")],
    torque_constant: Annotated[
        float | None, typer.Option(help="Torque constant of the motor, N·m/A, for drives that work in amperes.")
    ] = None,
    out: SetOutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the loop's gains in a drive's own units.

    Example: drive-profiles gains emulated_drive --position-gain 25 --velocity-gain 0.196 --velocity-integral-gain 3.92
    """
    from drive_profiles.family.profile import Profile
    from drive_profiles.realisation import NotRealisableError, gains_for, pid_gains

    with exit_on_error():
        profile = Profile.load(name)
    try:
        values = gains_for(
            profile,
            position_gain_per_s=position_gain,
            velocity_gain_nm_s_rad=velocity_gain,
            velocity_integral_gain_nm_rad=velocity_integral_gain,
            torque_constant_nm_a=torque_constant,
        )
    except NotRealisableError as error:
        _refuse(error, as_json=as_json)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    _save(profile, values, out, profile.loop)
    pid = None
    if profile.loop is not None and profile.loop.structure == "PID":
        pid = pid_gains(position_gain, velocity_gain, velocity_integral_gain)
    if as_json:
        facts = {"profile": profile.label, "values": values, "pid": dataclasses.asdict(pid) if pid else None}
        print_json(facts)
        return
    rows = [(n, profile.parameter(n).written_address, f"{v:.9g}", profile.parameter(n).unit) for n, v in values.items()]
    table("", ("parameter", "object", "value", "unit"), rows)
    _doubt(profile.loop)
    if pid is not None:
        typer.echo(f"A PID on the error equals the P-PI only behind a reference low-pass of {1e3 * pid.reference_lag_s:g} ms.")


def _save(profile: "Profile", values: Mapping[str, float], out: Path | None, fact: "NotchFacts | LoopFacts | None") -> None:
    """Save the values as a parameter set if --out is given."""
    if out is None:
        return
    from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet

    identity = profile.identity
    header = Header(profile=profile.label, vendor_id=identity.vendor_id, product_code=None, unverified=_why_unverified(fact))
    items = {name: Item(value=value, unit=profile.parameter(name).unit) for name, value in values.items()}
    with exit_on_error():
        ParameterSet(header=header, tuning=items).save(out)
    typer.echo(f"{len(items)} values in {out}", err=True)


@command(epilog=FILE_EPILOG)
def pages(*, out: Annotated[Path, typer.Option(metavar="DIRECTORY", help="Folder for the pages.")] = Path("docs/drives")) -> None:
    """Write the documentation's pages: one per profile, and their index.

    Example: drive-profiles pages --out docs/drives
    """
    from drive_profiles.family.profile import Profile, available
    from drive_profiles.files.safefile import write_atomically
    from drive_profiles.pages import written

    with exit_on_error():
        files = written([Profile.load(name) for name in available()])
        for name, text in files.items():
            write_atomically(out / name, text.encode(), force=True)
    typer.echo(f"{len(files)} pages in {out}")


def _doubt(fact: "NotchFacts | LoopFacts | None") -> None:
    if why := _why_unverified(fact):
        typer.echo(f"  unverified: {why}")


def _why_unverified(fact: "NotchFacts | LoopFacts | None") -> str:
    return "" if fact is None or fact.is_verified else " ".join((fact.note or fact.source).split())


def _refuse(error: "NotRealisableError", *, as_json: bool) -> NoReturn:
    if as_json:
        print_json({"profile": error.profile, "reasons": error.reasons})
    else:
        option = " (--torque-constant)"
        lines = [f"  {reason}{option if 'torque constant is needed' in reason else ''}" for reason in error.reasons]
        typer.echo("\n".join([f"{error.profile}: not realisable", *lines]), err=True)
    raise typer.Exit(error.exit_code)
