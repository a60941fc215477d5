"""The runs of the demo over the local bus, and one SYNC of the emulated robot."""

import tempfile
from pathlib import Path

from benchmarks.measure import agreed, apart, best_of, progress
from benchmarks.robots import robot_of
from hil.bench.bench import load_bench
from hil.can.frame import Frame
from hil.emulator import EmulatorProcess
from hil.experiments.plan import demo_experiments
from hil.experiments.runner import run_experiments
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.world import World

SYNC = Frame(0x80, b"")
STATE = ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s", "torque_nm")


def lock_step() -> list[str]:
    """Motion time over wall time of every run of the demo; above 1 is faster than life."""
    progress("runs of the demo")
    bench = load_bench("reference")
    with EmulatorProcess("reference") as emulator, tempfile.TemporaryDirectory() as out:
        bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": str(emulator.address)})})
        result = run_experiments(bench, demo_experiments(bench), Path(out)).result
    lines = ["| run | SYNC period | cycles recorded | motion s | wall s | motion / wall |", "|---|---|---|---|---|---|"]
    for run in result.runs:
        if run.order == 4:
            continue
        axis = "2, 3, 5" if run.axis is None else run.axis
        name = f"{run.experiment}, axis {axis}, {run.loop}-closed, {run.treatment}"
        motion, wall, period = run.motion_s, run.wall_s, 1e3 * run.sync_period_s
        cells = (name, f"{period:g} ms", run.cycles, f"{motion:.2f}", f"{wall:.2f}", f"{motion / wall:.1f}")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return lines


def world() -> list[str]:
    """A SYNC of the whole world (nodes and plant) over the plant alone, in one process.

    Raises:
        DisagreementError: The plant has gone another way in the world than alone.
    """
    robot = robot_of(3)
    lines = ["| SYNC period | world µs | plant and law alone µs | world / plant |", "|---|---|---|---|"]
    for period_us in (250, 1000, 2000):
        whole = World(robot.model_copy(update={"sync_period_s": 1e-6 * period_us}))
        whole.power_on()
        whole.receive(Frame(0, b"\x01\x00"))
        axes = Axes(robot)
        axes.cascade_config[:] = whole.axes.cascade_config  # gains as a drive's dictionary holds them, in single precision
        for row in range(len(axes.numbers)):
            whole.axes.open_brake(row, POSITION, period_us // 250)
            axes.open_brake(row, POSITION, period_us // 250)

        def cycles(whole: World = whole) -> None:
            for _ in range(500):
                whole.receive(SYNC)
                whole.finish_period()

        def plant(axes: Axes = axes, periods: int = period_us // 250) -> None:
            for _ in range(500):
                axes.advance(periods)

        cycle_us, plant_us = 2e3 * best_of(cycles), 2e3 * best_of(plant)
        for name in STATE:
            far = apart(whole.axes.plant_state[name], axes.plant_state[name])
            agreed(f"world, SYNC every {period_us / 1000:g} ms, {name}", far, 0.0)
        lines.append(f"| {period_us / 1000:g} ms | {cycle_us:.0f} | {plant_us:.0f} | {cycle_us / plant_us:.1f} |")
    return lines
