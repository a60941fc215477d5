"""Decision on a claim from the probability that it holds.

From `PROBABILITY` on the claim holds; from 1 − `PROBABILITY` down it does not; between the two it is open, and another run may
decide. An estimate that meets the claim by a margin m with the standard error σ gives it the probability Φ(m/σ).
"""

from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

from hil.design.estimation import PROBABILITY

MOST_RUNS = 4
"""Bound: runs of either kind where one leaves a claim open: the mean of n runs halves the sensor's noise at n = 4."""

RISK = 0.1
"""Probability: of a harm from which it is not risked after the last run: a harm costs as much as nine needless refusals."""


@dataclass(frozen=True)
class Decision:
    """Claim with its probability."""

    probability: float

    @classmethod
    def of(cls, margin: float, error: float) -> Self:
        """Claim that an estimate meets by a margin, with its standard error; the margin is negative if it does not."""
        return cls(NormalDist().cdf(margin / error) if error > 0.0 else float(margin > 0.0))

    @property
    def holds(self) -> bool:
        """True if the claim is as good as certain."""
        return self.probability >= PROBABILITY

    @property
    def fails(self) -> bool:
        """True if its contrary is as good as certain."""
        return self.probability <= 1.0 - PROBABILITY

    @property
    def is_open(self) -> bool:
        """True if neither is certain."""
        return not self.holds and not self.fails

    @property
    def is_likely(self) -> bool:
        """True if the claim is more probable than its contrary: the decision after the last run."""
        return self.probability > 0.5

    @property
    def is_risky(self) -> bool:
        """True if a harm, which the claim is, may not be risked after the last run."""
        return self.probability >= RISK
