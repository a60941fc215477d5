"""Transmission error from several passes.

If the gear is a spring, one fit takes all passes at once; otherwise each pass is fitted alone and the mean counts.

A slow pass shakes the arm more than a fast one, so a gear with hysteresis or a soft wind-up has another stiffness in each. Then
one arm for all passes bends A_k by more than any of them alone would, and the scatter of the passes is the honest standard error.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.design.ate.identification import JointEstimate, apart, identify
from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.transmission_error import PAPER_ORDERS

WIDENED_BY_GEAR = 3.0
"""Factor between the directions' disagreement and noise from which it is the gear's: wound up the one way and the other."""


def identify_passes(
    sweeps: Sequence[Sweep],
    reduction_ratio: float,
    sensing: Sensing,
    start: Arm | None = None,
    orders: Sequence[float] = PAPER_ORDERS,
    *,
    is_near: bool = False,
) -> JointEstimate:
    """Estimate A_k, φ_k, arm and sensor delay from passes.

    Each pass has ramps in both directions.

    Args:
        sweeps: Recordings, one for each pass.
        reduction_ratio: Reduction ratio N.
        sensing: The kind of signal in the recordings.
        start: An arm to start from.
        orders: Orders k of the error.
        is_near: True for a start from an estimate of most of these recordings: nothing is searched.

    Raises:
        ValueError: A direction is missing or too short, or shapes differ.
    """
    joint = identify(sweeps, reduction_ratio, sensing, start, orders, is_near=is_near)
    if not joint.is_bent and joint.widened < WIDENED_BY_GEAR:
        return joint
    joint = replace(joint, is_spring=False)
    if len(sweeps) < 2:
        return joint
    return mean_of([identify([sweep], reduction_ratio, sensing, joint.arm, orders, is_near=True) for sweep in sweeps], joint)


def mean_of(passes: Sequence[JointEstimate], joint: JointEstimate) -> JointEstimate:
    """Replace A_k e^{jφ_k} of an estimate by the passes' weighted mean.

    The standard errors contain the scatter of the passes.

    Args:
        passes: Estimates of one pass each.
        joint: Estimate of all passes, which gives everything else.
    """
    means: list[float] = []
    errors: list[float] = []
    for order in joint.orders:
        sizes = np.array([each.error.amplitude_arcsec[order] for each in passes])
        turns = np.radians([each.error.phase_deg[order] for each in passes])
        along = np.array([max(each.amplitude_error_arcsec[order], 1e-12) for each in passes])
        across = np.maximum(np.radians([each.phase_error_deg[order] for each in passes]) * sizes, 1e-12)
        weights = 1.0 / (along**2 + across**2)
        mean = complex(np.sum(weights * sizes * np.exp(1j * turns)) / np.sum(weights))
        off = (sizes * np.exp(1j * turns) - mean) * cmath.exp(-1j * cmath.phase(mean))
        means += [abs(mean), math.degrees(cmath.phase(mean)) % 360.0]
        error_rad = _scattered(off.imag, across, weights) / max(abs(mean), 1e-30)
        errors += [_scattered(off.real, along, weights), math.degrees(error_rad)]
    return replace(
        joint,
        values=apart(joint.orders, np.array(means), np.array(errors)),
        misfit={k: min(each.misfit[k] for each in passes) for k in joint.misfit},
        structured=min(each.structured for each in passes),
        explained_by_error=max(each.explained_by_error for each in passes),
    )


def _scattered(off: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Standard error of a mean of values that one gear bends.

    It is the larger of the best value's error and the scatter.

    The scatter has the weights of the mean: a pass whose vibration was cancelled knows the error better than the first one.
    """
    return max(float(np.min(errors)), float(np.sqrt(np.sum(weights * off**2) / np.sum(weights))))
