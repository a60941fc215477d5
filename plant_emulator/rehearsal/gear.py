"""The true gear's stiffness and loss at an amplitude.

A vibration of the torsion meets them; they are computed by harmonic balance.

With hysteresis or a soft wind-up the plant depends on the amplitude. So an identification at some torsion is compared with
the gear at that torsion, not with the robot file's constants, which hold for no motion of such a gear.

Source: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design (1968), section 2.2;
P. R. Dahl, A solid friction model, Aerospace Corporation TOR-158(3107-18) (1968).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from plant_emulator.robots.robot import RobotAxis

STEPS = 720
"""Instants of a period at which the gear's torque is reckoned; the loss is right to 0.2 %."""
ALL_AROUND_RAD = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
"""Arm angles over which the torsion by gravity is averaged if nobody knows where the arm was."""


@dataclass(frozen=True)
class GearPlant:
    """The plant of an axis at an amplitude of its gear's torsion.

    Attributes:
        stiffness_nm_rad: K_g.
        antiresonance_hz: f_a = √(K_g/J_l)/2π.
        resonance_hz: f_r of the free motor on the gear: √(K_g (1/J_l + 1/(N² J_m)))/2π.
        damping: ζ of the arm on its gear, (D_g + D_l + L/ω_a)/(2 J_l ω_a) with the loss L.
    """

    stiffness_nm_rad: float
    antiresonance_hz: float
    resonance_hz: float
    damping: float


def gear_plant(axis: RobotAxis, torsion_arcsec: float | None, arm_rad: Real = ALL_AROUND_RAD) -> GearPlant:
    """Return the plant that a vibration of the gear meets.

    Args:
        torsion_arcsec: Amplitude of the torsion; None for the robot file's constants.
        arm_rad: Arm angles of the motion; shape (n,).
    """
    stiffness, loss = axis.gear_stiffness_nm_rad, 0.0
    if torsion_arcsec is not None and (axis.hysteresis_torque_nm or axis.wind_up_softness):
        stiffness, loss = gear_at(axis, torsion_arcsec * ARCSEC, arm_rad)
    arm, motor = axis.arm_inertia_kg_m2, axis.reduction_ratio**2 * axis.motor_inertia_kg_m2
    omega = math.sqrt(stiffness / arm)
    damping = axis.gear_damping_nm_s_rad + axis.arm_damping_nm_s_rad + loss / omega
    per_turn = 2.0 * math.pi
    return GearPlant(
        stiffness, omega / per_turn, math.sqrt(stiffness * (1.0 / arm + 1.0 / motor)) / per_turn, damping / (2.0 * arm * omega)
    )


def gear_at(axis: RobotAxis, torsion_rad: float, arm_rad: Real = ALL_AROUND_RAD) -> tuple[float, float]:
    """Return stiffness and loss in N·m/rad for a sine of torsion.

    The sine is about the torsions by which gravity winds the gear up.

    The torque of ψ = ψ_g + a sin φ is K a sin φ + L a cos φ and harmonics; D_g is not in L.

    Raises:
        ValueError: The amplitude is not above 0.
    """
    if not torsion_rad > 0.0:
        raise ValueError(f"torsion_rad is {torsion_rad}; expected an amplitude above 0")
    phase = (np.arange(STEPS) + 0.5) * (2.0 * math.pi / STEPS)
    sine, rising = np.sin(phase), np.cos(phase) > 0.0
    torsion = torsion_rad * sine
    spring = _spring_nm(axis, _wound_up(axis, arm_rad)[:, np.newaxis] + torsion).mean(axis=0)
    torque = spring + _hysteresis_nm(axis, torsion, torsion_rad, rising)
    per_amplitude = 2.0 / (STEPS * torsion_rad)
    return float(per_amplitude * torque @ sine), float(per_amplitude * torque @ np.cos(phase))


def _hysteresis_nm(axis: RobotAxis, torsion: Real, amplitude: float, rising: NDArray[np.bool_]) -> Real:
    """Return the Dahl torque of a periodic torsion.

    After many periods it is ±F (1 − 2 e^{−(a ± ψ)/ψ_h}/(1 + e^{−2a/ψ_h})).
    """
    if not axis.hysteresis_torque_nm:
        return np.zeros_like(torsion)
    own = axis.hysteresis_torsion_arcsec * ARCSEC
    sign = np.where(rising, 1.0, -1.0)
    far = 2.0 / (1.0 + math.exp(-2.0 * amplitude / own))
    return np.asarray(sign * axis.hysteresis_torque_nm * (1.0 - far * np.exp(-(amplitude + sign * torsion) / own)))


def _spring_nm(axis: RobotAxis, torsion: Real) -> Real:
    """Return the torque of the soft wind-up.

    It is K_g ψ (1 − r exp(−(ψ/ψ_s)²)).
    """
    soft = axis.wind_up_softness * np.exp(-((torsion / (axis.wind_up_torsion_arcsec * ARCSEC)) ** 2))
    return np.asarray(axis.gear_stiffness_nm_rad * torsion * (1.0 - soft))


def _wound_up(axis: RobotAxis, arm_rad: Real) -> Real:
    """Return torsions under gravity; shape of `arm_rad`."""
    moment = axis.gravity_moment_nm * np.cos(arm_rad)
    low, high = np.zeros_like(moment), np.abs(moment) / (axis.gear_stiffness_nm_rad * (1.0 - axis.wind_up_softness))
    for _ in range(50):  # the torque rises with the torsion, r being below 1
        middle = 0.5 * (low + high)
        is_low = _spring_nm(axis, middle) < np.abs(moment)
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return np.asarray(np.copysign(0.5 * (low + high), moment))
