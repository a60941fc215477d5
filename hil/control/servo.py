"""The whole servo law: P-PI, notches on the torque command, torque limit and anti-windup; host and drive run it."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.cascade import (
    Cascade,
    CascadeConfigRow,
    CascadeStateRow,
    cascade_start,
    cascade_step,
    hold_integrator,
    observe_speed,
)
from hil.control.compiled import inlined
from hil.control.notch import NO_NOTCH, NOTCHES, FixedFilter, Notch, NotchConfigRow, NotchStateRow, notch_step
from hil.control.records import Rows, record_dtype


class LawRow(Protocol):
    """The servo law of one axis: gains and filters, and the memory of both."""

    cascade_config: CascadeConfigRow
    cascade_state: CascadeStateRow
    notch_config: Annotated[Rows[NotchConfigRow], (NOTCHES,)]
    notch_state: Annotated[Rows[NotchStateRow], (NOTCHES,)]


LAW = record_dtype(LawRow)


@inlined
def servo_start(law: LawRow, motor_angle: float, speed_rad_s: float, torque_nm: float) -> None:
    """Take over at this angle and speed while this torque acts, without a step in the torque.

    Args:
        law: The axis' law; its memory is changed in place.
        motor_angle: θ_m in rad.
        speed_rad_s: The motor's speed.
        torque_nm: The torque that acts now.
    """
    cascade_start(law.cascade_state, motor_angle, speed_rad_s, torque_nm)
    for column in range(NOTCHES):
        s = law.notch_state[column]
        s.s1 = s.s2 = s.frequency_hz = s.zeta_rd = 0.0
        s.active = 0
        # a filter that acts at this speed starts at once, on this torque
        s.speed_rps = abs(speed_rad_s) / (2.0 * math.pi)
        s.mean_nm = torque_nm


@inlined
def servo_step(
    law: LawRow,
    period_s: float,
    torque_limit_nm: float,
    position: float,
    velocity_offset: float,
    torque_offset: float,
    motor_angle: float,
) -> float:
    """One sample of the law of one axis: τ = F_n(s) u + τ_offset, limited to ±τ_max.

    F_n stands on the torque command, behind the PI: that is where it opens the loop at the anti-resonance and lets the
    motor give way to the transmission error. No allocation; all state is in the record.

    Args:
        law: The axis' law; its memory is changed in place.
        period_s: Sampling time T_s of the loop.
        torque_limit_nm: τ_max.
        position: θ_ref in rad, motor side.
        velocity_offset: θ̇_ff in rad/s.
        torque_offset: Added behind the filter, in N·m.
        motor_angle: θ_m in rad, as measured.

    Returns:
        The torque command in N·m.
    """
    cascade, state = law.cascade_config, law.cascade_state
    speed = observe_speed(cascade, state, period_s, motor_angle)
    u, before = cascade_step(cascade, state, period_s, position, velocity_offset)
    for column in range(NOTCHES):
        u = notch_step(law.notch_config[column], law.notch_state[column], period_s, speed, u)
    wanted = u + torque_offset
    torque = min(torque_limit_nm, max(-torque_limit_nm, wanted))
    if torque != wanted:
        hold_integrator(state, before, wanted - torque)
    return torque


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
        """Put gains and filters into one record of a `LAW` array; the torque limit is an argument of `servo_step`."""
        self.cascade.write(law["cascade_config"])
        for column in range(NOTCHES):
            notch: Notch | FixedFilter = self.notches[column] if column < len(self.notches) else NO_NOTCH
            notch.write(law["notch_config"][column])


class Servo:
    """The law of one axis with its state, for a caller in Python: the host-closed loop, and tests.

    Attributes:
        notch_state: The filters' memory, live: a `NOTCH_STATE` array of shape (1, NOTCHES).
    """

    def __init__(self, config: ServoConfig, period_s: float) -> None:
        """Lay out the record that the compiled law works on; it starts at angle 0, speed 0 and torque 0."""
        if not period_s > 0.0:
            raise ValueError(f"period_s = {period_s} must be above 0")
        self.config = config
        self.period_s = period_s
        laws = np.zeros(1, LAW)
        self._law: Any = laws[0]  # a view: its memory stays that of `laws`
        self.notch_state = laws["notch_state"]
        config.write(self._law)

    def start(self, motor_angle: float, speed_rad_s: float = 0.0, torque_nm: float = 0.0) -> None:
        """Take over at this angle and speed while this torque acts, without a step in the torque."""
        servo_start(self._law, motor_angle, speed_rad_s, torque_nm)

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
        return servo_step(
            self._law, self.period_s, self.config.torque_limit_nm, position, velocity_offset, torque_offset, motor_angle
        )
