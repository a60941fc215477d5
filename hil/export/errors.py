"""Exports that cannot be made."""

from hil.errors import FileProblemError


class ExportError(FileProblemError):
    """A source has nothing for the file, or contradictory units."""
