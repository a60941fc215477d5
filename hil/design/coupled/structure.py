"""Linear structure behind motors.

It is an arm on elastic joints, frozen in a posture, or the modes that one motor feels.

    M ẍ + D ẋ + K x = τ,      x = (θ_1 … θ_m; the rest),      P = (M s² + D s + K)⁻¹ of the motors

Of an arm in a posture q the rest are its joint angles, with the mass matrix H(q); each gear N_i, K_i, D_i lies between θ_i/N_i
and its joint. Gravity's own stiffness, a thousandth of a gear's, is left out, and so are torques that go with the speed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Complex, Real
from hil.design.frequency import Block, TwoInertia, closed_loop, held


def closed(receptance: Complex, motor: int, law: Complex | None) -> Complex:
    """Close one motor's loop in a receptance.

        R − R e eᵀ R/(1/C + eᵀ R e)

    If `law` is None, the motor is held.

    Args:
        receptance: R; shape (motors, motors, m).
        law: C = −τ/θ of it; shape (m,).
    """
    column, row, own = receptance[:, motor], receptance[motor], receptance[motor, motor]
    weight = 1.0 / own if law is None else law / (1.0 + law * own)
    return np.asarray(receptance - column[:, np.newaxis] * (row * weight)[np.newaxis])


@dataclass(frozen=True, eq=False)
class Structure:
    """Linear structure behind motors.

    Attributes:
        mass: M; shape (n, n).
        damping: D; shape (n, n).
        stiffness: K; shape (n, n).
        motors: Number of motors, which are the first coordinates.
    """

    mass: Real
    damping: Real
    stiffness: Real
    motors: int

    @classmethod
    def of_arm(cls, mass_matrix_kg_m2: Real, joints: Sequence[TwoInertia]) -> "Structure":
        """Build an arm on its gears.

        Args:
            mass_matrix_kg_m2: H of the posture; shape (n, n).
            joints: Motor and gear of each joint; their arms' inertias do not count.
        """
        n = len(joints)
        mass, damping, stiffness = (np.zeros((2 * n, 2 * n)) for _ in range(3))
        mass[n:, n:] = mass_matrix_kg_m2
        for i, joint in enumerate(joints):
            ratio = joint.reduction_ratio
            mass[i, i] = joint.motor_inertia_kg_m2
            damping[i, i], damping[n + i, n + i] = joint.motor_damping_nm_s_rad, joint.arm_damping_nm_s_rad
            gear = np.array([[1.0 / ratio**2, -1.0 / ratio], [-1.0 / ratio, 1.0]])
            at = np.ix_([i, n + i], [i, n + i])
            damping[at] += joint.gear_damping_nm_s_rad * gear
            stiffness[at] += joint.gear_stiffness_nm_rad * gear
        return cls(mass, damping, stiffness, n)

    @classmethod
    def of_modes(cls, motor: TwoInertia, modes: Sequence[tuple[float, float, float]]) -> "Structure":
        """Build a motor with its modes, all other motors held.

        Args:
            motor: The motor; of the rest only the reduction ratio counts.
            modes: Effective inertia in kg·m², frequency in Hz with the motor held, and damping of each.
        """
        n, ratio = 1 + len(modes), motor.reduction_ratio
        mass, damping, stiffness = (np.zeros((n, n)) for _ in range(3))
        mass[0, 0], damping[0, 0] = motor.motor_inertia_kg_m2, motor.motor_damping_nm_s_rad
        for i, (inertia, hz, zeta) in enumerate(modes, 1):
            omega = 2.0 * math.pi * hz
            spring = np.array([[1.0 / ratio**2, -1.0 / ratio], [-1.0 / ratio, 1.0]])
            at = np.ix_([0, i], [0, i])
            mass[i, i] = inertia
            damping[at] += 2.0 * zeta * omega * inertia * spring
            stiffness[at] += omega**2 * inertia * spring
        return cls(mass, damping, stiffness, 1)

    def stiffened(self, factor: float) -> "Structure":
        """Structure with all frequencies multiplied by a factor, motors aside.

        K is multiplied by its square, D by the factor itself.
        """
        return Structure(self.mass, factor * self.damping, factor**2 * self.stiffness, self.motors)

    def held(self, motors: Sequence[int]) -> "Structure":
        """Structure with some of its motors held."""
        free = [i for i in range(len(self.mass)) if i not in motors]
        at = np.ix_(free, free)
        return Structure(self.mass[at], self.damping[at], self.stiffness[at], self.motors - len(set(motors)))

    def dips_hz(self) -> Real:
        """Dips of the structure in Hz, ascending, with all motors held."""
        rest = slice(self.motors, None)
        squares = scipy.linalg.eigh(self.stiffness[rest, rest], self.mass[rest, rest], eigvals_only=True)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * math.pi))

    def receptance(self, frequency_hz: Real) -> Complex:
        """Angles of the motors per torque, all motors free.

        Shape (motors, motors, m) for frequencies of shape (m,).
        """
        s = 2j * math.pi * frequency_hz[:, np.newaxis, np.newaxis]
        dynamic: Any = self.mass * s**2 + self.damping * s + self.stiffness
        n = self.motors
        inner = dynamic[:, :n, :n] - dynamic[:, :n, n:] @ np.linalg.solve(dynamic[:, n:, n:], dynamic[:, n:, :n])
        return np.ascontiguousarray(np.moveaxis(np.linalg.inv(inner), 0, -1))

    def pole_radius(self, laws: Mapping[int, Block], period_s: float) -> float:
        """Largest |z| of the closed loops; see `poles`."""
        return float(np.max(np.abs(self.poles(laws, period_s))))

    def poles(self, laws: Mapping[int, Block], period_s: float) -> Complex:
        """Closed-loop poles in z with all motors under their laws.

        The structure is discretised exactly, with a hold.

        Args:
            laws: τ = −law(θ) of each motor, as a discrete system; motors without one are free.
            period_s: Sampling time of all.
        """
        n, inverse = len(self.mass), np.linalg.inv(self.mass)
        rates = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ self.stiffness, -inverse @ self.damping]])
        a, b = held(rates, np.vstack([np.zeros((n, self.motors)), inverse[:, : self.motors]]), period_s)
        for motor, law in laws.items():
            a, b = closed_loop(a, b[:, [motor]], law, motor), np.vstack([b, np.zeros((len(law[0]), self.motors))])
        return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)
