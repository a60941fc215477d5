"""Text from a forked copy of this process, made in parallel."""

import os
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable
from typing import IO

from drive_profiles.processors import usable_processors

_BEGUN: list["LaterText"] = []
"""Texts whose processes have not been waited for."""


class LaterText:
    """Text that a forked copy of this process makes, or this process.

    The copy has all memory of this process, so nothing has to be pickled. It needs Linux and a process with one thread: a lock
    that another thread holds would never be released in the copy. If the copy fails, this process makes the text when it is
    needed, and raises the error.
    """

    def __init__(self, make: Callable[[], str]) -> None:
        self._make: Callable[[], str] | None = make
        self._text = ""
        self._process = 0
        self._file: IO[bytes] | None = None
        processors = _processors()
        if processors < 2:
            self._finish()
            return
        for each in [*_BEGUN]:
            each._end(is_patient=False)
        while len(_BEGUN) >= processors:
            _BEGUN[0]._end(is_patient=True)
        self._begin(make)

    def __str__(self) -> str:
        self._end(is_patient=True)
        return self._text

    def _begin(self, make: Callable[[], str]) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed where it is read
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # threads of linear algebra, which end for the fork by themselves
            self._process = os.fork()
        if self._process == 0:
            status = 1
            try:
                self._file.write(make().encode())
                self._file.flush()
                status = 0
            finally:
                os._exit(status)
        _BEGUN.append(self)

    def _end(self, *, is_patient: bool) -> None:
        """Take the text if its process has ended, or wait for that."""
        if self._file is None:
            return
        ended, status = os.waitpid(self._process, 0 if is_patient else os.WNOHANG)
        if ended == 0:
            return
        _BEGUN.remove(self)
        with self._file as file:
            self._file = None
            if status == 0:
                file.seek(0)
                self._text, self._make = file.read().decode(), None
                return
        self._finish()

    def _finish(self) -> None:
        if self._make is not None:
            self._text, self._make = self._make(), None


def _processors() -> int:
    """Processors on which copies of this process can run."""
    if sys.platform != "linux" or threading.active_count() > 1:
        return 1
    return usable_processors()
