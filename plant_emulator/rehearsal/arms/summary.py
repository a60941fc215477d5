"""Summary of a rehearsal of arms."""

from collections.abc import Sequence

import numpy as np

from hil.report.pages.page import Section, filled_sections
from hil.report.report_table import Cell, ReportTable
from plant_emulator.rehearsal.arms.conditions import NAMES
from plant_emulator.rehearsal.many.claims import RehearsalClaim, part_claim
from plant_emulator.rehearsal.many.reading import is_quiet
from plant_emulator.rehearsal.many.rows import WALKED
from plant_emulator.rehearsal.many.tables import claims
from plant_emulator.trials.rows import Row, numbers, text

QUIET_FRACTION = 0.9
"""Smallest part of the arms whose tip becomes quiet in all conditions."""
WORDS = {
    "line": "the learnt line",
    "beside": "a line beside the learnt one",
    "elsewhere": "another line from the same start",
    "no_payload": "without the payload",
    "half_payload": "with half of the payload",
    "quick": "in 0.8 × the time",
    "slow": "in 1.4 × the time",
}


def arm_claims(rows: Sequence[Row]) -> list[RehearsalClaim]:
    """Return all claims, judged on these rows."""
    worse = [row for row in rows if row.get("is_worse") is True]
    quiet, on_line = sum(map(is_quiet, rows)), sum(row.get("line_quiet") is True for row in rows)
    broken = [row for row in rows if row.get("walk") != WALKED]
    asked = "at most 0.010 mm along x, y and z, or 1.3 × that without transmission errors, whichever is more"
    return [
        RehearsalClaim(
            "never_worse", "never worse", "Never worse: in no condition does the true tip rise in any direction by more "
            "than 5 % or 0.002 mm, whichever is more", "0", f"{len(worse)} of {len(rows)} arms", not worse,
        ),
        part_claim(
            "quiet_line", "quiet on the learnt line", f"On the line that the cancellation was learnt on: {asked}",
            on_line, len(rows), QUIET_FRACTION,
        ),
        part_claim(
            "quiet_all", "quiet in all conditions", f"On that line and, unchanged, in all other conditions: {asked}",
            quiet, len(rows), QUIET_FRACTION,
        ),
        RehearsalClaim(
            "whole", "internal errors", "Every path runs to its end", "0", f"{len(broken)} of {len(rows)}", not broken,
        ),
    ]  # fmt: skip


def arm_sections(rows: Sequence[Row], found: Sequence[RehearsalClaim]) -> list[Section]:
    """Return the chapters of the page."""
    return filled_sections(("result", "Result", [claims(found), arm_tips(rows)]))


def arm_tips(rows: Sequence[Row]) -> ReportTable:
    """Return the true tip in its worst direction, by condition.

    The table has medians in mm, and the largest value with the learnt cancellation.
    """
    cells: list[list[Cell]] = []
    for name in NAMES:
        own = [row for row in rows if f"tip_{name}_none_worst_mm" in row]
        if not own:
            continue
        middle = {
            treatment: float(np.median(numbers(own, f"tip_{name}_{treatment}_worst_mm") or [np.nan]))
            for treatment in ("none", "learnt", "floor")
        }
        most = max(numbers(own, f"tip_{name}_learnt_worst_mm"), default=float("nan"))
        quiet = sum(row.get(f"{name}_is_quiet") is True for row in own)
        worse = sum(name in text(row, "worse").split(", ") for row in own)
        shown = [f"{value:.4f}" for value in (middle["none"], middle["learnt"], most, middle["floor"])]
        cells.append([WORDS[name], *shown, f"{quiet} of {len(own)}", str(worse)])
    header = ("Condition", "Untreated, median", "Learnt, median", "Learnt, largest", "No error, median", "Quiet", "Worse")
    caption = "Largest displacement of the tip in its worst direction, mm, in the judged band and times, on a quiet sensor."
    return ReportTable("arms-table", "True tip of arms (mm)", header, cells, caption=caption)
