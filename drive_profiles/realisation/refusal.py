"""Refusal of a design that a drive cannot hold."""

from __future__ import annotations

from drive_profiles.errors import DriveProfileError


class NotRealisableError(DriveProfileError):
    """A design that the drive cannot hold, or that lacks facts.

    It is refused, never clamped.

    Args:
        profile: Name of the drive's profile.
        reasons: All reasons, each with the values.
    """

    exit_code = 9

    def __init__(self, profile: str, reasons: tuple[str, ...]) -> None:
        self.profile = profile
        self.reasons = reasons
        super().__init__(f"{profile}: {'; '.join(reasons)}")
