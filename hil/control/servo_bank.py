"""The laws of several axes in one compiled call: what the host runs in every cycle when it closes their loops."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.control.cascade import CASCADE_CONFIG, CASCADE_STATE, cascade_start
from hil.control.compiled import compiled
from hil.control.notch import NO_NOTCH, NOTCH_CONFIG, NOTCH_STATE, NOTCHES, FixedFilter, Notch
from hil.control.servo import ServoConfig, servo_step


@compiled
def bank_step(
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
    period_s: float,
    values: Any,
) -> None:
    """One sample of `servo_step` for every axis.

    Args:
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
        period_s: Sampling time.
        values: Rows θ_ref, θ_m and τ_max in, then τ and the zero frequency of the first filter (0 while it is out) out;
            shape (5, n_axes).
    """
    for row in range(cascade_config.shape[0]):
        values[3, row] = servo_step(
            cascade_config,
            cascade_state,
            notch_config,
            notch_state,
            row,
            period_s,
            values[2, row],
            values[0, row],
            0.0,
            0.0,
            values[1, row],
        )
        first = notch_state[row, 0]
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
        self._cascade_config = np.zeros(count, CASCADE_CONFIG)
        self._cascade_state = np.zeros(count, CASCADE_STATE)
        self._notch_config = np.zeros((count, NOTCHES), NOTCH_CONFIG)
        self._notch_state = np.zeros((count, NOTCHES), NOTCH_STATE)
        self._values = np.zeros((5, count))
        for row, config in enumerate(configs):
            config.cascade.write(self._cascade_config[row])
            self._values[2, row] = config.torque_limit_nm
            for column in range(NOTCHES):
                notch: Notch | FixedFilter = config.notches[column] if column < len(config.notches) else NO_NOTCH
                notch.write(self._notch_config[row, column])

    def __len__(self) -> int:
        """How many axes."""
        return len(self.notch_hz)

    def start(self, row: int, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Let one axis take over at this angle and speed while this torque acts, without a bump."""
        cascade_start(self._cascade_state, row, motor_angle, speed_rad_s, torque_nm)
        self._notch_state[row] = 0
        self._notch_state["speed_rps"][row] = abs(speed_rad_s) / (2.0 * math.pi)
        self._notch_state["mean_nm"][row] = torque_nm

    def step(self, positions: Sequence[float], motor_angles: Sequence[float]) -> list[float]:
        """One sample of all: references and measured motor angles in rad in, torques in N·m out."""
        values = self._values
        values[0], values[1] = positions, motor_angles
        bank_step(self._cascade_config, self._cascade_state, self._notch_config, self._notch_state, self.period_s, values)
        torques, self.notch_hz = values[3:].tolist()
        return torques  # type: ignore[no-any-return] # tolist() of an array gives whatever it holds

    def step_one(self, row: int, position: float, motor_angle: float) -> float:
        """One sample of one axis, the others left where they are."""
        return servo_step(
            self._cascade_config,
            self._cascade_state,
            self._notch_config,
            self._notch_state,
            row,
            self.period_s,
            float(self._values[2, row]),
            position,
            0.0,
            0.0,
            motor_angle,
        )
