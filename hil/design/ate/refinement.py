"""Refinement of the arm of a fit.

Gauss-Newton refines ω, ζ and delay, fits own arms of some orders, and removes the bias of the encoder's rounding.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.design.ate.model import Arm, RampsModel, least_squares

Real = NDArray[np.float64]

MOUNTING_HZ = 110.0
"""A sensor's resonance on its mounting, as likely below as above, so its bend at an arm's frequency f is within ±(f/110 Hz)²."""
LARGEST_BEND = 0.17
"""A mounting that resonates at 2.4 times the arm's frequency."""
ROUNDING_FELT, ROUNDING_STEPS = 0.02, 20
"""Fraction of the residual's power from which the encoder's rounding is taken out of the arm, and steps for that."""
CONVERGED = 1e-6
"""Step of each unknown, by its size, below which there are no more."""
LEAST_ZETA = 0.003
"""ζ below which more than the rounding has been taken out of the arm."""
OWN_FROM_ORDER = 2
"""Least order with an arm of its own: order 1 passes its resonance at twice the speed of order 2, which few ramps reach."""
OWN_FROM, OWN_BETTER = 0.1, 0.85
"""Amplitude over the largest from which an order may have its own arm, and the residual power that this may leave."""


def refine(model: RampsModel, start: Arm) -> Arm:
    """Gauss-Newton in ω, ζ and Δ with the linear unknowns projected out."""
    return refined(model, start, {}, 0.0)[0]


def refined(model: RampsModel, start: Arm, own: Mapping[float, Arm], bend_row: float) -> tuple[Arm, dict[float, Arm]]:
    """Refine the arm and the own arms by Gauss-Newton.

    The unknowns are ω, ζ, Δ, the mounting's bend, and ω and ζ of every own arm. If the fit leaves the neighbourhood of its
    start, or finds no resonance (ζ ≥ 1), the start is returned: the vibration is then not that of a linear arm.

    Args:
        model: Model of the ramps.
        start: Arm to start from.
        own: Arms of some orders' own, to start from.
        bend_row: Weight of the bend (`bend_weight`); 0 if the bend is held.
    """
    step_s = 1.0 / (2.0 * math.pi * start.resonance_hz)
    has_bend = bend_row > 0.0

    def arms(scaled: Real) -> tuple[Arm, dict[float, Arm]]:
        delay = start.delay_s + step_s * float(scaled[2])
        bend = start.bend + (float(scaled[3]) if has_bend else 0.0)
        pairs = [(start, scaled[:2])]
        pairs += [(own[order], scaled[i : i + 2]) for order, i in zip(own, range(3 + has_bend, len(scaled), 2), strict=True)]
        made = [
            replace(
                each, resonance_hz=each.resonance_hz * float(hz), damping=each.damping * float(zeta), delay_s=delay, bend=bend
            )
            for each, (hz, zeta) in pairs
        ]
        return made[0], dict(zip(own, made[1:], strict=True))

    def residual(scaled: Real) -> Real:
        arm, others = arms(scaled)
        return np.append(model.solve(arm, others)[1], bend_row * arm.bend)

    def jacobian(scaled: Real) -> Real:
        arm, others = arms(scaled)
        slopes = projected_slopes(model, arm, others)
        sizes = [start.resonance_hz, start.damping, step_s] + has_bend * [1.0]
        sizes += _sizes(own)
        columns = [0, 1, 2] + has_bend * [3] + list(range(4, slopes.shape[1]))
        known = [bend_row * (has_bend and column == 3) for column in columns]
        return np.vstack([-slopes[:, columns] * sizes, known])

    more = len(own)
    fit = scipy.optimize.least_squares(
        residual,
        np.array([1.0, 1.0, 0.0] + has_bend * [0.0] + more * [1.0, 1.0]),
        bounds=(
            [0.8, 0.1, -1.0] + has_bend * [-LARGEST_BEND] + more * [0.8, 0.1],
            [1.25, 10.0, 1.0] + has_bend * [LARGEST_BEND] + more * [1.25, 10.0],
        ),
        jac=jacobian,
        x_scale=np.array([0.01, 0.3, 0.05] + has_bend * [0.01] + more * [0.01, 0.3]),
    )
    found = arms(fit.x)
    is_lost = fit.active_mask[0] != 0 or found[0].damping >= 1.0
    return (start, dict(own)) if is_lost else found


def _sizes(own: Mapping[float, Arm]) -> list[float]:
    """ω/2π and ζ of each order's own arm."""
    return [size for each in own.values() for size in (each.resonance_hz, each.damping)]


def bend_weight(model: RampsModel, arm: Arm, left: Real) -> float:
    """Weight of the prior on the mounting's bend beside a residual.

    The bend is 0 ± (f/110 Hz)².
    """
    variance = float(np.sum(left**2)) / max(1.0, len(left) * model.independent)
    return math.sqrt(variance) / (arm.resonance_hz / MOUNTING_HZ) ** 2


def without_rounding(model: RampsModel, arm: Arm, own: Mapping[float, Arm]) -> tuple[Arm, dict[float, Arm]]:
    """Remove the bias of the encoder's rounding from the arms.

    The resonance amplifies the noise of the rounding, so that least squares overestimate the damping.

    The expected power of that noise P(ω, ζ) is known, and what is minimised is the residual's power less P: steps
    −(JᵀJ)⁻¹ (Jᵀr − ∇P/2), with J the slopes of the residual r by the unknowns of the arms, the linear unknowns projected out.
    """
    found, others = arm, dict(own)
    left = model.solve(arm, own)[1]
    if not is_rounding_felt(model, arm, own):
        return found, others
    weight, step_s = bend_weight(model, arm, left), 1.0 / (2.0 * math.pi * arm.resonance_hz)
    for _ in range(ROUNDING_STEPS):
        left = model.solve(found, others)[1]
        slopes = projected_slopes(model, found, others)
        known = np.zeros((1, slopes.shape[1]))
        known[0, 3] = weight
        downhill = slopes.T @ left
        downhill[:2] += 0.5 * np.array(_rounding_slopes(model, found))
        downhill[3] -= weight**2 * found.bend
        step = inverse_square(np.vstack([slopes, known])) @ downhill
        step *= min(1.0, 0.3 * found.damping / max(abs(float(step[1])), 1e-30))
        found = shifted(found, *step[:4])
        others = {k: shifted(each, step[4 + 2 * i], step[5 + 2 * i], *step[2:4]) for i, (k, each) in enumerate(others.items())}
        is_lost = abs(found.resonance_hz / arm.resonance_hz - 1.0) > 0.1 or abs(found.bend) > LARGEST_BEND
        if is_lost or not all(LEAST_ZETA <= each.damping < 1.0 for each in (found, *others.values())):
            return arm, dict(own)
        if np.all(np.abs(step) < CONVERGED * np.array([found.resonance_hz, found.damping, step_s, 1.0, *_sizes(others)])):
            break
    return found, others


def is_rounding_felt(model: RampsModel, arm: Arm, own: Mapping[float, Arm]) -> bool:
    """True if the encoder's rounding is a visible part of the residual."""
    return model.rounding_power(arm) >= ROUNDING_FELT * float(np.sum(model.solve(arm, own)[1] ** 2))


def _rounding_slopes(model: RampsModel, arm: Arm) -> tuple[float, float]:
    """Slopes of the rounding's power by ω/2π and ζ."""
    d_hz, d_zeta = 1e-3 * arm.resonance_hz, 1e-2 * arm.damping
    by_hz = model.rounding_power(shifted(arm, hz=d_hz)) - model.rounding_power(shifted(arm, hz=-d_hz))
    by_zeta = model.rounding_power(shifted(arm, damping=d_zeta)) - model.rounding_power(shifted(arm, damping=-d_zeta))
    return by_hz / (2.0 * d_hz), by_zeta / (2.0 * d_zeta)


def shifted(arm: Arm, hz: float = 0.0, damping: float = 0.0, late_s: float = 0.0, bend: float = 0.0) -> Arm:
    """An arm with other ω/2π, ζ, Δ and bend.

    Args:
        arm: The arm.
        hz: Added to ω/2π.
        damping: Added to ζ.
        late_s: Added to Δ.
        bend: Added to the bend.
    """
    return replace(
        arm,
        resonance_hz=arm.resonance_hz + float(hz),
        damping=arm.damping + float(damping),
        delay_s=arm.delay_s + float(late_s),
        bend=arm.bend + float(bend),
    )


def own_arms(model: RampsModel, arm: Arm) -> tuple[Arm, dict[float, Arm]]:
    """Fit own arms to some orders, if they clearly lower the residual.

    A large vibration may see another gear stiffness than a small one.
    """
    unknowns, left = model.solve(arm)
    sizes = {order: math.hypot(*unknowns[2 * row : 2 * row + 2]) for row, order in enumerate(model.orders)}
    strongest = max(sizes, key=lambda order: sizes[order])
    others = [k for k, size in sizes.items() if k != strongest and k >= OWN_FROM_ORDER and size > OWN_FROM * sizes[strongest]]
    if not others:
        return arm, {}
    found, own = refined(model, arm, dict.fromkeys(others, arm), 0.0)
    apart = model.solve(found, own)[1]
    is_better = float(np.sum(apart**2)) < OWN_BETTER * float(np.sum(left**2))
    return (found, own) if is_better else (arm, {})


def slopes_by_arms(model: RampsModel, arm: Arm, own: Mapping[float, Arm], unknowns: Real) -> list[Real]:
    """Slopes of the model by the arms' parameters.

    These are ω/2π, ζ, Δ and the bend of all, then ω/2π and ζ of each own arm.

    Args:
        model: Model of the ramps.
        arm: The arm.
        own: Arms of some orders' own.
        unknowns: The linear unknowns.
    """
    d_hz, d_zeta, d_s = 1e-4 * arm.resonance_hz, 1e-3 * arm.damping, 1e-5

    def difference(make: Callable[[float], tuple[Arm, Mapping[float, Arm]]], step: float) -> Real:
        return model.difference(make(step), make(-step), unknowns) / (2.0 * step)

    slopes = [
        difference(lambda x: (shifted(arm, hz=x), own), d_hz),
        difference(lambda x: (shifted(arm, damping=x), own), d_zeta),
        difference(lambda x: (shifted(arm, late_s=x), {k: shifted(each, late_s=x) for k, each in own.items()}), d_s),
        difference(lambda x: (shifted(arm, bend=x), {k: shifted(each, bend=x) for k, each in own.items()}), 1e-4),
    ]
    for order, each in own.items():
        slopes.append(difference(lambda x, k=order, e=each: (arm, {**own, k: shifted(e, hz=x)}), d_hz))  # type: ignore[misc]
        slopes.append(difference(lambda x, k=order, e=each: (arm, {**own, k: shifted(e, damping=x)}), d_zeta))  # type: ignore[misc]
    return slopes


def projected_slopes(model: RampsModel, arm: Arm, own: Mapping[float, Arm]) -> Real:
    """Slopes by the arms after projection on the linear unknowns.

    At the minimum they are the residual's slopes with the opposite sign.

    That of the linear unknowns themselves is left out, which is of second order; the gradient of the power is exact.

    Source: L. Kaufman, A variable projection method for solving separable nonlinear least squares problems, BIT 15 (1975).
    """
    motion, matrix = model.columns(arm, own)
    unknowns = least_squares(matrix, model.signal - motion)
    slopes = np.column_stack(slopes_by_arms(model, arm, own, unknowns))
    return np.asarray(slopes - matrix @ least_squares(matrix, slopes))


def inverse_square(jacobian: Real) -> Real:
    """(JᵀJ)⁻¹, on scaled columns."""
    scale = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    scaled = jacobian / scale
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-14, hermitian=True) / np.outer(scale, scale))
