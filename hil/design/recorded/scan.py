"""Blind scan of a recorded signal for orders of the motor.

It finds the orders that are there, without a list of expected ones.

Each order is fitted alone beside the slow part, through the arm where a sensor sits behind one. What it explains is held against
what its neighbours explain, so that noise of any strength makes a false alarm as rarely as is stated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.design.order_map import APART_TURNS
from hil.design.recorded.fit import waves_of_angle
from hil.design.recorded.order_columns import FLOOR_STEP, ORDER_STEP, SCAN_FROM, SCAN_TO, OrderColumns

FLOOR_WIDTH, FLOOR_CELLS = 1.0, 16.0
"""Measured: orders to either side of which the floor is the median, and independent ones at least. Of 100 recordings without any
error 2 have a peak above the level of 1 % (docs/recordings-method.md)."""
FALSE_ALARM = 0.01
"""Probability: with which noise alone reaches the level anywhere in the scan."""
MEDIAN_KNOWS = 0.48
"""Probability: degrees of freedom of a median of powers by the sum of theirs, (ln 2)²."""
ALIKE = 0.5
"""Measured with `FLOOR_WIDTH`: degrees of freedom of a sum over stretches, by those of noise: what a slow part leaves is
alike."""
MOST_LOOKS = 12
"""Bound: looks of a scan, each of which takes out one order."""
MOST_TAKEN = 0.4
"""Accuracy: orders to either side of one that was taken out that it may have taken along, at most: a factor of 2 changes nothing
in four recordings."""


@dataclass(frozen=True)
class Peak:
    """Order above the false-alarm level.

    Attributes:
        level: False-alarm level there.
    """

    order: float
    amplitude: float
    level: float


@dataclass(frozen=True)
class BlindScan:
    """Amplitude over the order; all of shape (n,).

    Attributes:
        amplitude: Amplitude that each order alone has, in rad of the joint.
        floor: Median of the neighbourhood.
        level: Level that noise reaches anywhere in the scan with the probability `FALSE_ALARM`.
        turns: Revolutions of the longest stretch.
        peaks: Orders above the level once higher ones are taken out, the highest first.
    """

    order: Real
    amplitude: Real
    floor: Real
    level: Real
    turns: float
    peaks: tuple[Peak, ...]

    @property
    def highest(self) -> Peak:
        """Highest peak above the level, or the one nearest to it."""
        above = self.amplitude >= self.level
        row = int(np.argmax(np.where(above, self.amplitude, 0.0) if np.any(above) else self.amplitude / self.level))
        return Peak(float(self.order[row]), float(self.amplitude[row]), float(self.level[row]))


def plain_amplitudes(signal: Real, slow: Real, phase_rad: Real, multiples: Real) -> Real:
    """Amplitude of each multiple of a phase beside slow columns.

    Each multiple is fitted alone; shape of `multiples`.

    Args:
        signal: Signal; shape (n,).
        slow: Columns of the slow part; shape (n, m).
        phase_rad: Phase; shape (n,).
        multiples: Multiples of it.
    """
    basis = np.linalg.qr(slow)[0]
    left = signal - basis @ (basis.T @ signal)
    amplitudes = np.empty(len(multiples))
    wave = waves_of_angle(phase_rad)
    for row in range(0, len(multiples), 64):
        columns = wave([float(each) for each in multiples[row : row + 64]])
        pairs = (columns - basis @ (basis.T @ columns)).T.reshape(-1, 2, len(left))
        gram, moment = pairs @ pairs.transpose(0, 2, 1), pairs @ left
        ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        amplitudes[row : row + 64] = np.linalg.norm(np.linalg.solve(gram + ridge, moment[..., None])[..., 0], axis=1)
    return amplitudes


def order_scan(looks: Sequence[OrderColumns], signals: Sequence[Real], orders: Real) -> BlindScan:
    """Scan all stretches together.

    The strength is the root of the mean square of the stretches' strengths, weighted by their revolutions.

    Args:
        looks: Waves of the stretches.
        signals: Signal of each, without lines of a fixed frequency.
        orders: Orders of the scan; shape (orders,).
    """
    turns = np.asarray([each.section.turns for each in looks])
    weight = turns / np.sum(turns)
    per_strength = 1.0 / np.sqrt(sum(part / each.per_strength**2 for each, part in zip(looks, weight, strict=True)))
    longest = float(np.max(turns))
    seen = np.asarray(sum(part * each.turns_seen(orders) for each, part in zip(looks, weight, strict=True)))
    over = level_over_floor(weight, seen)
    reach = floor_reach(seen)

    def together(rows: Sequence[int]) -> Real:
        left = [each.without(signal, rows) for each, signal in zip(looks, signals, strict=True)]
        powers = [part * each.powers(rest) for each, rest, part in zip(looks, left, weight, strict=True)]
        return np.asarray(np.sqrt(np.sum(powers, axis=0)))

    peaks: list[Peak] = []
    taken: list[int] = []
    strength = left = together([])
    for _ in range(MOST_LOOKS):
        # the strongest, whose side lobes may hide in their own floor; then that which stands highest above its neighbours
        for row in (int(np.argmax(left)), int(np.argmax(left / floor_of(left, reach, _beside(orders, taken, seen))))):
            rest = together([*taken, row])
            floor = floor_of(rest, reach, _beside(orders, [*taken, row], seen))
            if left[row] >= over[row] * floor[row] and row not in taken:
                break
        else:
            break
        if all(abs(orders[row] - each.order) > APART_TURNS / longest for each in peaks):
            size = float(per_strength[row])
            peaks.append(Peak(float(orders[row]), float(left[row]) * size, float(over[row] * floor[row]) * size))
        taken.append(row)
        left = rest
    floor = floor_of(left, reach, _beside(orders, taken, seen)) * per_strength
    highest_first = tuple(sorted(peaks, key=lambda each: -each.amplitude))
    return BlindScan(orders, strength * per_strength, floor, over * floor, longest, highest_first)


def level_over_floor(weight: Real, seen_turns: Real) -> Real:
    """False-alarm level over the median of the neighbours.

    Noise reaches it anywhere in the scan with the probability `FALSE_ALARM`.

    A power of noise that is summed over stretches with weights w has ν = 2/Σw² degrees of freedom, and so many independent orders
    there are as revolutions within which an order shows; between them it rises above them, about √ln(orders/p) times as often as
    at them (Rice). The median of few neighbours is itself uncertain, which makes an F distribution of it.

    Args:
        weight: Weights of the stretches, which add up to 1.
        seen_turns: Revolutions within which each order shows; shape (orders,).

    Returns:
        The strength over the floor; shape (orders,).
    """
    freedom = max(2.0, ALIKE * 2.0 / float(np.sum(weight**2)))
    cells = (SCAN_TO - SCAN_FROM) * float(np.mean(seen_turns))
    trials = cells * math.sqrt(math.log(cells / FALSE_ALARM))
    neighbours = floor_width(seen_turns) * seen_turns  # at the ends of the scan: elsewhere there are twice as many
    power = scipy.stats.f.isf(FALSE_ALARM / trials, freedom, MEDIAN_KNOWS * freedom * neighbours)
    return np.asarray(np.sqrt(power * freedom / float(scipy.stats.chi2.median(freedom))))


def floor_reach(seen_turns: Real) -> NDArray[np.int64]:
    """Rows to either side of an order for its floor.

    The floor is their median; shape of `seen_turns`.
    """
    return np.round(floor_width(seen_turns) / ORDER_STEP).astype(np.int64)


def floor_width(seen_turns: Real) -> Real:
    """Orders to either side of an order for its floor.

    The floor is the median among them; shape of `seen_turns`.
    """
    return np.minimum(np.maximum(FLOOR_WIDTH, FLOOR_CELLS / seen_turns), SCAN_TO - SCAN_FROM)


def _beside(orders: Real, taken: Sequence[int], seen_turns: Real) -> NDArray[np.bool_]:
    """True at orders that the removed ones do not influence.

    They lie at least one over the revolutions away; shape (orders,).
    """
    free = np.ones(len(orders), dtype=np.bool_)
    for row in taken:
        free &= np.abs(orders - orders[row]) > min(1.0 / float(seen_turns[row]), MOST_TAKEN)
    return free


def floor_of(strength: Real, reach: NDArray[np.int64], free: NDArray[np.bool_] | None = None) -> Real:
    """Median of the neighbours of each order, relative to a slope.

    The slope is that of the whole scan; shape of `strength`.

    Noise is seldom white: a parabola over the order and its logarithm, through the logarithms by least absolute deviations, is
    the slope, so that a wide neighbourhood does not make its low end an alarm.

    Args:
        reach: Rows to either side; shape of `strength`.
        free: True if noise was left in; shape of `strength`; None for everywhere.
    """
    free = np.ones(len(strength), dtype=np.bool_) if free is None else free
    count = len(strength)
    size = np.log(np.maximum(strength, 1e-300))
    place = np.linspace(0.0, 1.0, count)
    columns = np.column_stack([np.vander(place, 3), np.log(SCAN_FROM + (SCAN_TO - SCAN_FROM) * place)])
    weight = free.astype(np.float64)
    slope = np.zeros(count)
    for _ in range(8):
        slope = columns @ np.linalg.lstsq(columns * weight[:, None], size * weight, rcond=None)[0]
        weight = free / np.sqrt(np.maximum(np.abs(size - slope), 0.05))
    level = np.exp(slope)
    even = np.where(free, strength / level, np.nan)
    centres = np.append(np.arange(0, count - 1, FLOOR_STEP), count - 1)
    medians = [np.nanmedian(even[max(0, row - reach[row]) : row + reach[row] + 1 : 3]) for row in centres]
    return np.asarray(np.maximum(level * np.interp(np.arange(count), centres, medians), 1e-300))
