"""A motion in the time domain, without friction and without a bus: what the arm does while the filter follows the motor.

At constant speed the closed form G_al says how far the arm vibrates. On a ramp it does not: with the notch the closed loop has a
time constant of 0.2 s, in which a motor that gains 4 rev/s every second has left the resonance. So a filter is designed on the
ramp on which it will be judged.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.cascade import CASCADE_CONFIG, CASCADE_STATE
from hil.control.compiled import compiled
from hil.control.notch import NO_NOTCH, NOTCH_CONFIG, NOTCH_STATE, NOTCHES
from hil.control.servo import servo_step
from hil.design.frequency import ARCSEC, Loop, TwoInertia
from hil.design.transmission_error import TransmissionError

Real = NDArray[np.float64]

SAMPLE_S = 0.002
"""How often the motion is kept: 500 Hz shows vibrations up to 25 Hz with ease."""


@dataclass(frozen=True)
class Motion:
    """What the axis did, at equal intervals.

    Attributes:
        period_s: Between two samples.
        motor_speed_rps: f_m with its sign; shape (n,).
        arm_acceleration_rad_s2: θ̈_l; shape (n,).
    """

    period_s: float
    motor_speed_rps: Real
    arm_acceleration_rad_s2: Real


@compiled
def _error(orders: Any, cosine: Any, sine: Any, angle: float) -> float:
    """θ_sync = Σ A_k cos(k θ_m + φ_k) from A_k cos φ_k and A_k sin φ_k."""
    total = 0.0
    for i in range(len(orders)):
        total += cosine[i] * math.cos(orders[i] * angle) - sine[i] * math.sin(orders[i] * angle)
    return total


@compiled
def _run(
    step: Any,
    row: Any,
    ratio: float,
    orders: Any,
    cosine: Any,
    sine: Any,
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
    period_s: float,
    waiting: Any,
    every: int,
    reference: Any,
    speed: Any,
    acceleration: Any,
) -> None:
    """Law and plant sample by sample; every `every`-th sample is kept.

    Args:
        step: x after one period from (x, τ, θ_sync, its change over the period), see `_discrete`; shape (4, 7).
        row: θ̈_l from the same numbers; shape (7,).
        ratio: N.
        orders: k.
        cosine: A_k cos φ_k in rad.
        sine: A_k sin φ_k in rad.
        cascade_config: As `servo_step` takes it, one row.
        cascade_state: The same.
        notch_config: The same.
        notch_state: The same.
        period_s: Sampling time of the law.
        waiting: Torques that have been computed and do not act yet; shape (delay_samples,).
        every: How many samples make one that is kept.
        reference: θ_ref in rad; shape (samples,).
        speed: Out: rev/s of the motor; shape (kept,).
        acceleration: Out: θ̈_l; shape (kept,).
    """
    x, v = np.zeros(4), np.zeros(7)
    x[0] = reference[0]
    sync = _error(orders, cosine, sine, x[0])
    x[2] = x[0] / ratio + sync  # at rest and unloaded the gear is without torsion: eq. (1)
    last = 0.0
    for n in range(len(reference)):
        command = servo_step(
            cascade_config, cascade_state, notch_config, notch_state, 0, period_s, 1e300, reference[n], 0.0, 0.0, x[0]
        )
        torque = command
        if len(waiting) > 0:
            torque = waiting[n % len(waiting)]
            waiting[n % len(waiting)] = command
        # the motor's angle one period ahead is known to 1e-6 rad from its speed and last acceleration
        ahead = _error(orders, cosine, sine, x[0] + period_s * (x[1] + 0.5 * (x[1] - last)))
        last = x[1]
        for i in range(4):
            v[i] = x[i]
        v[4], v[5], v[6] = torque, sync, ahead - sync
        if n % every == 0:
            speed[n // every] = x[1] / (2.0 * math.pi)
            total = 0.0
            for j in range(7):
                total += row[j] * v[j]
            acceleration[n // every] = total
        for i in range(4):
            total = 0.0
            for j in range(7):
                total += step[i, j] * v[j]
            x[i] = total
        sync = ahead


def _discrete(plant: TwoInertia, period_s: float) -> tuple[Real, Real]:
    """The plant over one period, exactly: τ is held, θ_sync goes straight from one sample to the next.

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
    """e^M by its series, scaled and squared: scipy's calls LAPACK, whose threads take a hundred times as long for 7 × 7."""
    halvings = max(0, math.ceil(math.log2(max(1.0, float(np.max(np.sum(np.abs(matrix), axis=1)))))))
    scaled = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for n in range(1, 20):  # 1/20! is beyond double precision
        term = term @ scaled / n
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def follow(loop: Loop, error: TransmissionError, reference_rad: Real, sample_s: float = SAMPLE_S) -> Motion:
    """The axis along a motion of its motor, from rest, with the very law that the drive runs at the loop's period and delay.

    Friction, gravity, torque limit, encoder steps and the bus are left out. They are slow or small against the vibration: on the
    reference robot the tip peak of the ramp comes out within a few per cent of the full physics.

    Args:
        loop: Plant, gains, filters, sampling time, delay.
        error: θ_sync.
        reference_rad: θ_ref at every period of the loop; shape (samples,). It starts at rest.
        sample_s: How often the result is kept, rounded to whole periods.

    Source: the paper, Fig. 3, eq. (1) and (2).
    """
    every = max(1, round(sample_s / loop.period_s))
    reference = np.ascontiguousarray(reference_rad, dtype=np.float64)
    step, row = _discrete(loop.plant, loop.period_s)
    orders = np.array(sorted(error.amplitude_arcsec), dtype=np.float64)
    size = np.array([error.amplitude_arcsec[int(k)] * ARCSEC for k in orders])
    phase = np.array([math.radians(error.phase_deg[int(k)]) for k in orders])
    cascade, notches = np.zeros(1, CASCADE_CONFIG), np.zeros((1, NOTCHES), NOTCH_CONFIG)
    state = np.zeros(1, CASCADE_STATE)
    state["motor_angle_rad"] = reference[0]
    loop.cascade.write(cascade[0])
    for column in range(NOTCHES):
        (loop.notches[column] if column < len(loop.notches) else NO_NOTCH).write(notches[0, column])
    kept = -(-len(reference) // every)
    speed, acceleration = np.zeros(kept), np.zeros(kept)
    _run(
        step,
        row,
        loop.plant.reduction_ratio,
        orders,
        size * np.cos(phase),
        size * np.sin(phase),
        cascade,
        state,
        notches,
        np.zeros((1, NOTCHES), NOTCH_STATE),
        loop.period_s,
        np.zeros(loop.delay_samples),
        every,
        reference,
        speed,
        acceleration,
    )
    return Motion(every * loop.period_s, speed, acceleration)
