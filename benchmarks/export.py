"""What `hil export` of a minute's run costs, in each format: the whole command, and how much of it the format's package alone.

python -m benchmarks.export --rounds 5
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hil.bench.bench import Bench, load_bench
from hil.experiments.motions import line_motion
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

PERIOD_S, SECONDS, RATE = 0.001, 60.0, 1_000_000
PACKAGES = {".mf4": "asammdf", ".mcap": "mcap.writer", ".parquet": "pyarrow.parquet", ".dbc": "cantools.database"}


def bench() -> Bench:
    """The reference bench with a line that takes a minute, at 1 kHz."""
    whole = load_bench("reference")
    line = whole.line_motion
    if line is None:
        raise ValueError("the reference bench has no line")
    slow = {"duration_s": SECONDS - line.dwell_s - line.tail_s}
    line = line.model_copy(update=slow)
    bus = whole.bus.model_copy(update={"sync_period_s": PERIOD_S})
    return whole.model_copy(update={"line_motion": line, "bus": bus})


def run(folder: Path) -> tuple[int, int]:
    """A minute's run of three axes, as `hil run` leaves it; rows of its recording and frames of its log."""
    setup, world = bench(), World(load_robot("reference"))
    log = BusLog(folder / "bus.log", "can0")
    with Session(setup, InProcessChannel(world, medium_for(world, RATE)), log) as session:
        session.bring_up()
        result = session.run(line_motion(setup, PERIOD_S), "none", "drive")
    log.write()
    result.recording.save(folder / "runs" / "line.csv")
    with (folder / "bus.log").open("rb") as file:
        return len(result.recording.time_s), sum(1 for _ in file)


def cost(command: list[str]) -> tuple[float, float]:
    """Wall time and processor time of a command, s."""
    before, begin_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own interpreter
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - begin_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def median(command: list[str], rounds: int) -> tuple[float, float]:
    """Medians of both over some rounds, the first of which is not counted: it finds nothing in the machine's memory."""
    cost(command)
    found = [cost(command) for _ in range(rounds)]
    return statistics.median(wall for wall, _ in found), statistics.median(used for _, used in found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--keep", type=Path, help="folder of a run that is there, or is made there")
    asked = parser.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors", flush=True)  # noqa: T201
    with tempfile.TemporaryDirectory() as temporary:
        folder = asked.keep or Path(temporary)
        if not (folder / "bus.log").exists():
            folder.mkdir(parents=True, exist_ok=True)
            rows, frames = run(folder)
            print(f"{rows} rows, {frames} frames", flush=True)  # noqa: T201
        print("| file | from | s | processor s | of it only to load the package |")  # noqa: T201
        print("|---|---|---|---|---|")  # noqa: T201
        for suffix, package in PACKAGES.items():
            _, load_s = median([sys.executable, "-c", f"import numpy, {package}"], asked.rounds)
            for source in (folder,) if suffix == ".dbc" else (folder, folder / "bus.log"):
                out = Path(temporary, f"line{suffix}")
                command = [sys.executable, "-m", "hil", "export", str(source), "--to", str(out), "--bench", "reference"]
                wall_s, used_s = median(command, asked.rounds)
                name = "bus.log" if source != folder or suffix == ".dbc" else "recording"
                print(f"| `{suffix}` | {name} | {wall_s:.2f} | {used_s:.2f} | {load_s:.2f} |", flush=True)  # noqa: T201
    print(f"load of the machine behind: {os.getloadavg()[0]:.1f}")  # noqa: T201


if __name__ == "__main__":
    main()
