"""The P-PI cascade: proportional position loop around a proportional-integral velocity loop, on the motor side only."""

import math
from dataclasses import dataclass, fields
from typing import Any, Protocol

from numpy.typing import NDArray

from hil.control.compiled import inlined
from hil.control.records import record_dtype


class CascadeConfigRow(Protocol):
    """K_pp, K_vp, K_vi and the corner of F_lp, as the compiled law reads them."""

    position_gain_per_s: float
    velocity_gain_nm_s_rad: float
    velocity_integral_gain_nm_rad: float
    lowpass_hz: float


class CascadeStateRow(Protocol):
    """Memory of the cascade: the last angle, the low-passed speed v̂, the last velocity error and the integrator."""

    motor_angle_rad: float
    speed_rad_s: float
    error_rad_s: float
    integral_nm: float


CASCADE_CONFIG = record_dtype(CascadeConfigRow)
CASCADE_STATE = record_dtype(CascadeStateRow)


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
def cascade_start(state: CascadeStateRow, motor_angle: float, speed_rad_s: float, torque_nm: float) -> None:
    """Start without a step in the torque: the speed is known, and the integrator holds the torque that acts already.

    Args:
        state: The cascade's memory; changed in place.
        motor_angle: θ_m in rad.
        speed_rad_s: The motor's speed.
        torque_nm: The torque that acts now.
    """
    state.motor_angle_rad = motor_angle
    state.speed_rad_s = speed_rad_s
    state.error_rad_s = 0.0
    state.integral_nm = torque_nm


@inlined
def observe_speed(config: CascadeConfigRow, state: CascadeStateRow, period_s: float, motor_angle: float) -> float:
    """Low-passed motor speed v̂ = F_lp s θ_m in rad/s, bilinear; call it once per sample.

    Args:
        config: The cascade's gains.
        state: The cascade's memory; changed in place.
        period_s: Sampling time.
        motor_angle: θ_m in rad, as measured.
    """
    c = 2.0 / period_s
    w = 2.0 * math.pi * config.lowpass_hz
    state.speed_rad_s = ((c - w) * state.speed_rad_s + w * c * (motor_angle - state.motor_angle_rad)) / (c + w)
    state.motor_angle_rad = motor_angle
    return float(state.speed_rad_s)


@inlined
def cascade_step(
    config: CascadeConfigRow, state: CascadeStateRow, period_s: float, position: float, velocity_offset: float
) -> tuple[float, float]:
    """One sample of u = (K_vp + K_vi/s)(K_pp (θ_ref − θ_m) + θ̇_ff − v̂), bilinear; call `observe_speed` first.

    Args:
        config: The cascade's gains.
        state: The cascade's memory; changed in place.
        period_s: Sampling time.
        position: θ_ref in rad.
        velocity_offset: θ̇_ff in rad/s.

    Returns:
        u in N·m, and the integrator as it was before, for `hold_integrator`.
    """
    error = config.position_gain_per_s * (position - state.motor_angle_rad) + velocity_offset - state.speed_rad_s
    before = state.integral_nm
    state.integral_nm += config.velocity_integral_gain_nm_rad * 0.5 * period_s * (error + state.error_rad_s)
    state.error_rad_s = error
    return config.velocity_gain_nm_s_rad * error + state.integral_nm, before


@inlined
def hold_integrator(state: CascadeStateRow, before: float, excess_nm: float) -> None:
    """Anti-windup: where the torque was cut and the error would wind the integrator further, it stays where it was."""
    if excess_nm * state.error_rad_s > 0.0:
        state.integral_nm = before
