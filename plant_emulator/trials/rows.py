"""Rows: the results of trials, as plain values by column name.

A trial is a function of a module: it takes a seed or an index, and gives a row. Tables of rows are written as CSV and, if
pyarrow is installed, as Parquet.
"""

import csv
import importlib.util
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drive_profiles.files.reading import read_file
from drive_profiles.files.safefile import write_atomically

if TYPE_CHECKING:
    from numpy.typing import NDArray

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


MAX_BYTES = 64 << 20
"""Longest table that is read, with room for 100 000 robots."""


def columns_of(rows: Sequence[Row]) -> list[str]:
    """Return the columns of all rows, each once, in order."""
    found: dict[str, None] = {}
    for row in sorted(rows, key=len, reverse=True):  # the row that has most shows the order
        found |= dict.fromkeys(row)
    return list(found)


def csv_text(rows: Sequence[Row]) -> str:
    """Return rows as CSV (RFC 4180 with line feeds).

    Numbers have all their digits; truth values are yes and no; None is empty.
    """
    columns = columns_of(rows)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row.get(column)) for column in columns] for row in rows)
    return out.getvalue()


def columns_csv(columns: Mapping[str, "Sequence[float] | NDArray[Any]"]) -> str:
    """Return columns of numbers as CSV, with ten digits."""
    lines = (",".join(f"{value:.10g}" for value in row) for row in zip(*map(list, columns.values()), strict=True))
    return "\n".join([",".join(columns), *lines, ""])


def read_rows(path: Path) -> list[Row]:
    """Read rows that `csv_text` has written; all cells are text, empty ones None.

    Raises:
        FileError: It cannot be read.
    """
    text = read_file(path, "a table of robots", max_bytes=MAX_BYTES).decode("utf-8", "replace")
    return [{str(name): cell or None for name, cell in row.items()} for row in csv.DictReader(io.StringIO(text), restval="")]


def _cell(value: Value) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def parquet_bytes(rows: Sequence[Row]) -> bytes:
    """Return rows as Parquet.

    The cells decide whether a column has whole numbers, numbers, truth values or text.

    Raises:
        ImportError: pyarrow is not installed.
    """
    import pyarrow  # noqa: PLC0415 - an extra
    import pyarrow.parquet  # noqa: PLC0415

    arrays = {}
    for column in columns_of(rows):
        cells = [row.get(column) for row in rows]
        kinds = {type(cell) for cell in cells if cell is not None}
        if kinds == {int, float}:
            cells = [None if cell is None else float(cell) for cell in cells]
        elif len(kinds) > 1:
            cells = [None if cell is None else _cell(cell) for cell in cells]
        arrays[column] = pyarrow.array(cells, type=None if kinds else pyarrow.string())
    out = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(pyarrow.table(arrays), out)
    return bytes(out.getvalue().to_pybytes())


TABLES = ("robots.csv", "robots.parquet")
"""Files of a table."""


def write_table(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write `robots.csv` and, if possible, `robots.parquet`; return the files.

    Raises:
        FileError: A file cannot be written.
    """
    written = [folder / TABLES[0]]
    write_atomically(written[0], csv_text(rows).encode(), force=True)
    if importlib.util.find_spec("pyarrow") is not None:
        written.append(folder / TABLES[1])
        write_atomically(written[1], parquet_bytes(rows), force=True)
    return written
