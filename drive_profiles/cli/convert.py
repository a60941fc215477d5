"""``drive-profiles convert``: parameter sets to and from the formats of other tools."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the command, so that --help and completion stay quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.console import FILE_EPILOG, exit_on_error
from drive_profiles.cli.options import EdsOption, ProfileOption

if TYPE_CHECKING:
    from drive_profiles.family.catalogue import Catalogue
    from drive_profiles.parameter_set.parameters import ParameterSet
    from drive_profiles.standard.units import Scaling


def mount(app: typer.Typer) -> None:
    """Add these commands to an application."""
    app.command("convert", epilog=FILE_EPILOG)(convert)


def convert(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A parameter set (.toml), a DCF (.dcf) or a concise DCF (.cdcf, .bin).")
    ],
    out: Annotated[Path, typer.Option("--out", help="The file to write: .toml, .dcf, .cdcf or .bin.")],
    *,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    node_id: Annotated[int | None, typer.Option("--node-id", min=1, max=127, help="For $NODEID in an EDS.")] = None,
    counts_per_rev: Annotated[int | None, typer.Option(min=1, help="Of the drive's encoder, for values in rad.")] = None,
    rated_torque_nm: Annotated[float | None, typer.Option(help="6076h of the drive, for values in N·m.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Convert a parameter set to a DCF or a concise DCF (1F22h), or back.

    A DCF is made from the device's EDS, of which every other byte stays as it is. Values whose unit depends on the drive's
    encoder or rated torque need these two to become bytes.

    Example: drive-profiles convert axis2.toml --eds drive.eds --out axis2.dcf
    """
    from drive_profiles.device.target import catalogue_of
    from drive_profiles.parameter_set import formats
    from drive_profiles.parameter_set.parameters import ParameterSet

    with exit_on_error():
        code = revision = None
        if formats.is_toml(file):
            header = ParameterSet.load(file).header
            code, revision, profile = header.product_code, header.revision, profile or header.profile or None
        catalogue = catalogue_of(profile, eds, node_id, product_code=code, revision=revision)
        parameter_set = formats.read(file, catalogue, node_id)
        for line in parameter_set.header.not_read:
            typer.echo(f"left out: {line}", err=True)
        if formats.is_toml(out):
            parameter_set.save(out, force=force)
        else:
            scaling = _scaling(parameter_set, catalogue, counts_per_rev, rated_torque_nm)
            formats.write(out, parameter_set.writes(catalogue, scaling), eds, node_id=node_id, force=force)
        count = sum(1 for _ in parameter_set.items())
    typer.echo(f"{count} values in {out}")


def _scaling(wanted: ParameterSet, catalogue: Catalogue, counts_per_rev: int | None, rated_torque_nm: float | None) -> Scaling:
    """Scaling of the drive, as far as the set needs it.

    Raises:
        RefusedError: An option that the set needs is missing; the message names it.
    """
    from drive_profiles.errors import RefusedError
    from drive_profiles.standard.units import Scaling

    named = {key for _, key, item in wanted.items() if item.type is None}
    needed = {str(e.parameter.scale) for e in catalogue if e.parameter is not None and e.needs_scaling and e.name in named}
    given = {"counts": counts_per_rev, "per mille": rated_torque_nm}
    options = {"counts": "--counts-per-rev", "per mille": "--rated-torque-nm"}
    missing = [options[scale] for scale in sorted(needed) if given[scale] is None]
    if missing:
        raise RefusedError(f"values in rad or N·m depend on the drive: give {' and '.join(missing)}")
    return Scaling(counts_per_rev or 1, rated_torque_nm or 1.0)
