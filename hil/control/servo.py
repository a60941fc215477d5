"""The servo law of one axis for a caller in Python."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.cascade import Cascade
from hil.control.notch import NO_NOTCH, NOTCHES, FixedFilter, Notch
from hil.core.library import CORE

LAW = CORE.dtype("law")


@dataclass(frozen=True)
class ServoConfig:
    """Settings of one axis' law.

    Raises:
        ValueError: More notches than an axis has, or a torque limit that is not above zero.
    """

    cascade: Cascade
    torque_limit_nm: float
    notches: tuple[Notch | FixedFilter, ...] = ()

    def __post_init__(self) -> None:
        """Refuse settings that the law cannot run."""
        if len(self.notches) > NOTCHES:
            raise ValueError(f"{len(self.notches)} notches; an axis has {NOTCHES}")
        if not self.torque_limit_nm > 0.0:
            raise ValueError(f"torque_limit_nm = {self.torque_limit_nm} must be above 0")

    def write(self, law: NDArray[Any]) -> None:
        """Write gains and filters into one record of a `LAW` array."""
        self.cascade.write(law["cascade_config"])
        for column in range(NOTCHES):
            notch: Notch | FixedFilter = self.notches[column] if column < len(self.notches) else NO_NOTCH
            notch.write(law["notch_config"][column])


class Servo:
    """Law of one axis with its state.

    Attributes:
        notch_state: The filters' memory, live: a `NOTCH_STATE` array of shape (1, NOTCHES).
    """

    def __init__(self, config: ServoConfig, period_s: float) -> None:
        if not period_s > 0.0:
            raise ValueError(f"period_s = {period_s} must be above 0")
        self.config = config
        self.period_s = period_s
        laws = np.zeros(1, LAW)
        self.notch_state = laws["notch_state"]
        config.write(laws[0])
        self._law, self._step = CORE.pointer(laws, "law"), CORE.call.servo_step

    def start(self, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Take over at this angle and speed without a torque step.

        The given torque is the one that acts now.
        """
        CORE.call.servo_start(self._law, motor_angle, speed_rad_s, torque_nm)

    def step(self, position: float, motor_angle: float, velocity_offset: float = 0.0, torque_offset: float = 0.0) -> float:
        """One sample of the law.

        Args:
            position: θ_ref in rad.
            motor_angle: θ_m in rad, as measured.
            velocity_offset: θ̇_ff in rad/s.
            torque_offset: Added behind the filter, in N·m.

        Returns:
            The torque command in N·m.
        """
        limit_nm = self.config.torque_limit_nm
        torque_nm: float = self._step(self._law, self.period_s, limit_nm, position, velocity_offset, torque_offset, motor_angle)
        return torque_nm
