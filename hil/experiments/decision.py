"""Decision on a claim from an estimate and its standard error.

An estimate meets the claim by a margin m with the standard error σ, so the claim holds with the probability Φ(m/σ). From
`PROBABILITY` on it holds; from 1 − `PROBABILITY` down it does not; between the two it is open, and another run may decide.
"""

from statistics import NormalDist
from typing import NamedTuple

PROBABILITY = 0.975
"""Probability from which a claim counts as true."""
SIGMAS = NormalDist().inv_cdf(PROBABILITY)
"""The same as standard errors by which an estimate must meet the claim."""


class Decision(NamedTuple):
    """Claim with the margin by which an estimate meets it.

    Attributes:
        margin: Margin; negative if the estimate does not meet it.
        error: Its standard error.
    """

    margin: float
    error: float

    @property
    def holds(self) -> bool:
        """True if the claim is as good as certain."""
        return self.margin > 0.0 and self.margin >= SIGMAS * self.error

    @property
    def fails(self) -> bool:
        """True if its contrary is as good as certain."""
        return self.margin < 0.0 and -self.margin >= SIGMAS * self.error

    @property
    def is_open(self) -> bool:
        """True if neither is certain."""
        return not self.holds and not self.fails

    @property
    def is_likely(self) -> bool:
        """True if the claim is more probable than its contrary: the decision after the last run."""
        return self.margin > 0.0
