"""One robot of a rehearsal: drawn, run, and made a row."""

import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import cast, get_args

from drive_profiles.files.toml import loads
from drive_profiles.version import version_text
from hil.bench.bench import Bench
from plant_emulator.rehearsal.estimates import facts_of
from plant_emulator.rehearsal.many.rows import BROKEN, WALKED
from plant_emulator.rehearsal.path import PathOptions, run_path
from plant_emulator.rehearsal.record import MAX_WORDS
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import Kind, draw
from plant_emulator.robots.robot import Robot
from plant_emulator.trials.rows import Row, plain

BOTH = "both"
KINDS = (*get_args(Kind), BOTH)
"""Kinds of robots that can be asked for; with `both` robots of odd seeds are linear, those of even seeds real."""


_ALONE = threading.Lock()
"""One path at a time in a process."""


def kind_of(seed: int, kind: str) -> Kind:
    """Return the kind of a seed's robot.

    >>> kind_of(7, "both"), kind_of(8, "both"), kind_of(8, "any")
    ('linear', 'real', 'any')

    Raises:
        ValueError: There is no such kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: expected one of {', '.join(KINDS)}")
    if kind == BOTH:
        return "linear" if seed % 2 else "real"
    return cast("Kind", kind)


def drawn(seed: int, kind: str) -> tuple[Robot, str]:
    """Return a seed's robot and the text of its bench file."""
    robot = draw(seed, kind=kind_of(seed, kind))
    return robot, blank_bench(robot)


def facts(seed: int, kind: str) -> Row:
    """Return the facts of a seed's robot and first axis."""
    robot, text = drawn(seed, kind)
    found = facts_of(robot, loads(text, Bench, "blank bench"), min(robot.axis))
    return {name: plain(value) for name, value in ({"seed": seed, "kind": kind_of(seed, kind)} | found).items()}


def walked(head: Mapping[str, object], keep: str | None, walk: Callable[[Path], Mapping[str, object]]) -> Row:
    """Return the row of a robot's path, also of one that breaks.

    Args:
        head: The row's first cells, the seed among them.
        keep: Folder in which a folder named by the seed keeps all files of the path; None: they are deleted at its end.
        walk: Goes the path, with this folder for its files; gives the other cells.
    """
    begin, kept = time.process_time(), None if keep is None else nullcontext(f"{keep}/{head['seed']}")
    cells: dict[str, object] = {"walk": WALKED, "walk_words": ""}
    try:
        with kept or tempfile.TemporaryDirectory(prefix="rehearsal") as folder:
            cells |= walk(Path(folder))
    except Exception as error:  # noqa: BLE001 - of a thousand robots one that breaks is a row, and no end
        cells = {"walk": BROKEN, "walk_words": f"{type(error).__name__}: {error}"[:MAX_WORDS]}
    cells.setdefault("cpu_s", time.process_time() - begin)
    return {name: plain(value) for name, value in (dict(head) | cells | {"version": version_text()}).items()}


def run_seed(seed: int, kind: str, over_bus: bool, keep: str | None = None, probed_every: int = 1) -> Row:
    """Run the documented path on a seed's robot.

    Args:
        kind: One of `KINDS`.
        probed_every: Wrong corrections are tried on robots whose seed is a multiple of this; they cost as much as the path.
    """
    options = PathOptions(over_bus=over_bus, keeps_files=keep is not None, with_probes=seed % probed_every == 0)

    def walk(folder: Path) -> Mapping[str, object]:
        robot, text = drawn(seed, kind)
        return run_path(robot, loads(text, Bench, "blank bench"), folder, options).row()

    with _ALONE:
        return walked({"seed": seed, "kind": kind_of(seed, kind)}, keep, walk)
