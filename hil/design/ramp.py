"""Simulated motion of one axis, without a bus.

The filter follows the motor while the arm moves.

At constant speed the closed form G_al gives the arm's vibration. On a ramp it does not: with the notch the closed loop has a time
constant of 0.2 s, in which a motor that gains 4 rev/s every second has left the resonance. So a filter is designed on the ramp
on which it will be judged.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.control.servo import LAW, ServoConfig
from hil.core.library import CORE
from hil.design.frequency import Loop, TwoInertia, held
from hil.design.transmission_error import TransmissionError

SAMPLE_S = 0.002
"""Bound: time between two samples of the result: 500 Hz shows vibrations up to 25 Hz with ease."""


@dataclass(frozen=True)
class RampMotion:
    """Motion of an axis, or of some, at equal intervals.

    Attributes:
        motor_speed_rps: Motor speed f_m with its sign; shape (…, n).
        arm_acceleration_rad_s2: Arm acceleration θ̈_l; shape (…, n).
    """

    period_s: float
    motor_speed_rps: Real
    arm_acceleration_rad_s2: Real


@lru_cache(maxsize=64)
def _discrete(plant: TwoInertia, period_s: float) -> tuple[Real, Real]:
    """Discretise the plant exactly over one period.

    τ is held; θ_sync changes linearly from one sample to the next.

    ẋ = A x + b τ + (g K_g) θ_sync + (g D_g) θ̇_sync with x = (θ_m, θ̇_m, θ_l, θ̇_l) and τ_g acting by −1/(N J_m) on the motor and
    by 1/J_l on the arm.

    Returns:
        The matrix that takes (x, τ, θ_sync, Δθ_sync) to x one period later, shape (4, 7), and the row that takes the same to θ̈_l.
    """
    n, k, d = plant.reduction_ratio, plant.gear_stiffness_nm_rad, plant.gear_damping_nm_s_rad
    gear = np.array([k / n, d / n, -k, -d])
    motor, arm = -1.0 / (n * plant.motor_inertia_kg_m2), 1.0 / plant.arm_inertia_kg_m2
    a = np.zeros((7, 7))
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4], a[3, :4] = motor * gear, arm * gear
    a[1, 1] -= plant.motor_damping_nm_s_rad / plant.motor_inertia_kg_m2
    a[3, 3] -= plant.arm_damping_nm_s_rad / plant.arm_inertia_kg_m2
    a[1, 4] = 1.0 / plant.motor_inertia_kg_m2
    for i, by in ((1, motor), (3, arm)):
        a[i, 5], a[i, 6] = by * k, by * d / period_s
    a[5, 6] = 1.0 / period_s
    return np.hstack(held(a[:6, :6], a[:6, 6:], period_s))[:4], np.array(a[3])


def follow(
    loop: Loop,
    error: TransmissionError,
    reference_rad: Real,
    sample_s: float = SAMPLE_S,
    load_nm: tuple[float, float] = (0.0, 0.0),
) -> RampMotion:
    """Simulate the axis along a motion of its motor, from rest.

    The drive's own law runs at the loop's period and delay.

    Torque limit, encoder steps and the bus are left out; friction and gravity are one constant torque. On the reference robot the
    tip peak of the ramp comes out within a few per cent of the full physics.

    Args:
        reference_rad: θ_ref at every period of the loop; shape (samples,). It starts at rest.
        sample_s: Time between two samples of the result, rounded to whole periods.
        load_nm: Friction and gravity against the motor, constant on a ramp. To a filter that follows the speed they matter: while
            its coefficients change it passes a constant torque on as an oscillation. Gravity reaches the motor through the gear,
            N θ'_sync more or less of it.

    Source: the paper, Fig. 3, eq. (1) and (2).
    """
    motion = follow_alike([loop], [error], reference_rad, sample_s, load_nm)
    return RampMotion(motion.period_s, motion.motor_speed_rps[0], motion.arm_acceleration_rad_s2[0])


def follow_alike(
    loops: Sequence[Loop],
    errors: Sequence[TransmissionError],
    reference_rad: Real,
    sample_s: float = SAMPLE_S,
    load_nm: tuple[float, float] = (0.0, 0.0),
) -> RampMotion:
    """Simulate several axes along the same motion; shapes (axes, n); see `follow`.

    Side by side they take three quarters of the time, and no bit of them changes.

    Args:
        loops: Loops of one period and delay.
        errors: Errors of the same number of orders.
    """
    period_s, delay, count = loops[0].period_s, loops[0].delay_samples, len(loops)
    every = max(1, round(sample_s / period_s))
    reference = np.array(reference_rad, dtype=np.float64)
    plants, laws = np.zeros(count, CORE.dtype("ramp_plant")), np.zeros(count, LAW)
    for plant, law, loop in zip(plants, laws, loops, strict=True):
        plant["ratio"] = loop.plant.reduction_ratio
        step, plant["arm"] = _discrete(loop.plant, period_s)
        plant["step"] = step.T
        ServoConfig(loop.cascade, math.inf, tuple(loop.notches)).write(law)
    harmonics = np.stack([_harmonics(error) for error in errors])
    speeds, accelerations = np.zeros((2, count, -(-len(reference) // every)))
    waiting = np.full((count, delay), sum(load_nm))
    CORE.call.ramp_run(
        CORE.pointer(plants, "ramp_plant"), CORE.pointer(harmonics, "harmonic"), harmonics.shape[1], CORE.pointer(laws, "law"),
        count, period_s, *load_nm, CORE.pointer(waiting), delay, every, CORE.pointer(reference), len(reference),
        CORE.pointer(speeds), CORE.pointer(accelerations),
    )  # fmt: skip
    return RampMotion(every * period_s, speeds, accelerations)


def _harmonics(error: TransmissionError) -> NDArray[np.void]:
    """Orders of an error as `struct harmonic`; shape (orders,)."""
    found = np.zeros(len(error.amplitude_arcsec), CORE.dtype("harmonic"))
    for row, (order, size) in zip(found, sorted(error.amplitude_arcsec.items()), strict=True):
        phase = math.radians(error.phase_deg[order])
        row["order"], row["cosine"], row["sine"] = order, size * ARCSEC * math.cos(phase), size * ARCSEC * math.sin(phase)
    return found
