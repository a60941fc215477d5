"""``drive-profiles convert``: parameter sets to and from the formats of other tools."""

# ruff: noqa: PLC0415 - canopen and pydantic are imported inside the command, so that --help and completion stay quick

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli_read import EdsOption, ProfileOption
from drive_profiles.console import reported


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
    from drive_profiles import formats
    from drive_profiles.parameters import ParameterSet
    from drive_profiles.target import catalogue_of
    from drive_profiles.units import Scaling

    with reported():
        if profile is None and formats.is_toml(file):
            profile = ParameterSet.load(file).header.profile or None
        known = catalogue_of(profile, eds, node_id)
        parameter_set = formats.read(file, known, node_id)
        for line in parameter_set.header.not_read:
            typer.echo(f"left out: {line}", err=True)
        if formats.is_toml(out):
            parameter_set.save(out, force=force)
        else:
            scaling = None
            if counts_per_rev is not None or rated_torque_nm is not None:
                scaling = Scaling(counts_per_rev or 1, rated_torque_nm or 1.0)
            formats.write(out, parameter_set.writes(known, scaling), eds, node_id=node_id, force=force)
        count = sum(1 for _ in parameter_set.items())
    typer.echo(f"{count} values in {out}")
