"""An arm on a gear that is soft at small torsions and has hysteresis, along a measured motion of its motor.

The equations are those of `gear.h`.

Source of the harmonic balance: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design
(1968), section 2.2.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.core.library import CORE
from hil.design.ate.ripple import NO_RIPPLE, Ripple
from hil.design.transmission_error import motor_speed_rps

STEPS_PER_RADIAN = 2.0
"""Accuracy: steps per radian of the fastest vibration: a Runge-Kutta step of order 4 turns it by 3e-4 rad too little (h⁵/120)."""
LEAST_SOFTNESS, LEAST_HYSTERESIS_RAD = 1e-5, 1e-10
"""Accuracy: softness and friction that no motion shows: 1e-5 of the torque, and 20 µas of torsion."""
RIPPLE_ROUNDS = 2
"""Accuracy: rounds in which the ripple is evaluated at the angle that contains it: of 500″ at order 4, each leaves 1 %."""
BALANCED = 200
"""Accuracy: instants of a period, arm angles, and torsions under gravity of a harmonic balance: a factor of 2 changes 0.004."""


@dataclass(frozen=True)
class GearLaw:
    """Spring, losses and load of a gear, all per arm inertia J_l.

    Attributes:
        resonance_hz: Resonance ω/2π at large torsions, the motor held and without hysteresis.
        softness: r, fraction of the stiffness that is missing at small torsions.
        wind_up_rad: ψ_s, torsion over which it comes back.
        hysteresis_rad: F/K_g, torsion that carries Dahl's friction.
        hysteresis_torsion_rad: ψ_h, torsion over which that turns round.
        gravity_rad_s2: (g_c, g_s): gravity decelerates the arm by g_c cos θ_l + g_s sin θ_l.
    """

    resonance_hz: float
    damping: float
    gear_fraction: float = 0.9
    softness: float = 0.0
    wind_up_rad: float = 1.0
    hysteresis_rad: float = 0.0
    hysteresis_torsion_rad: float = 1.0
    gravity_rad_s2: tuple[float, float] = (0.0, 0.0)

    @property
    def is_linear(self) -> bool:
        """True if the spring is a straight line and nothing of the torque is friction's."""
        return self.softness < LEAST_SOFTNESS and self.hysteresis_rad < LEAST_HYSTERESIS_RAD

    def arm_at(self, torsion_rad: float, arm_rad: Real) -> tuple[float, float]:
        """Resonance in Hz and damping ratio of a vibration, by harmonic balance.

        A torsion ψ = ψ_g + a sin φ about what gravity winds up has the acceleration K a sin φ + L a cos φ, and harmonics.

        Args:
            torsion_rad: Amplitude a of the torsion.
            arm_rad: Arm angles of the motion; their quantiles count.
        """
        omega, angle = 2.0 * math.pi * self.resonance_hz, np.quantile(arm_rad, (np.arange(BALANCED) + 0.5) / BALANCED)
        phase = (np.arange(BALANCED) + 0.5) * (2.0 * math.pi / BALANCED)
        sine, sign = np.sin(phase), np.sign(np.cos(phase))
        cosine_part, sine_part = self.gravity_rad_s2
        load = (cosine_part * np.cos(angle) + sine_part * np.sin(angle)) / omega**2
        reach = float(np.max(np.abs(load))) / (1.0 - self.softness)
        sags = np.linspace(-reach, reach, BALANCED)
        torsion = np.interp(load, self._spring(sags), sags)[:, np.newaxis] + torsion_rad * sine
        spring = np.mean(self._spring(torsion), axis=0)
        far = 2.0 / (1.0 + math.exp(-2.0 * torsion_rad / self.hysteresis_torsion_rad))
        turned = np.exp(-torsion_rad * (1.0 + sign * sine) / self.hysteresis_torsion_rad)
        torque = spring + self.hysteresis_rad * sign * (1.0 - far * turned)
        scale = 2.0 * omega**2 / (BALANCED * torsion_rad)
        posture = float(np.mean(self.posture_stiffness(angle)))
        own = math.sqrt(max(scale * float(torque @ sine) + posture, np.finfo(float).tiny))
        return own / (2.0 * math.pi), (self.damping * omega + 0.5 * scale * float(torque @ np.cos(phase)) / own) / own

    def _spring(self, torsion_rad: Real) -> Real:
        """The spring's torque over K_g."""
        return np.asarray(torsion_rad * (1.0 - self.softness * np.exp(-((torsion_rad / self.wind_up_rad) ** 2))))

    def posture_stiffness(self, arm_rad: Real) -> Real:
        """Stiffness over J_l that gravity adds at arm angles, in rad/s² per rad."""
        cosine, sine = self.gravity_rad_s2
        return np.asarray(sine * np.cos(arm_rad) - cosine * np.sin(arm_rad))

    def record(self, wound: float = 0.0, ahead_rad: complex = 0j) -> NDArray[np.void]:
        """The law as `struct gear_law`; shape (1,)."""
        made = np.zeros(1, CORE.dtype("gear_law"))
        omega = 2.0 * math.pi * self.resonance_hz
        made["stiffness"] = omega**2
        made["gear_damping"] = 2.0 * self.gear_fraction * self.damping * omega
        made["arm_damping"] = 2.0 * (1.0 - self.gear_fraction) * self.damping * omega
        made["softness"], made["per_wind_up"] = self.softness, 1.0 / self.wind_up_rad
        made["hysteresis"], made["per_hysteresis"] = omega**2 * self.hysteresis_rad, 1.0 / self.hysteresis_torsion_rad
        made["gravity_cosine"], made["gravity_sine"] = self.gravity_rad_s2
        made["wound"] = wound
        made["ahead"], made["ahead_speed"] = ahead_rad.real, -omega * ahead_rad.imag
        return made

    def follow(self, base_rad: Real, speed_rad_s: Real, step_s: float, wound: float = 0.0, ahead_rad: complex = 0j) -> Real:
        """Acceleration of the arm along a motion of the gear's input, from rest or ringing.

        Args:
            base_rad: θ_m/N + θ_sync at every half step; shape (2 n + 1,).
            speed_rad_s: Its rate of change, of the same shape.
            wound: Dahl's friction over F at rest, which the motions before have left.
            ahead_rad: Phasor of the arm's ringing at the beginning: Re[ahead e^{jωt}] in a linear gear.

        Returns:
            θ̈_l in rad/s² at every step; shape (n + 1,).

        Raises:
            ValueError: The shapes differ, or there is no half step between two steps.
        """
        if base_rad.shape != speed_rad_s.shape or base_rad.ndim != 1 or len(base_rad) % 2 == 0:
            raise ValueError(
                f"base and speed have shapes {base_rad.shape} and {speed_rad_s.shape}; both must be (2 n + 1,), with half steps"
            )
        motions = np.stack([base_rad, speed_rad_s])[np.newaxis]
        return np.asarray(follow_alike(self.record(wound, ahead_rad), motions, step_s)[0])


def follow_alike(records: NDArray[np.void], motions: Real, step_s: float) -> Real:
    """Accelerations of several arms, as each has it alone; see `GearLaw.follow`.

    Args:
        records: A `struct gear_law` of each; shape (arms,).
        motions: The base of each and its rate, or those of all; shape (arms, 2, 2 n + 1) or (1, 2, 2 n + 1).

    Returns:
        θ̈_l in rad/s² at every step; shape (arms, n + 1).
    """
    numbers = motions.shape[2]
    accelerations = np.empty((len(records), numbers // 2 + 1))
    base = CORE.pointer(motions)
    CORE.call.gear_follow(
        CORE.pointer(records, "gear_law"), len(records), base, base + numbers, 2 * numbers if len(motions) > 1 else 0,
        numbers // 2, step_s, CORE.pointer(accelerations),
    )  # fmt: skip
    return accelerations


def _between(period_s: float, values: Real) -> scipy.interpolate.BSpline:
    """Spline of degree 7 through samples, at rest at both ends.

    At 0.3 of the sampling rate it keeps an amplitude to 0.2 %, a cubic spline to 4 %: f_r is there at long SYNC periods.
    """
    rest = [(order, 0.0) for order in (1, 2, 3)]
    time_s = period_s * np.arange(len(values))
    return scipy.interpolate.make_interp_spline(time_s, values, 7, bc_type=(rest, rest))  # type: ignore[arg-type]


@dataclass(frozen=True)
class BaseMotion:
    """Motion of a gear's input, at half steps of an integration.

    It is the spline through the measured motor angle, but for its ripple, with the waves of some orders.

    Attributes:
        rigid: θ_m/N in rad, and its rate; shape (2, 2 n + 1).
        waves: cos kθ_m and −sin kθ_m of each order k, and their rates; shape (2, 2 orders, 2 n + 1).
    """

    per_sample: int
    step_s: float
    rigid: Real
    waves: Real

    @classmethod
    def of(
        cls,
        motor_angle_rad: Real,
        period_s: float,
        reduction_ratio: float,
        orders: tuple[float, ...],
        fastest_hz: float,
        ripple: Ripple = NO_RIPPLE,
    ) -> "BaseMotion":
        """Motion along a measured motor angle.

        Args:
            motor_angle_rad: θ_m, equally spaced; shape (samples,).
            fastest_hz: Fastest vibration that the steps resolve.
            ripple: Ripple of the motor that its samples show at another frequency.
        """
        per_sample = max(1, math.ceil(STEPS_PER_RADIAN * 2.0 * math.pi * fastest_hz * period_s))
        shown, _ = ripple.angle(motor_angle_rad, motor_speed_rps(motor_angle_rad, period_s))
        spline = _between(period_s, motor_angle_rad - shown)
        halves = period_s / (2 * per_sample) * np.arange(2 * per_sample * (len(motor_angle_rad) - 1) + 1)
        smooth, smooth_speed = spline(halves), spline(halves, 1)
        angle, speed = smooth, smooth_speed
        for _ in range(RIPPLE_ROUNDS if ripple.waves else 0):
            added = ripple.angle(angle, smooth_speed / (2.0 * math.pi))
            angle, speed = smooth + added[0], smooth_speed + added[1]
        k = np.array(orders)[:, np.newaxis]
        cosine, sine = np.cos(k * angle), np.sin(k * angle)
        waves = np.stack([np.stack([cosine, -sine], 1), np.stack([-k * sine * speed, -k * cosine * speed], 1)])
        rigid = np.stack([angle, speed]) / reduction_ratio
        return cls(per_sample, period_s / per_sample, rigid, waves.reshape(2, 2 * len(orders), -1))

    def shaken(self, noise_rad: Real, reduction_ratio: float) -> tuple[Real, Real]:
        """What a disturbance of the measured motor angle adds to the input and to its rate; both of shape (2 n + 1,)."""
        spline = _between(self.step_s * self.per_sample, noise_rad / reduction_ratio)
        halves = 0.5 * self.step_s * np.arange(self.rigid.shape[1])
        return spline(halves), spline(halves, 1)

    def with_error(self, unknowns: Real, out: Real | None = None) -> Real:
        """θ_m/N + θ_sync and its rate, of A_k cos φ_k and A_k sin φ_k in rad; shape (2, 2 n + 1)."""
        made = np.matmul(unknowns, self.waves, out=out)
        made += self.rigid
        return np.asarray(made)
