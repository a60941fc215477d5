"""Reading of a user's file, whole and of bounded size.

Only regular files are read, since a pipe or a device could block the reader.
"""

import os
import stat
from pathlib import Path

from drive_profiles.errors import FileError, Problem

_OPENING = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY"))
"""Flags of the opening: it neither waits nor takes a terminal. Windows has neither flag, nor FIFOs in its folders."""
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def read_file(path: Path, expected: str, *, max_bytes: int) -> bytes:
    """Read the bytes of a file; links are followed.

    A FIFO or a device is refused before it is opened: to open one may wait for ever, and may do something. `expected` is the
    wanted file in a message's words.

    Raises:
        FileError: It is not a file, is larger than `max_bytes`, or cannot be read.
    """
    try:
        _refuse_all_but_files(path, path.stat().st_mode, expected)
        # what stood there may have been replaced meanwhile: even then the opening does not wait
        descriptor = os.open(path, _OPENING)
        with os.fdopen(descriptor, "rb") as file:
            _refuse_all_but_files(path, os.fstat(descriptor).st_mode, expected)
            data = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise FileError(path, (Problem(0, "", f"cannot be read ({reason})", expected),)) from error
    if len(data) > max_bytes:
        most = f"{max_bytes >> 20} MiB" if max_bytes >> 20 else f"{max_bytes} bytes"
        raise FileError(path, (Problem(0, "", f"is larger than {most}", expected),))
    return data


def kind_of(mode: int) -> str:
    """Return the words for what is no regular file, by its `st_mode`."""
    return _KINDS.get(stat.S_IFMT(mode), "something else")


def _refuse_all_but_files(path: Path, mode: int, expected: str) -> None:
    if not stat.S_ISREG(mode):
        raise FileError(path, (Problem(0, "", f"cannot be read: it is {kind_of(mode)}, not a file", expected),))
