"""Ringing of an arm while a loop holds its motor.

The module computes the modes that ring, and how much each of them rings after a stop.

While the set-points rest, nothing drives the arm, and its motion is a sum over the poles of the closed loop: decays of the
following error, and waves of the arm. So the tip's acceleration after a stop is linear in their amplitudes,

    a(t) = c + Σ c_i e^{−r_i t} + Σ Re(b_j e^{s_j t}),      t from the end of the set-points' motion

and the fit separates the following error from the ringing. A band-pass cannot do that, since both lie in the same band.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.shapers import MOST_SHAPED_DAMPING, SwingingMode
from hil.design.coupled.structure import Structure
from hil.design.estimation import inverse
from hil.design.frequency import TIP_HZ, Loop
from hil.design.modes.problem import ArmMode

APART_HZ = 1e-3
"""Accuracy: difference below which two poles are one."""
FEWEST_SAMPLES = 64
"""Probability: least number of samples after a stop: beside a dozen unknowns they tell the noise to 10 %."""


def closed_loop_rates(loop: Loop, modes: Sequence[ArmMode] = ()) -> Complex:
    """Closed-loop rates s at standstill, in rad/s, up to `TIP_HZ`.

    There is one of each pair; those that ring come last.

    Args:
        loop: The loop; without modes its plant is the arm.
        modes: Modes of an arm that rings with several; of the plant the motor counts then.
    """
    if modes:
        held = Structure.of_modes(loop.plant, [(each.inertia_kg_m2, each.frequency_hz, each.damping) for each in modes])
        poles = held.poles({0: loop.law_block()}, loop.period_s)
    else:
        poles = loop.closed_loop_poles()
    rates = np.log(poles.astype(np.complex128)) / loop.period_s
    highest, least = 2.0 * math.pi * TIP_HZ, 2.0 * math.pi * APART_HZ
    kept = [complex(rate.real, rate.imag if rate.imag > least else 0.0) for rate in rates if rate.imag > -least]
    return np.array(sorted((rate for rate in kept if abs(rate) <= highest), key=lambda rate: (_rings(rate), abs(rate))))


def _rings(rate: complex) -> bool:
    return rate.imag > 0.0 and 0.0 <= -rate.real <= MOST_SHAPED_DAMPING * abs(rate)


def modes_of(rates: Complex) -> list[SwingingMode]:
    """List the modes that ring, from the lowest.

    A pole with more damping than `MOST_SHAPED_DAMPING` does not ring.
    """
    return [SwingingMode(abs(rate) / (2.0 * math.pi), -rate.real / abs(rate)) for rate in rates.tolist() if _rings(rate)]


@dataclass(frozen=True)
class RingDown:
    """Waves of an arm after a stop.

    Attributes:
        modes: Modes that ring, from the lowest.
        amplitude_mm: Amplitude of the tip with each where the set-points stand still.
        rms_mm: Root mean square of all together, over the time that was looked at.
        time_s: That time.
        wave_m_s2: Acceleration of all that rings; shape (n,).
    """

    modes: tuple[SwingingMode, ...]
    amplitude_mm: tuple[float, ...]
    error_mm: tuple[float, ...]
    rms_mm: float
    time_s: float
    wave_m_s2: Real

    @property
    def largest_mm(self) -> float:
        """Largest displacement that the waves can have together."""
        return math.fsum(self.amplitude_mm)


def ring_down(tip_m_s2: Real, period_s: float, rates: Complex) -> RingDown:
    """Waves of an arm after a stop, by least squares.

    Args:
        tip_m_s2: Acceleration of the tip from where the set-points stand still; shape (n,).

    Raises:
        ValueError: Nothing rings, or there are too few samples.
    """
    modes = modes_of(rates)
    if not modes:
        raise ValueError("the closed loop has no mode that rings, so a stop cannot be judged")
    count = len(tip_m_s2)
    if count < FEWEST_SAMPLES:
        raise ValueError(f"the recording has {count} samples after the stop; at least {FEWEST_SAMPLES} are needed; raise tail_s")
    time: Real = period_s * np.arange(count, dtype=np.float64)
    values = np.asarray(tip_m_s2, dtype=np.float64)
    ringing = rates[len(rates) - len(modes) :]
    columns = [np.ones(count), *_columns(rates[: len(rates) - len(modes)], time)]
    matrix = np.column_stack([*columns, *_columns(ringing, time)])
    scale = np.linalg.norm(matrix, axis=0)
    solution = np.linalg.lstsq(matrix / scale, values, rcond=None)[0] / scale
    rest = values - matrix @ solution
    variance = float(rest @ rest) / (count - matrix.shape[1])
    spread = inverse((matrix / scale).T @ (matrix / scale)) * variance / np.outer(scale, scale)
    begin, amplitudes, errors, moved = len(columns), [], [], np.zeros(count)
    for number, rate in enumerate(ringing):
        at = begin + 2 * number
        to_mm = 1e3 / abs(rate) ** 2
        amplitudes.append(to_mm * math.hypot(solution[at], solution[at + 1]))
        errors.append(to_mm * math.sqrt(0.5 * (spread[at, at] + spread[at + 1, at + 1])))
        moved += to_mm * matrix[:, at : at + 2] @ solution[at : at + 2]
    return RingDown(
        tuple(modes), tuple(amplitudes), tuple(errors), float(np.sqrt(np.mean(moved**2))), count * period_s,
        matrix[:, begin:] @ solution[begin:],
    )  # fmt: skip


def _columns(rates: Complex, time_s: Real) -> list[Real]:
    """Decays and waves of poles over time."""
    found: list[Real] = []
    for rate in rates.tolist():
        wave = np.exp(rate * time_s)
        found += [wave.real, -wave.imag] if rate.imag else [wave.real]
    return found
