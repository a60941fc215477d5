"""The one table of a rehearsal: a line per robot, as CSV, and as Parquet where pyarrow is installed."""

import csv
import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path

from drive_profiles.files.safefile import write_atomically
from plant_emulator.rehearsal.many.rows import Row, Value


def columns_of(rows: Sequence[Row]) -> list[str]:
    """Columns of all rows, each once, in the order in which the rows bring them."""
    found: dict[str, None] = {}
    for row in sorted(rows, key=len, reverse=True):  # the row that has most shows the order
        found |= dict.fromkeys(row)
    return list(found)


def csv_text(rows: Sequence[Row]) -> str:
    """Rows as CSV (RFC 4180 with line feeds): numbers with all their digits, yes and no, empty for none."""
    columns = columns_of(rows)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row.get(column)) for column in columns] for row in rows)
    return out.getvalue()


def _cell(value: Value) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def has_parquet() -> bool:
    """True if Parquet can be written: pyarrow is installed (the extra `parquet`)."""
    return importlib.util.find_spec("pyarrow") is not None


def parquet_bytes(rows: Sequence[Row]) -> bytes:
    """Rows as Parquet: a column of whole numbers, numbers, truth values or text, by what its cells are.

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


def write_table(folder: Path, rows: Sequence[Row], *, force: bool = True) -> list[Path]:
    """Write `robots.csv`, and `robots.parquet` where that can be; return the files.

    Raises:
        RefusedError: A file is there already, and `force` is not given.
        FileError: A file cannot be written.
    """
    written = [folder / "robots.csv"]
    write_atomically(written[0], csv_text(rows).encode(), force=force)
    if has_parquet():
        written.append(folder / "robots.parquet")
        write_atomically(written[1], parquet_bytes(rows), force=force)
    return written
