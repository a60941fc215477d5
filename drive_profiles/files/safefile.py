"""Atomic writing of files: after a crash one is complete or missing."""

import contextlib
import errno
import json
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path

from drive_profiles.errors import FileError, Problem, RefusedError


def write_atomically(path: Path, data: bytes, *, force: bool = False) -> None:
    """Write a file atomically, through a temporary file that is renamed.

    The bytes are on disk before the file has its name, and the name when this returns, where the system can say so. The folder is
    made, and a link followed.

    Raises:
        RefusedError: The file exists already, and ``force`` is not given.
        FileError: The file cannot be written.
    """
    try:
        if not force and path.exists():
            raise RefusedError(f"{path} already exists; choose another name, or give --force")
        if path.exists() and not path.is_file():
            problem = Problem(0, "", "is not a regular file and cannot be replaced", "a regular file")
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
        _sync_folder(path.parent)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unwritable(path, error) from error


def write_json(path: Path, document: object, *, force: bool = False) -> None:
    """Write a JSON document as `write_atomically` does; numbers must be finite."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(path, text.encode(), force=force)


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the file's name to an `OSError`."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


def file_instead(folder: Path) -> str:
    """Say which file stands where a folder is to be; empty if none does."""
    found = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    return f"{found} is a file; expected a folder" if found.exists() and not found.is_dir() else ""


def make_writable(folder: Path, name: str) -> None:
    """Make a folder, and check that a file can be written to it later.

    Raises:
        FileError: It cannot be made, or nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise _unwritable(folder, error) from error
    check_writable(folder / name)


def check_writable(path: Path) -> None:
    """Check, by a temporary file, that a file can be written later.

    Raises:
        FileError: Its folder is missing, or nothing can be written there, or it is not a regular file.
    """
    try:
        if path.exists() and not path.is_file():
            raise FileError(path, (Problem(0, "", "is not a regular file and cannot be replaced", "a regular file"),))
        folder = path.resolve().parent
        if not folder.is_dir():
            raise FileError(path, (Problem(0, "", f"cannot be written: there is no folder {folder}", "an existing folder"),))
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b" ")
            file.flush()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unwritable(path, error) from error


def check_folder(path: Path) -> None:
    """Check that the folder exists in which a socket or a link is to be made.

    Raises:
        FileNotFoundError: It does not.
    """
    if not (folder := path.absolute().parent).is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {folder}; make it first, or choose another path")


def _unwritable(path: Path, error: OSError | ValueError) -> FileError:
    if isinstance(error, FileExistsError | NotADirectoryError):  # from making its folder
        return FileError(path, (Problem(0, "", f"cannot be written: {file_instead(path)}", ""),))
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return FileError(path, (Problem(0, "", f"cannot be written ({reason})", "a place that can be written"),))


def _sync_folder(path: Path) -> None:
    """Bring the names in a folder to disk, where the system can."""
    try:
        folder = os.open(path, os.O_RDONLY)
    except PermissionError:  # Windows opens no folder; elsewhere a folder may be one that its user may not list
        return
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
