"""Part of a fit's residual that is not noise.

A gear that is not a spring leaves such a part where the arm resonates; noise is everywhere.

The level of the noise is read in the quiet parts of the residual, block by block. What is above it is misfit. How far it can bend
an order's amplitude and phase follows from where it lies: a residual while the order itself is large counts against it.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from hil.control.arrays import Real

LEAST_MISSED = 3e-4
"""Measured: least part of a vibration that steps, spline and the sensor's filter miss. On 95 robots (10142 to 10241) the rms of z
of A_k, φ_k and Δ is 0.86 to 1.11, and 0.84 to 1.00 with 5e-4, with which it was 0.76 to 1.02 on 50201 to 50400."""
QUIET = 0.25
"""Probability: quantile of the blocks' powers that is taken for quiet."""
CHANCE = 1.5
"""Accuracy: power of a block over that of the noise up to which it may be chance: a factor of 2 changes nothing."""


def block_powers(values: Real, length: int) -> Real:
    """Mean power of each whole block of samples; shape (blocks,)."""
    count = max(1, len(values) // length)
    return np.array([float(np.mean(part**2)) for part in np.array_split(values, count)])


def noise_power(powers: Real, freedom: float) -> float:
    """Power of white noise, from the quiet ones of some blocks.

    `freedom` is the number of independent samples of a block.
    """
    # Wilson and Hilferty's approximation of the quantile of χ²/n
    spread = 2.0 / (9.0 * max(1.0, freedom))
    quiet = max(0.2, 1.0 - spread + NormalDist().inv_cdf(QUIET) * math.sqrt(spread)) ** 3
    return float(np.quantile(powers, QUIET)) / quiet


def misfit(residual: Sequence[Real], part: Sequence[Real], whole: Sequence[Real], length: int, freedom: float) -> float:
    """Part of one order's vibration that the model misses: residual beside noise over it.

    Both are weighted towards the instants at which the order's part is large.

    Args:
        residual: What the fit leaves, by recording; each of shape (n,).
        part: Part of one order in the model, by recording.
        whole: What the model gives, by recording.
        length: Samples of a block.
        freedom: Independent samples of a block.
    """
    above, all_own = 0.0, 0.0
    for each, ours, given in zip(residual, part, whole, strict=True):
        own = block_powers(ours, length)
        more = np.maximum(_above_noise(each, length, freedom), LEAST_MISSED**2 * block_powers(given, length))
        above += float(np.sum(more * own))
        all_own += float(np.sum(own**2))
    return math.sqrt(above / max(all_own, 1e-300))


def structured_power(residual: Sequence[Real], length: int, freedom: float) -> float:
    """Mean power of the residual above the noise, over all recordings."""
    return float(np.mean(np.concatenate([_above_noise(each, length, freedom) for each in residual])))


def _above_noise(residual: Real, length: int, freedom: float) -> Real:
    """Power of the residual above the noise; shape (blocks,)."""
    left = block_powers(residual, length)
    return np.maximum(0.0, left - CHANCE * noise_power(left, freedom))


def noise_variance(residual: Real, length: int, freedom: float) -> Real:
    """Variance of the residual at each sample: that of the noise, and what is above it in the sample's block; shape (n,)."""
    left = block_powers(residual, length)
    counts = [len(each) for each in np.array_split(residual, len(left))]
    return np.repeat(noise_power(left, freedom) + _above_noise(residual, length, freedom), counts)
