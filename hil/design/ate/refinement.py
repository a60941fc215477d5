"""Refinement of the arm of a fit.

Gauss-Newton refines ω, ζ and delay, and removes the bias of the encoder's rounding.
"""

import math
from dataclasses import replace

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.ate.model import Arm, RampsModel
from hil.design.estimation import EVALUATIONS, inverse
from hil.design.frequency import MOUNTING_HZ

LARGEST_BEND = 0.17
"""Bound: a mounting that resonates at 2.4 times the arm's frequency."""
CONVERGED = 1e-6
"""Accuracy: step of each unknown, by its size, of the last round."""
LEAST_ZETA = 0.003
"""Bound: ζ below which more than the rounding has been taken out of the arm."""


def refined(model: RampsModel, start: Arm, free: int = 3, bend_row: float = 0.0) -> Arm:
    """Gauss-Newton in the first of ω, ζ, Δ and the mounting's bend, with the linear unknowns projected out.

    If the fit leaves the neighbourhood of its start, or finds no resonance (ζ ≥ 1), the start is returned: the vibration is then
    not that of a linear arm.

    The first `free` of them are free; the bend has a prior of weight `bend_row` (`bend_weight`).
    """
    step_s = 1.0 / (2.0 * math.pi * start.resonance_hz)

    def arm(scaled: Real) -> Arm:
        hz, zeta, late, bend = np.append(scaled, [0.0] * (4 - free)).tolist()
        return replace(
            start, resonance_hz=start.resonance_hz * hz, damping=start.damping * zeta,
            delay_s=start.delay_s + step_s * late, bend=start.bend + bend,
        )  # fmt: skip

    def residual(scaled: Real) -> Real:
        return np.append(model.solve(arm(scaled))[1], bend_row * arm(scaled).bend)

    def jacobian(scaled: Real) -> Real:
        sizes = np.array([start.resonance_hz, start.damping, step_s, 1.0])
        slopes = np.vstack([-projected_slopes(model, arm(scaled)) * sizes, [0.0, 0.0, 0.0, bend_row]])
        return np.asarray(slopes[:, :free])

    fit = scipy.optimize.least_squares(
        residual,
        np.array([1.0, 1.0, 0.0, 0.0][:free]),
        bounds=([0.8, 0.1, -1.0, -LARGEST_BEND][:free], [1.25, 10.0, 1.0, LARGEST_BEND][:free]),
        jac=jacobian,
        x_scale=np.array([0.01, 0.3, 0.05, 0.01][:free]),
    )
    found = arm(fit.x)
    return start if fit.active_mask[0] != 0 or found.damping >= 1.0 else found


def bend_weight(model: RampsModel, arm: Arm, left: Real) -> float:
    """Weight of the prior on the mounting's bend, 0 ± (f/110 Hz)²."""
    variance = float(np.sum(left**2)) / max(1.0, len(left) * model.independent)
    return math.sqrt(variance) / (arm.resonance_hz / MOUNTING_HZ) ** 2


def without_rounding(model: RampsModel, arm: Arm) -> Arm:
    """Remove the bias of the encoder's rounding from the arm.

    The resonance amplifies the noise of the rounding, so that least squares overestimate the damping.

    The expected power of that noise P(ω, ζ) is known, and what is minimised is the residual's power less P: steps
    −(JᵀJ)⁻¹ (Jᵀr − ∇P/2), with J the slopes of the residual r by the unknowns of the arm, the linear unknowns projected out.
    """
    found, weight = arm, bend_weight(model, arm, model.solve(arm)[1])
    sizes = np.array([arm.resonance_hz, 1.0, 1.0 / (2.0 * math.pi * arm.resonance_hz), 1.0])
    for _ in range(EVALUATIONS):
        slopes = projected_slopes(model, found)
        downhill = slopes.T @ model.solve(found)[1]
        downhill[:2] += 0.5 * np.array(_rounding_slopes(model, found))
        downhill[3] -= weight**2 * found.bend
        known = np.diag([0.0, 0.0, 0.0, weight**2])
        step = inverse(slopes.T @ slopes + known) @ downhill
        step *= min(1.0, 0.3 * found.damping / max(abs(float(step[1])), 1e-30))
        found = shifted(found, *step)
        is_lost = abs(found.resonance_hz / arm.resonance_hz - 1.0) > 0.1 or abs(found.bend) > LARGEST_BEND
        if is_lost or not LEAST_ZETA <= found.damping < 1.0:
            return arm
        if np.all(np.abs(step) < CONVERGED * sizes):
            break
    return found


def _rounding_slopes(model: RampsModel, arm: Arm) -> tuple[float, float]:
    """Slopes of the rounding's power by ω/2π and ζ."""
    d_hz, d_zeta = 1e-3 * arm.resonance_hz, 1e-2 * arm.damping
    by_hz = model.rounding_power(shifted(arm, hz=d_hz)) - model.rounding_power(shifted(arm, hz=-d_hz))
    by_zeta = model.rounding_power(shifted(arm, damping=d_zeta)) - model.rounding_power(shifted(arm, damping=-d_zeta))
    return by_hz / (2.0 * d_hz), by_zeta / (2.0 * d_zeta)


def shifted(arm: Arm, hz: float = 0.0, damping: float = 0.0, late_s: float = 0.0, bend: float = 0.0) -> Arm:
    """An arm with other ω/2π, ζ, Δ and bend."""
    return replace(
        arm,
        resonance_hz=arm.resonance_hz + float(hz),
        damping=arm.damping + float(damping),
        delay_s=arm.delay_s + float(late_s),
        bend=arm.bend + float(bend),
    )


def slopes_by_arm(model: RampsModel, arm: Arm, unknowns: Real) -> Real:
    """Slopes of the model by ω/2π, ζ, Δ and the bend; shape (rows, 4)."""
    steps = np.diag([1e-4 * arm.resonance_hz, 1e-3 * arm.damping, 1e-5, 1e-4])
    sides = [model.difference(shifted(arm, *step), shifted(arm, *-step), unknowns) for step in steps]
    return np.column_stack(sides) / (2.0 * np.diag(steps))


def projected_slopes(model: RampsModel, arm: Arm) -> Real:
    """Slopes by the arm after projection on the linear unknowns.

    That of the linear unknowns themselves is left out, which is of second order; the gradient of the power is exact.

    Source: L. Kaufman, A variable projection method for solving separable nonlinear least squares problems, BIT 15 (1975).
    """
    return model.projected(arm, slopes_by_arm(model, arm, model.solve(arm)[0]))
