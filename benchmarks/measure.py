"""Two things measured in turn in one run, whether they found the same, tables of them, and the facts of the machine."""

import importlib.metadata
import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drive_profiles.processors import usable_processors

Row = tuple[object, ...]


class DisagreementError(RuntimeError):
    """A contender has found something else than the others: what its speed is compared with is other work.

    Attributes:
        contender: Which.
        difference: How far its result lies from theirs.
        bound: How far it may.
    """

    def __init__(self, contender: str, difference: float, bound: float) -> None:
        self.contender, self.difference, self.bound = contender, difference, bound
        super().__init__(f"{contender}: its result differs by {difference:.3g}, the bound is {bound:.3g}")


def agreed(contender: str, difference: float, bound: float) -> float:
    """The difference again, if it is within its bound.

    Raises:
        DisagreementError: It is above it, or no number.
    """
    if not difference <= bound:
        raise DisagreementError(contender, float(difference), bound)
    return difference


def apart(mine: ArrayLike, theirs: ArrayLike) -> float:
    """The largest difference of two results; none between infinities that are equal, NaN where either has one."""
    a, b = np.asarray(mine, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    if a.shape != b.shape:
        return float("inf")
    return float(np.max(differences(a, b), initial=0.0))


def differences(mine: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """The amounts by which two results differ, one by one."""
    with np.errstate(invalid="ignore"):  # infinity less infinity
        return np.where(mine == theirs, 0.0, np.abs(mine - theirs))


def progress(text: str) -> None:
    """Tell on standard error what is being measured."""
    print(f"{time.strftime('%H:%M:%S')}  {text}", file=sys.stderr, flush=True)  # noqa: T201 - a program's own word


_once = False


def measure_once() -> None:
    """Measure everything once from now on, to see that it runs; the figures are worth nothing then."""
    global _once  # noqa: PLW0603 - the one setting of a program
    _once = True


def turns(count: int, least: int = 1) -> int:
    """Number of turns, or the least one where everything is measured once."""
    return least if _once else count


def in_turn(contenders: Mapping[str, Callable[[], float]], rounds: int = 5) -> dict[str, float]:
    """The median rate of each contender, measured A, B, A, B, … so that all of them meet the same moods of the machine.

    Args:
        contenders: Each gives a rate, of so many per second.
        rounds: How often each has its turn; one more, the first, is not counted, and not needed to see that it runs.
    """
    found: dict[str, list[float]] = {name: [] for name in contenders}
    uncounted = turns(1, least=0)
    for turn in range(uncounted + turns(rounds)):
        for name, measure in contenders.items():
            rate = measure()
            if turn >= uncounted:
                found[name].append(rate)
    return {name: statistics.median(rates) for name, rates in found.items()}


def seconds(function: Callable[[], object]) -> float:
    """How long a call takes."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def best_of(function: Callable[[], object], repeats: int = 5) -> float:
    """Seconds of the fastest of some calls: the one that the rest of the machine disturbed least."""
    return min(seconds(function) for _ in range(turns(repeats)))


def table(heads: Iterable[str], rows: Iterable[Row]) -> list[str]:
    """A Markdown table; numbers with three significant digits."""
    heads = list(heads)
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    lines += [f"| {' | '.join(shown(cell) for cell in row)} |" for row in rows]
    return lines


def shown(cell: object) -> str:
    """A cell: text as it is, a number with three significant digits, nothing as a dash."""
    if cell is None:
        return "–"
    if not isinstance(cell, float):
        return str(cell)
    if abs(cell) >= 1000.0:
        return f"{cell:,.0f}".replace(",", " ")
    return f"{cell:.3g}"


def machine() -> list[str]:
    """What this was measured on, as a Markdown list."""
    load = " ".join(f"{value:.2f}" for value in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"
    usable = usable_processors()
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "scipy", "canopen", "python-can")]
    facts = {
        "Processor": f"{_processor()}, {usable} of {os.cpu_count()} cores usable, governor {_governor()}",
        "System": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "Python": f"{platform.python_implementation()} {platform.python_version()}; {', '.join(versions)}",
        "Load average before the run": f"{load} (1, 5, 15 minutes); on a quiet machine it is well below the number of cores",
    }
    return [f"- {name}: {value}" for name, value in facts.items()]


def _processor() -> str:
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    return found.group(1) if found else platform.processor() or "unknown processor"


def _governor() -> str:
    try:
        return Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").read_text().strip()
    except OSError:
        return "not readable"
