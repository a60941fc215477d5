"""Tables of reports: cells, numbers as text, and a table as Markdown."""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from markupsafe import Markup

NONE = "–"


@dataclass(frozen=True)
class Mark:
    """Yes, no or not judged, shown by colour, sign and word.

    Attributes:
        value: True for yes, False for no, None for not judged.
        text: Word beside the sign.
    """

    value: bool | None
    text: str = ""

    def __str__(self) -> str:
        """The word alone, for a terminal or Markdown."""
        return self.text or {True: "yes", False: "no", None: "not judged"}[self.value]


Cell = str | Mark
T = TypeVar("T")
Columns = Sequence[tuple[str, Callable[[T], Cell]]]
"""Columns of a table: heading, and cell of a thing."""


@dataclass(frozen=True)
class ReportTable:
    """One table.

    Attributes:
        text_columns: Indices of left-aligned columns.
        caption: Sentences below the table.
        paper: Corresponding table of the paper; empty for none.
        is_prose: True if text wraps, and a row becomes a block on a narrow screen.
        groups: Headings inside the table, by the row below each.
    """

    key: str
    title: str
    header: tuple[str, ...]
    rows: list[list[Cell]]
    text_columns: Collection[int] = (0,)
    caption: str = ""
    paper: str = ""
    is_prose: bool = False
    groups: Mapping[int, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """False without a row: no page shows it."""
        return bool(self.rows)

    def texts(self) -> list[tuple[str, ...]]:
        """Return header and rows for a terminal, with headings as rows."""
        rows: list[Sequence[Cell]] = [self.header]
        for index, row in enumerate(self.rows):
            rows += [(self.groups[index], *[""] * (len(self.header) - 1))] if index in self.groups else []
            rows.append(row)
        return [tuple(cell.striptags() if isinstance(cell, Markup) else str(cell) for cell in row) for row in rows]

    def markdown(self) -> str:
        """Return the table as Markdown, with headings as rows."""
        lines = [_markdown(self.header), f"|{'---|' * len(self.header)}"]
        for index, row in enumerate(self.rows):
            if index in self.groups:
                lines.append(f"| **{self.groups[index]}** |{' |' * (len(self.header) - 1)}")
            lines.append(_markdown(row))
        return "\n".join(lines)


def tabulate(
    key: str, title: str, columns: Columns[T], things: Iterable[T], caption: str = "", text_columns: Collection[int] = (0,)
) -> ReportTable:
    """Tabulate things, one in each row."""
    rows: list[list[Cell]] = [[cell(each) for _, cell in columns] for each in things]
    header = tuple(heading for heading, _ in columns)
    return ReportTable(key, title, header, rows, text_columns, caption)


def _markdown(cells: Sequence[Cell]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


_NEGATIVE_ZERO = re.compile(r"-0(\.0*)?(?![\d.])")


def number(value: float | str | bool | None, form: str = "{:.3g}") -> str:
    """Format a number for a cell; a dash for None."""
    if value is None:
        return NONE
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if math.isnan(value):
        return NONE
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = form.format(value)
    return (text[1:] if _NEGATIVE_ZERO.match(text) else text).replace("-", "−")


def vector_text(unit: Sequence[float]) -> str:
    """Format a direction in space.

    >>> vector_text((1.0, 0.0, -0.5))
    '(1.00, 0.00, −0.50)'
    """
    return f"({', '.join(f'{part:.2f}' for part in unit)})".replace("-", "−")


def with_error(value: float | None, error: float | None) -> str:
    """Format value ± standard error as one text, the value alone without an error."""
    if value is None:
        return NONE
    return number(value, "{:.4g}") if error is None or not error > 0.0 else " ± ".join(value_and_error(value, error))


def value_and_error(value: float, error: float) -> tuple[str, str]:
    """Format value and standard error to the error's first digit.

    Without an error, to at most four digits.

    >>> value_and_error(48.9745, 0.0432), value_and_error(-0.00067115, 0.00008), value_and_error(12.5, 0.0)
    (('48.97', '0.04'), ('−0.00067', '0.00008'), ('12.5', '0'))
    >>> value_and_error(-0.2, 5.0)
    ('0', '5')
    """
    if not error > 0.0 or not math.isfinite(error) or not math.isfinite(value):
        return number(value, "{:.4g}"), number(error)
    digits = max(0, -math.floor(math.log10(float(f"{error:.0e}"))))
    return number(value, f"{{:.{digits}f}}"), number(error, f"{{:.{digits}f}}")
