"""Distributions: how each quantity of a drawn robot or plant is drawn.

Each draw of a number takes one number of its generator, however wide the distribution is:

    >>> import numpy as np
    >>> wide, narrow = np.random.default_rng(7), np.random.default_rng(7)
    >>> Even(0.0, 4.0).draw(wide) > Even(1.0, 1.0).draw(narrow), Chance().draw(wide) == Chance().draw(narrow)
    (True, True)
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


class Even(NamedTuple):
    """All values between two limits, equally probable."""

    low: float
    high: float

    def draw(self, source: np.random.Generator) -> float:
        """Draw a value."""
        return float(source.uniform(self.low, self.high))


class Logarithmic(NamedTuple):
    """All values between two positive limits, all ratios equally probable."""

    low: float
    high: float

    def draw(self, source: np.random.Generator) -> float:
        """Draw a value."""
        return math.exp(source.uniform(math.log(self.low), math.log(self.high)))


class Whole(NamedTuple):
    """Whole numbers between two limits, both included."""

    low: int
    high: int

    def draw(self, source: np.random.Generator) -> int:
        """Draw a value."""
        return int(source.integers(self.low, self.high, endpoint=True))


class OneOf(NamedTuple):
    """Some values, equally probable."""

    values: tuple[float, ...]

    def draw(self, source: np.random.Generator) -> float:
        """Draw a value."""
        return self.values[int(source.integers(len(self.values)))]


class Chance(NamedTuple):
    """True with a probability."""

    probability: float = 0.5

    def draw(self, source: np.random.Generator) -> bool:
        """Draw a value."""
        return bool(source.random() < self.probability)


Distribution = Even | Logarithmic | Whole | OneOf | Chance
Distributions = Mapping[str, Distribution]
"""Distribution of each drawn quantity, by name."""
