"""The fields by which the control period speaks to a drive."""

from dataclasses import dataclass
from typing import Any

from plant_emulator.motion.axes import Axes, live


@dataclass(frozen=True, slots=True)
class AxisSignals:
    """Live columns of `MOTION` (see there), each an array over the rows of the axes."""

    trip: Any
    event: Any
    limited: Any
    stopped: Any
    following_count: Any

    @classmethod
    def of(cls, axes: Axes) -> "AxisSignals":
        """The columns of these axes."""
        return cls(*(live(axes.motion, name) for name in ("trip", "event", "limited", "stopped", "following_count")))
