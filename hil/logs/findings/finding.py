"""Finding in a log, in words, with stamps and a picture."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real

MOST_POINTS = 4000
"""Points of a picture: no screen shows more."""
MOST_STAMPS = 5


class Severity(IntEnum):
    """Weight of a finding; the worst come first."""

    NOTE = 0
    WARNING = 1
    FAULT = 2


@dataclass(frozen=True)
class Picture:
    """Numbers of a picture.

    Attributes:
        x: Numbers along; shape (n,).
        y: Numbers upwards; shape (n,).
        limits: Values of y that are drawn as limits, by name.
        is_line: True if the points are joined.
    """

    x: Real
    y: Real
    x_label: str
    y_label: str
    limits: tuple[tuple[str, float], ...] = ()
    is_line: bool = False


@dataclass(frozen=True)
class Finding:
    """One fault, warning or note.

    Attributes:
        kind: Its kind, a word or two joined by hyphens.
        stamps_s: First places, in s since the log's first frame.
        node: Node-ID; None if it is of the bus.
    """

    kind: str
    severity: Severity
    words: str
    remedy: str
    stamps_s: tuple[float, ...] = ()
    count: int = 1
    node: int | None = None
    picture: Picture | None = None


@dataclass(frozen=True)
class Untold:
    """A question that a log cannot answer.

    Attributes:
        kind: What would have been looked for.
        words: Reason, and data that would answer it.
        node: Node-ID; None if it is of the bus.
    """

    kind: str
    words: str
    node: int | None = None


Said = Finding | Untold


def together(parts: Iterable[Iterable[Said]]) -> list[Said]:
    """Join what is alike in several parts of a log: the words of the first, and the stamps and occurrences of all."""
    found: dict[object, Said] = {}
    for part in parts:
        seen: Counter[object] = Counter()
        for each in part:
            what = each if isinstance(each, Untold) else (each.kind, each.severity, each.node)
            seen[what] += 1
            first = found.setdefault((what, seen[what]), each)
            if isinstance(first, Finding) and isinstance(each, Finding) and each is not first:
                stamps_s = (*first.stamps_s, *each.stamps_s)[:MOST_STAMPS]
                found[what, seen[what]] = replace(first, stamps_s=stamps_s, count=first.count + each.count)
    return list(found.values())


def stamps_of(stamp_ns: NDArray[np.int64], rows: NDArray[np.intp]) -> tuple[float, ...]:
    """The first few stamps of some rows, in s."""
    return tuple(round(float(stamp_ns[row]) * 1e-9, 6) for row in rows[:MOST_STAMPS])


def picture_of(
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    labels: tuple[str, str],
    limits: tuple[tuple[str, float], ...] = (),
    is_line: bool = False,
) -> Picture:
    """Return a picture of many points, reduced to minima and maxima."""
    if len(x) > MOST_POINTS:
        width = -(-len(x) // (MOST_POINTS // 2))
        edges = np.arange(0, len(x), width)
        low = np.array([edge + int(np.argmin(y[edge : edge + width])) for edge in edges])
        high = np.array([edge + int(np.argmax(y[edge : edge + width])) for edge in edges])
        rows = np.unique(np.concatenate([low, high]))
        x, y = x[rows], y[rows]
    return Picture(np.asarray(x, float), np.asarray(y, float), *labels, limits, is_line)
