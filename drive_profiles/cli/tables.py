"""Tables of the three tools as aligned text.

A cell wraps between words; where even that is too wide, or takes more lines, each row becomes a block of its own. What does not
go to a terminal has a line for each row, as wide as it is. Machines read `--json`.
"""

import re
import textwrap
from collections.abc import Sequence

GAP = 2
_NUMBER = re.compile(r"[-+−]?(\d[\d.,]*|\.\d+)(e[-+]?\d+)?( ?[%‰])?|[-–?]|", re.IGNORECASE)


def lines(header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Return a table's lines: header, on a terminal a rule, and rows.

    `width` has the columns of the terminal; None: as many as it takes. A table without a header has empty names.
    """
    cells = [[" ".join(cell.split()) for cell in row] for row in (header, *rows)]
    widths = _widths([list(column) for column in zip(*cells, strict=True)], width)
    if widths is None:
        return _blocks(cells[0], cells[1:], width or 0)
    columns = [[row[i] for row in cells[1:]] for i in range(len(cells[0]))]
    right = [i > 0 and any(column) and all(map(_NUMBER.fullmatch, column)) for i, column in enumerate(columns)]
    shown = [line for row in cells[1:] for line in _row(row, widths, right)]
    if not any(cells[0]):
        return shown
    if width is not None and len(shown) > len(rows):
        blocks = _blocks(cells[0], cells[1:], width)
        if len(blocks) < len(shown):
            return blocks
    rule = [] if width is None else [(" " * GAP).join("─" * each for each in widths)]
    return [*_row(cells[0], widths, right), *rule, *shown]


def _widths(columns: list[list[str]], width: int | None) -> list[int] | None:
    """Return each column's width; None if words would have to be broken."""
    widths = [max(map(len, column)) for column in columns]
    least = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    if width is None:
        return widths
    room = width - GAP * (len(columns) - 1)
    if sum(least) > room:
        return None
    if widths[0] + sum(least[1:]) <= room:
        least[0] = widths[0]  # the name of a row is left whole where it can be
    while sum(widths) > room:
        widest = max((i for i in range(len(widths)) if widths[i] > least[i]), key=lambda i: widths[i])
        widths[widest] -= 1
    return widths


def _row(row: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> list[str]:
    wrapped = [_wrap(cell, width) for cell, width in zip(row, widths, strict=True)]
    shown = []
    for number in range(max(map(len, wrapped))):
        parts = [cell[number] if number < len(cell) else "" for cell in wrapped]
        padded = [part.rjust(w) if r else part.ljust(w) for part, w, r in zip(parts, widths, right, strict=True)]
        shown.append((" " * GAP).join(padded).rstrip())
    return shown


def _blocks(header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return each row as a block.

    Its first cell comes first, a number with its column's name, then the others after theirs, as many on a line as fit.
    """
    shown = []
    for row in rows:
        shown += _wrap(f"{header[0]} {row[0]}".lstrip() if row[0].isdecimal() else row[0], width)
        line = ""
        for name, cell in zip(header[1:], row[1:], strict=True):
            part = f"{name}: {cell}" if name else cell
            if line and cell and len(line) + 3 + len(part) > width - GAP:
                shown += _wrap(line, width, indent="  ")
                line = ""
            line += f"{' · ' if line and cell else ''}{part if cell else ''}"
        shown += _wrap(line, width, indent="  ")
    return shown


def _wrap(text: str, width: int, indent: str = "") -> list[str]:
    return textwrap.wrap(
        text, max(width, 1), break_long_words=False, break_on_hyphens=False, initial_indent=indent, subsequent_indent=indent * 2
    ) or [""]
