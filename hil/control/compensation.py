"""Cancellation of the transmission error: a correction of the set-point as a function of the measured motor angle and speed.

With θ_sync = Σ A_k cos(k θ_m + φ_k) the gear's torsion does not feel the error any more where the motor does

    Δθ_m = −N Σ A_k cos(k θ_m + φ_k),

so each order asks for a sine of known angle k θ_m, whose frequency k f_m follows the motor. What a loop, its set-points and the
bus make of a sine at that frequency is one complex number, G_k(f_m); here it is a table over |f_m|, worked out beforehand
(`hil.design.inverse`), delays included: a delay d is a phase k ω d, so that the sine is that of the angle at which it will act.
Turning backwards everything but k θ_m + φ_k changes the sign of its phase: G_k is then its own conjugate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.notch import lowpass_blend

Complex = NDArray[np.complex128]

COMPENSATION_CONFIG = np.dtype([
    ("step_rps", np.float64),
    ("speed_lowpass_hz", np.float64),
    ("fade_s", np.float64),
    ("torque_step_nm", np.float64),
])  # fmt: skip
"""Distance of the table's speeds; corner of the low-pass that gives f_m; time to full strength; what a torque is rounded to."""

COMPENSATION_STATE = np.dtype([
    ("motor_angle_rad", np.float64),
    ("speed_rad_s", np.float64),
    ("share", np.float64),
    ("left_nm", np.float64),
    ("is_running", np.int64),
])  # fmt: skip
"""What persists: last angle, low-passed speed, how far it is faded in, what rounding has left of the torque."""

SPEED_LOWPASS_HZ = 20.0
"""At 4 rps/s the lag of 8 ms is 0.03 rps of 6: 0.5 % of G_k. One count of a 17-bit encoder in 1 ms is 0.008 rps."""
FADE_S = 0.2
"""A correction that began at once would be a step of N A_k: 3 mrad at the motor."""


@dataclass(frozen=True)
class Correction:
    """What is added to the set-points of one axis, by order and motor speed.

    Attributes:
        orders: k.
        phase_rad: φ_k.
        step_rps: Distance of the speeds, which begin at 0.
        reference: G_k by speed, −N A_k included, in rad at the motor; shape (orders, speeds).
        torque: The same for the torque offset, in N·m.

    Raises:
        ValueError: Shapes that do not fit.
    """

    orders: tuple[int, ...]
    phase_rad: tuple[float, ...]
    step_rps: float
    reference: Complex
    torque: Complex

    def __post_init__(self) -> None:
        """Refuse what the law cannot read."""
        shape = np.shape(self.reference)
        fits = len(shape) == 2 and shape[0] == len(self.orders) == len(self.phase_rad) and shape[1] >= 2
        if not fits or np.shape(self.torque) != shape:
            raise ValueError(f"tables of shapes {shape} and {np.shape(self.torque)} for {len(self.orders)} orders")
        if not self.step_rps > 0.0:
            raise ValueError(f"step_rps = {self.step_rps} must be above 0")
        if not (np.all(np.isfinite(self.reference)) and np.all(np.isfinite(self.torque))):
            raise ValueError("a table holds what is not finite")

    @property
    def speeds_rps(self) -> NDArray[np.float64]:
        """Motor speeds of the table; shape (speeds,)."""
        return np.arange(np.shape(self.reference)[1], dtype=np.float64) * self.step_rps

    def scaled(self, gain: float) -> "Correction":
        """The same with another strength; a negative one has the opposite sign."""
        return Correction(self.orders, self.phase_rad, self.step_rps, gain * self.reference, gain * self.torque)

    def largest_reference_rad(self, up_to_rps: float = math.inf) -> float:
        """What the correction of the set-point can be at most up to a motor speed."""
        return self._largest(self.reference, up_to_rps)

    def largest_torque_nm(self, up_to_rps: float = math.inf) -> float:
        """What the torque offset can be at most up to a motor speed."""
        return self._largest(self.torque, up_to_rps)

    def largest_rate_rps(self, up_to_rps: float = math.inf) -> float:
        """How fast the correction of the set-point can be at most, in rev/s, up to a motor speed."""
        turning = np.asarray(self.orders)[:, np.newaxis] * self.speeds_rps * self.reference
        return self._largest(turning, up_to_rps)

    def _largest(self, table: Complex, up_to_rps: float) -> float:
        inside = self.speeds_rps <= up_to_rps + self.step_rps  # between two speeds it is between their values
        return float(np.max(np.sum(np.abs(table[:, inside]), axis=0)))


@inlined
def compensation_step(
    config: Any, state: Any, orders: Any, table: Any, row: int, period_s: float, angle: float
) -> tuple[float, float]:
    """One sample of one axis: what is added to its set-point in rad, and to its torque in N·m.

    Args:
        config: `COMPENSATION_CONFIG` array, shape (n_axes,).
        state: `COMPENSATION_STATE` array, shape (n_axes,); changed in place.
        orders: k and φ_k; shape (n_axes, n_orders, 2).
        table: Re and Im of G_k for the set-point, then for the torque; shape (n_axes, n_orders, n_speeds, 4).
        row: Axis.
        period_s: Sampling time.
        angle: θ_m in rad, as measured.
    """
    c, s = config[row], state[row]
    if s.is_running == 0:
        s.motor_angle_rad, s.speed_rad_s, s.share, s.left_nm, s.is_running = angle, 0.0, 0.0, 0.0, 1
    s.speed_rad_s += lowpass_blend(c.speed_lowpass_hz, period_s) * ((angle - s.motor_angle_rad) / period_s - s.speed_rad_s)
    s.motor_angle_rad = angle
    s.share = min(1.0, s.share + period_s / c.fade_s)
    place = min(abs(s.speed_rad_s) / (2.0 * math.pi * c.step_rps), table.shape[2] - 1.0)
    low = min(int(place), table.shape[2] - 2)
    part = place - low
    side = -1.0 if s.speed_rad_s < 0.0 else 1.0
    reference, torque = 0.0, 0.0
    for column in range(table.shape[1]):
        below, above = table[row, column, low], table[row, column, low + 1]
        turned = orders[row, column, 0] * angle + orders[row, column, 1]
        cosine, sine = math.cos(turned), side * math.sin(turned)
        reference += (below[0] + part * (above[0] - below[0])) * cosine - (below[1] + part * (above[1] - below[1])) * sine
        torque += (below[2] + part * (above[2] - below[2])) * cosine - (below[3] + part * (above[3] - below[3])) * sine
    reference, torque = s.share * reference, s.share * torque
    if c.torque_step_nm > 0.0:  # what is rounded off now is added next time: below 25 Hz nothing of it is left
        wanted = torque + s.left_nm
        torque = math.floor(wanted / c.torque_step_nm + 0.5) * c.torque_step_nm
        s.left_nm = wanted - torque
    return reference, torque


@inlined
def inner_compensation(
    a2_rad: float,
    phi2_rad: float,
    a4_rad: float,
    phi4_rad: float,
    inertia_kg_m2: float,
    damping_nm_s_rad: float,
    lowpass_hz: float,
    period_s: float,
    angle: float,
    speed_rad_s: float,
) -> tuple[float, float, float]:
    """One sample inside a drive, which has angle and speed at hand: Δθ_ref, Δθ̇_ff and Δτ, without a table.

    With Δθ_m = −Σ a_k cos(k θ_m + φ_k), a_k = N A_k: the set-point moves by Δθ_m, so that the position loop sees nothing of it;
    the velocity offset is F_lp s Δθ_m, as the loop measures it (F_lp as its delay, 1/2πf); the torque is J_m Δθ̈_m + D_m Δθ̇_m,
    half a period ahead for its hold. What θ̈_m adds to Δθ̈_m, a share of θ̈_m/(k θ̇_m²), is left out.

    Args:
        a2_rad: N A_2, at the motor.
        phi2_rad: φ_2.
        a4_rad: N A_4.
        phi4_rad: φ_4.
        inertia_kg_m2: J_m.
        damping_nm_s_rad: D_m.
        lowpass_hz: Corner of F_lp.
        period_s: The drive's own sampling time.
        angle: θ_m as measured.
        speed_rad_s: θ̇_m as measured.
    """
    reference = -a2_rad * math.cos(2.0 * angle + phi2_rad) - a4_rad * math.cos(4.0 * angle + phi4_rad)
    late = angle - speed_rad_s / (2.0 * math.pi * lowpass_hz)
    rate = 2.0 * a2_rad * math.sin(2.0 * late + phi2_rad) + 4.0 * a4_rad * math.sin(4.0 * late + phi4_rad)
    ahead = angle + 0.5 * period_s * speed_rad_s
    x2, x4 = 2.0 * ahead + phi2_rad, 4.0 * ahead + phi4_rad
    bend = 4.0 * a2_rad * math.cos(x2) + 16.0 * a4_rad * math.cos(x4)
    slope = 2.0 * a2_rad * math.sin(x2) + 4.0 * a4_rad * math.sin(x4)
    torque = inertia_kg_m2 * speed_rad_s * speed_rad_s * bend + damping_nm_s_rad * speed_rad_s * slope
    return reference, speed_rad_s * rate, torque


@compiled
def compensate(config: Any, state: Any, orders: Any, table: Any, period_s: float, values: Any) -> None:
    """`compensation_step` of every axis.

    Args:
        config: `COMPENSATION_CONFIG` array, shape (n_axes,).
        state: `COMPENSATION_STATE` array, shape (n_axes,).
        orders: Shape (n_axes, n_orders, 2).
        table: Shape (n_axes, n_orders, n_speeds, 4).
        period_s: Sampling time.
        values: Row θ_m in; rows Δθ_ref and Δτ out; shape (3, n_axes).
    """
    for row in range(config.shape[0]):
        reference, torque = compensation_step(config, state, orders, table, row, period_s, values[0, row])
        values[1, row], values[2, row] = reference, torque


class Compensation:
    """The corrections of several axes with their states, one compiled call per cycle."""

    def __init__(
        self,
        corrections: Sequence[Correction | None],
        period_s: float,
        torque_steps_nm: Sequence[float] | None = None,
        *,
        speed_lowpass_hz: float = SPEED_LOWPASS_HZ,
        fade_s: float = FADE_S,
    ) -> None:
        """Lay out the arrays; None leaves an axis alone.

        Args:
            corrections: By axis.
            period_s: Sampling time.
            torque_steps_nm: What each torque offset is rounded to; 0: nothing.
            speed_lowpass_hz: Corner of the low-pass that gives the motor speed.
            fade_s: Time to full strength.

        Raises:
            ValueError: No axis, or a time that is not above zero.
        """
        if not corrections:
            raise ValueError("no axis to correct")
        if not (period_s > 0.0 and fade_s > 0.0 and speed_lowpass_hz > 0.0):
            raise ValueError(
                f"period_s = {period_s}, fade_s = {fade_s} and speed_lowpass_hz = {speed_lowpass_hz} must be above 0"
            )
        there = [correction for correction in corrections if correction is not None]
        count = max((len(correction.orders) for correction in there), default=1)
        points = max((np.shape(correction.reference)[1] for correction in there), default=2)
        self.period_s = period_s
        self._config = np.zeros(len(corrections), COMPENSATION_CONFIG)
        self._config["speed_lowpass_hz"], self._config["fade_s"], self._config["step_rps"] = speed_lowpass_hz, fade_s, 1.0
        if torque_steps_nm is not None:
            self._config["torque_step_nm"] = torque_steps_nm
        self._state = np.zeros(len(corrections), COMPENSATION_STATE)
        self._orders = np.zeros((len(corrections), count, 2))
        self._table = np.zeros((len(corrections), count, points, 4))
        for row, correction in enumerate(corrections):
            if correction is not None:
                self._write(row, correction)
        self._values = np.zeros((3, len(corrections)))
        self.step([0.0] * len(corrections))  # compiled, or loaded, before the first cycle waits for it
        self.reset()

    def _write(self, row: int, correction: Correction) -> None:
        columns, given = len(correction.orders), np.shape(correction.reference)[1]
        self._config["step_rps"][row] = correction.step_rps
        self._orders[row, :columns] = np.stack([correction.orders, correction.phase_rad], axis=1)
        for place, table in ((0, correction.reference), (2, correction.torque)):
            self._table[row, :columns, :given, place], self._table[row, :columns, :given, place + 1] = table.real, table.imag
        self._table[row, :, given:] = self._table[row, :, given - 1 : given]

    def reset(self) -> None:
        """Begin anew, from nothing."""
        self._state[:] = np.zeros(1, COMPENSATION_STATE)[0]

    def step(self, angles_rad: Sequence[float]) -> tuple[list[float], list[float]]:
        """One sample of all: measured motor angles in, corrections of set-points and torques out."""
        values = self._values
        values[0] = angles_rad
        compensate(self._config, self._state, self._orders, self._table, self.period_s, values)
        references, torques = values[1:].tolist()
        return references, torques
