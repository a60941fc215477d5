"""The P-PI cascade: proportional position loop around a proportional-integral velocity loop, on the motor side only."""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import inlined

CASCADE_CONFIG = np.dtype([
    ("position_gain_per_s", np.float64),
    ("velocity_gain_nm_s_rad", np.float64),
    ("velocity_integral_gain_nm_rad", np.float64),
    ("lowpass_hz", np.float64),
])  # fmt: skip
"""K_pp, K_vp, K_vi and the corner of F_lp, as the compiled law reads them."""

CASCADE_STATE = np.dtype([
    ("motor_angle_rad", np.float64),
    ("speed_rad_s", np.float64),
    ("error_rad_s", np.float64),
    ("integral_nm", np.float64),
])  # fmt: skip
"""What persists: the last angle, the low-passed speed v̂, the last velocity error and the integrator."""


@dataclass(frozen=True)
class Cascade:
    """Gains of the P-PI cascade.

    Attributes:
        position_gain_per_s: K_pp in 1/s.
        velocity_gain_nm_s_rad: K_vp in N·m·s/rad.
        velocity_integral_gain_nm_rad: K_vi in N·m/rad.
        lowpass_hz: Corner of F_lp, first order.

    Raises:
        ValueError: A negative gain or a corner that is not above zero.
    """

    position_gain_per_s: float
    velocity_gain_nm_s_rad: float
    velocity_integral_gain_nm_rad: float
    lowpass_hz: float = 300.0

    def __post_init__(self) -> None:
        """Refuse a sign that would turn the loop round."""
        for field in fields(self):
            if not getattr(self, field.name) >= 0.0:
                raise ValueError(f"{field.name} = {getattr(self, field.name)} must not be below 0")
        if not self.lowpass_hz > 0.0:
            raise ValueError(f"lowpass_hz = {self.lowpass_hz} must be above 0")

    def write(self, row: NDArray[Any]) -> None:
        """Put the gains into one record of a `CASCADE_CONFIG` array."""
        for field in fields(self):
            row[field.name] = getattr(self, field.name)


@inlined
def cascade_start(state: Any, row: int, motor_angle: float, speed_rad_s: float, torque_nm: float) -> None:
    """Start without a bump: the speed is known, and the integrator holds the torque that is there already."""
    s = state[row]
    s.motor_angle_rad = motor_angle
    s.speed_rad_s = speed_rad_s
    s.error_rad_s = 0.0
    s.integral_nm = torque_nm


@inlined
def observe_speed(config: Any, state: Any, row: int, period_s: float, motor_angle: float) -> float:
    """v̂ = F_lp s θ_m, bilinear: the low-passed motor speed in rad/s. To be called once per sample."""
    s = state[row]
    c = 2.0 / period_s
    w = 2.0 * math.pi * config[row].lowpass_hz
    s.speed_rad_s = ((c - w) * s.speed_rad_s + w * c * (motor_angle - s.motor_angle_rad)) / (c + w)
    s.motor_angle_rad = motor_angle
    return float(s.speed_rad_s)


@inlined
def cascade_step(
    config: Any, state: Any, row: int, period_s: float, position: float, velocity_offset: float
) -> tuple[float, float]:
    """One sample of u = (K_vp + K_vi/s)(K_pp (θ_ref − θ_m) + θ̇_ff − v̂), bilinear; call `observe_speed` first.

    Args:
        config: `CASCADE_CONFIG` array, shape (n_axes,).
        state: `CASCADE_STATE` array, shape (n_axes,); changed in place.
        row: Axis.
        period_s: Sampling time.
        position: θ_ref in rad.
        velocity_offset: θ̇_ff in rad/s.

    Returns:
        u in N·m, and the integrator as it was before, for `hold_integrator`.
    """
    c, s = config[row], state[row]
    error = c.position_gain_per_s * (position - s.motor_angle_rad) + velocity_offset - s.speed_rad_s
    before = s.integral_nm
    s.integral_nm += c.velocity_integral_gain_nm_rad * 0.5 * period_s * (error + s.error_rad_s)
    s.error_rad_s = error
    return c.velocity_gain_nm_s_rad * error + s.integral_nm, before


@inlined
def hold_integrator(state: Any, row: int, before: float, excess_nm: float) -> None:
    """Anti-windup: where the torque was cut and the error would wind the integrator further, it stays where it was."""
    s = state[row]
    if excess_nm * s.error_rad_s > 0.0:
        s.integral_nm = before
