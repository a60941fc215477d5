"""Record drawn robots, or print the errors of replayed estimates.

`record` takes half a minute of a processor per robot and is resumed by the same command; `replay` takes seconds.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from drive_profiles.files.safefile import write_atomically
from hil.report.report_table import Cell, ReportTable
from plant_emulator.rehearsal.evidence.replay import HELD_OUT_FROM, REPLAYED, record, recorded_robots, replayed
from plant_emulator.rehearsal.many.reading import of_kind
from plant_emulator.rehearsal.many.seeds import seeds_of
from plant_emulator.rehearsal.many.summary import FAR_Z, QuantityStatistics, quantities
from plant_emulator.trials.rows import Row


def _seeds(text: str) -> tuple[int, ...]:
    try:
        return seeds_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def given() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(prog="python -m plant_emulator.rehearsal.evidence", description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    make = commands.add_parser("record", help="identify the robots that are missing in the folder, and keep their recordings")
    make.add_argument("folder", type=Path)
    make.add_argument("--seeds", type=_seeds, required=True, help="seeds of the robots: 7, 1-40,50")
    make.add_argument("--kind", choices=("linear", "real", "any"), required=True)
    again = commands.add_parser("replay", help="estimate from the folder's recordings, and print the errors as Markdown")
    again.add_argument("folder", type=Path)
    again.add_argument("--rows", type=Path, help="JSON file that keeps the rows for a later comparison")
    again.add_argument("--before", type=Path, help="rows of an earlier replay, which are printed in brackets")
    words = parser.parse_args()
    if words.command == "record" and max(words.seeds) >= HELD_OUT_FROM:
        make.error(f"seed {max(words.seeds)} is held out; expected seeds below {HELD_OUT_FROM}")
    if words.command == "replay" and not recorded_robots(words.folder):
        again.error(f"{words.folder} has no recorded robot; expected the folder of an earlier record")
    return words


def _main(words: argparse.Namespace) -> None:
    if words.command == "record":
        for seed, refused in record(words.seeds, words.kind, words.folder):
            sys.stderr.write(f"{words.kind} {seed}: {'; '.join(refused) or 'done'}\n")
        return
    rows = []
    for each in recorded_robots(words.folder):
        rows.append(replayed(each))
        sys.stderr.write(f"{each.folder.name}: {rows[-1]['words'] or 'done'}\n")
    before = [] if words.before is None else json.loads(words.before.read_text(encoding="utf-8"))
    if words.rows is not None:
        write_atomically(words.rows, json.dumps(rows, indent=1, ensure_ascii=False).encode(), force=True)
    sys.stdout.write(f"{errors_table(rows, before).markdown()}\n")


def errors_table(rows: Sequence[Row], before: Sequence[Row] = ()) -> ReportTable:
    """Return the statistics of every quantity, by kind of robot.

    Args:
        rows: Rows of `replay.replayed`.
        before: Rows of an earlier replay of the same recordings; each cell has its value in brackets.
    """
    cells: list[list[Cell]] = []
    groups = {}
    for kind in dict.fromkeys(str(row["kind"]) for row in rows):
        own, old = of_kind(rows, kind), {each.name: each for each in quantities(of_kind(before, kind), REPLAYED)}
        groups[len(cells)] = f"{kind}: {len(own)} robots, {sum(bool(row['words']) for row in own)} without an estimate"
        for each in quantities(own, REPLAYED):
            now, then = _cells(each), _cells(old[each.name]) if each.name in old else None
            cells.append([each.name, *(f"{a} ({b})" for a, b in zip(now, then, strict=True))] if then else [each.name, *now])
    header = ("Quantity", "Robots", "rms of z", "Mean z", f"|z| > {FAR_Z:g}", "Median σ", "Median deviation", "Largest z")
    return ReportTable("errors", "Replayed estimates and truth", header, cells, groups=groups)


def _cells(each: QuantityStatistics) -> list[str]:
    off = "–" if each.median_off is None else f"{each.median_off:.2g}"
    worst = f"{each.worst_z:+.1f}: {each.worst_seed}"
    return [str(each.count), f"{each.rms_z:.2f}", f"{each.mean_z:+.2f}", str(each.far), f"{each.median_error:.2g}", off, worst]


if __name__ == "__main__":
    _main(given())
