"""Report of late imports and compilation while a robot is served.

An import takes milliseconds to seconds, the compiler seconds. Meanwhile the whole bus is silent: heartbeats are missing, and
other nodes report the master as lost. So `serve` loads everything before the first frame, and then seals its process.

A sealed process still loads what is missing, since a robot that stops is better than one that ends. It reports the fact on
standard error, which every test that serves a robot checks.
"""

import contextlib
import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from hil.control.compiled import watched

LATE = "loaded while the robot was served:"
"""Words with which a complaint begins."""


class _Imports(MetaPathFinder):
    """Import hook that finds nothing and reports every late import."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._said: set[str] = set()

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find nothing; the next finder does."""
        if fullname not in self._said:
            self._said.add(fullname)
            self._say(f"{LATE} module {fullname}, and the bus was silent meanwhile")
        return None


@contextlib.contextmanager
def sealed(say: Callable[[str], None]) -> Iterator[None]:
    """Report imports, loading and compilation in this context.

    Each module or function is reported once.

    Objects that exist at the start are excluded from garbage collection: traversing the 200 000 objects of a served robot
    takes 150 ms.

    Args:
        say: Called with each report.
    """
    imports = _Imports(say)
    gc.freeze()
    sys.meta_path.insert(0, imports)
    try:
        with watched(lambda name: say(f"{LATE} machine code of {name}, and the bus was silent meanwhile")):
            yield
    finally:
        sys.meta_path.remove(imports)
        gc.unfreeze()
