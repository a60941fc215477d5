"""Recordings as MF4 of measuring systems.

asammdf is loaded only to read one.
"""

import contextlib
import gc
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.control.arrays import Real
from hil.errors import MissingPackageError, RecordingFileError
from hil.recordings.source import MOST_ROWS, at_stamps

TIME = "time_s"
"""Name under which the channels' own time is offered."""


class MdfFile:
    """An MF4 file, whose channels have stamps of their own."""

    def __init__(self, path: Path) -> None:
        """Read the names.

        Raises:
            MissingPackageError: asammdf is not installed.
            RecordingFileError: The file cannot be read.
        """
        self.path = path
        with self._opened() as file:
            self.names = (TIME, *(name for name in file.channels_db if name != TIME))

    def columns(self, names: Sequence[str]) -> dict[str, Real]:
        """Return channels by name at the stamps of the first one.

        All of shape (n,).

        Raises:
            RecordingFileError: A channel cannot be read, holds no numbers, or is in the file more than once.
        """
        with self._opened() as file:
            return self._columns(file, names)

    def _columns(self, file: Any, names: Sequence[str]) -> dict[str, Real]:
        found: dict[str, Real] = {}
        stamps: Real | None = None
        for name in (each for each in names if each != TIME):
            found_at = file.channels_db[name]
            if len(found_at) > 1:
                raise RecordingFileError(self.path, f"{name!r} names {len(found_at)} channels")
            channel = self._channel(file, name, *found_at[0])
            values = np.asarray(channel.samples)
            if values.ndim != 1 or not np.issubdtype(values.dtype, np.number):
                raise RecordingFileError(self.path, f"the channel {name!r} holds {values.dtype}; expected numbers")
            if len(values) > MOST_ROWS:
                raise RecordingFileError(self.path, f"more than {MOST_ROWS} rows")
            own = np.asarray(channel.timestamps, dtype=np.float64)
            if stamps is None:
                stamps = own
            found[name] = at_stamps(self.path, name, stamps, own, values.astype(np.float64))
        if TIME in names and stamps is not None:
            found[TIME] = stamps
        return found

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the file, and close it at the end.

        Otherwise it keeps its descriptor until the garbage collection.
        """
        try:
            import asammdf  # noqa: PLC0415 - an extra
        except ImportError:
            raise MissingPackageError(self.path, "asammdf", "mf4") from None
        problem = None
        with _unheard():
            try:
                file = asammdf.MDF(self.path)
            except Exception as error:  # noqa: BLE001 - the package raises whatever its parser meets
                problem = f"not an MF4 file, or cut off: {error}"
        if problem is not None:
            raise RecordingFileError(self.path, problem)
        with contextlib.closing(file):
            yield file

    def _channel(self, file: Any, name: str, group: int, index: int) -> Any:
        try:
            return file.get(name, group=group, index=index)
        except Exception as error:  # as above
            raise RecordingFileError(self.path, f"the channel {name!r} cannot be read: {error}") from error


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Suppress the traceback of a half-opened file's deletion."""
    told = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        gc.collect()
        sys.unraisablehook = told
