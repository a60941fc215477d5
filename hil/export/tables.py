"""Files of numbers over time: MF4, Parquet and MCAP.

Their packages are loaded only to write one.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.errors import ExportError, MissingPackageError
from hil.export.series import TIME, Series, unit_of

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
PIECE = 20_000
"""Rows that are put into words at once."""


def write_mf4(path: Path, series: Sequence[Series]) -> None:
    """Write an MF4 file: a channel group for each of the series.

    Raises:
        MissingPackageError: asammdf is not installed.
    """
    try:
        import asammdf  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingPackageError(path, "asammdf", "mf4") from None
    with asammdf.MDF(version="4.10") as file:
        for each in series:
            signals = [
                asammdf.Signal(samples=values, timestamps=each.time_s, name=name, unit=unit_of(name))
                for name, values in each.columns.items()
            ]
            file.append(signals, acq_name=each.name, common_timebase=True)
        file.save(path, overwrite=True, compression=0)


def write_parquet(path: Path, series: Sequence[Series]) -> None:
    """Write a Parquet file with a row for each stamp.

    Columns of other frames are empty in a row. Rows of several series are put in the order of their stamps.

    Raises:
        MissingPackageError: pyarrow is not installed.
        ExportError: Two of the series have a column of one name.
    """
    try:
        import pyarrow as arrow  # noqa: PLC0415 - an extra
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise MissingPackageError(path, "pyarrow", "parquet") from None
    time = np.concatenate([each.time_s for each in series])
    order = np.argsort(time, kind="stable")

    def column(values: Real, is_there: NDArray[np.bool_] | None = None) -> Any:
        # arrow.array would load pandas to ask whether this is one of its arrays
        held = None if is_there is None else arrow.py_buffer(np.packbits(is_there, bitorder="little"))
        return arrow.Array.from_buffers(arrow.float64(), len(values), [held, arrow.py_buffer(np.ascontiguousarray(values))])

    columns: dict[str, Any] = {TIME: column(time[order])}
    begin = 0
    for each in series:
        place = np.full(len(time), -1, np.int64)
        place[begin : begin + len(each.time_s)] = np.arange(len(each.time_s))
        begin += len(each.time_s)
        rows = place[order]
        for name, values in each.columns.items():
            if name in columns:
                raise ExportError(path, f"two columns are named {name}")
            columns[name] = column(values[np.maximum(rows, 0)], None if rows.min(initial=0) >= 0 else rows >= 0)
    fields = [arrow.field(name, arrow.float64(), metadata={"unit": unit_of(name)}) for name in columns]
    table = arrow.Table.from_arrays(list(columns.values()), schema=arrow.schema(fields))
    arrow.parquet.write_table(table, path)


def write_mcap(path: Path, series: Sequence[Series]) -> None:
    """Write an MCAP file with a channel for each series.

    JSON messages with their schema, in the order of their stamps.

    Raises:
        MissingPackageError: mcap is not installed.
        ExportError: A time stamp is below 0, which MCAP cannot hold.
    """
    try:
        from mcap.writer import Writer  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingPackageError(path, "mcap", "mcap") from None
    earliest_s = min((float(each.time_s.min()) for each in series if len(each.time_s)), default=0.0)
    if earliest_s < 0.0:
        raise ExportError(path, f"the earliest time stamp is {earliest_s:g} s; MCAP holds none below 0; write a .parquet file")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="hil-bench")
        channels = []
        for each in series:
            schema = writer.register_schema(each.name, "jsonschema", json.dumps(json_schema(each)).encode())
            channels.append(writer.register_channel(f"/{each.name}", "json", schema))
        time = np.concatenate([each.time_s for each in series])
        of_series = np.concatenate([np.full(len(each.time_s), number) for number, each in enumerate(series)])
        texts = [in_words(each) for each in series]
        for row in np.argsort(time, kind="stable"):
            number = int(of_series[row])
            stamp = round(float(time[row]) * 1e9)
            writer.add_message(channels[number], stamp, next(texts[number]).encode(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def json_schema(series: Series) -> dict[str, Any]:
    """Return the JSON Schema of a row; a missing number is null."""
    properties = {TIME: {"type": "number"}} | {
        name: {"type": ["number", "null"], "description": unit_of(name)} for name in series.columns
    }
    return {"$schema": SCHEMA_DIALECT, "title": series.name, "type": "object", "properties": properties}


def in_words(series: Series, stamp_name: str = TIME) -> Iterator[str]:
    """Rows as JSON objects, all digits of every number in them."""
    names = [stamp_name, *series.columns]
    template = "{" + ",".join(f"{json.dumps(name)}:%s" for name in names) + "}"
    for begin in range(0, len(series.time_s), PIECE):
        pieces = [_texts(values[begin : begin + PIECE]) for values in (series.time_s, *series.columns.values())]
        yield from (template % row for row in zip(*pieces, strict=True))


def _texts(values: Real) -> Iterable[str]:
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(~np.isfinite(values)):
        texts[int(row)] = "null"
    return texts
