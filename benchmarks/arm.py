"""A coupled arm: its closed loop without any bus, beside as many axes that do not feel each other; and all of it over the bus."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.measure import Row, in_turn, progress, shown, table
from benchmarks.measure import seconds as timed
from benchmarks.plant import SYNC_S, TICKS, energised, follow, targets
from benchmarks.robots import swing
from benchmarks.whole_bench import BITRATE, Clocked, wait_for
from drive_profiles.address import LOCAL, Address
from hil.bench.bench import load_bench
from hil.can.local import LocalChannel
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import load_robot

LIKE = {1: 2, 4: 5, 6: 5}
"""Axes of the reference arm with the gains of another of the reference bench."""


def energised_arm() -> Axes:
    """The reference arm at home, all brakes open."""
    bench, axes = load_bench("reference"), Axes(load_robot("reference-arm"))
    for row, number in enumerate(axes.numbers):
        bench.axis[LIKE.get(number, number)].control.cascade().write(axes.cascade_config[row])
        axes.open_brake(row, POSITION, TICKS)
    return axes


def _rate(axes: Axes, duration_s: float) -> float:
    wanted = targets(axes, duration_s)
    if np.any(axes.motion["trip"]):
        raise RuntimeError("a drive has stopped: what was measured is no motion")
    return duration_s / timed(lambda: follow(axes, wanted, Axes.advance))


def arm(duration_s: float = 1.0) -> list[str]:
    """Simulated seconds per second of six coupled axes, and of six and three that are not."""
    progress("an arm, no bus")
    ways = {
        "three axes, decoupled": lambda: _rate(energised(3), duration_s),
        "six axes, decoupled": lambda: _rate(energised(6), duration_s),
        "six axes of the reference arm": lambda: _rate(energised_arm(), duration_s),
    }
    found = in_turn(ways, 5)
    reference = found["six axes, decoupled"]
    periods = SYNC_S / TICKS
    rows: list[Row] = [(name, rate, shown(1e6 * periods / rate), shown(rate / reference)) for name, rate in found.items()]
    return table(("", "simulated s per s", "µs per control period", "speed relative to six decoupled"), rows)


def arm_over_bus(duration_s: float = 3.0, rounds: int = 3) -> list[str]:
    """How much faster than life the six axes of the reference arm move, drive-closed, the emulator a process."""
    progress("an arm over the bus")
    bench = load_bench("reference-arm")
    period_s = bench.bus.sync_period_s
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="arm-") as folder:
        for bitrate in (None, BITRATE):
            address = Address(LOCAL, str(Path(folder) / f"{bitrate or 0}.sock"))
            bus = str(address) if bitrate is None else f"{address}@{bitrate}"
            command = [sys.executable, "-m", "plant_emulator", "serve", "--robot", "reference-arm", "--bus", bus]
            server = subprocess.Popen(command, stdout=subprocess.DEVNULL)  # noqa: S603 - our own interpreter and module
            try:
                wait_for(address, server)
                channel = LocalChannel(address)
                factor = in_turn({"run": lambda channel=channel: _faster_than_life(channel, duration_s)}, rounds)["run"]
                channel.close()
            finally:
                server.terminate()
                server.wait(10.0)
            rows.append(("without" if bitrate is None else "1 Mbit/s", factor, 1e6 * period_s / factor))
    return table(("bit times", "× real time", f"µs per cycle of {1e3 * period_s:g} ms"), rows)


def _faster_than_life(channel: LocalChannel, duration_s: float) -> float:
    """All six axes swing: motion time over wall time."""
    bench, clocked = load_bench("reference-arm").model_copy(update={"settle_s": 0.05}), Clocked()
    with Session(bench, channel, BusLog(None), clocked) as session:
        session.bring_up()
        result = session.run(swing(6, bench.bus.sync_period_s, duration_s), "none", "drive")
    if result.stopped is not None or result.missed_cycles:
        raise RuntimeError(f"{result.stopped}, {result.missed_cycles} cycles missed")
    return clocked.share * result.motion_s / (clocked.end - clocked.begin)
