"""The inverse of the loop: set-points that make the motor follow a given sine, so that the gear does not feel its error.

Where Δθ_m = −N θ_sync the torsion ψ = θ_m/N + θ_sync − θ_l is smooth, so neither gear nor arm takes part: the motor moves
as if it were alone, A = J_m s² + D_m s, and the law has to give τ = A Δθ_m. With C_v = K_vp + K_vi/s, filter F_n and hold H

    F_n H C_v (K_pp (Δθ_ref − Δθ_m) − F_lp s Δθ_m) = A Δθ_m
    Δθ_ref/Δθ_m = 1 + (F_lp s + A/(F_n H C_v))/K_pp.

Of the plant only J_m and D_m appear in it; the arm's resonance does not. With a torque offset (60B2h) Δτ = A Δθ_m the law does
not act, and none of its filters matters:

    Δθ_ref/Δθ_m = 1 + F_lp s/K_pp.

At 12 Hz and K_pp = 25/s either is about 3, 70° to 76° ahead. The addition turns the very angle at which the error is read, so
there are mixed waves beside the orders (`hil.design.counter_motion`): without them 0.5 % of the error would be left where
N A_k is 3 mrad, and 5 % where it is 30 mrad.
"""

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hil.control.cancellation import CancellationTable, WaveLabel
from hil.design.counter_motion import counter_motion
from hil.design.frequency import Loop

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Actuation = Literal["reference", "torque"]
"""Input of the loop that moves the motor: the set-point alone, or a torque offset with it."""

HIGHEST_HZ = 60.0
"""Highest k f_m at which an order is usually cancelled; it fades over the fifth below. Order 4 at 10 rps is 40 Hz."""
STEP_RPS = 0.05
CHIRP_STEP_HZ = 0.1
"""Step of the second derivative by the frequency."""
LEAST_RPS = 1e-4
"""The speed that stands for 0, where 1/s has no value."""


@dataclass(frozen=True)
class CyclicTiming:
    """Delays between a measured angle and the effect of an addition computed from it, over the bus.

    The angle is sampled at a SYNC; the set-point that follows from it comes into force at the next one and is reached a period T
    later, at the last of the drive's own periods T_c: 2 T − T_c. A torque offset acts at once and stands for T: 1.5 T on average.

    Attributes:
        sync_period_s: SYNC period T.
        control_period_s: Control period T_c of the drive.
        delay_s: Delay of set-points beyond that, where a drive or a bus has more.
    """

    sync_period_s: float
    control_period_s: float
    delay_s: float = 0.0

    def reference(self, frequency_hz: Real) -> Complex:
        """Gain of a sampled sine that is interpolated linearly, at the law's input; shape of `frequency_hz`."""
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 2.0 * self.sync_period_s - self.control_period_s + self.delay_s
        # interpolated at m instants: (sin(πfT)/(m sin(πfT/m)))², which is sinc² where m is large
        steps = max(1, round(self.sync_period_s / self.control_period_s))
        shape = (np.sinc(frequency * self.sync_period_s) / np.sinc(frequency * self.sync_period_s / steps)) ** 2
        return np.asarray(shape * np.exp(-2j * math.pi * frequency * late))

    def torque(self, frequency_hz: Real) -> Complex:
        """Gain of a sampled sine that is held, at the motor; shape of `frequency_hz`."""
        frequency = np.asarray(frequency_hz, dtype=np.float64)
        late = 1.5 * self.sync_period_s + self.delay_s
        return np.asarray(np.sinc(frequency * self.sync_period_s) * np.exp(-2j * math.pi * frequency * late))


@dataclass(frozen=True)
class InnerTiming:
    """Delays inside a drive that computes the addition itself: it acts in the control period in which the angle is measured."""

    control_period_s: float

    def reference(self, frequency_hz: Real) -> Complex:
        """Gain at the law's input, 1; shape of `frequency_hz`."""
        return np.ones_like(np.asarray(frequency_hz, dtype=np.complex128))

    def torque(self, frequency_hz: Real) -> Complex:
        """Gain at the motor: the hold over the drive's own period; shape of `frequency_hz`."""
        frequency = np.asarray(frequency_hz, dtype=np.float64) * self.control_period_s
        return np.asarray(np.sinc(frequency) * np.exp(-1j * math.pi * frequency))


def reference_per_motor_angle(
    loop: Loop, frequency_hz: Real, actuation: Actuation = "reference", speed_rps: float = 0.0
) -> Complex:
    """Gain Δθ_ref/Δθ_m at the law's input with which the gear feels nothing; shape of `frequency_hz`.

    Args:
        loop: Law and motor.
        frequency_hz: Frequencies above 0; shape (m,).
        actuation: `reference` where the law gives the torque, `torque` where an offset does.
        speed_rps: Motor speed, for the filters.

    Raises:
        ValueError: The loop has no K_pp, or neither K_vp nor K_vi.
    """
    gains = loop.cascade
    if gains.position_gain_per_s <= 0.0 or gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad <= 0.0:
        raise ValueError("a loop without gain follows no set-point")
    jw = 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)
    delay = np.exp(-jw * loop.period_s)
    s = 2.0 / loop.period_s * (1.0 - delay) / (1.0 + delay)
    corner = 2.0 * math.pi * gains.lowpass_hz
    speed = corner * s / (s + corner)
    if actuation == "reference":
        motor, _, _ = loop.plant.terms(jw)
        hold = (1.0 - delay) / (jw * loop.period_s) * delay**loop.delay_samples
        law = gains.velocity_gain_nm_s_rad + gains.velocity_integral_gain_nm_rad / s
        speed = speed + motor / (law * loop.notch_response(frequency_hz, speed_rps) * hold)
    return np.asarray(1.0 + speed / gains.position_gain_per_s)


def cancellation_table(
    loop: Loop,
    amplitude_rad: Mapping[float, float],
    phase_rad: Mapping[float, float],
    timing: CyclicTiming | InnerTiming,
    max_rps: float,
    actuation: Actuation = "reference",
    highest_hz: float = HIGHEST_HZ,
    most_rad_s2: float = 0.0,
) -> CancellationTable:
    """The table of one axis: G(f_m) = c (Δθ_ref/Δθ_m)/(what the bus makes of it) of every wave c of Δθ_m; −N A_k of an order.

    Args:
        loop: Law, motor and filters.
        amplitude_rad: Amplitude A_k at the arm, by order.
        phase_rad: Phase φ_k, by order.
        timing: Delays of the additions.
        max_rps: Highest motor speed of the table; beyond it the last values stay.
        actuation: `reference`: by the set-point alone; `torque`: with a torque offset.
        highest_hz: Highest k f_m at which an order is cancelled.
        most_rad_s2: Largest acceleration of the motor at which its chirp is allowed for.

    Raises:
        ValueError: There is nothing to cancel, or the loop has no gain.
    """
    if not amplitude_rad or not max_rps > 0.0:
        raise ValueError(f"nothing to cancel: orders {sorted(amplitude_rad)}, up to {max_rps} rev/s")
    speeds = np.arange(math.ceil(max_rps / STEP_RPS) + 2) * STEP_RPS
    turning = np.maximum(speeds, LEAST_RPS)
    at_motor = {order: loop.plant.reduction_ratio * size for order, size in amplitude_rad.items()}
    # an order fades towards the highest frequency, and every wave that comes from it
    faded = {order: np.clip((highest_hz - order * turning) / (0.2 * highest_hz), 0.0, 1.0) for order in amplitude_rad}
    # a filter that follows the motor has no response of its own to a chirp
    has_chirp = most_rad_s2 > 0.0 and not loop.notches
    labels, references, torques, motions, bends = [], [], [], [], []

    def gain(frequency: Real) -> Complex:
        return np.asarray(_inverse(loop, frequency, turning, actuation) / timing.reference(frequency))

    for wave in counter_motion(at_motor, phase_rad):
        frequency = wave.order * turning
        left = np.prod([faded[order] for order in wave.sources], axis=0) * (frequency <= highest_hz)
        size, phase = (-abs(wave.coefficient), phase_rad[wave.order]) if wave.degree == 1 else cmath.polar(wave.coefficient)
        wanted = size * left
        labels.append(WaveLabel(wave.order, phase, wave.degree, wave.sources))
        references.append(wanted * gain(frequency))
        if has_chirp:
            bends.append(wanted * _chirp(gain, frequency, wave.order))
        motor, _, _ = loop.plant.terms(2j * math.pi * frequency)
        torques.append(wanted * motor / timing.torque(frequency) if actuation == "torque" else np.zeros_like(references[-1]))
        motions.append(np.abs(wanted))
    reference, torque, motion = (np.asarray(part) for part in (references, torques, motions))
    bend = np.asarray(bends) if has_chirp else None
    return CancellationTable(tuple(labels), STEP_RPS, reference, torque, motion, bend, most_rad_s2)


def _chirp(gain: Callable[[Real], Complex], frequency_hz: Real, order: float) -> Complex:
    """Change of a gain for each rad/s² by which the motor speeds up: −(j/2) k d²G/dω²; shape of `frequency_hz`.

    The sine e^{jφ(t)} was e^{j(φ − ω τ + k α τ²/2)} a time τ ago, and ∫ g(τ) τ² e^{−jωτ} dτ = −d²G/dω².
    """
    middle = np.maximum(frequency_hz, 2.0 * CHIRP_STEP_HZ)
    bent = gain(middle + CHIRP_STEP_HZ) - 2.0 * gain(middle) + gain(middle - CHIRP_STEP_HZ)
    return np.asarray(-0.5j * order * bent / (2.0 * math.pi * CHIRP_STEP_HZ) ** 2)


def _inverse(loop: Loop, frequency_hz: Real, speed_rps: Real, actuation: Actuation) -> Complex:
    """Gain Δθ_ref/Δθ_m on the line of one order, with the filters that act at each speed."""
    if actuation == "torque" or not loop.notches:
        return reference_per_motor_angle(loop, frequency_hz, actuation)
    pairs = zip(frequency_hz, speed_rps, strict=True)
    return np.array([reference_per_motor_angle(loop, np.array([f]), actuation, float(v))[0] for f, v in pairs])
