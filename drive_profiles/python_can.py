"""Import of python-can without its slow readers of MF4 files.

If asammdf is installed, `import can` imports it (and `import canopen` imports `can`), which takes about ten times as long as
the rest of python-can. Few programs read MF4 logs; they load the readers when they need them.
"""

import importlib
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

PACKAGE = "asammdf"
READERS = "can.io.mf4"


class _NotYet(MetaPathFinder):
    """Finder that hides asammdf while python-can imports its MF4 module."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find nothing, so that the other finders are asked.

        Raises:
            ModuleNotFoundError: python-can asks for the package as it is imported.
        """
        importing: Any = sys.modules.get(READERS)
        if fullname == PACKAGE and importing is not None and not hasattr(importing, "MF4Reader"):
            raise ModuleNotFoundError(f"{PACKAGE} is loaded when an MF4 file is opened", name=fullname)
        return None


def postpone_mf4() -> None:
    """Let this process import python-can without asammdf.

    A program that does so calls `with_mf4` before it opens an MF4 file.
    """
    if not any(isinstance(finder, _NotYet) for finder in sys.meta_path):
        sys.meta_path.insert(0, _NotYet())


def with_mf4() -> None:
    """Load python-can's MF4 readers and writers; without asammdf they say so."""
    readers: Any = importlib.import_module(READERS)
    if readers.asammdf is not None:
        return
    try:
        importlib.import_module(PACKAGE)
    except ImportError:
        return
    importlib.reload(readers)  # the classes that `can` has registered look their names up in this very module
