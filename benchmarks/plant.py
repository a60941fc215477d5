"""The closed loop of a robot's axes without any bus: ours, the same sources with loose arithmetic, plain Python, general solvers.

All follow the same line: the drives' servo law every control period, set-points every 2 ms, straight lines between them.
"""

import ctypes
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks import plant_python
from benchmarks.measure import Row, agreed, apart, differences, in_turn, progress, seconds, shown, table
from benchmarks.robots import numbers, robot_of, swing
from drive_profiles.standard.units import real32
from hil.control.cascade import Cascade
from hil.core.build import SUFFIX, BuildError, compile_core
from hil.robot_tables import Control
from plant_emulator.core import CORE
from plant_emulator.core.build import PLANT
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import Robot
from plant_emulator.studies.simulate import Simulation, simulate

try:
    import control as python_control
except ImportError:
    python_control = None  # pip install -e .[bench]

TICKS = 8
"""Control periods per set-point."""
SYNC_S = 0.002
FULL_S, SETTLE_S = 3.0, 0.5
LOOSE = ("-march=native", "-ffp-contract=fast")
"""For the C compiler: every instruction that this processor has, and products fused with sums."""
SAME_STEPS = 1e-9
"""How far the same stepping with its roundings in another order may come to lie from ours, relative to the largest values.

Rounding grows to 6e-12 in the three seconds of the motion. A constant that is wrong in its seventh
digit gives 2e-7 where it is a low-pass that nothing follows, and 6e-2 where it is in the friction: there a count turns over.
"""
TRUNCATION = 1e-4
"""The same for a solver that picks its own steps: the difference is the error of our four steps per control period.

It is 2.8e-5 with four, 1.1e-6 with eight, 1.1e-8 with 32.
"""
SOLVER = {"method": "RK45", "rtol": 1e-8, "atol": 1e-11}
Stepper = Callable[[Axes, int], None]
Real = NDArray[np.float64]
Step = Callable[[Real, Real, float], Real]
OURS, SIMULATE, PYTHON = (
    "ours, `Axes.advance`",
    "ours, `simulate` (line motion, every SYNC recorded)",
    "plain Python, floats and lists",
)
LOOSELY = f"ours, {' '.join(LOOSE)}"


def energised(count: int) -> Axes:
    """All brakes open, at home."""
    axes = Axes(robot_of(count))
    for row in range(count):
        axes.open_brake(row, POSITION, TICKS)
    return axes


def targets(axes: Axes, duration_s: float) -> Real:
    """Set-points in counts, one row per SYNC; the swing of the whole bench, from its beginning."""
    motion = swing(len(numbers(len(axes.numbers))), SYNC_S, FULL_S)
    wanted: Real = np.round(motion.motor_angle_rad * axes.motion["counts_per_rad"])
    return wanted[: round(duration_s / SYNC_S)]


def follow(axes: Axes, wanted: Real, advance: Stepper) -> None:
    """Set-point by set-point."""
    previous, target, elapsed = axes.motion["previous_counts"], axes.motion["target_counts"], axes.motion["elapsed_periods"]
    for row in wanted:
        previous[:] = target
        target[:] = row
        elapsed[:] = 0
        advance(axes, TICKS)


def compiled(flags: Sequence[str]) -> Stepper | None:
    """The core's own sources built with other options, now; None if there is no compiler."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        try:
            library = compile_core(PLANT, out=Path(folder, f"plant{SUFFIX}"), options=flags)
        except BuildError:
            return None
        function = ctypes.CDLL(str(library)).advance
    pointer, whole, real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    function.argtypes = [whole, real, whole, pointer, pointer, whole, pointer]
    function.restype = None

    bound: tuple[Axes, int, int, NDArray[np.void]] | None = None

    def advance(axes: Axes, periods: int) -> None:
        nonlocal bound
        period_s, substeps, count = axes.robot.control_period_s, axes.robot.plant_substeps, len(axes.numbers)
        if bound is None or bound[0] is not axes:
            prepared = np.zeros(count, CORE.dtype("prepared"))
            bound = axes, axes.rows.ctypes.data, prepared.ctypes.data, prepared
        function(periods, period_s, substeps, bound[1], bound[2], count, None)

    return advance


def solver_step(axes: Axes) -> Step:
    """One control period of all axes by `scipy.integrate.solve_ivp`: the torque is constant, so nothing jumps inside."""
    rates = plant_python.rates(axes)

    def step(state: Real, torque: Real, period_s: float) -> Real:
        found = solve_ivp(lambda t, x: rates(x, torque), (0.0, period_s), state, **SOLVER)
        return np.asarray(found.y[:, -1])

    return step


def control_step(axes: Axes) -> Step:
    """The same by python-control's `input_output_response`."""
    rates, count = plant_python.rates(axes), len(axes.numbers)
    system = python_control.NonlinearIOSystem(
        lambda t, x, u, params: rates(x, u), lambda t, x, u, params: x, inputs=count, outputs=4 * count, states=4 * count
    )

    def step(state: Real, torque: Real, period_s: float) -> Real:
        held = np.repeat(torque[:, np.newaxis], 2, axis=1)
        options = {"rtol": SOLVER["rtol"], "atol": SOLVER["atol"]}
        found = python_control.input_output_response(system, [0.0, period_s], held, state, solve_ivp_kwargs=options)
        return np.asarray(found.states[:, -1])

    return step


def _rate(count: int, duration_s: float, advance: Stepper) -> float:
    axes = energised(count)
    wanted = targets(axes, duration_s)
    return duration_s / seconds(lambda: follow(axes, wanted, advance))


def _general(make: Callable[[Axes], Step], duration_s: float) -> tuple[float, float]:
    """Simulated seconds per second, and how far from ours the arms end, relative to their way."""
    axes, ours = energised(3), energised(3)
    wanted = targets(axes, FULL_S)[300 : 300 + round(duration_s / SYNC_S)]
    for each in (axes, ours):
        for name in ("previous_counts", "target_counts"):
            each.motion[name] = 0.0
    wanted -= wanted[0]
    follow(ours, wanted, Axes.advance)
    step = make(axes)
    took = seconds(lambda: plant_python.follow_with(axes, wanted, step))
    way = np.abs(ours.plant_state["arm_angle_rad"] - energised(3).plant_state["arm_angle_rad"])
    return duration_s / took, apart(axes.plant_state["arm_angle_rad"] / way, ours.plant_state["arm_angle_rad"] / way)


def agreement(advance: Stepper, count: int = 3, duration_s: float = FULL_S) -> float:
    """The largest difference between ours and another over a motion: of any field that changes, relative to its largest value.

    Infinite where a field differs that stays 0 with us, NaN where the other is not a number.
    """
    ours, other = energised(count), energised(count)
    columns = _columns(ours).shape[1]
    largest, far = np.zeros(columns), np.zeros(columns)
    for row in targets(ours, duration_s):
        follow(ours, row[np.newaxis], Axes.advance)
        follow(other, row[np.newaxis], advance)
        mine = _columns(ours)
        largest = np.maximum(largest, np.where(np.isfinite(mine), np.abs(mine), 0.0).max(axis=0))
        far = np.maximum(far, differences(mine, _columns(other)).max(axis=0))
    with np.errstate(divide="ignore"):
        return float(np.max(np.divide(far, largest, out=np.zeros(columns), where=far != 0.0)))


def _columns(axes: Axes) -> Real:
    """All that a control period can change: a row per axis, a column per field."""
    count = len(axes.numbers)
    records = (axes.plant_state, axes.motion, axes.cascade_state, axes.notch_state)
    return np.hstack([structured_to_unstructured(each, dtype=np.float64).reshape(count, -1) for each in records])


def _simulation() -> Simulation:
    robot = robot_of(3)
    return simulate(robot, None, controls=_controls(robot), notches={}, sync_period_s=SYNC_S, settle_s=SETTLE_S)


def _controls(robot: Robot) -> dict[int, Control]:
    return {number: axis.control for number, axis in robot.axis.items() if axis.control is not None}


def _whole_simulation() -> float:
    begin = time.perf_counter()
    return float(_simulation().time_s[-1] + SETTLE_S) / (time.perf_counter() - begin)


def _simulation_apart() -> float:
    """How far `simulate` and the same set-points by `Axes.advance` are apart: arm angles at each SYNC, relative to their way."""
    done, axes = _simulation(), energised(3)
    for number, control in _controls(axes.robot).items():
        gains = {name: real32(value) for name, value in control.model_dump().items()}
        Cascade(**gains).write(axes.cascade_config[axes.row(number)])
    rows = [axes.row(number) for number in done.axes]
    wanted = np.zeros((round(SETTLE_S / SYNC_S), len(axes.numbers)))
    follow(axes, wanted, Axes.advance)
    arms = np.empty(done.arm_angle_rad.shape)
    for place, counts in enumerate(done.reference_counts):
        arms[place] = axes.plant_state["arm_angle_rad"][rows]
        row = np.zeros((1, len(axes.numbers)))
        row[0, rows] = counts
        follow(axes, row, Axes.advance)
    return apart(arms, done.arm_angle_rad) / float(np.ptp(done.arm_angle_rad, axis=0).max())


def plant() -> list[str]:
    """Simulated seconds per second of the closed loop of three axes, each way, and how far they agree.

    Raises:
        DisagreementError: One of them is further from ours than its bound.
    """
    progress("plant: compile, compare")
    contenders: dict[str, Callable[[], float]] = {
        OURS: partial(_rate, 3, FULL_S, Axes.advance),
        SIMULATE: _whole_simulation,
        PYTHON: lambda: 0.1 / plant_python.measure(energised(3), targets(energised(3), 0.1)),
    }
    in_python = plant_python.agreement(energised(3), energised(3), targets(energised(3), 0.1))
    far = {SIMULATE: agreed(SIMULATE, _simulation_apart(), SAME_STEPS), PYTHON: agreed(PYTHON, in_python, SAME_STEPS)}
    loose = compiled(LOOSE)
    if loose is not None:
        contenders[LOOSELY] = partial(_rate, 3, FULL_S, loose)
        far[LOOSELY] = agreed(LOOSELY, agreement(loose), SAME_STEPS)
    progress("plant: ours, loose and Python in turn")
    found = in_turn(contenders, 3)
    general = {f"scipy `solve_ivp` ({SOLVER['method']}, rtol {SOLVER['rtol']:g})": solver_step}
    if python_control is not None:
        general[f"python-control {python_control.__version__} `input_output_response`"] = control_step
    for name, make in general.items():
        progress(f"plant: {name}")
        found[name], difference = _general(make, 0.02)
        far[name] = agreed(name, difference, TRUNCATION)
    mine = found[OURS]
    rows: list[Row] = [(name, rate, mine / rate, _exponent(far.get(name))) for name, rate in found.items()]
    heads = ("three axes, drive-closed, no bus", "simulated s per s", "our speed / this", "largest relative difference from ours")
    missing = (
        [] if python_control is not None else ["", "python-control is not installed (`pip install -e .[bench]`): not measured."]
    )
    missing += [] if loose is not None else ["", "No C compiler here: the limit was not measured."]
    return [*table(heads, rows), *missing]


def _exponent(value: float | None) -> str | None:
    return None if value is None else f"{value:.1e}" if value else "0"


def growth(counts: tuple[int, ...] = (1, 3, 6, 12, 20, 30)) -> list[str]:
    """Simulated seconds per second without a bus, from one axis to thirty, beside loose arithmetic."""
    loose = compiled(LOOSE)
    rows: list[Row] = []
    for count in counts:
        progress(f"growth, no bus: {count} axes")
        ways: dict[str, Stepper] = {"ours": Axes.advance}
        if loose is not None:
            agreed(f"loose, {count} axes", agreement(loose, count, 1.0), SAME_STEPS)
            ways["loose"] = loose
        found = in_turn({name: partial(_rate, count, 1.0, way) for name, way in ways.items()}, 3)
        limit = found.get("loose")
        per_axis = 1e6 * SYNC_S / found["ours"] / count / TICKS
        rows.append((count, found["ours"], shown(per_axis), limit, None if limit is None else limit / found["ours"]))
    return table(("axes", "ours, simulated s per s", "µs per axis and control period", "loose", "loose / ours"), rows)
