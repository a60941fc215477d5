"""Numbers against time, as they go into files of other programs."""

from dataclasses import dataclass
from pathlib import Path

from hil.control.arrays import Real
from hil.recording import Recording

SUFFIXES = {"rad": "rad", "m_s2": "m/s²", "nm": "N·m", "hz": "Hz", "s": "s", "rad_s": "rad/s", "per_mille": "‰"}
"""Units by the ending of a column's name; the longest that fits counts."""
TIME = "time_s"


@dataclass(frozen=True)
class Series:
    """Columns with common stamps.

    Attributes:
        time_s: Stamps; shape (n,).
        columns: Numbers by name with their unit as in a recording; each of shape (n,).
    """

    name: str
    time_s: Real
    columns: dict[str, Real]


def unit_of(column: str) -> str:
    """Return the unit of a column by its suffix, or "".

    >>> unit_of("axis2_position_rad"), unit_of("tip_x_m_s2"), unit_of("missing")
    ('rad', 'm/s²', '')
    """
    fits = [suffix for suffix in SUFFIXES if column.endswith(f"_{suffix}")]
    return SUFFIXES[max(fits, key=len)] if fits else ""


def of_recording(path: Path) -> Series:
    """The columns of a recording of `hil run`.

    Raises:
        ValueError: The file is not a recording.
    """
    recording = Recording.load(path)
    return Series(path.stem, recording.time_s, {name: values for name, values in recording.columns.items() if name != TIME})
