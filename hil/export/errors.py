"""Exports that cannot be made."""

from pathlib import Path
from typing import ClassVar

from hil.errors import HilError


class ExportError(HilError):
    """A source has nothing for the file, or contradictory units."""

    exit_code: ClassVar[int] = 3

    def __init__(self, path: Path, problem: str) -> None:
        """Keep the file and the defect."""
        self.path, self.problem = path, problem
        super().__init__(f"{path}: {problem}")
