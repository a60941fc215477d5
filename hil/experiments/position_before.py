"""Position of an axis before its last motion, from the log of that motion.

Every command that moves an axis writes the frames before the motion to its log first. So the log has the position, also of a
command that was killed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drive_profiles.address import parse_address
from drive_profiles.standard.cia402 import Object
from hil.bench.bench import Bench
from hil.errors import LogError, NotPossibleError
from hil.experiments.measurement import log_label
from hil.logs.opening import open_log
from hil.logs.overheard import OverheardValue, overheard
from hil.results.base import LOG_FILE

FOLDERS = ("bench-out/*", "*")
"""Folders that are searched: those that commands make, and those that `--out` names in the present folder."""


@dataclass(frozen=True)
class PositionBefore:
    """Position of an axis before a motion.

    Attributes:
        counts: Content of the drive's 6064h before the motion.
        log: Log that has it.
    """

    counts: int
    log: Path


def position_before(bench: Bench, axis: int, folder: Path = Path()) -> PositionBefore:
    """Find the position of an axis before its last motion on this bus.

    Args:
        folder: Folder in which the commands were given.

    Raises:
        NotPossibleError: No log has a motion of the axis.
    """
    interface, node = log_label(parse_address(bench.bus.address)), bench.axis[axis].node_id
    logs = {path for pattern in FOLDERS for path in folder.glob(f"{pattern}/{LOG_FILE}")}
    for log in sorted(logs, key=lambda path: path.stat().st_mtime_ns, reverse=True):
        position = next(_positions(log, interface, node), None)
        if position is not None:
            return PositionBefore(int.from_bytes(position, "little", signed=True), log)
    searched = " and ".join(f"{pattern}/{LOG_FILE}" for pattern in FOLDERS)
    raise NotPossibleError(
        f"no log of a motion of axis {axis} in {searched}, so its position before the last motion is not known; "
        "give the command in the folder of the last one, or name a position with --to"
    )


def _positions(log: Path, interface: str, node: int) -> Iterator[bytes]:
    """Yield the first position of a node, if the log has a motion of it."""
    try:
        events = overheard(open_log(log, interface=interface))
    except LogError:
        return
    values = [each for each in events if isinstance(each, OverheardValue) and each.node == node]
    if any(each.is_write and each.address == (Object.MODES_OF_OPERATION, 0) for each in values):
        yield from (each.data for each in values if each.address == (Object.POSITION_ACTUAL, 0))
