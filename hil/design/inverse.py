"""The inverse of the loop: which set-points make the motor do a given sine, so that the gear does not feel its error.

Where Δθ_m = −N θ_sync the torsion ψ = θ_m/N + θ_sync − θ_l is smooth, so neither gear nor arm takes part: the motor moves
as if it were alone, A = J_m s² + D_m s, and the law has to give τ = A Δθ_m. With C_v = K_vp + K_vi/s, filter F_n and hold H

    F_n H C_v (K_pp (Δθ_ref − Δθ_m) − F_lp s Δθ_m) = A Δθ_m
    Δθ_ref/Δθ_m = 1 + (F_lp s + A/(F_n H C_v))/K_pp.

No part of it but J_m and D_m is of the plant; the arm's resonance does not come in. With a torque offset (60B2h) Δτ = A Δθ_m the
law is left alone, and no filter in it matters:

    Δθ_ref/Δθ_m = 1 + F_lp s/K_pp.

At 12 Hz and K_pp = 25/s either is about 3, 70° to 76° ahead. What is left of the error is of second order in k Δθ_m, since the
correction turns the very angle from which it is computed: 0.5 % where N A_k is 3 mrad.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hil.control.compensation import Correction
from hil.design.frequency import Loop

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Way = Literal["reference", "torque"]

HIGHEST_HZ = 60.0
"""Up to which k f_m an order is corrected; it fades over the fifth below. A_4 of 5″ at 10 rps is 40 Hz."""
STEP_RPS = 0.05
LEAST_RPS = 1e-4
"""The speed that stands for 0, where 1/s has no value."""


@dataclass(frozen=True)
class CyclicTiming:
    """When what is computed from a measured angle acts.

    The angle is sampled at a SYNC; the set-point that follows from it comes into force at the next one and is reached a period T
    later, at the last of the drive's own periods T_c: 2 T − T_c. A torque offset acts at once and stands for T: 1.5 T on average.

    Attributes:
        sync_period_s: T.
        control_period_s: T_c.
        delay_s: Of set-points beyond that, where a drive or a bus has more.
    """

    sync_period_s: float
    control_period_s: float
    delay_s: float = 0.0

    def reference(self, frequency_hz: Real) -> Complex:
        """What the law sees of a sampled sine that is interpolated linearly."""
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 2.0 * self.sync_period_s - self.control_period_s + self.delay_s
        # interpolated at m instants: (sin(πfT)/(m sin(πfT/m)))², which is sinc² where m is large
        steps = max(1, round(self.sync_period_s / self.control_period_s))
        shape = (np.sinc(frequency * self.sync_period_s) / np.sinc(frequency * self.sync_period_s / steps)) ** 2
        return np.asarray(shape * np.exp(-2j * math.pi * frequency * late))

    def torque(self, frequency_hz: Real) -> Complex:
        """What the motor feels of a sampled sine that is held."""
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 1.5 * self.sync_period_s + self.delay_s
        return np.asarray(np.sinc(frequency * self.sync_period_s) * np.exp(-2j * math.pi * frequency * late))


@dataclass(frozen=True)
class InnerTiming:
    """The same inside a drive, whose own loop computes the correction: it acts in the period in which the angle is measured."""

    control_period_s: float

    def reference(self, frequency_hz: Real) -> Complex:
        """Nothing in between."""
        return np.ones_like(np.asarray(frequency_hz, dtype=np.complex128))

    def torque(self, frequency_hz: Real) -> Complex:
        """The hold of the drive's own period."""
        frequency = np.asarray(frequency_hz, dtype=np.float64) * self.control_period_s
        return np.asarray(np.sinc(frequency) * np.exp(-1j * math.pi * frequency))


def reference_per_motor_angle(loop: Loop, frequency_hz: Real, way: Way = "reference", speed_rps: float = 0.0) -> Complex:
    """Δθ_ref/Δθ_m at the law's input where the gear feels nothing; shape of `frequency_hz`.

    Args:
        loop: Law and motor.
        frequency_hz: Above 0.
        way: Whether the law gives the torque, or an offset does.
        speed_rps: Motor speed, for the filters.

    Raises:
        ValueError: Without K_pp, or K_vp and K_vi, nothing can be asked of the loop.
    """
    gains = loop.cascade
    if gains.position_gain_per_s <= 0.0 or gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad <= 0.0:
        raise ValueError("a loop without gain follows no set-point")
    jw = 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)
    delay = np.exp(-jw * loop.period_s)
    s = 2.0 / loop.period_s * (1.0 - delay) / (1.0 + delay)
    corner = 2.0 * math.pi * gains.lowpass_hz
    speed = corner * s / (s + corner)
    if way == "reference":
        motor, _, _ = loop.plant.terms(jw)
        hold = (1.0 - delay) / (jw * loop.period_s) * delay**loop.delay_samples
        law = gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad / s
        speed = speed + motor / (law * loop.notch_response(frequency_hz, speed_rps) * hold)
    return np.asarray(1.0 + speed / gains.position_gain_per_s)


def correction(
    loop: Loop,
    amplitude_rad: Mapping[int, float],
    phase_rad: Mapping[int, float],
    timing: CyclicTiming | InnerTiming,
    max_rps: float,
    way: Way = "reference",
    highest_hz: float = HIGHEST_HZ,
) -> Correction:
    """The table of one axis: G_k(f_m) = −N A_k (Δθ_ref/Δθ_m)/(what the bus makes of it).

    Args:
        loop: Law, motor and filters.
        amplitude_rad: A_k at the arm, by order.
        phase_rad: φ_k.
        timing: When corrections act.
        max_rps: Up to which motor speed; beyond it the last values stay.
        way: By the set-point alone, or with a torque offset.
        highest_hz: Up to which k f_m.

    Raises:
        ValueError: Nothing to correct, or a loop that cannot be asked.
    """
    if not amplitude_rad or not max_rps > 0.0:
        raise ValueError(f"nothing to correct: orders {sorted(amplitude_rad)}, up to {max_rps} rps")
    speeds = np.arange(math.ceil(max_rps / STEP_RPS) + 2) * STEP_RPS
    turning = np.maximum(speeds, LEAST_RPS)
    references, torques = [], []
    for order, amplitude in amplitude_rad.items():
        frequency = order * turning
        wanted = -loop.plant.reduction_ratio * amplitude * np.clip((highest_hz - frequency) / (0.2 * highest_hz), 0.0, 1.0)
        references.append(wanted * _inverse(loop, frequency, turning, way) / timing.reference(frequency))
        motor, _, _ = loop.plant.terms(2j * math.pi * frequency)
        torques.append(wanted * motor / timing.torque(frequency) if way == "torque" else np.zeros_like(references[-1]))
    phases = tuple(phase_rad[order] for order in amplitude_rad)
    return Correction(tuple(amplitude_rad), phases, STEP_RPS, np.asarray(references), np.asarray(torques))


def _inverse(loop: Loop, frequency_hz: Real, speed_rps: Real, way: Way) -> Complex:
    """Δθ_ref/Δθ_m on the line of one order, with the filters that act at each speed."""
    if way == "torque" or not loop.notches:
        return reference_per_motor_angle(loop, frequency_hz, way)
    pairs = zip(frequency_hz, speed_rps, strict=True)
    return np.array([reference_per_motor_angle(loop, np.array([f]), way, float(v))[0] for f, v in pairs])
