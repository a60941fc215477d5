"""Exports that cannot be made."""

from pathlib import Path
from typing import ClassVar

from hil.errors import HilError


class ExportError(HilError):
    """A source holds nothing that such a file could hold, or its units contradict each other."""

    exit_code: ClassVar[int] = 3

    def __init__(self, path: Path, problem: str) -> None:
        """Keep the file and what is wrong."""
        self.path, self.problem = path, problem
        super().__init__(f"{path}: {problem}")
