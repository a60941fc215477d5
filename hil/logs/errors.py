"""Logs that cannot be read."""

from pathlib import Path

from hil.errors import HilError


class LogError(HilError):
    """The file is not a log of a bus, or has no frames."""

    exit_code = 3

    def __init__(self, path: Path, what: str) -> None:
        """Keep file and reason."""
        self.path, self.what = path, what
        super().__init__(f"{path}: {what}")
