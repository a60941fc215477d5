"""Table of a cancellation's trials: expected and actual effect of each order."""

from collections.abc import Iterable

from hil.report.report_table import Cell, Mark, ReportTable, number, value_and_error
from hil.results.runs import TrialPart

HEADER = ("", "Order", "Expected fall (%)", "Fall (%)", "± (%)", "Remaining (%)", "± (%)", "Factor", "Change of φ (°)", "Verdict")


def trial_table(key: str, title: str, parts: Iterable[tuple[str, TrialPart]]) -> ReportTable:
    """Table of the verdicts of one or more trials; None without any."""
    rows = [_row(name, part) for name, part in parts]
    caption = (
        "A cancellation is tried in part, on all axes and on each alone, then in full. Each order of each axis is judged by its "
        "own amplitude at the tip. Only accepted orders are used: a refused one is wrong, and one that is not judged has too "
        "little effect to be seen above the sensor's noise. Factor and change of φ: the corrections that amplitude and phase of "
        "the cancellation need."
    )
    return ReportTable(key, title, HEADER, rows, {0, 1, 9}, caption)


def _row(name: str, part: TrialPart) -> list[Cell]:
    mark = {"accepted": True, "refused": False, "not judged": None}[part.verdict]
    return [
        name,
        f"axis {part.axis}, k = {part.order:g}",
        number(100.0 * part.expected_fall_fraction, "{:.0f}"),
        *_both(100.0 * part.fall_fraction, 100.0 * part.fall_error),
        *_both(100.0 * part.left_fraction, 100.0 * part.left_error),
        " ± ".join(_both(part.factor, part.factor_error)),
        " ± ".join(_both(part.turn_deg, part.turn_error_deg)),
        Mark(mark, part.verdict),
    ]


def _both(value: float | None, error: float | None) -> tuple[str, str]:
    """Return a value and its standard error, or two dashes."""
    if value is None or error is None or not 0.0 < error < TOO_LARGE:
        return "–", "–"
    return value_and_error(value, error)


TOO_LARGE = 1e4
"""Standard error, in percent, of what says nothing."""
