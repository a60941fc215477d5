"""The laws of several axes in one call.

The host makes this call in every cycle when it closes their loops.
"""

from collections.abc import Sequence

import numpy as np

from hil.control.servo import LAW, ServoConfig
from hil.core.library import CORE


class ServoBank:
    """The laws of several axes with their states."""

    def __init__(self, configs: Sequence[ServoConfig], period_s: float) -> None:
        """Lay out the arrays.

        Raises:
            ValueError: `period_s` is not above zero.
        """
        if not period_s > 0.0:
            raise ValueError(f"period_s = {period_s} must be above 0")
        count = len(configs)
        self.period_s = period_s
        laws = np.zeros(count, LAW)
        self._values = np.zeros((5, count))
        for row, config in enumerate(configs):
            config.write(laws[row])
            self._values[2, row] = config.torque_limit_nm
        self.laws, self.values = CORE.pointer(laws, "law"), CORE.pointer(self._values)
        self._each, self._limits_nm = [self.laws + row for row in range(count)], [each.torque_limit_nm for each in configs]
        self._step, self._step_one = CORE.call.bank_step, CORE.call.servo_step

    def __len__(self) -> int:
        """Number of axes."""
        return len(self._each)

    @property
    def notch_hz(self) -> list[float]:
        """Zero frequency of each axis' first filter after the last step, 0 while it is out."""
        return self._values[4].tolist()  # type: ignore[no-any-return] # tolist() of an array gives whatever it holds

    def start(self, row: int, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Let one axis take over without a step in the torque.

        Args:
            motor_angle: θ_m in rad.
            torque_nm: The torque that acts now.
        """
        CORE.call.servo_start(self._each[row], motor_angle, speed_rad_s, torque_nm)

    def step(self, positions: Sequence[float], motor_angles: Sequence[float]) -> list[float]:
        """Return the torques of all axes in N·m.

        References and measured motor angles are in rad.
        """
        values = self._values
        values[0], values[1] = positions, motor_angles
        self._step(self.laws, len(self._each), self.period_s, self.values)
        return values[3].tolist()  # type: ignore[no-any-return] # tolist() of an array gives whatever it holds

    def step_one(self, row: int, position: float, motor_angle: float) -> float:
        """Return the torque of one axis in N·m.

        Reference and motor angle are in rad; the other laws keep their state.
        """
        torque_nm: float = self._step_one(self._each[row], self.period_s, self._limits_nm[row], position, 0.0, 0.0, motor_angle)
        return torque_nm
