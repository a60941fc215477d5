"""Record drawn robots, or print the errors of replayed estimates.

`record` takes half a minute of a processor per robot and is resumed by the same command; `replay` takes seconds.
"""

import argparse
import json
import sys
from pathlib import Path

from drive_profiles.files.safefile import write_atomically
from plant_emulator.rehearsal.evidence.recordings import record, recorded_robots
from plant_emulator.rehearsal.evidence.replay import replayed
from plant_emulator.rehearsal.evidence.table import errors_table
from plant_emulator.rehearsal.many.seeds import seeds_of


def _given() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m plant_emulator.rehearsal.evidence", description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    make = commands.add_parser("record", help="identify the robots that are missing in the folder, and keep their recordings")
    make.add_argument("folder", type=Path)
    make.add_argument("--seeds", type=seeds_of, required=True, help="seeds of the robots: 7, 1-40,50")
    make.add_argument("--kind", choices=("linear", "real", "any"), required=True)
    again = commands.add_parser("replay", help="estimate from the folder's recordings, and print the errors as Markdown")
    again.add_argument("folder", type=Path)
    again.add_argument("--rows", type=Path, help="JSON file that keeps the rows for a later comparison")
    again.add_argument("--before", type=Path, help="rows of an earlier replay, which are printed in brackets")
    return parser.parse_args()


def _main(given: argparse.Namespace) -> None:
    if given.command == "record":
        for seed, refused in record(given.seeds, given.kind, given.folder):
            sys.stderr.write(f"{given.kind} {seed}: {'; '.join(refused) or 'done'}\n")
        return
    rows = []
    for each in recorded_robots(given.folder):
        rows.append(replayed(each))
        sys.stderr.write(f"{each.folder.name}: {rows[-1]['words'] or 'done'}\n")
    before = [] if given.before is None else json.loads(given.before.read_text(encoding="utf-8"))
    if given.rows is not None:
        write_atomically(given.rows, json.dumps(rows, indent=1, ensure_ascii=False).encode(), force=True)
    sys.stdout.write(f"{errors_table(rows, before).markdown()}\n")


if __name__ == "__main__":
    _main(_given())
