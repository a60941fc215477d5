"""The closed loop of a robot's axes without any bus, four ways: ours, plain Python, general solvers, and C as the limit.

All follow the same line: the drives' servo law every control period, set-points every 2 ms, straight lines between them.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks import plant_python
from benchmarks.measure import Row, in_turn, progress, seconds, shown, table
from benchmarks.robots import numbers, robot_of, swing
from plant_emulator.axes import Axes
from plant_emulator.motion import POSITION
from plant_emulator.simulate import simulate

try:
    import control as python_control
except ImportError:
    python_control = None  # pip install -e .[bench]

TICKS = 8
"""Control periods per set-point."""
SYNC_S = 0.002
FULL_S = 3.0
SOURCE = Path(__file__).with_name("plant.c")
SOLVER = {"method": "RK45", "rtol": 1e-8, "atol": 1e-11}
Stepper = Callable[[Axes, int], None]
Step = Callable[[NDArray[np.float64], NDArray[np.float64], float], NDArray[np.float64]]


def energised(count: int) -> Axes:
    """All brakes open, at home."""
    axes = Axes(robot_of(count))
    for row in range(count):
        axes.energise(row, POSITION, TICKS)
    return axes


def targets(axes: Axes, duration_s: float) -> NDArray[np.float64]:
    """Set-points in counts, one row per SYNC; the swing of the whole bench, from its beginning."""
    motion = swing(len(numbers(len(axes.numbers))), SYNC_S, FULL_S)
    wanted: NDArray[np.float64] = np.round(motion.motor_angle_rad * axes.motion["counts_per_rad"])
    return wanted[: round(duration_s / SYNC_S)]


def follow(axes: Axes, wanted: NDArray[np.float64], advance: Stepper) -> None:
    """Set-point by set-point."""
    previous, target, tick = axes.motion["previous_counts"], axes.motion["target_counts"], axes.motion["tick"]
    for row in wanted:
        previous[:] = target
        target[:] = row
        tick[:] = 0
        advance(axes, TICKS)


def compiled_c() -> Stepper | None:
    """The same stepping in C, compiled now; None where there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        library = Path(folder) / "plant.so"
        command = [compiler, "-O3", "-march=native", "-shared", "-fPIC", str(SOURCE), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)  # noqa: S603 - the compiler of this machine on our own file
        function = ctypes.CDLL(str(library)).advance
    pointer = ctypes.c_void_p
    function.argtypes = [ctypes.c_int64, ctypes.c_int64, ctypes.c_double, ctypes.c_int64, *[pointer] * 7]
    function.restype = None
    known: dict[int, tuple[Axes, tuple[object, ...]]] = {}  # with the axes themselves: an identity may pass to others

    def advance(axes: Axes, ticks: int) -> None:
        if id(axes) not in known:
            arrays = (axes.plant, axes.plant_state, axes.motion, axes.cascade_config, axes.cascade_state)
            places = tuple(array.ctypes.data for array in (*arrays, axes.notch_config, axes.notch_state))
            known.clear()
            known[id(axes)] = axes, places
        function(len(axes.numbers), ticks, axes.robot.control_period_s, axes.robot.plant_substeps, *known[id(axes)][1])

    return advance


def solver_step(axes: Axes) -> Step:
    """One control period of all axes by `scipy.integrate.solve_ivp`: the torque is constant, so nothing jumps inside."""
    rates = plant_python.rates(axes)

    def step(state: NDArray[np.float64], torque: NDArray[np.float64], period_s: float) -> NDArray[np.float64]:
        found = solve_ivp(lambda t, x: rates(x, torque), (0.0, period_s), state, **SOLVER)
        return np.asarray(found.y[:, -1])

    return step


def control_step(axes: Axes) -> Step:
    """The same by python-control's `input_output_response`."""
    rates, count = plant_python.rates(axes), len(axes.numbers)
    system = python_control.NonlinearIOSystem(
        lambda t, x, u, params: rates(x, u), lambda t, x, u, params: x, inputs=count, outputs=4 * count, states=4 * count
    )

    def step(state: NDArray[np.float64], torque: NDArray[np.float64], period_s: float) -> NDArray[np.float64]:
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
    way = np.abs(ours.plant_state["arm_angle"] - energised(3).plant_state["arm_angle"])
    apart = np.abs(axes.plant_state["arm_angle"] - ours.plant_state["arm_angle"])
    return duration_s / took, float(np.max(apart / way))


def agreement(advance: Stepper, count: int = 3) -> float:
    """The largest difference between ours and another over the whole motion, relative to the largest value of its column."""
    ours, other = energised(count), energised(count)
    worst = 0.0
    wanted = targets(ours, FULL_S)
    largest = dict.fromkeys(("motor_angle", "motor_speed", "arm_angle", "arm_speed"), 1e-300)
    apart = dict.fromkeys(largest, 0.0)
    for row in wanted:
        follow(ours, row[np.newaxis], Axes.advance)
        follow(other, row[np.newaxis], advance)
        for name in largest:
            mine, theirs = ours.plant_state[name], other.plant_state[name]
            largest[name] = max(largest[name], float(np.abs(mine).max()))
            apart[name] = max(apart[name], float(np.abs(mine - theirs).max()))
    return max([worst, *(apart[name] / largest[name] for name in largest)])


def _whole_simulation() -> float:
    robot = robot_of(3)
    controls = {number: axis.control for number, axis in robot.axis.items() if axis.control is not None}
    begin = time.perf_counter()
    done = simulate(robot, None, controls=controls, notches={})
    return float(done.time_s[-1] + 0.5) / (time.perf_counter() - begin)


def plant() -> list[str]:
    """Simulated seconds per second of the closed loop of three axes, each way, and how far they agree."""
    progress("plant: compile C, compare")
    in_c = compiled_c()
    contenders: dict[str, Callable[[], float]] = {
        "ours, `Axes.advance`": partial(_rate, 3, FULL_S, Axes.advance),
        "ours, `simulate` (line motion, every SYNC recorded)": _whole_simulation,
        "plain Python, floats and lists": lambda: 0.1 / plant_python.measure(energised(3), targets(energised(3), 0.1)),
    }
    apart: dict[str, float] = {}
    if in_c is not None:
        contenders["C, gcc -O3"] = partial(_rate, 3, FULL_S, in_c)
        apart["C, gcc -O3"] = agreement(in_c)
    apart["plain Python, floats and lists"] = plant_python.agreement(energised(3), energised(3), targets(energised(3), 0.1))
    progress("plant: ours, Python and C in turn")
    found = in_turn(contenders, 3)
    general = {f"scipy `solve_ivp` ({SOLVER['method']}, rtol {SOLVER['rtol']:g})": solver_step}
    if python_control is not None:
        general[f"python-control {python_control.__version__} `input_output_response`"] = control_step
    for name, make in general.items():
        progress(f"plant: {name}")
        found[name], apart[name] = _general(make, 0.02)
    mine = found["ours, `Axes.advance`"]
    rows: list[Row] = [(name, rate, mine / rate, _exponent(apart.get(name))) for name, rate in found.items()]
    heads = ("three axes, drive-closed, no bus", "simulated s per s", "ours / this", "largest relative difference to ours")
    missing = (
        [] if python_control is not None else ["", "python-control is not installed (`pip install -e .[bench]`): not measured."]
    )
    missing += [] if in_c is not None else ["", "No C compiler here: the limit was not measured."]
    return [*table(heads, rows), *missing]


def _exponent(value: float | None) -> str | None:
    return None if value is None else f"{value:.1e}"


def growth(counts: tuple[int, ...] = (1, 3, 6, 12, 20, 30)) -> list[str]:
    """Simulated seconds per second without a bus, from one axis to thirty, beside C."""
    in_c = compiled_c()
    rows: list[Row] = []
    for count in counts:
        progress(f"growth, no bus: {count} axes")
        ways = {"ours": Axes.advance} | ({} if in_c is None else {"C": in_c})
        found = in_turn({name: partial(_rate, count, 1.0, way) for name, way in ways.items()}, 3)
        limit = found.get("C")
        per_axis = 1e6 * SYNC_S / found["ours"] / count / TICKS
        rows.append((count, found["ours"], shown(per_axis), limit, None if limit is None else limit / found["ours"]))
    return table(("axes", "ours, simulated s per s", "µs per axis and control period", "C", "C / ours"), rows)
