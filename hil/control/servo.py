"""The servo law, whole: P-PI, notches on the torque command, torque limit and anti-windup. Host and drive run this."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.control.cascade import (
    CASCADE_CONFIG,
    CASCADE_STATE,
    Cascade,
    cascade_start,
    cascade_step,
    hold_integrator,
    observe_speed,
)
from hil.control.compiled import inlined
from hil.control.notch import NO_NOTCH, NOTCH_CONFIG, NOTCH_STATE, NOTCHES, FixedFilter, Notch, notch_step


@inlined
def servo_step(
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
    row: int,
    period_s: float,
    torque_limit_nm: float,
    position: float,
    velocity_offset: float,
    torque_offset: float,
    motor_angle: float,
) -> float:
    """One sample of the law of one axis: τ = F_n(s) u + τ_offset, limited to ±τ_max.

    F_n stands on the torque command, behind the PI: that is where it opens the loop at the anti-resonance and lets the
    motor give way to the transmission error. No allocation; all state is in the arrays.

    Args:
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
        row: Axis.
        period_s: Sampling time T_s of this very loop.
        torque_limit_nm: τ_max.
        position: θ_ref in rad, motor side.
        velocity_offset: θ̇_ff in rad/s.
        torque_offset: Added behind the filter, in N·m.
        motor_angle: θ_m in rad, as measured.

    Returns:
        The torque command in N·m.
    """
    speed = observe_speed(cascade_config, cascade_state, row, period_s, motor_angle)
    u, before = cascade_step(cascade_config, cascade_state, row, period_s, position, velocity_offset)
    for column in range(notch_config.shape[1]):
        u = notch_step(notch_config, notch_state, row, column, period_s, speed, u)
    wanted = u + torque_offset
    torque = min(torque_limit_nm, max(-torque_limit_nm, wanted))
    if torque != wanted:
        hold_integrator(cascade_state, row, before, wanted - torque)
    return torque


@dataclass(frozen=True)
class ServoConfig:
    """What one axis' law is set to.

    Raises:
        ValueError: More notches than an axis has, or a torque limit that is not above zero.
    """

    cascade: Cascade
    torque_limit_nm: float
    notches: tuple[Notch | FixedFilter, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what the law cannot run."""
        if len(self.notches) > NOTCHES:
            raise ValueError(f"{len(self.notches)} notches; an axis has {NOTCHES}")
        if not self.torque_limit_nm > 0.0:
            raise ValueError(f"torque_limit_nm = {self.torque_limit_nm} must be above 0")


class Servo:
    """The law of one axis with its state, for a caller in Python: the host-closed loop, and tests."""

    def __init__(self, config: ServoConfig, period_s: float) -> None:
        """Lay out the arrays that the compiled law works on; it starts at angle 0, speed 0 and torque 0."""
        if not period_s > 0.0:
            raise ValueError(f"period_s = {period_s} must be above 0")
        self.config = config
        self.period_s = period_s
        self._cascade_config = np.zeros(1, CASCADE_CONFIG)
        self._cascade_state = np.zeros(1, CASCADE_STATE)
        self._notch_config = np.zeros((1, NOTCHES), NOTCH_CONFIG)
        self.notch_state = np.zeros((1, NOTCHES), NOTCH_STATE)
        config.cascade.write(self._cascade_config[0])
        for column in range(NOTCHES):
            notch: Notch | FixedFilter = config.notches[column] if column < len(config.notches) else NO_NOTCH
            notch.write(self._notch_config[0, column])

    def start(self, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Take over at this angle and speed while this torque acts, without a bump."""
        cascade_start(self._cascade_state, 0, motor_angle, speed_rad_s, torque_nm)
        self.notch_state[:] = 0
        # a filter that acts at this speed starts at once, on this torque
        self.notch_state["speed_rps"] = abs(speed_rad_s) / (2.0 * math.pi)
        self.notch_state["mean_nm"] = torque_nm

    def step(self, position: float, motor_angle: float, velocity_offset: float = 0.0, torque_offset: float = 0.0) -> float:
        """One sample: reference and measured motor angle in rad in, torque in N·m out."""
        return servo_step(
            self._cascade_config,
            self._cascade_state,
            self._notch_config,
            self.notch_state,
            0,
            self.period_s,
            self.config.torque_limit_nm,
            position,
            velocity_offset,
            torque_offset,
            motor_angle,
        )
