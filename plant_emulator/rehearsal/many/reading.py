"""Rows as they are read: numbers, steps, tips and quantities of a robot by the names of their columns."""

from collections.abc import Iterable, Sequence

from hil.robot_tables import ORDERS
from plant_emulator.rehearsal.many.rows import Row

ENDED = ("done", "noted", "refused", "stopped", "crashed", "skipped")
"""Ends of a step, from the best; `noted` is done with less than was asked."""
IS_DONE = frozenset({"done", "noted"})

TREATED = ("notch_designed", "cancellation", "cancellation_learnt")
"""Treatments that the path chooses by what it measures; the copied notch is nobody's choice."""


def number(row: Row, name: str) -> float | None:
    """Number of a cell; None if there is none."""
    value = row.get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def text(row: Row, name: str) -> str:
    """Text of a cell; empty where there is none."""
    value = row.get(name)
    return value if isinstance(value, str) else ""


def numbers(rows: Iterable[Row], name: str) -> list[float]:
    """All numbers of a column."""
    return [value for row in rows if (value := number(row, name)) is not None]


def is_done(row: Row, step: str) -> bool:
    """True if the step has its result."""
    return text(row, f"{step}_ended") in IS_DONE


def tips_mm(row: Row, treatment: str) -> dict[int, float]:
    """True tip by order under a treatment or `floor`; only orders whose resonance the motion passes."""
    found = {order: number(row, f"tip_{treatment}_k{order}_mm") for order in ORDERS}
    return {order: value for order, value in found.items() if value is not None}


def worst_tip_mm(row: Row, treatment: str) -> float | None:
    """True tip of the worst order."""
    return max(tips_mm(row, treatment).values(), default=None)


def is_quiet(row: Row) -> bool:
    """True if the path ends with a true tip within the goal."""
    return row.get("is_quiet") is True


def accepted(row: Row) -> list[str]:
    """Treatments that the path accepted and whose true tip is known."""
    return [name for name in TREATED if is_done(row, name) and tips_mm(row, name)]


def of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Rows of the robots of a kind."""
    return [row for row in rows if row.get("kind") == kind]
