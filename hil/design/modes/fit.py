"""Number of an arm's modes that the data support, and the plant.

Starts are found on a grid: with frequencies and a damping given, 1/P is linear in J_m, D_m and the effective inertias, none of
which is below 0. Then all unknowns are fitted, with one mode more as long as that lowers the misfit by more than its unknowns
would by chance (Bayesian information criterion, with the scatter that the largest model leaves).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Complex, Real
from hil.design.estimation import DIFFERENCE_STEP, SURE_SIGMAS, EstimatedMode, EstimatedParameter, inverse
from hil.design.frequency import LIKELY_DAMPING
from hil.design.modes.problem import INERTIA, ArmMode, ModalProblem, amplification
from hil.design.plant_identification import Descents, PlantEstimate, enlargement, estimate_of
from hil.design.plant_problem import AGE, DELAY, J_L, J_M, LEVER, SamplingTiming
from hil.design.plant_spectra import Spectra

MODE_GRID = 32
"""Accuracy: frequencies that are tried for a mode: a factor of 2 changes nothing of an arm of three links."""
START_OPEN = 0.05
"""Accuracy: relative error that is left open while starts are looked for: a factor of 2 changes nothing of that arm."""
DELAYS_S = (0.0, 0.002, 0.005, 0.01, 0.02)
"""Accuracy: delays of the accelerometer that are tried there: a factor of 2 changes nothing of that arm."""
FOLLOWED = 2
"""Accuracy: starts of each number of modes that are followed: 1 to 3 give the same for that arm."""
MODES_APART = 1.15
"""Accuracy: least ratio of two modes' frequencies: a factor of 2 in its logarithm changes nothing of an arm of three links, or
two."""
UNKNOWN_COST = 3.0
"""Accuracy: what an unknown more must bring, over what the information criterion asks, since scatter is not all that a model
leaves: a factor of 2 changes nothing of an arm of three links, or two."""
LEADING = 0.3
"""Measured: part of the largest tip part, or inertia, from which the lowest mode is the leading one: 0.21 leads to the same modes
of an arm of three links and one of two; 0.42 leads to another of the first, and 0.15 to another of the second."""


def fit_modes(
    data: Spectra,
    timing: SamplingTiming,
    reduction_ratio: float,
    lever_m: float,
    gravity_nm_rad: float,
    single: PlantEstimate,
    most: int = 3,
) -> PlantEstimate:
    """Fit the plant with as many modes as the data support.

    If one mode is enough, the result is the given plant.

    With several, the plant is the motor with the leading mode: the lowest that carries a good part of the tip's motion.

    Args:
        data: Spectra of the main run's periods.
        timing: Sampling times, and the law inside the drive.
        gravity_nm_rad: Slope of the gravity moment.
        single: The plant with one mode, fitted to the same data.
        most: Largest number of modes.
    """
    problem = ModalProblem(data, timing, reduction_ratio, lever_m, gravity_nm_rad)
    single_fit = _Fit.best(problem, [single.unknowns])
    starts = _starts(problem, most)
    fits = [single_fit, *(_Fit.best(problem, starts[count]) for count in range(2, most + 1))]
    scatter = max(2.0 * min(each.cost for each in fits) / fits[-1].residuals, 1e-12)
    best = min(fits, key=lambda each: 2.0 * each.cost / scatter + UNKNOWN_COST * len(each.x) * math.log(each.residuals))
    while best is not single_fit and not _are_there(best):
        best = fits[fits.index(best) - 1]
    return single if best is single_fit else _estimate(best, single)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Completed fit.

    Attributes:
        x: Its unknowns.
        jacobian: Slopes of the residuals.
        cost: Half the sum of the loss.
    """

    problem: ModalProblem
    x: Real
    jacobian: Real
    cost: float
    residuals: int

    @classmethod
    def best(cls, problem: ModalProblem, starts: Sequence[Real]) -> "_Fit":
        """Fit the unknowns from some starts."""
        fit: Any = min(Descents(problem).of(starts), key=lambda each: float(each.cost))
        return cls(problem, fit.x, np.asarray(fit.jac), float(fit.cost), len(fit.fun))

    def covariance(self) -> Real:
        """Covariance of the unknowns, enlarged by the misfit."""
        return np.asarray(inverse(self.jacobian.T @ self.jacobian) * enlargement(self.problem, self.x))


def _are_there(fit: _Fit) -> bool:
    """True if each mode is significant and no two lie together."""
    covariance, modes = fit.covariance(), fit.problem.modes(fit.x)
    spots = [J_L, *(slot + INERTIA for slot in fit.problem.slots(fit.x))]
    known = all(SURE_SIGMAS * math.sqrt(max(0.0, covariance[spot, spot])) < 1.0 for spot in spots)
    hz = sorted(mode.frequency_hz for mode in modes)
    return known and all(high > MODES_APART * low for low, high in itertools.pairwise(hz))


def _leading(modes: Sequence[ArmMode]) -> int:
    """Number of the leading mode, of modes from the lowest."""
    sizes = [abs(mode.inertia_kg_m2 if mode.tip_part is None else mode.tip_part) for mode in modes]
    return next(i for i, size in enumerate(sizes) if size >= LEADING * max(sizes))


def _starts(problem: ModalProblem, most: int) -> dict[int, list[Real]]:
    """Starts by number of modes, the likeliest first."""
    grid = np.geomspace(1.3 * problem.data.frequency_hz[0], 0.95 * problem.data.frequency_hz[-1], MODE_GRID)
    motor, tips = _motor_fit(problem, grid), _tip_fits(problem, grid)
    sets: list[tuple[int, ...]] = [(i,) for i in range(MODE_GRID)]
    found: dict[int, list[Real]] = {}
    for count in range(1, most + 1):
        tried = sorted((_left(motor, tips, each), each) for each in sets)
        kept: list[tuple[int, ...]] = []
        for _, each in tried:
            if len(kept) < FOLLOWED and all(max(abs(a - b) for a, b in zip(each, other, strict=True)) > 1 for other in kept):
                kept.append(each)
        found[count] = [_start(problem, grid, each, motor, tips) for each in kept]
        best = [each for _, each in tried[: MODE_GRID if count == 1 else 2 * MODE_GRID]]
        sets = list({tuple(sorted((*each, i))) for each in best for i in range(MODE_GRID) if i not in each})
        sets = [each for each in sets if all(grid[b] > MODES_APART * grid[a] for a, b in itertools.pairwise(each))]
    return found


@dataclass(frozen=True, eq=False)
class _Linear:
    """Linear fit with some of many columns.

    Attributes:
        columns: The columns; shape (n, columns).
        wanted: What they are to add up to; shape (n,).
        always: Number of the first columns, which are always there.
    """

    columns: Real
    wanted: Real
    always: int = 0
    delay_s: float = 0.0

    def chosen(self, each: tuple[int, ...]) -> Real:
        """Columns of some modes."""
        return self.columns[:, [*range(self.always), *(self.always + i for i in each)]]

    def positive(self, each: tuple[int, ...]) -> tuple[float, Real]:
        """Residual of a fit with some modes, and their sizes, none negative."""
        chosen = self.chosen(each)
        sizes = np.linalg.norm(chosen, axis=0)
        solved, left = scipy.optimize.nnls(chosen / sizes, self.wanted)
        return float(left), np.asarray(solved / sizes)

    def signed(self, each: tuple[int, ...]) -> tuple[float, Real]:
        """Residual of a fit with some modes, and their signed sizes."""
        chosen = self.chosen(each)
        solved = np.linalg.solve(chosen.T @ chosen, chosen.T @ self.wanted)
        return float(np.linalg.norm(self.wanted - chosen @ solved)), np.asarray(solved)


def _weighted(columns: Complex, wanted: Complex, weight: Real, always: int = 0, delay_s: float = 0.0) -> _Linear:
    """Linear fit of complex numbers.

    Shapes (lines, columns), (lines,) and (lines,).
    """
    rows, right = columns * weight[:, np.newaxis], wanted * weight
    return _Linear(np.concatenate([rows.real, rows.imag]), np.concatenate([right.real, right.imag]), always, delay_s)


def _motor_fit(problem: ModalProblem, grid: Real) -> _Linear:
    """Linear fit of 1/P."""
    data, jw = problem.data, problem.jw
    unlagged = np.array([0.0] * AGE + [0.5 * problem.timing.control_s])
    torque = problem.torque(unlagged, data.torque.mean(axis=0), np.zeros_like(problem.excitation))
    angle = data.angle.mean(axis=0)
    stiffness = np.asarray(torque / angle)
    noise = np.sqrt(problem.scatter.output) / np.maximum(np.abs(angle), 1e-300)
    columns = [jw**2, jw, *(jw**2 * amplification(float(hz), LIKELY_DAMPING, jw) / problem.ratio**2 for hz in grid)]
    return _weighted(np.stack(columns, axis=1), stiffness, 1.0 / (np.abs(stiffness) * np.hypot(noise, START_OPEN)), 2)


def _tip_fits(problem: ModalProblem, grid: Real) -> list[_Linear]:
    """Linear fits of the tip's motion, one per delay."""
    data, scatter, lines = problem.data, problem.tip_scatter, problem.tip_lines
    if data.tip is None or scatter is None:
        return []
    jw, angle = problem.jw[lines], data.angle.mean(axis=0)[lines]
    follows = np.asarray(data.tip.mean(axis=0)[lines] / angle)
    noise = np.sqrt(scatter.output[lines]) / np.maximum(np.abs(follows * angle), 1e-300)
    weight = 1.0 / (np.abs(follows) * np.hypot(noise, START_OPEN))
    rigid = problem.lever_m / problem.ratio * jw**2
    found = []
    for delay_s in DELAYS_S:
        columns = [rigid * amplification(float(hz), LIKELY_DAMPING, jw) * np.exp(-jw * delay_s) for hz in grid]
        found.append(_weighted(np.stack(columns, axis=1), follows, weight, 0, delay_s))
    return found


def _left(motor: _Linear, tips: list[_Linear], each: tuple[int, ...]) -> float:
    """Residual of motor and tip with some modes."""
    tip = min((fit.signed(each)[0] for fit in tips), default=0.0)
    return math.hypot(motor.positive(each)[0], tip)


def _start(problem: ModalProblem, grid: Real, each: tuple[int, ...], motor: _Linear, tips: list[_Linear]) -> Real:
    """Unknowns from a linear fit, the mode with most inertia first."""
    _, solved = motor.positive(each)
    whole = float(np.sum(solved[2:]))
    sizes = np.maximum(solved[2:], 0.005 * whole)
    best = min(tips, key=lambda fit: fit.signed(each)[0], default=None)
    parts = sizes / whole if best is None else best.signed(each)[1]
    lever = max(abs(float(np.sum(parts))), 0.1)
    modes = [
        ArmMode(float(s), float(grid[i]), LIKELY_DAMPING, float(p) / lever) for i, s, p in zip(each, sizes, parts, strict=True)
    ]
    start = np.array([max(float(solved[0]), 0.02 * whole / problem.ratio**2), float(solved[1])])
    x = problem.start_with(start, sorted(modes, key=lambda mode: -mode.inertia_kg_m2))
    if best is not None:
        x[LEVER], x[DELAY] = math.log(lever), max(best.delay_s, 1e-4)
    return x


def resonances_hz(motor_inertia_kg_m2: float, reduction_ratio: float, modes: list[ArmMode]) -> list[float]:
    """Peaks of the motor's response, one above each mode, in Hz.

    They are eigenfrequencies of motor and modes together.

    Args:
        motor_inertia_kg_m2: J_m.
        modes: The modes, from the lowest.
    """
    own = np.array([(2.0 * math.pi * mode.frequency_hz) ** 2 for mode in modes])
    pull = np.sqrt([mode.inertia_kg_m2 / (reduction_ratio**2 * motor_inertia_kg_m2) for mode in modes]) * np.sqrt(own)
    matrix = np.diag(own) + np.outer(pull, pull)
    return [math.sqrt(each) / (2.0 * math.pi) for each in np.linalg.eigvalsh(matrix).tolist()]


def _estimate(fit: _Fit, single: PlantEstimate) -> PlantEstimate:
    """Motor, modes and the leading one, with their errors."""
    problem, covariance = fit.problem, fit.covariance()
    order = sorted(range(len(problem.modes(fit.x))), key=lambda i: problem.modes(fit.x)[i].frequency_hz)
    lead = _leading([problem.modes(fit.x)[i] for i in order])

    def numbers(x: Real) -> Real:
        modes = [problem.modes(x)[i] for i in order]
        peaks = resonances_hz(math.exp(x[J_M]), problem.ratio, modes)
        rows = [(m.inertia_kg_m2, m.frequency_hz, m.damping, p, m.tip_part or 0.0) for m, p in zip(modes, peaks, strict=True)]
        omega = 2.0 * math.pi * modes[lead].frequency_hz
        stiffness = omega**2 * modes[lead].inertia_kg_m2
        return np.array([*itertools.chain(*rows), stiffness, 2.0 * modes[lead].damping * stiffness / omega])

    values = numbers(fit.x)
    slope = np.stack(
        [(numbers(fit.x + DIFFERENCE_STEP * unit) - values) / DIFFERENCE_STEP for unit in np.eye(len(fit.x))], axis=1
    )
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, covariance, slope), 0.0))
    cells = [EstimatedParameter(float(v), float(e)) for v, e in zip(values, errors, strict=True)]
    parts = 5 if problem.data.tip is not None else 4
    modes = tuple(EstimatedMode(*cells[5 * i : 5 * i + parts]) for i in range(len(order)))
    plant, (stiffness, damping) = estimate_of(problem, fit.x, covariance), cells[-2:]
    leading = modes[lead]
    of_lead = {
        "arm_inertia_kg_m2": leading.inertia_kg_m2,
        "gear_stiffness_nm_rad": stiffness,
        "gear_damping_nm_s_rad": damping,
        "arm_damping_nm_s_rad": EstimatedParameter(0.0, damping.value),
        "antiresonance_hz": leading.antiresonance_hz,
        "resonance_hz": leading.resonance_hz,
        "damping": leading.damping,
    }
    together = plant.values.with_others({name: (each.value, each.standard_error) for name, each in of_lead.items()})
    motor = replace(
        plant.plant,
        arm_inertia_kg_m2=leading.inertia_kg_m2.value,
        arm_damping_nm_s_rad=0.0,
        gear_stiffness_nm_rad=stiffness.value,
        gear_damping_nm_s_rad=damping.value,
    )
    parameters = {**plant.parameters, **of_lead}
    return replace(plant, plant=motor, parameters=parameters, values=together, modes=modes, unknowns=single.unknowns)
