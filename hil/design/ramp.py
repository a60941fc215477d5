"""Simulated motion of one axis, without a bus.

The filter follows the motor while the arm moves.

At constant speed the closed form G_al gives the arm's vibration. On a ramp it does not: with the notch the closed loop has a time
constant of 0.2 s, in which a motor that gains 4 rev/s every second has left the resonance. So a filter is designed on the ramp
on which it will be judged.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.control.compiled import compiled, inlined
from hil.control.records import record_dtype
from hil.control.servo import LAW, LawRow, ServoConfig, servo_start, servo_step
from hil.design.frequency import Loop, TwoInertia
from hil.design.transmission_error import TransmissionError

Real = NDArray[np.float64]

SAMPLE_S = 0.002
"""Time between two samples of the result: 500 Hz shows vibrations up to 25 Hz with ease."""
MAX_PARTS = 20
"""Orders are looked for among fractions with denominators up to this."""
MAX_MULTIPLE = 40.0
"""Most turnings on from the first to the highest order; more take as long as sines."""


@dataclass(frozen=True)
class RampMotion:
    """Motion of the axis, at equal intervals.

    Attributes:
        period_s: Time between two samples.
        motor_speed_rps: Motor speed f_m with its sign; shape (n,).
        arm_acceleration_rad_s2: Arm acceleration θ̈_l; shape (n,).
    """

    period_s: float
    motor_speed_rps: Real
    arm_acceleration_rad_s2: Real


class _PlantRow(Protocol):
    """Plant over one period of the law.

    ratio: N; step: the state x one period later from (x, τ, θ_sync, its change over the period), see `_discrete`; arm: θ̈_l from
    the same numbers.
    """

    ratio: float
    step: Annotated[Real, (4, 7)]
    arm: Annotated[Real, (7,)]


_PLANT = record_dtype(_PlantRow)


@compiled
def _waves(harmonics: Real, angle: float) -> tuple[float, float]:
    """Error θ_sync and its slope dθ_sync/dθ_m at a motor angle.

        θ_sync = Σ A_k cos(k θ_m + φ_k)

    `harmonics` are those of `_harmonics`.

    Where all orders are multiples of one, cos k θ_m and sin k θ_m come from its own by turning on: one sine instead of all.
    """
    error, slope = 0.0, 0.0
    base = 0.0
    if harmonics.shape[1] > 0 and harmonics[3, 0] > 0.0:
        base = harmonics[0, 0] / harmonics[3, 0]
    once, turned = complex(math.cos(base * angle), math.sin(base * angle)), complex(1.0, 0.0)
    there = 0.0
    for i in range(harmonics.shape[1]):
        k, a, b = harmonics[0, i], harmonics[1, i], harmonics[2, i]
        if base > 0.0:
            while there < harmonics[3, i]:
                turned *= once
                there += 1.0
        else:
            turned = complex(math.cos(k * angle), math.sin(k * angle))
        error += a * turned.real - b * turned.imag
        slope -= k * (a * turned.imag + b * turned.real)
    return error, slope


@inlined
def _product(row: Real, values: Real) -> float:
    """Sum of the products, always in the same order."""
    total = 0.0
    for j in range(7):
        total += row[j] * values[j]
    return total


@compiled
def _run(
    plant: _PlantRow,
    harmonics: Real,
    law: LawRow,
    period_s: float,
    friction_nm: float,
    gravity_nm: float,
    waiting: Real,
    every: int,
    reference: Real,
    samples: Real,
) -> None:
    """Run law and plant sample by sample; every `every`-th sample is recorded.

    Args:
        plant: The plant over one period.
        harmonics: The error, as of `_harmonics`.
        law: The law that closes the loop.
        period_s: Sampling time of the law.
        friction_nm: Friction against the motor throughout; the law holds it and gravity from the beginning.
        gravity_nm: Gravity against the motor, through the gear: the error's slope modulates it.
        waiting: Torques that have been computed and do not act yet; shape (delay_samples,).
        every: Number of control periods per recorded sample.
        reference: θ_ref in rad; shape (samples,).
        samples: Out: rev/s of the motor, and θ̈_l; shape (2, samples).
    """
    x, v = np.zeros(4), np.zeros(7)
    x[0] = reference[0]
    sync, slope = _waves(harmonics, x[0])
    x[2] = x[0] / plant.ratio + sync  # at rest and unloaded the gear is without torsion: eq. (1)
    servo_start(law, x[0], 0.0, friction_nm + gravity_nm)
    last = 0.0
    for n in range(len(reference)):
        command = servo_step(law, period_s, 1e300, reference[n], 0.0, 0.0, x[0])
        torque = command
        if len(waiting) > 0:
            torque = waiting[n % len(waiting)]
            waiting[n % len(waiting)] = command
        v[:4] = x
        load = friction_nm
        if gravity_nm != 0.0:
            load += gravity_nm * (1.0 + plant.ratio * slope)
        # the motor's angle one period ahead is known to 1e-6 rad from its speed and last acceleration
        ahead, slope = _waves(harmonics, x[0] + period_s * (x[1] + 0.5 * (x[1] - last)))
        last = x[1]
        v[4], v[5], v[6] = torque - load, sync, ahead - sync
        if n % every == 0:
            samples[0, n // every] = x[1] / (2.0 * math.pi)
            samples[1, n // every] = _product(plant.arm, v)
        for i in range(4):
            x[i] = _product(plant.step[i], v)
        sync = ahead


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
    return _exponential(a * period_s)[:4], np.array(a[3])


def _exponential(matrix: Real) -> Real:
    """Matrix exponential by its series, with scaling and squaring.

    For 7 × 7 the threads of LAPACK take a hundred times as long.
    """
    halvings = max(0, math.ceil(math.log2(max(1.0, float(np.max(np.sum(np.abs(matrix), axis=1)))))))
    scaled = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for n in range(1, 20):  # 1/20! is beyond double precision
        term = term @ scaled / n
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


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
        loop: Plant, gains, filters, sampling time, delay.
        error: Transmission error θ_sync.
        reference_rad: θ_ref at every period of the loop; shape (samples,). It starts at rest.
        sample_s: Time between two samples of the result, rounded to whole periods.
        load_nm: Friction and gravity against the motor, constant on a ramp. To a filter that follows the speed they matter: while
            its coefficients change it passes a constant torque on as an oscillation. Gravity reaches the motor through the gear,
            N θ'_sync more or less of it.

    Source: the paper, Fig. 3, eq. (1) and (2).
    """
    every = max(1, round(sample_s / loop.period_s))
    reference = np.ascontiguousarray(reference_rad, dtype=np.float64)
    plant, law = np.zeros(1, _PLANT), np.zeros(1, LAW)
    plant["ratio"] = loop.plant.reduction_ratio
    plant["step"][0], plant["arm"][0] = _discrete(loop.plant, loop.period_s)
    ServoConfig(loop.cascade, math.inf, tuple(loop.notches)).write(law[0])
    samples = np.zeros((2, -(-len(reference) // every)))
    waiting = np.full(loop.delay_samples, sum(load_nm))
    _run(plant[0], _harmonics(error), law[0], loop.period_s, *load_nm, waiting, every, reference, samples)
    return RampMotion(every * loop.period_s, samples[0], samples[1])


def _harmonics(error: TransmissionError) -> Real:
    """Orders and amplitudes of an error, as an array (4, orders).

    The rows are k, A_k cos φ_k and A_k sin φ_k in rad, and k in units of the largest common divisor of the orders.

    The last row is 0 where there is nothing of the kind, or only what would take longer than sines.
    """
    orders = sorted(error.amplitude_arcsec)
    size = np.array([error.amplitude_arcsec[k] * ARCSEC for k in orders])
    phase = np.array([math.radians(error.phase_deg[k]) for k in orders])
    parts = [Fraction(k).limit_denominator(MAX_PARTS) for k in orders]
    whole = math.lcm(*(part.denominator for part in parts))
    multiples = np.array([float(part * whole) for part in parts])
    exact = all(abs(float(part) - k) <= 1e-12 * k for part, k in zip(parts, orders, strict=True))
    if not exact or multiples.max(initial=0.0) > MAX_MULTIPLE:
        multiples[:] = 0.0
    return np.array([orders, size * np.cos(phase), size * np.sin(phase), multiples])
