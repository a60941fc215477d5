"""Recordings as Parquet; pyarrow is loaded only to read one."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.control.arrays import Real
from hil.errors import MissingPackageError, RecordingFileError
from hil.recordings.source import MOST_ROWS


class ParquetFile:
    """A Parquet file of columns."""

    def __init__(self, path: Path) -> None:
        """Read the names.

        Raises:
            MissingPackageError: pyarrow is not installed.
            RecordingFileError: The file cannot be read.
        """
        try:
            import pyarrow  # noqa: PLC0415 - an extra
            import pyarrow.parquet  # noqa: PLC0415
        except ImportError:
            raise MissingPackageError(path, "pyarrow", "parquet") from None
        self.path = path
        try:
            self._file = pyarrow.parquet.ParquetFile(path)
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise RecordingFileError(path, f"not a Parquet file: {error}") from error
        self.names = tuple(map(str, self._file.schema_arrow.names))
        if self._file.metadata.num_rows > MOST_ROWS:
            raise RecordingFileError(path, f"more than {MOST_ROWS} rows: {self._file.metadata.num_rows}")

    def columns(self, names: Sequence[str]) -> dict[str, Real]:
        """Read columns of numbers by name; NaN for missing ones.

        All of shape (n,).

        Raises:
            RecordingFileError: A column holds no numbers, or the file is damaged.
        """
        import pyarrow  # noqa: PLC0415

        found: dict[str, Real] = {}
        try:
            table = self._file.read(columns=list(names))
            for name in names:
                kind = table.schema.field(name).type
                if pyarrow.types.is_timestamp(kind):  # of any resolution, since 1970
                    nanoseconds = table.column(name).cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
                    found[name] = nanoseconds.to_numpy().astype(np.float64) * 1e-9
                    continue
                if not (pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind)):
                    raise RecordingFileError(self.path, f"the column {name!r} holds {kind}; expected numbers")
                found[name] = np.asarray(table.column(name).cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            if isinstance(error, RecordingFileError):
                raise
            raise RecordingFileError(self.path, f"cannot be read: {error}") from error
        return found
