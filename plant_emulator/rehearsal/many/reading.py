"""Access to rows by the names of their columns."""

from collections.abc import Sequence

from hil.robot_tables import ORDERS
from plant_emulator.trials.rows import Row, number, text

ENDED = ("done", "noted", "refused", "stopped", "crashed", "skipped")
"""Ends of a step, from the best; `noted` is done with less than was asked."""
IS_DONE = frozenset({"done", "noted"})

TREATED = ("notch_designed", "cancellation", "cancellation_learnt")
"""Treatments that the path chooses by its measurements; it never chooses the copied notch."""


def is_done(row: Row, step: str) -> bool:
    """Return True if the step has its result."""
    return text(row, f"{step}_ended") in IS_DONE


def tips_mm(row: Row, treatment: str) -> dict[int, float]:
    """Return the true tip by order under a treatment or `floor`.

    Orders whose resonance the motion does not pass are left out, unless it passes none at all.
    """
    found = {order: number(row, f"tip_{treatment}_k{order}_mm") for order in ORDERS}
    return {order: value for order, value in found.items() if value is not None}


def worst_tip_mm(row: Row, treatment: str) -> float | None:
    """Return the true tip of the worst order."""
    return max(tips_mm(row, treatment).values(), default=None)


def is_quiet(row: Row) -> bool:
    """Return True if the path's true tip meets the goal."""
    return row.get("is_quiet") is True


def accepted(row: Row) -> list[str]:
    """Return the accepted treatments whose true tip is known."""
    return [name for name in TREATED if is_done(row, name) and tips_mm(row, name)]


def of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return the rows of a kind's robots."""
    return [row for row in rows if row.get("kind") == kind]
