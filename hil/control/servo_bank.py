"""The laws of several axes in one compiled call, which the host makes in every cycle when it closes their loops."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled
from hil.control.records import Rows
from hil.control.servo import LAW, LawRow, ServoConfig, servo_start, servo_step


@compiled
def bank_step(laws: Rows[LawRow], period_s: float, values: NDArray[np.float64]) -> None:
    """One sample of `servo_step` for every axis.

    Args:
        laws: `LAW` array, shape (n_axes,).
        period_s: Sampling time.
        values: Rows θ_ref, θ_m and τ_max in, then τ and the zero frequency of the first filter (0 while it is out) out;
            shape (5, n_axes).
    """
    for row in range(len(laws)):
        law = laws[row]
        values[3, row] = servo_step(law, period_s, values[2, row], values[0, row], 0.0, 0.0, values[1, row])
        first = law.notch_state[0]
        values[4, row] = first.frequency_hz if first.active != 0 else 0.0


class ServoBank:
    """The laws of several axes with their states.

    Attributes:
        notch_hz: Zero frequency of each axis' first filter after the last step, 0 while it is out.
    """

    def __init__(self, configs: Sequence[ServoConfig], period_s: float) -> None:
        """Lay out the arrays; every axis starts at angle 0, speed 0 and torque 0.

        Raises:
            ValueError: `period_s` is not above zero.
        """
        if not period_s > 0.0:
            raise ValueError(f"period_s = {period_s} must be above 0")
        count = len(configs)
        self.period_s = period_s
        self.notch_hz = [0.0] * count
        self._laws = np.zeros(count, LAW)
        self._each = list(self._laws)  # views: the compiled law knows a record again by its identity
        self._values = np.zeros((5, count))
        for row, config in enumerate(configs):
            config.write(self._each[row])
            self._values[2, row] = config.torque_limit_nm

    def __len__(self) -> int:
        """Number of axes."""
        return len(self.notch_hz)

    def start(self, row: int, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Let one axis take over at this angle and speed while this torque acts, without a step in the torque.

        Args:
            row: Index of the axis.
            motor_angle: θ_m in rad.
            speed_rad_s: The motor's speed.
            torque_nm: The torque that acts now.
        """
        servo_start(self._each[row], motor_angle, speed_rad_s, torque_nm)

    def step(self, positions: Sequence[float], motor_angles: Sequence[float]) -> list[float]:
        """Torques in N·m of all axes, from references and measured motor angles in rad."""
        values = self._values
        values[0], values[1] = positions, motor_angles
        bank_step(self._laws, self.period_s, values)
        torques, self.notch_hz = values[3:].tolist()
        return torques  # type: ignore[no-any-return] # tolist() of an array gives whatever it holds

    def step_one(self, row: int, position: float, motor_angle: float) -> float:
        """Torque in N·m of one axis, from its reference and motor angle in rad; the other laws keep their state."""
        limit_nm = float(self._values[2, row])
        return servo_step(self._each[row], self.period_s, limit_nm, position, 0.0, 0.0, motor_angle)
