"""Fields through which the control period signals to a drive."""

from dataclasses import dataclass
from typing import Any

from plant_emulator.motion.axes import Axes, live


@dataclass(frozen=True, slots=True)
class AxisSignals:
    """Live columns of `MOTION` (see there).

    Each is an array over the rows of the axes.
    """

    trip: Any
    event: Any
    limited: Any
    stopped: Any
    following_count: Any

    @classmethod
    def of(cls, axes: Axes) -> "AxisSignals":
        """Return the columns of these axes."""
        return cls(*(live(axes.motion, name) for name in ("trip", "event", "limited", "stopped", "following_count")))
