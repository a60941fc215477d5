"""A core as Python sees it: functions and record layouts.

numpy's layouts are those of the structs that the headers describe.
"""

import importlib.util
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.core.build import LAW, BuildError, Core, build

_NUMBERS: dict[str, np.dtype[Any]] = {
    "double": np.dtype(np.float64),
    "int64_t": np.dtype(np.int64),
    "uint64_t": np.dtype(np.uint64),
    "uint8_t": np.dtype(np.uint8),
}
"""Types of numbers in the headers."""


class Library:
    """A core that is loaded.

    Attributes:
        call: The functions of the core, and the constants of its enumerations.
        constants: Numbers that its headers define, by name.
    """

    def __init__(self, core: Core) -> None:
        """Load the core; build it first if it is missing or stale.

        Raises:
            ImportError: It has to be built, and cannot be.
        """
        declared = self._declared(core)
        self.constants: dict[str, float] = declared.CONSTANTS
        self._ffi: Any = declared.ffi
        self.NULL: Any = self._ffi.NULL
        self._arrays: dict[str, tuple[np.dtype[Any], Any]] = {}
        self.call: Any = self._ffi.dlopen(str(core.library))
        if self._ffi.string(self.call.core_sources()).decode() != declared.SOURCES:
            raise ImportError(f"{core.library} and {core.declarations} were built from different sources; install again")

    @staticmethod
    def _declared(core: Core) -> ModuleType:
        """Declarations of the core, which belong to its sources."""
        digest = core.digest()
        for attempt in range(2):
            if core.library.exists() and core.declarations.exists():
                spec = importlib.util.spec_from_file_location(f"{core.name}_abi", core.declarations)
                if spec is not None and spec.loader is not None:
                    module = importlib.util.module_from_spec(spec)
                    spec.loader.exec_module(module)
                    if digest == module.SOURCES:
                        return module
            if attempt == 0:
                try:
                    build(core)
                except (BuildError, OSError) as error:
                    raise ImportError(f"{core.library} was built from other sources, and cannot be rebuilt: {error}") from None
        raise ImportError(f"{core.declarations} was built from other sources; remove it, and install again")

    @cache  # noqa: B019 - a library lives as long as the process
    def dtype(self, name: str) -> np.dtype[Any]:
        """Memory layout of a struct of the headers."""
        return self._dtype_of(self._ffi.typeof(f"struct {name}"))

    def _dtype_of(self, kind: Any) -> np.dtype[Any]:
        if kind.kind == "struct":
            fields = kind.fields
            return np.dtype(
                {
                    "names": [name for name, _ in fields],
                    "formats": [self._dtype_of(field.type) for _, field in fields],
                    "offsets": [field.offset for _, field in fields],
                    "itemsize": self._ffi.sizeof(kind),
                }
            )
        if kind.kind == "array":
            return np.dtype((self._dtype_of(kind.item), (kind.length,)))
        return _NUMBERS[kind.cname]

    def pointer(self, array: NDArray[Any] | np.void, name: str = "double") -> Any:
        """Return a pointer to an array's first element.

        It keeps the array alive, and is a C array of such elements.

        Args:
            array: The array, or one of its records; C code may write to it.
            name: Type of its elements in C: a number, or the name of a struct.

        Raises:
            ValueError: The array has other elements, or is not contiguous, or read-only.
        """
        wanted, kind = self._arrays.get(name) or self._array_of(name)
        dtype = array.dtype
        if dtype is not wanted and dtype != wanted:
            raise ValueError(f"array of {dtype} where {name} is expected")
        # a record of an array says that it is read-only, which it is not
        if not array.flags.carray and not isinstance(array, np.void):
            raise ValueError(f"array of shape {array.shape} is read-only or not contiguous; give a contiguous copy of it")
        return self._ffi.from_buffer(kind, array)

    def _array_of(self, name: str) -> tuple[np.dtype[Any], Any]:
        """Memory layout of a number or struct, and the type of its C arrays, which are kept."""
        is_number = name in _NUMBERS
        kind = self._ffi.typeof(f"{name}[]" if is_number else f"struct {name}[]")
        return self._arrays.setdefault(name, (_NUMBERS[name] if is_number else self.dtype(name), kind))

    def address(self, pointer: Any) -> int:
        """Address of a function or a record, for another core's `borrowed`."""
        return int(self._ffi.cast("uintptr_t", pointer))

    def borrowed(self, address: int, like: Any) -> Any:
        """Return a pointer to what belongs to another core.

        Args:
            address: Its address there; the caller keeps it alive.
            like: A pointer of the wanted type.
        """
        return self._ffi.cast(self._ffi.typeof(like), address)

    def integers(self, count: int) -> Any:
        """Room for whole numbers, all zero."""
        return self._ffi.new("int64_t[]", count)

    def bytes(self, count: int) -> Any:
        """Room for bytes, all zero."""
        return self._ffi.new("uint8_t[]", count)

    def new(self, name: str) -> Any:
        """A struct of the core's own, all zero."""
        return self._ffi.new(f"struct {name} *")


CORE = Library(LAW)
"""The control law, and what the bus, design, logs and the master have in C."""
