"""Waves of all orders of a scan beside a stretch's slow part."""

from collections.abc import Sequence

import numpy as np

from hil.control.arrays import Real
from hil.design.recorded.fit import AngleSection
from hil.design.recorded.slow import slow_columns
from hil.design.transmission_error import AT_ONCE

SCAN_FROM, SCAN_TO, ORDER_STEP = 0.6, 10.0, 0.01
"""Bound: orders of a scan, and their step: below lies what is slow. A peak of r revolutions is 1/r wide, ten steps at r = 10."""
SAMPLES_PER_TURN, LEAST_SAMPLES = 60, 500
"""Accuracy: samples that show the highest order of a scan: of more the neighbours are averaged, which takes 5 % of it."""
MOST_NUMBERS = 60_000_000
"""Bound: numbers of all stretches' waves, 4 bytes each: of more the longest stretches are scanned."""
FLOOR_STEP = 10
"""Accuracy: rows from one median of a scan to the next, and from one order to the next at which it is seen how far apart orders
must be to be told apart: a factor of 2 changes levels of four recordings by 2 %, and of four drawn ones by 0.6 %."""


def scanned_orders() -> Real:
    """Orders of a scan; shape (orders,)."""
    return np.arange(SCAN_FROM, SCAN_TO + ORDER_STEP / 2, ORDER_STEP)


class OrderColumns:
    """One stretch of a scan.

    Attributes:
        section: The stretch, averaged; its angle has the shape (n,).
        basis: Orthonormal columns of the slow part; shape (n, degree + 1).
        pairs: Orthonormal waves of each order beside it; shape (orders, 2, n).
        per_strength: Amplitude of an order by its strength; shape (orders,).
    """

    def __init__(self, section: AngleSection, degree: int, orders: int) -> None:
        """Make room for so many orders."""
        self.section = section
        self.basis = np.linalg.qr(slow_columns(section.angle_rad, degree))[0]
        self.pairs = np.zeros((orders, 2, len(section.signal)), dtype=np.float32)
        self.per_strength = np.ones(orders)

    def fill(self, rows: slice, orders: Sequence[float]) -> None:
        """Make the waves of some orders."""
        count = len(self.section.signal)
        columns = self.section.waves(orders)
        columns = columns - self.basis @ (self.basis.T @ columns)
        pairs = columns.reshape(count, -1, 2).transpose(1, 0, 2)
        orthonormal, triangle = np.linalg.qr(pairs)
        self.pairs[rows] = orthonormal.transpose(0, 2, 1)
        ridge = 1e-12 * np.trace(triangle.transpose(0, 2, 1) @ triangle, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        inverse = np.linalg.inv(triangle.transpose(0, 2, 1) @ triangle + ridge + 1e-300 * np.eye(2))
        self.per_strength[rows] = np.sqrt(0.25 * count * np.trace(inverse, axis1=1, axis2=2))

    def beside_slow(self, signal: Real) -> Real:
        """Signal without its slow part; shape (n,)."""
        return np.asarray(signal - self.basis @ (self.basis.T @ signal))

    def powers(self, left: Real) -> Real:
        """Squared strength of each order; shape (orders,).

        The strength is the amplitude of a plain wave that explains as much.

        Args:
            left: Signal without its slow part; shape (n,).
        """
        explained = self.pairs.reshape(-1, len(left)) @ left.astype(np.float32)
        return np.asarray(np.sum(explained.astype(np.float64).reshape(-1, 2) ** 2, axis=1) * 2.0 / len(left))

    def turns_seen(self, orders: Real) -> Real:
        """Revolutions within which each order shows; shape of `orders`.

        Two plain waves over n revolutions are alike by sinc², whose integral over their distance is 1/n. Through an arm an order
        shows mostly while it rings, so waves of orders further apart are alike; the inverse of the same integral says how far.
        """
        probed = np.arange(0, len(orders), FLOOR_STEP)
        waves = self.pairs.reshape(-1, self.pairs.shape[2])
        between = (self.pairs[probed].reshape(-1, waves.shape[1]) @ waves.T).reshape(len(probed), 2, -1, 2)
        alike = 0.5 * np.sum(between.astype(np.float64) ** 2, axis=(1, 3))
        return np.asarray(np.interp(orders, orders[probed], 1.0 / (ORDER_STEP * np.sum(alike, axis=1))))

    def without(self, signal: Real, rows: Sequence[int]) -> Real:
        """Signal without its slow part and some orders; shape (n,)."""
        left = self.beside_slow(signal)
        if not rows:
            return left
        waves = self.pairs[list(rows)].reshape(-1, len(signal)).T.astype(np.float64)
        return np.asarray(left - waves @ np.linalg.lstsq(waves, left, rcond=1e-6)[0])


def columns_of(sections: Sequence[AngleSection], degrees: Sequence[int], orders: Real) -> list[OrderColumns | None]:
    """Make the waves of each stretch.

    If memory does not suffice for all, the shorter stretches have None.

    Args:
        degrees: Degree of the slow part of each.
        orders: Orders of the scan; shape (orders,).
    """
    found: list[OrderColumns | None] = [None] * len(sections)
    numbers = 0
    for place in sorted(range(len(sections)), key=lambda each: -sections[each].turns):
        section = sections[place].averaged(max(LEAST_SAMPLES, round(SAMPLES_PER_TURN * sections[place].turns)))
        numbers += 2 * len(orders) * len(section.signal)
        if numbers > MOST_NUMBERS and any(each is not None for each in found):
            break
        found[place] = OrderColumns(section, degrees[place], len(orders))
    for start in range(0, len(orders), AT_ONCE):  # all stretches of a recording share what an arm answers to an order
        few = [float(order) for order in orders[start : start + AT_ONCE]]
        for each in found:
            if each is not None:
                each.fill(slice(start, start + len(few)), few)
    return found
