"""Declarations of a core to Python: cffi's text and numbers.

Both come from the headers.

It is written when the core is built, so that a program that starts does not wait for a parser of C.
"""

import contextlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

_INCLUDE = re.compile(r'#include "([^"]+)"')
_NUMBER = re.compile(r"#define (\w+) (-?[\d.]+(?:e-?\d+)?)\s")
_BODY = re.compile(r"^INLINED .*?^}\n", re.MULTILINE | re.DOTALL)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def _headers(path: Path, root: Path, known: dict[Path, str]) -> None:
    """Read a header and those that it includes into `known`."""
    if path in known:
        return
    text = path.read_text(encoding="utf-8")
    known[path] = ""
    for name in _INCLUDE.findall(text):
        beside = path.parent / name
        _headers(beside if beside.exists() else root / name, root, known)
    del known[path]
    known[path] = text


def _declarations(text: str) -> Iterator[str]:
    """Yield the lines of a header that declare something."""
    wanted = [True]
    for line in _BODY.sub("", _COMMENT.sub("", text)).splitlines():
        word = line.split(maxsplit=1)[0] if line.strip() else ""
        if word in {"#ifdef", "#ifndef"}:
            wanted.append(word == "#ifndef")
        elif word == "#else":
            wanted[-1] = not wanted[-1]
        elif word == "#endif":
            wanted.pop()
        elif not word.startswith("#") and all(wanted):
            yield line


def declarations(root: Path, header: str) -> tuple[str, dict[str, float]]:
    """Return the declarations and numbers of a header, includes followed.

    Args:
        root: Folder against which includes are resolved that do not lie beside their header.
        header: Path of the header below it.
    """
    headers: dict[Path, str] = {}
    _headers(root / header, root, headers)
    text = _COMMENT.sub(" ", "".join(headers.values()))
    numbers = {name: float(number) for name, number in _NUMBER.findall(text)}
    return "\n".join(line for each in headers.values() for line in _declarations(each)), numbers


def module_text(root: Path, header: str, digest: str) -> str:
    """Return the source of the module that declares a core to Python."""
    import cffi  # noqa: PLC0415 - only those who build need its parser

    text, numbers = declarations(root, header)
    ffi = cffi.FFI()
    ffi.cdef(text)
    ffi.set_source("core_abi", None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "core_abi.py")
        with contextlib.redirect_stdout(None):  # it says what it writes
            ffi.emit_python_code(str(path))
        return f"{path.read_text(encoding='utf-8')}\nCONSTANTS = {numbers!r}\nSOURCES = {digest!r}\n"
