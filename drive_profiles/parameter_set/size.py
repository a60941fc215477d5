"""Size limit of a parameter-set file, in any format.

It ensures that every file written can be read again.
"""

from __future__ import annotations

from drive_profiles.errors import RefusedError

MAX_BYTES = 4 << 20
"""Largest file: the sections of an EDS, 20,000 at most, make a set of 2.1 MB, with 107 bytes a line."""


def check(data: bytes) -> None:
    """Refuse the bytes of a file that no reader would take.

    Raises:
        RefusedError: They are more than `MAX_BYTES`.
    """
    if len(data) > MAX_BYTES:
        raise RefusedError(
            f"the set would be a file of {len(data)} bytes; expected at most {MAX_BYTES >> 20} MiB, the largest that is read; "
            "pull fewer classes into one file (--classes)"
        )
