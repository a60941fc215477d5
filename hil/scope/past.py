"""The last seconds of all signals, for viewers who join later."""

from collections import deque

import numpy as np

from hil.control.arrays import Real

KEPT_S = 10.0
"""Time that is kept."""
MOST_ROWS_KEPT = 200_000
"""Rows that are kept at most: 10 s at 20 kHz."""


class Past:
    """Rows of the last seconds.

    Attributes:
        first: Number of the first row that is kept, counted from the start.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._blocks: deque[tuple[Real, Real]] = deque()
        self.first = self.end = 0

    def add(self, time_s: Real, values: Real) -> None:
        """Add rows.

        If time runs backwards, older rows are removed. If signals have been added, older rows have NaN for them. Times rise and
        have the shape (n,), values (n, m), m never less than before.
        """
        if not len(time_s):
            return
        if self._blocks and time_s[0] <= self._blocks[-1][0][-1]:
            self._blocks.clear()
            self.first = self.end
        width = values.shape[1]
        if self._blocks and self._blocks[-1][1].shape[1] < width:
            self._blocks = deque((times, widened(block, width)) for times, block in self._blocks)
        self._blocks.append((time_s, values))
        self.end += len(time_s)
        while self._blocks[0][0][-1] < time_s[-1] - self._kept_s or self.end - self.first > MOST_ROWS_KEPT:
            self.first += len(self._blocks.popleft()[0])

    def since(self, row: int) -> tuple[int, Real, Real]:
        """Rows from a number on.

        Returns:
            Number of the first row, times and values; shapes (n,), (n, m).
        """
        begin = max(row, self.first)
        number, times, values = self.end, [], []
        for time_s, block in reversed(self._blocks):
            number -= len(time_s)
            skipped = max(0, begin - number)
            if skipped >= len(time_s):
                break
            times.append(time_s[skipped:])
            values.append(block[skipped:])
            if skipped:
                break
        if not times:
            return self.end, np.empty(0), np.empty((0, self._blocks[-1][1].shape[1] if self._blocks else 0))
        return begin, np.concatenate(times[::-1]), np.concatenate(values[::-1])


def widened(block: Real, width: int) -> Real:
    """Widen rows by NaN for added signals; shape (n, width)."""
    wide = np.full((len(block), width), np.nan)
    wide[:, : block.shape[1]] = block
    return wide
