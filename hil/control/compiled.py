"""The one door to the compiler: functions compiled by numba, cached on disk by the content of their sources."""

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core import config as numba_config

P = ParamSpec("P")
R = TypeVar("R")

_CONTROL = Path(__file__).parent


def _digest(*folders: Path) -> str:
    """A short hash of every source in the folders and below them.

    numba looks at the file of the compiled function alone; what it inlines from another file may change unseen. A cache
    folder named after all the sources that can be inlined cannot be stale.
    """
    digest = hashlib.sha256()
    for folder in dict.fromkeys(folders):
        for source in sorted(folder.rglob("*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


_digests: dict[Path, str] = {}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of numbers and arrays to machine code on its first call, and keep the code on disk.

    Strict IEEE arithmetic (no fast-math): the host and the emulated drive must compute the same bits.
    """
    folder = Path(inspect.getfile(function)).resolve().parent
    if folder not in _digests:
        _digests[folder] = _digest(_CONTROL, folder)
    settings: Any = numba_config  # its attributes come from the environment at run time
    before = settings.CACHE_DIR
    settings.CACHE_DIR = str(folder / "__pycache__" / f"compiled-{_digests[folder]}")
    try:
        wrapped: Callable[P, R] = numba.njit(cache=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = before
    return wrapped
