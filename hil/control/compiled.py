"""The one door to the compiler: functions compiled by numba, kept on disk by the content of their sources."""

import hashlib
import inspect
from collections.abc import Callable
from functools import cached_property, update_wrapper
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

from hil.control import machine_code

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


class Compiled(Generic[P, R]):
    """A function that runs as machine code: from disk if it is there, otherwise compiled now and put there.

    Strict IEEE arithmetic (no fast-math): the host and the emulated drive must compute the same bits.

    Attributes:
        py_func: The function as it was written.
        loaded: How many kinds of arguments are served from disk.
    """

    def __init__(self, function: Callable[P, R], *, inline: bool = False) -> None:
        """Nothing is compiled or loaded yet; with `inline` it becomes part of each compiled caller."""
        update_wrapper(self, function)
        self.py_func = function
        self.loaded = 0
        self._inline = inline
        self._entries: dict[tuple[str | None, ...], Callable[..., R]] = {}
        self._latest: Callable[..., R] | None = None

    def _folder(self) -> Path:
        folder = Path(inspect.getfile(self.py_func)).resolve().parent
        if folder not in _digests:
            _digests[folder] = _digest(_CONTROL, folder)
        return folder / "__pycache__" / f"compiled-{_digests[folder]}"

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba has it; what cannot run without numba, it keeps in the same folder."""
        import numba  # noqa: PLC0415 - a second or two, and not needed for what lies on disk
        from numba.core import config  # noqa: PLC0415

        settings: Any = config  # its attributes come from the environment at run time
        before = settings.CACHE_DIR
        settings.CACHE_DIR = str(self._folder())
        try:
            return numba.njit(cache=not self._inline, error_model="numpy", forceinline=self._inline)(self.py_func)
        finally:
            settings.CACHE_DIR = before

    @property
    def _numba_type_(self) -> Any:
        """What numba takes it for where another compiled function calls it."""
        return (self._part if self._inline else self.dispatcher)._numba_type_

    @cached_property
    def _part(self) -> Any:
        """The function as part of its callers: without the entry points for Python and C, a quarter of the compiler's time."""
        import numba  # noqa: PLC0415 - see `dispatcher`

        settings: dict[str, Any] = {"error_model": "numpy", "forceinline": True}
        settings |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return numba.njit(**settings)(self.py_func)

    def _entry(self, arguments: tuple[Any, ...]) -> Callable[..., R]:
        kinds = tuple(map(machine_code.kind, arguments))
        entry = self._entries.get(kinds)
        if entry is None:
            self._entries[kinds] = entry = self._made(kinds, arguments)
        return entry

    def _made(self, kinds: tuple[str | None, ...], arguments: tuple[Any, ...]) -> Any:
        known = tuple(each for each in kinds if each is not None)
        if len(known) < len(kinds):
            return self.dispatcher
        path = self._folder() / machine_code.file_name(self.py_func.__qualname__, known)
        entry = machine_code.load(path, known)
        if entry is not None:
            self.loaded += 1
            return entry
        fresh = self._compile(arguments)
        return (fresh and self._saved(path, known, fresh)) or self.dispatcher

    @staticmethod
    def _saved(path: Path, kinds: tuple[str, ...], fresh: Any) -> Any:
        """What runs without numba, or None: a numba whose insides are others only starts more slowly."""
        try:
            return machine_code.save(path, kinds, fresh)
        except (AttributeError, KeyError, LookupError, RuntimeError, TypeError, ValueError):
            return None

    def _compile(self, arguments: tuple[Any, ...]) -> Any:
        """The result of numba, or None where it comes from numba's own files, which hold no more than it needs itself."""
        import numba  # noqa: PLC0415 - see `dispatcher`

        types = tuple(map(numba.typeof, arguments))
        self.dispatcher.compile(types)
        return self.dispatcher.overloads[types] if types not in self.dispatcher.stats.cache_hits else None

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """Run it; arguments by position alone."""
        if named:
            raise TypeError(f"{self.py_func.__name__} takes its arguments by position")
        if self._latest is not None:
            try:
                return self._latest(*arguments)
            except machine_code.OtherKindError:
                pass
        self._latest = self._entry(arguments)
        return self._latest(*arguments)


def compiled(function: Callable[P, R]) -> Compiled[P, R]:
    """Compile a function of numbers and arrays to machine code on its first call, and keep the code on disk."""
    return Compiled(function)


def inlined(function: Callable[P, R]) -> Compiled[P, R]:
    """`compiled`, and part of the machine code of each compiled function that calls it.

    A call hands over an array as seven numbers and a tuple as all of its own, on the stack: two thirds of a control period
    went into that.
    """
    return Compiled(function, inline=True)
