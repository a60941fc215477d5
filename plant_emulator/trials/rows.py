"""Rows: the results of trials, as plain values by column name.

A trial is a function of a module: it takes a seed or an index, and gives a row.
"""

import math
from collections.abc import Iterable, Mapping

Value = str | int | float | bool | None
Row = Mapping[str, Value]


def steady(row: Row) -> dict[str, Value]:
    """Return the columns that follow from the seed alone.

    Columns of processor time differ between machines and days, and are left out.
    """
    return {name: value for name, value in row.items() if not name.endswith("cpu_s")}


def plain(value: object) -> Value:
    """Return the value for a row; non-finite numbers become None.

    Raises:
        TypeError: It is neither text, number, truth value nor None.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if (item := getattr(value, "item", None)) is not None:  # a scalar of numpy
        return plain(item())
    raise TypeError(f"{value!r} is not a value of a row")


def number(row: Row, name: str) -> float | None:
    """Return the number of a cell, or None."""
    value = row.get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def text(row: Row, name: str) -> str:
    """Return the text of a cell, or ""."""
    value = row.get(name)
    return value if isinstance(value, str) else ""


def numbers(rows: Iterable[Row], name: str) -> list[float]:
    """Return all numbers of a column."""
    return [value for row in rows if (value := number(row, name)) is not None]
