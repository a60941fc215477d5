"""hil init: a bench file from a scan of the bus."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.address import choose_bus
from drive_profiles.cli.application import command
from drive_profiles.cli.console import epilog, fail, numbered
from hil.cli.console import ExitStatus, exit_on_error, say
from hil.cli.options import AXES, BusOption

INIT_EPILOG = epilog(
    (ExitStatus.DONE, ExitStatus.USAGE, ExitStatus.FILE, ExitStatus.BUS, ExitStatus.NODE, ExitStatus.INTERRUPTED),
    {ExitStatus.FILE: "bad URDF file, or the file exists already", ExitStatus.INTERRUPTED: "interrupted"},
)


@command(epilog=INIT_EPILOG)
def init(
    out: Annotated[Path, typer.Option("--out", help="Bench file to write; it must not exist yet.")],
    bus: BusOption = None,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NODE=PROFILE",
            help="Drive profile of a node, if its identity fits several or none; repeatable.",
            autocompletion=AXES.with_profile,
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the bench; default: that of the file.")] = None,
    urdf: Annotated[Path | None, typer.Option(help="URDF file of the arm, with its lengths and levers.")] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="NAME,NAME", help="With --urdf: the joints of the drives, by ascending node-ID.")
    ] = None,
    tip_link: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="With --urdf: the link of the tip. Default: the last link, if only one ends the arm."),
    ] = None,
) -> None:
    """Write a bench file from a scan of the bus.

    The file has nodes, profiles, counts, first limits, and a SYNC period that fits. Nothing is written to any node. The
    file marks the lines that only you can fill in; until you do, no command accepts it.

    Examples:
        hil init --bus socketcan:can0@1M --out bench.toml

        hil init --profile 3=schunk_pilz_prbt/prbt --out bench.toml
    """
    named = _named(profile or [])
    with exit_on_error(moves=False):
        choice = choose_bus(bus)
        if choice is None:
            raise fail("no bus is given; give --bus, or set HIL_BUS", ExitStatus.USAGE)
        if urdf is None and (joints, tip_link) != (None, None):
            raise fail("--joints and --tip-link need a URDF file; give --urdf as well", ExitStatus.USAGE)
        if out.exists():
            raise fail(f"{out} already exists; nothing was written", ExitStatus.FILE)
        say(str(choice))

        from drive_profiles.files.safefile import check_writable, write_atomically
        from hil.commissioning.draft import ArmDrawing, draft, left_to_type
        from hil.commissioning.scan import scan_bus

        check_writable(out)
        drawing = None
        if urdf is not None:
            names = () if joints is None else tuple(each.strip() for each in joints.split(","))
            drawing = ArmDrawing(urdf, out.parent, names, tip_link)
        text = draft(name or out.stem, choice.address, scan_bus(choice.address, named), drawing)
        write_atomically(out, text.encode())
    left = left_to_type(text)
    typer.echo(f"{out}: {len(left)} lines are left for you to fill in")
    for line, key in left:
        typer.echo(f"  line {line}: {key}")
    say(f"then: hil plan --bench {out}, and hil check --bench {out} before anything else moves it")


def _named(given: list[str]) -> dict[int, str]:
    """Return profiles by node-ID, those of files by absolute path.

    A relative path in the bench file would count from its own folder.
    """
    named = numbered("--profile", given, "NODE=PROFILE")
    return {node: str(path.absolute()) if (path := Path(name)).suffix and path.exists() else name for node, name in named.items()}
