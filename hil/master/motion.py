"""The motion of a run and its result."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from hil.control.arrays import Real
from hil.control.notch import FixedFilter, Notch
from hil.errors import SafetyStopError
from hil.master.lateness import WallClockTiming
from hil.recording import Recording

FilterUse = Literal["none", "notch"]
"""The filters of the bench file that act in a run: none of them, or all."""


@dataclass(frozen=True)
class Motion:
    """The motion of some axes in a run.

    Attributes:
        axes: Axis numbers, in the order of the columns.
        time_s: Time from 0, one row per SYNC; shape (n,).
        motor_angle_rad: Motor angles relative to the start of each axis; shape (n, axes). The axes are brought to the first row
            before anything is recorded.
        starts_at_home: True for a motion of the tool, whose angles count from zero motor angles; else they count from the present
            position of each axis.
        torque_offset_nm: Torque added in the loop that the drive closes (60B2h), shape (n, axes); None: it is not mapped.
        returns: False for axes that remain at the end of the motion.
        excitation_rad: Part of the motor angles that excites a plant, in which no acceleration is limited; shape (n, axes); None
            without one.
    """

    axes: tuple[int, ...]
    time_s: Real
    motor_angle_rad: Real
    starts_at_home: bool
    torque_offset_nm: Real | None = None
    returns: bool = True
    excitation_rad: Real | None = None

    @property
    def period_s(self) -> float:
        """The SYNC period, whole nanoseconds."""
        return float(round((self.time_s[1] - self.time_s[0]) * 1e9) / 1e9)


@dataclass(frozen=True)
class RunResult:
    """The result of a run.

    Attributes:
        recording: Data that the master received; shorter than the motion if the run was stopped.
        sensor_missed: Cycles of the motion without the tip: accelerometer, or all encoders of the joints.
        wall_s: Duration of the whole run, set-up, settling, return and restoration included.
        dropped_cycles: Cycles of the motion whose set-points were not sent in time: none in lock-step.
        timing: Lateness of the cycles of the whole run; None in lock-step, where time waits for the master.
        bus_errors: Errors on the bus that the controller reported, in words, with their number.
        discarded: Number of impossible positions, which were ignored.
        filters: Filters that acted, by axis: as the drives held them, or those of the host's loop.
    """

    recording: Recording
    cycles: int
    missed_cycles: int
    sensor_missed: int
    wall_s: float
    motion_s: float
    control_period_s: float
    stopped: SafetyStopError | None
    dropped_cycles: int = 0
    timing: WallClockTiming | None = None
    bus_errors: dict[str, int] = field(default_factory=dict)
    discarded: int = 0
    filters: Mapping[int, tuple[Notch | FixedFilter, ...]] = field(default_factory=dict)
