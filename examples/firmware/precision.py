"""The law in single against double precision: how far apart the tip is over the motions of the paper.

    python examples/firmware/precision.py

The plant is that of the reference robot in double precision, with its encoders; only the law differs.
"""

import ctypes
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.analysis import band_passed, integrated_twice
from hil.bench.bench import load_bench
from hil.control.servo import LAW, ServoConfig
from hil.core import build
from hil.core.library import CORE as LAW_CORE
from plant_emulator.core import CORE
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import load_robot
from plant_emulator.studies.simulate import references

Real = NDArray[np.float64]
SYNC_S = 0.002
BAND_HZ = (5.0, 50.0)
"""Band of the vibration that the paper looks at."""
Law = Callable[[float, float], float]
"""Torque in N·m from position and motor angle in rad."""


def narrowed(kind: np.dtype[Any]) -> np.dtype[Any]:
    """Layout of a record where numbers have half the bytes."""
    if kind.names:
        return np.dtype([(name, narrowed(kind[name])) for name in kind.names])
    if kind.subdtype is not None:
        return np.dtype((narrowed(kind.subdtype[0]), kind.subdtype[1]))
    return np.dtype({"f": np.float32, "i": np.int32}[kind.kind])


def single(folder: Path) -> Any:
    """Build the law in single precision, as it is for a drive."""
    law = build.Core("law", "hil/control", "hil/control/servo.h", ("hil/control", "hil/core"))
    options = ("-DHIL_SINGLE", "-fsingle-precision-constant")
    library = ctypes.CDLL(str(build.compile_core(law, out=folder / "single.native", options=options)))
    library.servo_step.restype = ctypes.c_float
    library.servo_step.argtypes = [ctypes.c_void_p, *[ctypes.c_float] * 6]
    library.servo_start.argtypes = [ctypes.c_void_p, *[ctypes.c_float] * 3]
    library.servo_move_origin.argtypes = [ctypes.c_void_p, ctypes.c_float]
    return library


def double_law(config: ServoConfig, period_s: float) -> Law:
    """The law as the emulator runs it."""
    records = np.zeros(1, LAW)
    config.write(records[0])
    law = LAW_CORE.pointer(records, "law")
    return lambda position, angle: LAW_CORE.call.servo_step(law, period_s, config.torque_limit_nm, position, 0.0, 0.0, angle)


def single_law(library: Any, config: ServoConfig, period_s: float, turn_rad: float) -> Law:
    """The law as a drive runs it; its origin follows the motor in steps of `turn_rad`, which a count of the encoder divides.

    Args:
        library: The law in single precision.
        config: Gains and filters.
        period_s: Sampling time.
        turn_rad: Angle by which the origin moves; infinite: it stays where it is.
    """
    wide = np.zeros(1, LAW)
    config.write(wide[0])
    records = wide.astype(narrowed(LAW))
    law = records.ctypes.data_as(ctypes.c_void_p)  # it keeps the records
    origin: float | None = None

    def step(position: float, angle: float) -> float:
        nonlocal origin
        if origin is None:
            origin = 0.0 if math.isinf(turn_rad) else turn_rad * round(angle / turn_rad)
            library.servo_start(law, angle - origin, 0.0, 0.0)
        while abs(angle - origin) > turn_rad:
            by = math.copysign(turn_rad, angle - origin)
            library.servo_move_origin(law, by)
            origin += by
        at = position - origin, angle - origin
        torque: float = library.servo_step(law, period_s, config.torque_limit_nm, at[0], 0.0, 0.0, at[1])
        return torque

    return step


def tip(axis: int | None, law_of: Callable[[ServoConfig, float], Law], *, with_notch: bool) -> Real:
    """Vertical acceleration of the tip at each SYNC of a motion of the paper; shape (n,)."""
    robot, bench = load_robot("reference"), load_bench("reference")
    numbers, _, angles = references(robot, axis, SYNC_S)
    axes, period_s = Axes(robot), robot.control_period_s
    rows, periods = [axes.row(number) for number in numbers], round(SYNC_S / robot.control_period_s)
    laws, moved = [], []
    for number, row in zip(numbers, rows, strict=True):
        table = bench.axis[number]
        notches = tuple(each.notch() for each in table.notch) if with_notch else ()
        laws.append(law_of(ServoConfig(table.control.cascade(), robot.axis[number].torque_limit_nm, notches), period_s))
        axes.motion["mode"][row] = POSITION
        moved.append((CORE.pointer(axes.plant[row].copy(), "plant"), CORE.pointer(axes.plant_state[row], "plant_state")))
    counts_per_rad = [float(axes.motion["counts_per_rad"][row]) for row in rows]
    wanted = np.vstack([np.zeros((round(0.5 / SYNC_S), len(rows))), angles])
    vertical = np.zeros(len(wanted))
    for i in range(len(wanted) - 1):
        vertical[i] = axes.tip_acceleration()[2]
        for period in range(1, periods + 1):
            for column, row in enumerate(rows):
                angle = (
                    math.floor(axes.plant_state["motor_angle_rad"][row] * counts_per_rad[column] + 0.5) / counts_per_rad[column]
                )
                position = wanted[i, column] + (wanted[i + 1, column] - wanted[i, column]) * period / periods
                torque = laws[column](position, angle)
                CORE.call.plant_step(*moved[column], torque, 0, period_s, robot.plant_substeps)
    return vertical


def displacement_mm(acceleration: Real) -> Real:
    """Displacement in the band of the vibration."""
    return 1e3 * integrated_twice(band_passed(acceleration, SYNC_S, BAND_HZ), SYNC_S, BAND_HZ[0])


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        library, turn_rad = single(Path(folder)), 2.0 * math.pi
        print("motion              vibration of the tip   single − double   the same, origin not moved")  # noqa: T201
        for axis, name in ((2, "axis 2"), (3, "axis 3"), (None, "line")):
            for with_notch in (False, True):
                exact = displacement_mm(tip(axis, double_law, with_notch=with_notch))
                apart = []
                for turn in (turn_rad, math.inf):
                    near = tip(axis, lambda config, period: single_law(library, config, period, turn), with_notch=with_notch)  # noqa: B023
                    apart.append(float(np.max(np.abs(displacement_mm(near) - exact))))
                words = f"{name}, {'notch' if with_notch else 'no notch'}"
                print(f"{words:18} {np.max(np.abs(exact)):18.3f} mm {apart[0]:14.6f} mm {apart[1]:21.6f} mm")  # noqa: T201


if __name__ == "__main__":
    main()
