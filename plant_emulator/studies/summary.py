"""Summary of many runs: fractions within specification and stable, and influences."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Real
from plant_emulator.studies.robustness import RESULTS, Study
from plant_emulator.studies.spread import Unknown
from plant_emulator.trials.rows import Row, Value, csv_text, numbers, text
from plant_emulator.trials.statistics import CONFIDENCE, RunFraction, percentiles, run_fraction

PERCENTILES = (5, 25, 50, 75, 95, 99)
FEWEST_RUNS = 20
"""Fewest runs for influences."""


@dataclass(frozen=True)
class Influence:
    """Influence of one unknown on the result.

    Attributes:
        correlation: Spearman's rank correlation; of an angle, unsigned, the multiple one with its cosine and sine.
        p_value: Probability of such a correlation by chance.
        coefficient: Standardised regression coefficient: by how many standard deviations the result moves with one of the
            unknown, all others held; of an angle unsigned. None with too few runs.
        is_clear: Too strong for chance among so many unknowns (Bonferroni, 5 %).
    """

    name: str
    label: str
    correlation: float
    low: float
    high: float
    p_value: float
    coefficient: float | None
    is_clear: bool


@dataclass(frozen=True)
class Summary:
    """The runs of one study.

    Attributes:
        nominal: The robot of the file.
        meeting: Stable and within the specification.
        faults: Number of runs with each fault.
        influences: The unknowns that are open, the strongest first.
        explained: Fraction of the variance that the linear regression explains, adjusted for its number of terms; None with too
            few runs.
        worst: The run furthest from the specification.
    """

    study: Study
    judged: tuple[Row, ...]
    nominal: Row
    meeting: RunFraction
    stable: RunFraction
    faults: dict[str, int]
    percentiles: dict[int, float]
    influences: tuple[Influence, ...]
    explained: float | None
    worst: Row

    @property
    def title(self) -> str:
        """The study in words."""
        notch = "with" if any(self.study.filters.values()) else "without"
        return f"{self.study.words}, {notch} notch, {len(self.judged)} plants"

    @property
    def results(self) -> Real:
        """Results run by run; see `Study.result`."""
        return np.array([self.study.result(each) for each in self.judged])


def summarise(study: Study, judged: Sequence[Row], nominal: Row) -> Summary:
    """Summarise the runs of a study, at least one."""
    values = np.array([study.result(each) for each in judged])
    bad = -values if study.is_by_area else values
    found, explained = influences(study, judged, values)
    faults = [text(each, "faults").split() for each in judged]
    return Summary(
        study=study,
        judged=tuple(judged),
        nominal=nominal,
        meeting=run_fraction(sum(each["meets"] is True for each in judged), len(judged)),
        stable=run_fraction(sum(not each for each in faults), len(judged)),
        faults=dict(sorted(Counter(chain.from_iterable(faults)).items())),
        percentiles=percentiles(values, PERCENTILES),
        influences=found,
        explained=explained,
        worst=judged[int(np.argmax(bad))],
    )


def influences(study: Study, judged: Sequence[Row], values: Real) -> tuple[tuple[Influence, ...], float | None]:
    """Return the unknowns by influence, and the explained variance.

    The order is that of the rank correlation with the result; a regression gives the variance.
    """
    unknowns = [unknown for unknown in study.unknowns if unknown.is_open(study.spread)]
    if len(judged) < FEWEST_RUNS or not unknowns or np.ptp(scipy.stats.rankdata(values)) == 0.0:
        return (), None
    columns = [np.array(numbers(judged, unknown.name)) for unknown in unknowns]
    coefficients, explained = _regression(unknowns, columns, values)
    found = []
    for unknown, column, coefficient in zip(unknowns, columns, coefficients, strict=True):
        correlation, p_value = _angle_correlation(column, values) if _is_angle(unknown) else _correlation(column, values)
        low, high = _interval(correlation, len(judged), is_signed=not _is_angle(unknown))
        clear = p_value < (1.0 - CONFIDENCE) / len(unknowns)
        found.append(Influence(unknown.name, unknown.label, correlation, low, high, p_value, coefficient, clear))
    return tuple(sorted(found, key=lambda each: -abs(each.correlation))), explained


def _is_angle(unknown: Unknown) -> bool:
    return unknown.name.endswith("_deg")


def _correlation(column: Real, values: Real) -> tuple[float, float]:
    """Return Spearman's ρ, 0 for a constant column, and its p-value."""
    if np.ptp(column) == 0.0:
        return 0.0, 1.0
    found: Any = scipy.stats.spearmanr(column, values)
    return float(found.statistic), float(found.pvalue)


def _angle_correlation(degrees: Real, values: Real) -> tuple[float, float]:
    """Return the correlation of values with an angle, and its p-value.

    It is the multiple correlation of the values' ranks with cosine and sine of the angle; the p-value is by the F test.

    R² = (r_c² + r_s² − 2 r_c r_s r_cs)/(1 − r_cs²).

    Source: K. V. Mardia, Linear-circular correlation coefficients and rhythmometry, Biometrika 63 (1976).
    """
    angle, ranks, n = np.radians(degrees), scipy.stats.rankdata(values), len(values)
    matrix = np.corrcoef([ranks, np.cos(angle), np.sin(angle)])
    c, s, both = float(matrix[0, 1]), float(matrix[0, 2]), float(matrix[1, 2])
    square = min(1.0, max(0.0, (c * c + s * s - 2.0 * c * s * both) / (1.0 - both * both)))
    ratio = math.inf if square == 1.0 else (n - 3) * square / (2.0 * (1.0 - square))
    return math.sqrt(square), float(scipy.stats.f.sf(ratio, 2, n - 3))


def _interval(correlation: float, n: int, *, is_signed: bool) -> tuple[float, float]:
    """Return the 95 % interval of a rank correlation.

    It is Fisher's z with the standard error √((1 + ρ²/2)/(n − 3)) for ranks.

    Source: D. G. Bonett and T. A. Wright, Sample size requirements for correlations, Psychometrika 65 (2000).
    """
    z = math.atanh(min(0.999999, max(-0.999999, correlation)))
    reach = float(scipy.stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) * math.sqrt((1.0 + 0.5 * correlation**2) / (n - 3))
    low, high = math.tanh(z - reach), math.tanh(z + reach)
    return (low if is_signed else max(0.0, low)), high


def _regression(unknowns: Sequence[Unknown], columns: Sequence[Real], values: Real) -> tuple[list[float | None], float | None]:
    """Return standardised regression coefficients and the adjusted R².

    The linear regression has all unknowns at once, and uses finite results only.
    """
    finite = np.isfinite(values)
    terms, owners = [], []
    for number, (unknown, column) in enumerate(zip(unknowns, columns, strict=True)):
        parts = [np.cos(np.radians(column)), np.sin(np.radians(column))] if _is_angle(unknown) else [column]
        for part in parts:
            terms.append(part[finite])
            owners.append(number)
    n, count = int(np.count_nonzero(finite)), len(terms)
    if n < 2 * count or np.ptp(values[finite]) == 0.0:
        return [None] * len(unknowns), None
    x = np.array([_standard(term) for term in terms]).T
    y = _standard(values[finite])
    found, *_ = np.linalg.lstsq(x, y, rcond=None)
    left = float(np.sum((y - x @ found) ** 2)) / float(np.sum(y**2))
    by_owner: list[list[float]] = [[] for _ in unknowns]
    for owner, coefficient in zip(owners, found, strict=True):
        by_owner[owner].append(float(coefficient))
    coefficients: list[float | None] = [each[0] if len(each) == 1 else math.hypot(*each) for each in by_owner]
    return coefficients, 1.0 - left * (n - 1) / (n - 1 - count)


def _standard(column: Real) -> Real:
    deviation = float(np.std(column))
    return np.zeros_like(column) if deviation == 0.0 else (column - np.mean(column)) / deviation


def document(summary: Summary) -> dict[str, Any]:
    """Return the summary for JSON.

    Infinite numbers are null. It is the same on any machine and number of processes.
    """
    study = summary.study
    return {
        "robot": study.robot.name,
        "experiment": "line-motion" if study.axis is None else "constant-acceleration",
        "axis": study.axis,
        "seed": study.seed,
        "runs": len(summary.judged),
        "sync_period_s": study.robot.sync_period_s,
        "f_al_hz": study.f_al_hz,
        "specification": {"area_reduction_percent": study.area_reduction_percent}
        if study.is_by_area
        else {"tip_peak_mm": study.tip_mm},
        "gains": {str(number): asdict(cascade) for number, cascade in study.cascades.items()},
        "filters": {str(number): [asdict(notch) for notch in notches] for number, notches in study.filters.items()},
        "spread": study.spread.model_dump(),
        "meeting": asdict(summary.meeting),
        "stable": asdict(summary.stable),
        "faults": summary.faults,
        "percentiles": {str(percent): finite(value) for percent, value in summary.percentiles.items()},
        "nominal": run_document(study, summary.nominal),
        "worst": run_document(study, summary.worst),
        "influences": [asdict(each) for each in summary.influences],
        "explained": summary.explained,
    }


def run_document(study: Study, row: Row) -> dict[str, Any]:
    """Return one run for JSON."""
    results = {name: finite(row[name]) for name in RESULTS}
    return results | {
        "faults": text(row, "faults").split(),
        "values": {unknown.name: row[unknown.name] for unknown in study.unknowns},
    }


def finite(value: Value) -> Value:
    """Return the value if JSON can express it, else None."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def draws_csv(summary: Summary) -> str:
    """Return a CSV line per run: index, judgement, and all drawn values."""
    return csv_text([{name: _cell(value) for name, value in row.items()} for row in summary.judged])


def _cell(value: Value) -> Value:
    """Return a value with nine digits; truth values are 1 and 0."""
    return int(value) if isinstance(value, bool) else f"{value:.9g}" if isinstance(value, float) else value
