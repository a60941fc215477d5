"""Logs that cannot be read."""

from hil.errors import FileProblemError


class LogError(FileProblemError):
    """The file is not a log of a bus, or has no frames."""
