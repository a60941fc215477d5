"""Sensor behind the arm on its gear.

The module predicts the tip acceleration or motor torque of a motion with a transmission error.

The motor's angle is a spline over its samples; the arm answers to it on a grid fine enough for the highest order, from rest or
from a steady turning. For a given arm the signal is linear in A_k cos φ_k and A_k sin φ_k.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.ate.model import Arm, Sensing
from hil.design.frequency import OF_SAMPLING
from hil.design.recorded.fit import AngleSection
from hil.design.recorded.slow import degrees_for, slow_columns

FINE_S = 0.0005
"""Accuracy: step on which the arm answers: 0.1 % at 30 Hz."""
PASSED_UP_TO = 3.0
"""Highest frequency that is fitted, by the arm's, since a sensor shows noise beyond. In two recordings 4.2 changes 0.5, and
errors by 9 %; 2.1 changes 1.9, and errors by 39 %."""
DIFFERENCE = 0.05
"""Accuracy: step of a slope in resonance, damping and delay, by their errors: a factor of 2 changes 0.005 in two recordings."""
MOST_FINE = 4_000_000
"""Bound: memory of a fit: 32 MB for each column."""
MOST_KEPT = 6
"""Accuracy: arms, or orders, whose waves are kept, for time alone: those of one standard error, or of several stretches."""


@dataclass(frozen=True)
class ArmPrior:
    """Arm and sensor before the fit, with standard errors.

    Attributes:
        arm: Arm on its gear and delay of the sensor.
        resonance_fraction: Standard error of its resonance by its resonance.
        damping_fraction: Standard error of its damping by its damping.
    """

    arm: Arm
    resonance_fraction: float
    damping_fraction: float
    delay_error_s: float

    def moved(self, by: Sequence[float]) -> Arm:
        """Arm with its parameters moved by some standard errors."""
        return replace(
            self.arm,
            resonance_hz=self.arm.resonance_hz * math.exp(self.resonance_fraction * by[0]),
            damping=self.arm.damping * math.exp(self.damping_fraction * by[1]),
            delay_s=self.arm.delay_s + self.delay_error_s * by[2],
        )


class ThroughArm:
    """Recording of a sensor behind the arm, on an even grid.

    Attributes:
        time_s: The grid; shape (n,).
        motor_rad: Motor angle there.
        signal: Signal there, without what lies beyond `PASSED_UP_TO`.
    """

    def __init__(self, time_s: Real, motor_rad: Real, values: Real, ratio: float, sensing: Sensing, arm_hz: float) -> None:
        """Put a recording on the grid.

        Args:
            time_s: Instants of the samples, increasing; shape (n,).
            motor_rad: Motor angle; shape (n,).
            values: Acceleration in m/s², or torque in N·m; shape (n,).
            arm_hz: Resonance by which the passed frequencies count.

        Raises:
            ValueError: The sampling is too slow for the arm, or the recording too long.
        """
        period = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
        if period > 0.2 / arm_hz:
            least = 200.0 / arm_hz
            raise ValueError(
                f"samples every {1e3 * period:.3g} ms do not show an arm at {arm_hz:.3g} Hz; at most {least:.3g} ms is allowed"
            )
        self._ratio, self._sensing = ratio, sensing
        self._every = max(1, math.ceil(period / FINE_S))
        if len(time_s) * self._every > MOST_FINE:
            raise ValueError(
                f"{len(time_s)} samples are too many; at most {MOST_FINE // self._every} can be fitted through an arm"
            )
        self.time_s = time_s[0] + period * np.arange(len(time_s))
        self._fine_s = time_s[0] + period / self._every * np.arange((len(time_s) - 1) * self._every + 1)
        self._fine_rad = scipy.interpolate.CubicSpline(time_s, motor_rad)(self._fine_s)
        self.motor_rad = np.asarray(self._fine_rad[:: self._every])
        self._low = scipy.signal.butter(4, min(PASSED_UP_TO * arm_hz, OF_SAMPLING / period), fs=1.0 / period, output="sos")
        even = np.asarray(scipy.interpolate.CubicSpline(time_s, values)(self.time_s))
        self.signal = np.asarray(scipy.signal.sosfiltfilt(self._low, even))
        self._made: dict[tuple[Arm, tuple[float, ...]], Real] = {}
        self.independent = min(1.0, 2.0 * PASSED_UP_TO * arm_hz * period)

    def motion(self, arm: Arm) -> Real:
        """Signal that the motor's own motion makes; shape (n,)."""
        moved = self._fine_rad / self._ratio
        few = max(2, self._every)
        speed = (moved[few] - moved[0]) / (self._fine_s[few] - self._fine_s[0])
        steady = moved - moved[0] - speed * (self._fine_s - self._fine_s[0])  # what turns steadily is not accelerated
        felt = self._sensing.gain * self._answer(steady, arm)
        felt += self._sensing.motor_inertia_kg_m2 * self._ratio * self._twice(steady)
        return self._shown(felt, arm)

    def waves(self, arm: Arm, orders: Sequence[float]) -> Real:
        """Signal per unit of each linear unknown; shape (n, 2·orders).

        The unknowns are A cos φ and A sin φ of each order, in rad.
        """
        key = arm, tuple(orders)
        if key not in self._made:
            if len(self._made) >= MOST_KEPT:
                self._made.clear()
            waves = [wave for k in orders for wave in (np.cos(k * self._fine_rad), -np.sin(k * self._fine_rad))]
            self._made[key] = np.column_stack([self._shown(self._sensing.gain * self._answer(wave, arm), arm) for wave in waves])
        return self._made[key]

    def _answer(self, driven: Real, arm: Arm) -> Real:
        """Acceleration of the arm in rad/s² for a motion of its gear."""
        step = float(self._fine_s[1] - self._fine_s[0])
        modes = [(1.0 - sum(each.part for each in arm.others), arm.resonance_hz, arm.damping)]
        modes += [(each.part, each.resonance_hz, each.damping) for each in arm.others]
        total = np.zeros_like(driven)
        for part, hz, damping in modes:
            omega = 2.0 * math.pi * hz
            above, below = _discrete(omega, damping, arm.gear_fraction * damping, step)
            start = scipy.signal.lfilter_zi(above, below) * driven[0]
            total += part * scipy.signal.lfilter(above, below, driven, zi=start)[0]
        return self._twice(total)

    def _twice(self, values: Real) -> Real:
        step = float(self._fine_s[1] - self._fine_s[0])
        inner = (values[2:] - 2.0 * values[1:-1] + values[:-2]) / step**2
        return np.concatenate([inner[:1], inner, inner[-1:]])

    def _shown(self, fine: Real, arm: Arm) -> Real:
        late = fine[:: self._every] if arm.delay_s == 0.0 else np.interp(self.time_s - arm.delay_s, self._fine_s, fine)
        return np.asarray(scipy.signal.sosfiltfilt(self._low, late))


@functools.lru_cache(maxsize=64)
def _discrete(omega: float, damping: float, of_gear: float, step: float) -> tuple[Real, Real]:
    """Discretise the arm's response for linear input between samples.

        (2 ζ_g ω s + ω²)/(s² + 2 ζ ω s + ω²)

    Returns numerator and denominator in z.
    """
    system = (np.array([2.0 * of_gear * omega, omega**2]), np.array([1.0, 2.0 * damping * omega, omega**2]))
    above, below, _ = scipy.signal.cont2discrete(system, step, "foh")
    return np.asarray(above, dtype=np.float64).ravel(), np.asarray(below, dtype=np.float64).ravel()


Rows = Sequence[tuple[ThroughArm, slice]]
"""Stretches: a recording, and rows of it."""


@dataclass(frozen=True)
class RefinedArm:
    """Arm as the recordings show it.

    Attributes:
        steps: Arms that lie one standard error away, each along an axis of their uncertainty.
    """

    arm: Arm
    steps: tuple[Arm, ...]


def refined_arm(rows: Rows, orders: Sequence[float], prior: ArmPrior) -> RefinedArm:
    """Refine resonance, damping and delay on some stretches.

    The prior of the arm counts with its standard errors.

    Args:
        rows: The stretches.
    """
    bases = []
    for through, inside in rows:
        angle = through.motor_rad[inside]
        turns = float(np.ptp(angle)) / (2.0 * math.pi)
        bases.append(slow_columns(angle, min(8, max(degrees_for(turns, min(orders))))))
    rest = np.ones(1)

    def residual(by: Real) -> Real:
        arm, parts = prior.moved([float(each) for each in by]), []
        known: dict[int, tuple[Real, Real]] = {}
        for (through, inside), basis in zip(rows, bases, strict=True):
            if id(through) not in known:
                known[id(through)] = through.motion(arm), through.waves(arm, orders)
            motion, waves = known[id(through)]
            wanted, design = (through.signal - motion)[inside], np.hstack([basis, waves[inside]])
            design = design / (np.linalg.norm(design, axis=0) + 1e-300)
            parts.append(wanted - design @ np.linalg.lstsq(design, wanted, rcond=1e-10)[0])
        return np.concatenate([*(part / rest[0] for part in parts), by])

    def slopes(by: Real) -> Real:  # over a step that counts: one by the size of `by`, which begins at 0, sees rounding alone
        here = residual(by)
        return np.column_stack([(residual(by + DIFFERENCE * axis) - here) / DIFFERENCE for axis in np.eye(3)])

    first = residual(np.zeros(3))[:-3]
    independent = float(np.mean([through.independent for through, _ in rows]))
    rest[0] = math.sqrt(float(np.mean(first**2)) / independent) or 1.0
    by = np.zeros(3)
    jacobian = np.eye(3)
    for _ in range(2):  # the noise is known once the arm is
        found = scipy.optimize.least_squares(residual, by, slopes, bounds=(-6.0, 6.0), x_scale=1.0, max_nfev=12)
        by, jacobian = np.asarray(found.x), np.asarray(found.jac)
        rest[0] *= math.sqrt(float(np.mean(residual(by)[:-3] ** 2)) / independent) if independent > 0 else 1.0
        rest[0] = max(rest[0], 1e-300)
    covariance = np.linalg.inv(jacobian.T @ jacobian + 1e-12 * np.eye(3))
    values, axes = np.linalg.eigh(covariance)
    steps = tuple(prior.moved(list(by + math.sqrt(max(value, 0.0)) * axis)) for value, axis in zip(values, axes.T, strict=True))
    return RefinedArm(prior.moved(list(by)), steps)


def arm_section(through: ThroughArm, inside: slice, arm: Arm) -> AngleSection:
    """Section of a recording for a given arm."""

    def waves(orders: Sequence[float]) -> Real:
        return through.waves(arm, orders)[inside]

    return AngleSection(through.motor_rad[inside], (through.signal - through.motion(arm))[inside], waves)
