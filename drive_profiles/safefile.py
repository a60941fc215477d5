"""Files that are there whole or not at all, whatever happens while they are written."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from drive_profiles.errors import FileError, Problem, RefusedError


def write_atomically(path: Path, data: bytes, *, force: bool = False) -> None:
    """Write a file by way of a temporary one: fsync, rename, fsync of the folder.

    Args:
        path: The file; its folder is made. Of a link, the file that it names.
        data: Its contents.
        force: Replace what is there.

    Raises:
        RefusedError: It is there already.
        FileError: It cannot be written.
    """
    try:
        if not force and path.exists():
            raise RefusedError(f"{path} is there already; choose another name, or --force")
        if path.exists() and not path.is_file():
            problem = Problem(0, "", "is no file that could be replaced", "a file")
            raise FileError(path, (problem,))
        path = path.resolve()
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less what the user's mask takes away
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        problem = Problem(0, "", f"cannot be written ({reason})", "a place that can be written")
        raise FileError(path, (problem,)) from error
