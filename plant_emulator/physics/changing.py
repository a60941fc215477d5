"""A gear that does not stay as it is: its transmission error over time, wear, load, direction and temperature.

The plant's amplitudes and phases are those of the instant. A gear that changes has them put anew after each control period, from
the values that it left the factory with and from what it has gone through since; over the period they are held. One that does
not change costs a comparison.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.records import record_dtype
from plant_emulator.physics.axis import MORE_LINES, PlantRow, PlantStateRow, friction, synchronous_error

NAMED_LINES = 3
"""Orders 1, 2 and 4, which come before the others in the arrays of `ChangeRow`."""
LINES = NAMED_LINES + MORE_LINES

Each = Annotated[NDArray[np.float64], (LINES,)]

SMOOTHING_S = 0.05
"""Time constant with which the error follows load and direction: a reversal does not throw the arm."""
TURNING_RAD_S = 1.0
"""Motor speed at which the direction has become 0.7 of a whole one."""


class ChangeRow(Protocol):
    """How the transmission error of an axis changes; a number for each order, 1, 2 and 4 first."""

    is_changing: float
    a_rad: Each
    phi_rad: Each
    step_rad: Each
    step_s: Each
    drift_rad_s: Each
    growth_per_s: Each
    growth_per_rad: Each
    load_per_nm: Each
    load_rad_nm: Each
    direction_part: Each
    direction_rad: Each
    warmth_per_k: Each
    warmth_rad_k: Each
    reference_c: float
    ambient_c: float
    resistance_k_w: float
    thermal_constant_s: float


class PastRow(Protocol):
    """What a gear has gone through: time with the brake open, way of the motor, smoothed load and direction, temperature."""

    operating_periods: int
    operating_s: float
    turned_rad: float
    load_nm: float
    direction: float
    temperature_c: float


CHANGE = record_dtype(ChangeRow)
PAST = record_dtype(PastRow)


@inlined
def _spring_nm(p: PlantRow, s: PlantStateRow) -> float:
    """The gear's torque without its damping, K_g ψ (1 − r exp(−(ψ/ψ_s)²)) + z, N·m."""
    torsion = s.motor_angle_rad / p.reduction_ratio + synchronous_error(p, s.motor_angle_rad)[0] - s.arm_angle_rad
    stiffness = p.gear_stiffness_nm_rad
    if p.wind_up_softness > 0.0:
        ratio = torsion / p.wind_up_torsion_rad
        stiffness *= 1.0 - p.wind_up_softness * math.exp(-ratio * ratio)
    return stiffness * torsion + s.hysteresis_nm


@inlined
def go_through(c: ChangeRow, past: PastRow, p: PlantRow, s: PlantStateRow, braked: bool, period_s: float) -> None:
    """What a gear goes through in a control period.

        d/dt τ_L = (τ_g − τ_L)/T_s,   d/dt s = (ω/√(ω² + ω_0²) − s)/T_s
        d/dt ϑ = (ϑ_a + R (τ_f(ω) + D_m ω) ω − ϑ)/T_th

    each exact for a right-hand side that is held over the period.

    Args:
        c: How the error changes.
        past: What the gear has gone through; changed in place.
        p: The axis' constants.
        s: Its state at the end of the period.
        braked: Whether the brake holds the motor: then nothing wears.
        period_s: The control period.
    """
    speed = 0.0 if braked else s.motor_speed_rad_s
    if not braked:
        past.operating_periods += 1
        past.operating_s = past.operating_periods * period_s
        past.turned_rad += abs(speed) * period_s
    part = 1.0 - math.exp(-period_s / SMOOTHING_S)
    past.load_nm += part * (_spring_nm(p, s) - past.load_nm)
    past.direction += part * (speed / math.sqrt(speed * speed + TURNING_RAD_S * TURNING_RAD_S) - past.direction)
    rise = p.static_friction_nm - p.coulomb_friction_nm
    lost = p.motor_damping_nm_s_rad * speed + friction(p.coulomb_friction_nm, rise, 1.0 / p.stribeck_velocity_rad_s, speed)
    warm = c.ambient_c + c.resistance_k_w * lost * speed
    past.temperature_c += (1.0 - math.exp(-period_s / c.thermal_constant_s)) * (warm - past.temperature_c)


@inlined
def _line(c: ChangeRow, past: PastRow, i: int) -> tuple[float, float]:
    """Amplitude and phase of one order now, in rad.

    Args:
        c: How the error changes.
        past: What the gear has gone through.
        i: Row of the order.
    """
    warmer = past.temperature_c - c.reference_c
    size = 1.0 + c.growth_per_s[i] * past.operating_s + c.growth_per_rad[i] * past.turned_rad
    size += c.load_per_nm[i] * past.load_nm + c.direction_part[i] * past.direction + c.warmth_per_k[i] * warmer
    phase = c.phi_rad[i] + c.drift_rad_s[i] * past.operating_s + c.load_rad_nm[i] * past.load_nm
    phase += c.direction_rad[i] * past.direction + c.warmth_rad_k[i] * warmer
    if past.operating_s >= c.step_s[i]:
        phase += c.step_rad[i]
    return c.a_rad[i] * max(0.0, size), phase


@compiled
def put_error(c: ChangeRow, past: PastRow, p: PlantRow) -> None:
    """The transmission error as it is now, into the axis' constants.

        A_k = A_k0 (1 + g t + w n + a_L τ_L + a_s s + a_ϑ (ϑ − ϑ_0)), not below 0
        φ_k = φ_k0 + Δφ (from t_s on) + d t + b_L τ_L + b_s s + b_ϑ (ϑ − ϑ_0)

    Args:
        c: How the error changes.
        past: What the gear has gone through: t, n, τ_L, s, ϑ.
        p: The axis' constants; A_k and φ_k are changed in place.
    """
    p.a1_rad, p.phi1_rad = _line(c, past, 0)
    p.a2_rad, p.phi2_rad = _line(c, past, 1)
    p.a4_rad, p.phi4_rad = _line(c, past, 2)
    if p.is_more > 0.0:
        for i in range(MORE_LINES):
            p.more_rad[i], p.more_phi_rad[i] = _line(c, past, NAMED_LINES + i)
