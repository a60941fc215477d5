"""Errors of recordings from elsewhere."""

from pathlib import Path
from typing import ClassVar

from hil.errors import FileProblemError, HilError


class RecordingFileError(FileProblemError, ValueError):
    """A recording, or a given layout, cannot be used."""


class MissingPackageError(HilError):
    """A format needs a package that is not installed."""

    exit_code: ClassVar[int] = 3

    def __init__(self, path: Path, package: str, extra: str) -> None:
        """Keep the file, the package and the extra that installs it."""
        self.path, self.package, self.extra = path, package, extra
        super().__init__(f"{path}: this format needs {package}, which is not installed: pip install 'hil-bench[{extra}]'")
