"""Parallel projections: side, front, top, and at an angle."""

import math
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Real

AZIMUTH_RAD, ELEVATION_RAD = math.radians(-60.0), math.radians(24.0)
"""Direction from which the view at an angle is taken: from the front, on the arm's right, and above."""
HIDDEN_FRACTION = 0.3
"""Part of a vector along the line of sight up to which it is seen well."""


@dataclass(frozen=True)
class View:
    """A parallel projection of the base frame.

    Attributes:
        right: Unit vector that points to the right on the paper; shape (3,).
        up: Unit vector that points up on it; shape (3,).
        names: Names of both directions, of its axes; empty for a view at an angle, which has none.
    """

    title: str
    right: Real
    up: Real
    names: tuple[str, str] | None = None

    def flat(self, points: Real) -> tuple[Real, Real]:
        """Project points of shape (..., 3).

        To the right and up, each of shape (...).
        """
        return np.asarray(points @ self.right), np.asarray(points @ self.up)


def _base(title: str, right: int, up: int) -> View:
    names = ("x", "y", "z")
    return View(title, np.eye(3)[right], np.eye(3)[up], (names[right], names[up]))


SIDE, FRONT, ABOVE = _base("From the side", 0, 2), _base("From the front", 1, 2), _base("From above", 0, 1)

ANGLE = View(
    "At an angle",
    np.array([-math.sin(AZIMUTH_RAD), math.cos(AZIMUTH_RAD), 0.0]),
    np.array([*(-math.sin(ELEVATION_RAD) * np.array([math.cos(AZIMUTH_RAD), math.sin(AZIMUTH_RAD)])), math.cos(ELEVATION_RAD)]),
)


def fullest(vectors: Real) -> View:
    """Return the view that hides least of some vectors.

    Vectors have the shape (n, 3). The side is preferred, then the top.
    """
    sizes = np.sum(np.asarray(vectors) ** 2, axis=0)
    hidden = {SIDE.title: sizes[1], ABOVE.title: sizes[2], FRONT.title: sizes[0]}
    views = (SIDE, ABOVE, FRONT)
    clear = [view for view in views if hidden[view.title] <= HIDDEN_FRACTION**2 * float(np.sum(sizes))]
    return clear[0] if clear else min(views, key=lambda view: float(hidden[view.title]))
