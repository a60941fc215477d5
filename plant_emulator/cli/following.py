"""plant-emulator following: tracking cancellations on drawn robots."""

import csv
from collections.abc import Iterator
from dataclasses import astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, print_json, progress, table
from plant_emulator.cli.console import EmulatorExitStatus, JsonOption, ends, exit_on_error

if TYPE_CHECKING:
    from plant_emulator.rehearsal.following.study import Outcome

FOLLOWING_EPILOG = ends(DONE="done, whatever the results", FILE="a path that cannot be written")
MOST_ROBOTS = 10_000


@command(epilog=FOLLOWING_EPILOG)
def following(
    first: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first robot.")] = 1,
    robots: Annotated[
        int, typer.Option("--robots", min=1, max=MOST_ROBOTS, help="Number of robots, one for each seed from the first on.")
    ] = 10,
    law: Annotated[
        list[str] | None, typer.Option("--law", help="observer, filtered-x LMS or repetition; repeatable; default: all.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV file for every law on every motion of every robot.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare cancellations that follow with a fixed one, on drawn robots.

    A cancellation that follows (observer, filtered-x LMS or repetition) adapts during the motion.

    Example: plant-emulator following --seed 1 --robots 100 --law observer --out following.csv
    """
    with exit_on_error():
        from drive_profiles.files.safefile import check_writable
        from plant_emulator.rehearsal.following.study import LAWS, outcomes, summary

        laws = tuple(law or LAWS)
        unknown = [name for name in laws if name not in LAWS]
        if unknown:
            raise fail(f"no law {unknown[0]!r}; expected one of {', '.join(LAWS)}", EmulatorExitStatus.USAGE)
        if out is not None and (out.is_file() or out.is_dir() or not out.exists()):  # before hours of simulation; not a device
            check_writable(out)
        found: list[Outcome] = []
        with progress("robots", robots) as step:
            for seed in range(first, first + robots):
                found += outcomes([seed], laws)
                step(1)
        if out is not None:
            with out.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow([field.name for field in fields(found[0])])
                writer.writerows(astuple(each) for each in found)
        rows = list(summary(found))
        if as_json:
            print_json([row._asdict() for row in rows])
            return
        table("", tuple(name.replace("_", " ") for name in rows[0]._fields), [tuple(_cells(row)) for row in rows])


def _cells(row: tuple[object, ...]) -> Iterator[str]:
    for cell in row:
        yield f"{cell:.4f}" if isinstance(cell, float) else "–" if cell is None else str(cell)
