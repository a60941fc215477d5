"""Memory of a long run: a leak of ten bytes per cycle would show."""

import os
import time
from pathlib import Path

from benchmarks.measure import Row, progress, table, turns
from benchmarks.robots import bench_of, robot_of, swing
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.timed import TimedBus
from plant_emulator.world import World

AXES, PERIOD_S, RUN_S = 3, 1e-3, 60.0
BITRATE = 1_000_000


def resident_mib() -> float | None:
    """This process' resident memory; None if /proc does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return None
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


def memory(minutes: int = 10, *, bit_times: bool = True) -> list[str]:
    """Runs of a minute on one bus and one session: resident memory and frames lost after each."""
    minutes = turns(minutes)
    world = World(robot_of(AXES, PERIOD_S))
    medium = medium_for(world, BITRATE if bit_times else None)
    channel = InProcessChannel(world, medium)
    motion = swing(AXES, PERIOD_S, RUN_S)
    rows: list[Row] = []
    missed = 0
    first: float | None = None
    with Session(bench_of(AXES, sync_period_s=PERIOD_S), channel, BusLog(None)) as session:
        session.bring_up()
        for minute in range(1, minutes + 1):
            progress(f"memory: minute {minute} of {minutes}")
            begin = time.perf_counter()
            result = session.run(motion, "none", "drive")
            if result.stopped is not None:
                raise RuntimeError(str(result.stopped))
            missed += result.missed_cycles + result.sensor_missed
            now = resident_mib()
            if minute == 2:  # the first run has filled what is kept: the record of sent frames, caches
                first = now
            grown = None if first is None or now is None else 1024.0 * (now - first)
            if minute in {1, 2} or minute % max(1, minutes // 5) == 0:
                lost, bits = _lost(medium)
                factor = RUN_S / (time.perf_counter() - begin)
                rows.append((minute, channel.syncs, now, grown, missed, lost, bits, factor))
    heads = ("minutes of bus time", "SYNCs", "resident MiB", "KiB more than after minute 2", "answers missed")
    return table((*heads, "frames refused or lost", "frames on the wire", "× real time"), rows)


def _lost(medium: object) -> tuple[int | None, int | None]:
    """Frames that the wire has refused or lost, and those that it has carried; None without bit times."""
    if not isinstance(medium, TimedBus):
        return None, None
    counts = medium.wire.statistics
    return counts.refused + counts.lost, counts.frames
