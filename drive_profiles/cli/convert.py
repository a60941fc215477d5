"""``drive-profiles convert``: parameter sets to and from the formats of other tools."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import FILE_EPILOG, exit_on_error
from drive_profiles.cli.options import EdsOption, ProfileOption
from drive_profiles.errors import RefusedError

if TYPE_CHECKING:
    from drive_profiles.family.catalogue import Catalogue
    from drive_profiles.parameter_set.parameters import ParameterSet
    from drive_profiles.standard.units import Scaling


@command(epilog=FILE_EPILOG)
def convert(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A parameter set (.toml), a DCF (.dcf) or a concise DCF (.cdcf, .bin).")
    ],
    out: Annotated[Path, typer.Option("--out", help="The file to write: .toml, .dcf, .cdcf or .bin.")],
    *,
    profile: ProfileOption = None,
    eds: EdsOption = None,
    node_id: Annotated[int | None, typer.Option("--node-id", min=1, max=127, help="Node-ID for $NODEID in an EDS.")] = None,
    counts_per_rev: Annotated[
        int | None, typer.Option(min=1, help="Counts per revolution of the drive's encoder, for values in rad.")
    ] = None,
    rated_torque_nm: Annotated[float | None, typer.Option(help="Rated torque of the drive (6076h), for values in N·m.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it exists.")] = False,
) -> None:
    """Convert a parameter set to a DCF or concise DCF, or back.

    A DCF is made from the device's EDS; every other byte stays as it is. To turn values in rad or N·m into bytes, the command
    needs the counts of the drive's encoder or its rated torque; a set that was pulled states both. Node-ID, bit rate and serial
    number go into the DCF's commissioning section; the rest of the header goes into comments there. A concise DCF is the value
    of 1F22h.

    Example: drive-profiles convert axis2.toml --eds drive.eds --out axis2.dcf
    """
    from drive_profiles.cli.sets import catalogue_for
    from drive_profiles.parameter_set import formats

    with exit_on_error():
        is_set = out.suffix.lower() == ".toml"
        if not is_set:
            formats.check_suffix(out)
        catalogue = catalogue_for(file, profile, eds, node_id)
        facts = {"counts_per_rev": counts_per_rev, "rated_torque_nm": rated_torque_nm}
        parameter_set = formats.read(file, catalogue, node_id, facts)
        header = parameter_set.header
        for line in header.not_read:
            typer.echo(f"left out: {line}", err=True)
        if is_set:
            parameter_set.save(out, force=force)
        else:
            scaling = _scaling(parameter_set, catalogue)
            has_flags = out.suffix.lower() not in formats.CONCISE  # a DCF says itself what is kept out of downloads
            for key in () if has_flags else parameter_set.skipped_by_objflags(catalogue):
                typer.echo(f"left out: {key}; the EDS excludes it from downloads (ObjFlags)", err=True)
            writes = parameter_set.writes(catalogue, scaling, flagged=has_flags)
            for each in formats.write(out, writes, eds, node_id=node_id or header.node_id, force=force, header=header):
                typer.echo(f"{each.entry}: does not fit into a DCF; kept in a comment, which other tools ignore", err=True)
        count = sum(1 for _ in parameter_set.items())
    typer.echo(f"{count} values in {out}")


def _scaling(wanted: "ParameterSet", catalogue: "Catalogue") -> "Scaling":
    """Return the scaling of the drive, from the set's header.

    Raises:
        RefusedError: The header does not state what the set needs; the message names the options that do.
    """
    named = {key for _, key, item in wanted.items() if item.type is None}
    options = {"counts": "--counts-per-rev", "per mille": "--rated-torque-nm"}
    missing = {e.scale for e in catalogue if e.scale and e.name in named and wanted.header.scaling_of(e) is None}
    if missing:
        given = " and ".join(options[scale] for scale in sorted(missing))
        raise RefusedError(f"values in rad or N·m depend on the drive: give {given}")
    return wanted.header.scaling()
