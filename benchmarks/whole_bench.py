"""The whole bench, physics at the other end: how much faster than life a run is."""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.measure import Row, agreed, apart, in_turn, progress, shown, table
from benchmarks.robots import Loop, bench_of, robot_of, swing
from drive_profiles.address import LOCAL, Address
from hil.can.channel import Channel
from hil.can.errors import BusUnavailableError
from hil.can.local import LocalChannel, connect_local
from hil.master.session import Session
from hil.recording import BusLog, Recording
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.world import SECOND, World

BITRATE = 1_000_000


@contextlib.contextmanager
def emulator(count: int, period_s: float, bitrate: int | None) -> Iterator[Address]:
    """The emulated robot of so many axes as a process, as `plant-emulator serve` runs it."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        address = Address(LOCAL, str(Path(folder) / "robot.sock"))
        command = [sys.executable, "-m", "benchmarks.emulator", address.channel, str(count), str(period_s), str(bitrate or 0)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE)  # noqa: S603 - our own interpreter and module
        try:
            wait_for(address, process)
            yield address
        finally:
            if process.stdin is not None:
                process.stdin.close()
            process.wait(10.0)


def wait_for(address: Address, process: subprocess.Popen[bytes], timeout_s: float = 60.0) -> None:
    """Wait until a process serves.

    Raises:
        RuntimeError: It has ended, or does not in time.
    """
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(BusUnavailableError):
            connect_local(address).close()
            return
        time.sleep(0.02)
    raise RuntimeError(f"nobody serves at {address}")


class Clocked:
    """Notes when a session's motion begins and ends: set-up, approach and restoration do not count."""

    def __init__(self) -> None:
        self.begin = self.end = self.share = 0.0

    def __call__(self, share: float) -> None:
        """Called by the session, at each 256th cycle and at the end."""
        if share == 0.0:
            self.begin = time.perf_counter()
        elif share < 1.0:
            self.end, self.share = time.perf_counter(), share


def forget(recording: Recording) -> None:
    """Where nobody compares."""


def run(
    channel: Channel,
    count: int,
    period_s: float,
    loop: Loop,
    duration_s: float,
    keep: Callable[[Recording], object] = forget,
) -> float:
    """One run of a session on a channel: motion time over wall time.

    Args:
        channel: Where the robot is.
        count: How many axes it has.
        period_s: SYNC period.
        loop: Where it is closed.
        duration_s: Of the motion.
        keep: Gets what was recorded.

    Raises:
        RuntimeError: It was stopped, or an answer is missing.
    """
    bench, clocked = bench_of(count, sync_period_s=period_s), Clocked()
    with Session(bench, channel, BusLog(Path(os.devnull)), clocked) as session:
        session.bring_up()
        result = session.run(swing(count, period_s, duration_s), "none", loop)
    if result.stopped is not None or result.missed_cycles or result.sensor_missed:
        raise RuntimeError(f"{count} axes: {result.stopped}, {result.missed_cycles} cycles missed")
    keep(result.recording)
    return clocked.share * result.motion_s / (clocked.end - clocked.begin)


Case = tuple[int, float, Loop, int | None, float]
"""Axes, SYNC period, where the loop is closed, bit rate, duration of the motion."""


def in_process(case: Case, keep: Callable[[Recording], object] = forget) -> Callable[[], float]:
    """A run with everything in one process, to be repeated."""
    count, period_s, loop, bitrate, duration_s = case
    world = World(robot_of(count, period_s))
    world.free_step(SECOND)  # at rest to the last digit, as a served robot is, whose time has passed since it was made
    channel = InProcessChannel(world, None if bitrate is None else medium_for(world, bitrate), is_logged=False)
    return lambda: run(channel, count, period_s, loop, duration_s, keep)


@contextlib.contextmanager
def as_processes(case: Case, keep: Callable[[Recording], object] = forget) -> Iterator[Callable[[], float]]:
    """The same over the local bus, the emulator a process."""
    count, period_s, loop, bitrate, duration_s = case
    with emulator(count, period_s, bitrate) as address:
        channel = LocalChannel(address)
        try:
            yield lambda: run(channel, count, period_s, loop, duration_s, keep)
        finally:
            channel.close()


def _recordings_apart(one: Recording, two: Recording) -> float:
    """The largest difference in any column; infinite where one has columns that the other has not."""
    if one.columns.keys() != two.columns.keys():
        return float("inf")
    return float(np.max([apart(column, two.columns[name]) for name, column in one.columns.items()]))


def whole_bench(rounds: int = 3) -> list[str]:
    """The cases that matter: the loop closed over the bus at 250 µs, and drive-closed at 1 ms with bit times and without.

    Raises:
        DisagreementError: In lock-step time is the bench's own: both ways must record the same to the last bit, and have not.
    """
    cases: list[Case] = [
        (6, 250e-6, "host", None, 0.75),
        (3, 250e-6, "host", None, 0.75),
        (3, 1e-3, "drive", None, 3.0),
        (3, 1e-3, "drive", BITRATE, 3.0),
    ]
    rows: list[Row] = []
    for case in cases:
        count, period_s, loop, bitrate, _ = case
        progress(f"bench: {count} axes, {1e3 * period_s:g} ms, {loop}-closed, {'no' if bitrate is None else bitrate} bit times")
        kept: dict[str, Recording] = {}
        with as_processes(case, partial(kept.__setitem__, "two")) as two:
            found = in_turn({"one": in_process(case, partial(kept.__setitem__, "one")), "two": two}, rounds)
        agreed(f"two processes, {count} axes, {loop}-closed, recording", _recordings_apart(kept["one"], kept["two"]), 0.0)
        cycle_us = 1e6 * period_s
        times = [value for factor in found.values() for value in (factor, cycle_us / factor)]
        rows.append((count, f"{cycle_us:g} µs", f"{loop}-closed", "without" if bitrate is None else "1 Mbit/s", *times))
    heads = ("axes", "SYNC", "loop", "bit times", "one process: × real time", "µs per cycle")
    return table((*heads, "two processes: × real time", "µs per cycle"), rows)


def growth(counts: tuple[int, ...] = (1, 3, 6, 12, 20, 30)) -> list[str]:
    """A cycle of the whole bench at 1 ms, in one process, from one axis to thirty."""
    rows: list[Row] = []
    first = 0.0
    for count in counts:
        progress(f"growth: {count} axes")
        factor = in_turn({"ours": in_process((count, 1e-3, "drive", None, 1.0))}, 3)["ours"]
        cycle_us = 1e3 / factor
        first = first or cycle_us
        rows.append((count, factor, cycle_us, f"{shown(cycle_us / first)}"))
    return table(("axes", "× real time", "µs per cycle", "relative to one axis"), rows)
