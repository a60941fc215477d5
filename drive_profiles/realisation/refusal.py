"""The refusal of what a drive cannot hold, with its reasons."""

from __future__ import annotations

from drive_profiles.errors import DriveProfileError


class NotRealisableError(DriveProfileError):
    """The drive cannot hold what was designed, or it is not known how it would. It is refused, never clamped.

    Args:
        profile: Name of the drive's profile.
        reasons: All of them, each with the values.
    """

    exit_code = 9

    def __init__(self, profile: str, reasons: tuple[str, ...]) -> None:
        self.profile = profile
        self.reasons = reasons
        super().__init__(f"{profile}: {'; '.join(reasons)}")
