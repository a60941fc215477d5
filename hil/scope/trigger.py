"""Triggers on a level, a status word, or an emergency."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from hil.control.arrays import Real

STATE_BITS = 0x6F
"""Bits of the status word that show the state (CiA 402, 6041h)."""


class TriggerRule(BaseModel):
    """Condition of a trigger.

    Attributes:
        kind: `edge` of a signal, change of the state in a `status` word, or an `emcy`.
        signal: Name of the signal; "" for an emergency, and for all status words.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["edge", "status", "emcy"]
    signal: str = ""
    level: FiniteFloat = 0.0
    slope: Literal["rising", "falling", "either"] = "rising"
    before_s: float = Field(default=0.5, ge=0.0, le=10.0)
    after_s: float = Field(default=0.5, ge=0.0, le=10.0)


class Trigger:
    """An armed trigger that checks rows as they come."""

    def __init__(self, rule: TriggerRule) -> None:
        self.rule = rule
        self._last: Real | None = None

    def feed(self, time_s: Real, values: Real, emergencies_s: Sequence[float] = ()) -> float | None:
        """Time at which it fires; None if it does not.

        A level is crossed between two samples that lie on either side of it, the earlier one not on it. Samples that are missing
        are passed over. Times have the shape (n,), the signal or all status words (n, m).
        """
        if self.rule.kind == "emcy":
            return min(emergencies_s, default=None)
        if not len(time_s) or not values.shape[1]:
            return None
        if self._last is None or len(self._last) != values.shape[1]:
            self._last = np.full(values.shape[1], np.nan)
        fired = [
            row
            for column in range(values.shape[1])
            if (row := self._first(np.concatenate([[self._last[column]], values[:, column]]), column)) is not None
        ]
        return float(time_s[min(fired)]) if fired else None

    def _first(self, series: Real, column: int) -> int | None:
        """Return a series' first firing row; its first value is past."""
        there = np.flatnonzero(~np.isnan(series))
        known = series[there]
        if self._last is not None and len(known):
            self._last[column] = known[-1]
        if len(known) < 2:
            return None
        if self.rule.kind == "status":
            states = known.astype(np.int64) & STATE_BITS
            hits = states[1:] != states[:-1]
        else:
            rises = (known[:-1] < self.rule.level) & (known[1:] >= self.rule.level)
            falls = (known[:-1] > self.rule.level) & (known[1:] <= self.rule.level)
            hits = {"rising": rises, "falling": falls, "either": rises | falls}[self.rule.slope]
        rows = np.flatnonzero(hits)
        return int(there[rows[0] + 1]) - 1 if len(rows) else None
