"""`python -m benchmarks [group ...]`: speed, as ratios of two things measured in turn in one run, if both find the same.

Groups: master, bench, plant, node, sdo, robustness, startup, growth, memory, runs; all of them unless some are named.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks import demo_runs, plant, whole_bench
from benchmarks.arm import arm, arm_over_bus
from benchmarks.master_path import master_path
from benchmarks.measure import DisagreementError, machine, measure_once, progress
from benchmarks.memory import memory
from benchmarks.node_frames import node_frames
from benchmarks.rehearsed import rehearsed
from benchmarks.robustness import robustness
from benchmarks.sdo import sdo
from benchmarks.startup import calls, startup
from benchmarks.upload import upload

Section = tuple[str, str, Callable[[], list[str]]]
"""Title, what is to be known about it, and what gives its table."""


def groups(minutes: int) -> dict[str, list[Section]]:
    """All sections by group, in the order of the page."""
    return {
        "master": [(
            "The master's path",
            "One cycle is a SYNC, N answers of 8 bytes, the servo law and N set-points. The N nodes only echo frames, in "
            "their own process on the same core. *Ours* is `Run.follow`, in stretches as a motion passes: the exchange, the "
            "checks of every axis, its law, a row of the recording, and the frames for the log. *A cycle a call* is the same "
            "where something in Python acts in each cycle, as a cancellation that follows. *`canopen`* is the package's PDO "
            "maps and the same law on python-can's `virtual`, as threads of one process. *Bare* writes and reads the same "
            "records, packed beforehand, on the same kind of socket, without law or checks; no cycle in Python is faster on "
            "this path.",
            master_path,
        )],
        "bench": [(
            "The whole bench",
            "A run as `hil run` does it (session, guards, recording, log; without set-up and return) against the emulated "
            "robot: drives, accelerometer, physics. Every axis swings by a revolution of its motor, at 0.5 Hz.",
            whole_bench.whole_bench,
        )],
        "plant": [(
            "The closed loop without a bus",
            "The servo law runs every 250 µs, with four Runge-Kutta steps of the plant in each period; set-points come every "
            "2 ms. *Loose* is the same code, built for this processor with fused multiply-adds; *ours* has strict "
            "arithmetic. "
            f"Loose and plain Python may differ from ours by {plant.SAME_STEPS:g}, because they round in another order. "
            "The general solvers integrate each control period alone, with the law in Python in between. "
            f"They may differ from ours by {plant.TRUNCATION:g}: the truncation error of our fixed steps, mostly from friction "
            "near rest.",
            plant.plant,
        )],
        "node": [(
            "What a frame costs one node",
            "One operational drive without a bus: frames in, answers out. The physics is not counted.",
            node_frames,
        )],
        "sdo": [
            ("SDO round trips", "One client, one node, one object at a time.", sdo),
            (
                "Upload of 200 objects: snapshot, write, read back",
                "Tool and emulated node in one process; each frame takes the time of its bits.",
                upload,
            ),
        ],
        "robustness": [
            ("Robustness: a thousand robots", "`plant-emulator robustness`, one axis, no bus.", robustness),
            (
                "A robot's rehearsal",
                "`plant-emulator rehearse`: the whole path in one process, without wrong corrections; each step as a part of it.",
                rehearsed,
            ),
        ],
        "startup": [
            ("Start-up", "", startup),
            ("The core from Python", "Calls of the C libraries; each time is the median of several rounds.", calls),
        ],
        "growth": [
            ("Growth: the whole bench", "Drive-closed, SYNC every 1 ms, one process, no bit times.", whole_bench.growth),
            ("Growth: the closed loop without a bus", "", plant.growth),
            (
                "An arm: the closed loop without a bus",
                "The links of the arm couple its axes; each decoupled axis turns an inertia of its own.",
                arm,
            ),
            ("An arm over the bus", "Six axes of the reference arm, drive-closed, SYNC every 2 ms, two processes.", arm_over_bus),
        ],
        "memory": [(
            "Memory of a long run",
            "Three axes, SYNC every 1 ms, 1 Mbit/s with bit times, everything in one process, one session, runs of a minute.",
            lambda: memory(minutes),
        )],
        "runs": [
            (
                "The runs of the demo, lock-step over the local bus, two processes",
                "Wall time is that of the whole run: set-up over SDO, settling, motion, return, restoration.",
                demo_runs.lock_step,
            ),
            ("One SYNC of the emulated robot, three axes energised, in one process", "", demo_runs.world),
        ],
    }  # fmt: skip


def main() -> None:
    """Measure, print the page; `--out` also writes it to a file. Contenders that do not agree end it, without a page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("group", nargs="*", help="what to measure; all unless named")
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    parser.add_argument("--title", default="Performance", help="heading of the page")
    parser.add_argument("--hour", action="store_true", help="an hour of bus time for the memory, instead of ten minutes")
    parser.add_argument("--once", action="store_true", help="everything once, to see that it runs; the figures are worth nothing")
    arguments = parser.parse_args()
    if arguments.once:
        measure_once()
    known = groups(60 if arguments.hour else 10)
    unknown = [name for name in arguments.group if name not in known]
    if unknown:
        parser.error(f"no group {unknown[0]!r}; there are {', '.join(known)}")
    chosen = arguments.group or list(known)
    begin = time.monotonic()
    lines = [
        f"# {arguments.title}",
        "",
        "With these measurements you can judge how fast the bench is, and what limits it.",
        f"`make bench`, or `python -m benchmarks {' '.join(arguments.group) or '[group ...]'}`, makes this page.",
        NOTE,
        "",
    ]
    lines += machine()
    for name in chosen:
        for title, said, measure in known[name]:
            try:
                lines += ["", f"## {title}", "", *([said, ""] if said else []), *measure()]
            except DisagreementError as error:
                sys.exit(f"{title}: {error}")
    text = "\n".join(lines) + "\n"
    progress(f"done in {time.monotonic() - begin:.0f} s")
    sys.stdout.write(text)
    if arguments.out is not None:
        arguments.out.write_text(text, encoding="utf-8")


NOTE = (
    "Times depend on machine and load, so compare the ratios.\n"
    "Each ratio compares the medians of two programs that were measured alternately in one run.\n"
    "Both programs must give the same result, to the last bit unless a bound is stated; otherwise the benchmark ends with an "
    "error.\nThe pages are [performance](performance.md) and [growth and long runs](performance-growth.md)."
)

if __name__ == "__main__":
    main()
