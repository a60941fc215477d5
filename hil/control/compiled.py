"""The only access to the compiler: functions compiled by numba, stored on disk by the content of their sources."""

import hashlib
import inspect
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

from hil.control import machine_code

P = ParamSpec("P")
R = TypeVar("R")

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(r"^(?:from ([\w.]+) )?import (?:\(([^)]*)\)|([^\n]*))", re.MULTILINE)


@cache
def _imports(source: Path, roots: tuple[Path, ...]) -> tuple[Path, ...]:
    """Sources below the roots that a source imports for all of its functions."""
    names = []
    for module, several, one in _IMPORT.findall(source.read_text(encoding="utf-8")):
        imported = re.findall(r"[\w.]+", several or one)
        names += [module, *(f"{module}.{name}" for name in imported)] if module else imported
    stems = [root.joinpath(*name.split(".")) for name in names for root in roots]
    files = [file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py")]
    return tuple(file for file in dict.fromkeys(files) if file.is_file())


@cache
def _digest(source: Path, root: Path) -> str:
    """Short hash of a source, and of all others that it imports directly or through another.

    numba looks at the file of the compiled function alone; code and constants that it inlines come from these too, so a cache
    folder of this name cannot be stale.

    Args:
        source: The file of the compiled function.
        root: The folder that holds its top-level package.
    """
    roots, found, waiting = tuple(dict.fromkeys((_ROOT, root))), {source, Path(__file__).resolve()}, [source]
    while waiting:
        new = set(_imports(waiting.pop(), roots)) - found
        found |= new
        waiting += new
    digest = hashlib.sha256()
    for file in sorted(found):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


_watchers: list[Callable[[str], None]] = []


@contextmanager
def watched(tell: Callable[[str], None]) -> Iterator[None]:
    """Tell the name of each function whose machine code is loaded or made in this context, before that is done."""
    _watchers.append(tell)
    try:
        yield
    finally:
        _watchers.remove(tell)


class Compiled(Generic[P, R]):
    """A function that runs as machine code, loaded from disk or else compiled and stored there.

    Strict IEEE arithmetic (no fast-math): the host and the emulated drive must compute the same bits.

    Attributes:
        py_func: The function as it was written.
        loaded: Number of combinations of argument types that are served from disk.
        refused: Reason why machine code was not stored, by types of arguments; numba serves those calls.
    """

    def __init__(self, function: Callable[P, R], *, inline: bool = False) -> None:
        """Wrap the function without compiling it; with `inline` it becomes part of each compiled caller."""
        update_wrapper(self, function)
        self.py_func = function
        self.loaded = 0
        self.refused: dict[tuple[str, ...], str] = {}
        self._inline = inline
        self._entries: dict[tuple[str | None, ...], Callable[..., R]] = {}
        self._latest: Callable[..., R] | None = None

    def _folder(self) -> Path:
        source = Path(inspect.getfile(self.py_func)).resolve()
        root = source.parents[self.py_func.__module__.count(".")]
        return source.parent / "__pycache__" / f"compiled-{_digest(source, root)}"

    @cached_property
    def dispatcher(self) -> Any:
        """The function compiled by numba, whose own cache is in the same folder."""
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
        """Type that numba sees where another compiled function calls this one."""
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
        for tell in tuple(_watchers):
            tell(self.py_func.__qualname__)
        known = tuple(each for each in kinds if each is not None)
        if len(known) < len(kinds):
            return self.dispatcher
        path = self._folder() / machine_code.file_name(self.py_func.__qualname__, known)
        entry = machine_code.load(path, known)
        if entry is not None:
            self.loaded += 1
            return entry
        fresh = self._compile(known, arguments)
        return (fresh and self._saved(path, known, fresh, arguments)) or self.dispatcher

    def _saved(self, path: Path, kinds: tuple[str, ...], fresh: Any, arguments: tuple[Any, ...]) -> Any:
        """Machine code that runs without numba; None if it cannot be stored, which only makes the start slower."""
        try:
            return machine_code.save(path, kinds, fresh, arguments)
        except machine_code.NotSavedError as error:
            self.refused[kinds] = str(error)
            if isinstance(error, machine_code.DifferentBitsError):
                said = f"{self.py_func.__qualname__}: machine code thrown away, numba serves instead: {error}"
                warnings.warn(said, RuntimeWarning, stacklevel=5)
        except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:  # a numba whose insides are others
            self.refused[kinds] = f"{type(error).__name__}: {error}"
        return None

    def _compile(self, kinds: tuple[str, ...], arguments: tuple[Any, ...]) -> Any:
        """Result of numba's compiler; None if it comes from numba's own cache, which lacks the LLVM code.

        A number gets the one type of its key, whatever numba would infer: code for a small unsigned integer is wrong for -1.
        """
        import numba  # noqa: PLC0415 - see `dispatcher`

        numbers = {"d": numba.float64, "q": numba.int64, "?": numba.boolean}
        pairs = zip(kinds, arguments, strict=True)
        typeof: Any = numba.typeof
        types = tuple(numbers[each] if each in numbers else typeof(argument) for each, argument in pairs)
        self.dispatcher.compile(types)
        return self.dispatcher.overloads[types] if types not in self.dispatcher.stats.cache_hits else None

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """Run the function; arguments are given by position."""
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
    """Compile as `compiled` does, and make the function part of each compiled function that calls it.

    A call passes an array as seven numbers and a tuple as all of its items, on the stack: that took two thirds of a control
    period.
    """
    return Compiled(function, inline=True)
