"""What is asked of the robot in one run, and what the run left."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.errors import SafetyStopError
from hil.master.lateness import Timing
from hil.recording import Recording

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """What is asked of the robot in one run.

    Attributes:
        axes: Axis numbers, in the order of the columns.
        time_s: From 0, one row per SYNC; shape (n,).
        motor_angle_rad: Relative to where each axis starts; shape (n, axes).
        starts_at_home: The motion is one of the tool, so it begins where all motor angles are zero; else where the axis stands.
        torque_offset_nm: Added to the torque of the loop that the drive closes (60B2h), shape (n, axes); None: nothing is mapped.
    """

    axes: tuple[int, ...]
    time_s: Real
    motor_angle_rad: Real
    starts_at_home: bool
    torque_offset_nm: Real | None = None

    @property
    def period_s(self) -> float:
        """The SYNC period, whole nanoseconds."""
        return float(round((self.time_s[1] - self.time_s[0]) * 1e9) / 1e9)


@dataclass(frozen=True)
class RunResult:
    """What a run left.

    Attributes:
        recording: What the master received; shorter than the motion where it was stopped.
        cycles: SYNCs of the motion.
        missed_cycles: Cycles of the motion in which an answer did not come.
        sensor_missed: Cycles of the motion without the accelerometer.
        wall_s: What the whole run took, set-up, settling, return and restoration included.
        motion_s: How long the motion lasts in the bench's time.
        control_period_s: Sampling time of the loop.
        stopped: Why it was stopped, or None.
        dropped_cycles: Cycles of the motion whose set-points were not sent in time: none in lock-step.
        timing: How well the beat of the wall clock was kept in the whole run; None in lock-step, where there is none.
        bus_errors: What the controller has told of errors on the bus meanwhile, in words, and how often.
        discarded: Positions that could not be, and were forgotten.
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
    timing: Timing | None = None
    bus_errors: dict[str, int] = field(default_factory=dict)
    discarded: int = 0
