"""Fit of a plant whose arm has several modes.

With the motors of all other axes held, an arm is a structure that this motor shakes by its gear. Its modes with the motor held,
at ω_i, have effective inertias J_i about the joint, which add up to the whole one:

    1/P = J_m s² + D_m s + (1/N²) Σ J_i s² H_i,      H_i = (2 ζ_i ω_i s + ω_i²)/(s² + 2 ζ_i ω_i s + ω_i²)

Each ω_i is a dip of P, and between two of them lies a peak. One mode is motor and arm on a gear, with J_l = J_1 and
K_g = ω_1² J_1. Of several, Σ J_i is the inertia of the joint and Σ J_i ω_i² the stiffness of its gear. The tip, along the way in
which the rigid arm moves it, follows with

    a/θ_m = (s²/N) L Σ γ_i H_i,      Σ γ_i = 1.

Source: effective masses of a structure on a moving base, A. Girard, N. Roy, Structural Dynamics in Industry (2008), chapter 5.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Complex, Real
from hil.design.estimation import EstimatedMode
from hil.design.frequency import TIP_HZ, AnyComplex, TwoInertia
from hil.design.plant_problem import DAMPING, J_L, K_G, LARGEST_CHANGE, LEVER, TURNED, PlantProblem, SamplingTiming
from hil.design.plant_spectra import Spectra

WITHOUT_TIP, WITH_TIP = LEVER, TURNED + 1
"""Unknowns of motor and first mode."""
INERTIA, FREQUENCY, ZETA, PART = range(4)
"""Unknowns of each further mode: ln J_i, ln ω_i, ln ζ_i, and with an accelerometer γ_i."""
WIDEST = 0.3
"""Accuracy: change of ln ω_i in one round of the fit: a factor of 2 changes nothing of an arm of three links."""
SMALLEST_ZETA, LARGEST_ZETA = 0.002, 0.4
"""Bound: range of a mode's ζ: with less it rings for hundreds of swings, with more it has no peak that a spectrum shows."""


@dataclass(frozen=True)
class ArmMode:
    """Mode of the arm with the motor held.

    Attributes:
        inertia_kg_m2: Effective inertia J_i about the joint.
        frequency_hz: Frequency ω_i/2π, at which the motor's response has a dip.
        tip_part: Part γ_i of the tip's rigid motion that this mode carries; None without an accelerometer.
    """

    inertia_kg_m2: float
    frequency_hz: float
    damping: float
    tip_part: float | None = None

    @classmethod
    def of(cls, mode: EstimatedMode) -> "ArmMode":
        """Take the values of an estimated mode."""
        part = None if mode.tip_part is None else mode.tip_part.value
        return cls(mode.inertia_kg_m2.value, mode.antiresonance_hz.value, mode.damping.value, part)


def amplification(frequency_hz: float, damping: float, jw: AnyComplex) -> Complex:
    """H of a mode; shape of `jw`."""
    omega = 2.0 * math.pi * frequency_hz
    follows = 2.0 * damping * omega * jw + omega**2
    return np.asarray(follows / (jw**2 + follows))


def modal_angle(motor: TwoInertia, modes: Sequence[ArmMode], frequency_hz: Real) -> Complex:
    """Motor angle per torque of a motor with several modes behind it.

    Args:
        motor: The motor; of the rest only the reduction ratio counts.
        frequency_hz: Frequencies; shape (m,).
    """
    jw = 2j * math.pi * frequency_hz
    own, _, _ = motor.terms(jw)
    load = sum(m.inertia_kg_m2 * jw**2 * amplification(m.frequency_hz, m.damping, jw) for m in modes)
    return np.asarray(1.0 / (own + load / motor.reduction_ratio**2))


def modal_tip(motor: TwoInertia, modes: Sequence[ArmMode], frequency_hz: Real, lever_m: float, delay_s: float) -> Complex:
    """Tip acceleration per motor angle, with several modes.

    Args:
        motor: The motor; of it only the reduction ratio counts.
        modes: All modes, with their parts of the tip's motion.
        frequency_hz: Frequencies; shape (m,).
    """
    jw = 2j * math.pi * frequency_hz
    follows = sum((m.tip_part or 0.0) * amplification(m.frequency_hz, m.damping, jw) for m in modes)
    return np.asarray(lever_m / motor.reduction_ratio * jw**2 * follows * np.exp(-jw * delay_s))


class ModalProblem(PlantProblem):
    """Residual of a fit with several modes."""

    def __init__(self, data: Spectra, timing: SamplingTiming, reduction_ratio: float, lever_m: float, gravity: float) -> None:
        super().__init__(data, timing, reduction_ratio, lever_m, gravity)
        self.tip_lines = np.flatnonzero(data.frequency_hz < TIP_HZ)
        self.first = WITHOUT_TIP if data.tip is None else WITH_TIP
        self.each = PART if data.tip is None else PART + 1

    def focus(self, f_a: float) -> None:
        """Use the tip at all frequencies at which modes may be."""

    def start_with(self, motor: Real, modes: list[ArmMode]) -> Real:
        """Build all unknowns from the motor's values and some modes.

        Args:
            motor: J_m and D_m + D_l/N²; shape (2,).
        """
        first = modes[0]
        omega = 2.0 * math.pi * first.frequency_hz
        stiffness, damping = omega**2 * first.inertia_kg_m2, 2.0 * first.damping * omega * first.inertia_kg_m2
        values = [motor[0], first.inertia_kg_m2, stiffness, damping]
        x = self.start(np.append(np.log(values), motor[1]))
        for mode in modes[1:]:
            more = [math.log(mode.inertia_kg_m2), math.log(2.0 * math.pi * mode.frequency_hz), math.log(mode.damping)]
            x = np.concatenate([x, more, [] if self.data.tip is None else [mode.tip_part or 0.0]])
        return x

    def slots(self, x: Real) -> list[int]:
        """First unknown of each further mode."""
        return list(range(self.first, len(x), self.each))

    def modes(self, x: Real) -> list[ArmMode]:
        """Modes of the unknowns, in their order."""
        plant, has_tip = self.plant(x), self.data.tip is not None
        stiffness, inertia = plant.gear_stiffness_nm_rad, plant.arm_inertia_kg_m2
        damping = 0.5 * math.exp(x[DAMPING]) / math.sqrt(stiffness * inertia)
        parts = [float(x[slot + PART]) if has_tip else None for slot in self.slots(x)]
        rest = 1.0 - sum(part or 0.0 for part in parts) if has_tip else None
        found = [ArmMode(inertia, plant.antiresonance_hz, damping, rest)]
        for slot, part in zip(self.slots(x), parts, strict=True):
            further, omega, zeta = np.exp(x[slot : slot + PART]).tolist()
            found.append(ArmMode(further, omega / (2.0 * math.pi), zeta, part))
        return found

    def angle_per_torque(self, x: Real, frequency_hz: Real, gravity_nm_rad: float) -> Complex:
        """Motor angle per torque; further modes load the motor beside the first."""
        alone, jw = super().angle_per_torque(x, frequency_hz, gravity_nm_rad), 2j * math.pi * frequency_hz
        load = np.zeros_like(alone)
        for mode in self.modes(x)[1:]:
            load += mode.inertia_kg_m2 * jw**2 * amplification(mode.frequency_hz, mode.damping, jw)
        return np.asarray(alone / (1.0 + alone * load / self.ratio**2))

    def arm_per_motor(self, x: Real, frequency_hz: Real, gravity_nm_rad: float) -> Complex:
        """Arm angle per motor angle, as the tip shows it: each mode carries its part of it."""
        jw = 2j * math.pi * frequency_hz
        first, *others = self.modes(x)
        found = (first.tip_part or 0.0) * super().arm_per_motor(x, frequency_hz, gravity_nm_rad)
        for mode in others:
            found = found + (mode.tip_part or 0.0) / self.ratio * amplification(mode.frequency_hz, mode.damping, jw)
        return np.asarray(found)

    def shapes(self, x: Real, jw: AnyComplex, gravity_nm_rad: float) -> tuple[Complex, Complex]:
        """What the slopes are made of: those of the plant, and three of each further mode, as `PlantProblem.shapes`."""
        of_angle, of_arm = super().shapes(x, jw, gravity_nm_rad)
        frequency = np.asarray(np.imag(jw) / (2.0 * math.pi), dtype=np.float64)
        alone, angle = super().angle_per_torque(x, frequency, gravity_nm_rad), self.angle_per_torque(x, frequency, gravity_nm_rad)
        first, *others = self.modes(x)
        arm = super().arm_per_motor(x, frequency, gravity_nm_rad)
        angles, arms = [of_angle * (angle / alone) ** 2], [of_arm * (first.tip_part or 0.0)]
        for mode in others:
            made = amplification(mode.frequency_hz, mode.damping, jw)
            omega = 2.0 * math.pi * mode.frequency_hz
            by_zeta = 2.0 * mode.damping * omega * jw * (1.0 - made) ** 2 / jw**2
            by_omega = by_zeta + 2.0 * omega**2 * (1.0 - made) ** 2 / jw**2
            load = -mode.inertia_kg_m2 * (angle * jw / self.ratio) ** 2
            part = (mode.tip_part or 0.0) / self.ratio
            angles.append(load * np.stack([made, by_omega, by_zeta]))
            arms.append(np.stack([made / self.ratio - arm, part * by_omega, part * by_zeta]))
        return np.concatenate(angles), np.concatenate(arms)

    def by_shapes(self, x: Real) -> tuple[Real, Real]:
        """Factors of `shapes` in the slopes by each unknown; shape (unknowns, n)."""
        by_angle, by_arm = super().by_shapes(x)
        more = np.zeros((2, len(x), 3 * len(self.slots(x))))
        for column, slot in enumerate(self.slots(x)):
            own = slice(3 * column, 3 * column + 3)
            more[0, [slot + INERTIA, slot + FREQUENCY, slot + ZETA], own] = np.eye(3)
            if self.data.tip is not None:
                more[1, [slot + PART, slot + FREQUENCY, slot + ZETA], own] = np.eye(3)
        return np.hstack([by_angle, more[0]]), np.hstack([by_arm, more[1]])

    def bounds(self, x: Real, *, are_times_held: bool = False) -> tuple[Real, Real]:
        """Bounds of one round of the fit around x."""
        low, high = super().bounds(x, are_times_held=are_times_held)
        low[J_L], high[J_L], low[K_G], high[K_G] = x[J_L] - 1.0, x[J_L] + 1.0, x[K_G] - 1.0, x[K_G] + 1.0
        for slot in self.slots(x):
            low[slot + INERTIA], high[slot + INERTIA] = x[slot + INERTIA] - LARGEST_CHANGE, x[slot + INERTIA] + LARGEST_CHANGE
            low[slot + FREQUENCY], high[slot + FREQUENCY] = x[slot + FREQUENCY] - WIDEST, x[slot + FREQUENCY] + WIDEST
            low[slot + ZETA], high[slot + ZETA] = math.log(SMALLEST_ZETA), math.log(LARGEST_ZETA)
            if self.data.tip is not None:
                low[slot + PART], high[slot + PART] = -3.0, 3.0
        return low, high

    def scale(self, x: Real) -> Real:
        """Step sizes of the unknowns that have similar effects."""
        more = [0.1, 0.03, 0.3, 0.1][: self.each]
        return np.concatenate([super().scale(x[: self.first]), more * len(self.slots(x))])
