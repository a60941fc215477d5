"""Request of an identification from recordings, and its errors."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from hil.design.recorded.fit import AngleSection
from hil.design.recorded.stretches import MotionStretch
from hil.errors import HilError
from hil.recordings.layout import Said
from hil.recordings.reading import Recorded
from hil.robot_tables import ORDERS

MOST_STRETCHES = 64
"""Bound: stretches that are fitted of all files together, the longest first; and files, since each has one at least."""
MOST_SAMPLES = 20_000
"""Bound: samples of a stretch: of more the neighbours are averaged."""


class RecordedAteError(HilError):
    """Error: the recordings do not show the transmission error."""

    exit_code: ClassVar[int] = 9


class ContradictedError(HilError, ValueError):
    """Error: the recordings contradict their description."""

    exit_code: ClassVar[int] = 3


@dataclass(frozen=True)
class RecordedRequest:
    """Request of an identification from recordings.

    Attributes:
        said: Given columns, ratio and robot.
        sensorless: True if the motor's torque is taken even where an acceleration was recorded.
    """

    files: tuple[Path, ...]
    axis: int
    said: Said
    orders: tuple[float, ...] = ORDERS
    sensorless: bool = False

    def __post_init__(self) -> None:
        """Refuse an impossible request."""
        if not self.files:
            raise ValueError("no recording is named; at least 1 is needed")
        if len(self.files) > MOST_STRETCHES:
            raise ValueError(f"{len(self.files)} recordings are too many; at most {MOST_STRETCHES} are allowed")


@dataclass(frozen=True)
class FoundStretch:
    """Stretch of one of the recordings.

    Attributes:
        file: Number of its file.
        section: The same rows with the waves that are fitted to them.
    """

    file: int
    recorded: Recorded
    stretch: MotionStretch
    section: AngleSection
