"""Cancellation of the transmission error: an addition to the set-point that follows from the measured motor angle and speed.

With θ_sync = Σ A_k cos(k θ_m + φ_k) the gear's torsion does not feel the error any more where the motor does

    Δθ_m = −N Σ A_k cos(k θ_m + φ_k),

so each order asks for a sine of known angle k θ_m, whose frequency k f_m follows the motor. What a loop, its set-points and the
bus make of a sine at that frequency is one complex number, G_k(f_m); here it is a table over |f_m|, worked out beforehand
(`hil.design.inverse`), delays included: a delay d is a phase k ω d, so that the sine is that of the angle at which it will act.
Turning backwards everything but k θ_m + φ_k changes the sign of its phase: G_k is then its own conjugate. While the motor
speeds up a sine is a chirp, for which G_k is another by −(j/2) k |θ̇_m|˙ d²G_k/dω²: the phase ahead grows with the time squared.

The measured angle θ_m contains what has been added. The sines are those of the angle without it, which turns smoothly,
θ_0 = θ_m + N Σ A_k cos(k θ_m + φ_k); so Δθ_m has the mixed waves of `hil.design.counter_motion` beside its orders.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled, inlined
from hil.control.notch import lowpass_blend
from hil.control.records import Rows, record_dtype

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class CancellationConfigRow(Protocol):
    """Parameters of one axis' cancellation.

    Distance of the table's speeds; corner of the low-pass that gives f_m; revolutions in which the first addition is forgotten;
    step to which a torque is rounded; largest acceleration for which G changes.
    """

    step_rps: float
    speed_lowpass_hz: float
    fade_rev: float
    torque_step_nm: float
    most_rad_s2: float


class CancellationStateRow(Protocol):
    """Memory of one axis' cancellation.

    Last angle without what was added; low-passed speed; what is left of the first addition; remainder that rounding has left of
    the torque.
    """

    smooth_angle_rad: float
    speed_rad_s: float
    slower_rad_s: float
    offset_rad: float
    left_nm: float
    is_running: int


CANCELLATION_CONFIG = record_dtype(CancellationConfigRow)
CANCELLATION_STATE = record_dtype(CancellationStateRow)

SPEED_LOWPASS_HZ = 20.0
"""At 4 rps/s the lag of 8 ms is 0.03 rps of 6: 0.5 % of G_k. One count of a 17-bit encoder in 1 ms is 0.008 rps."""
FADED_OVER_KEPT = 1.25
"""Frequency over the one up to which a wave is kept, from which it has no more right to the set-point's speed than others."""
SPEED_USED = 0.95
"""Fraction of a speed limit up to which waves are fitted in: the rounding of an encoder moves the set-point as well."""
FADE_S = 0.2
"""Time to full strength inside a drive: a cancellation that began at once would be a step of N A_k, 3 mrad at the motor."""
FADE_REV = 2.0
"""Motor revolutions in which the first addition is forgotten, to 1/e.

What is added at first is taken off, so that a motor at rest stays where it is: a step of N A_k, and one that is faded in too,
would wind up the velocity loop against friction, and the motor would break away with a jolt."""


@dataclass(frozen=True)
class WaveLabel:
    """One sine of a table.

    Attributes:
        order: Its order k.
        phase_rad: Its phase φ.
        degree: 1 for an order of the error itself; for a mixed wave the number of amplitudes that it grows with.
        sources: Orders of the error from which it comes.
    """

    order: float
    phase_rad: float
    degree: int
    sources: frozenset[float]


@dataclass(frozen=True)
class CancellationTable:
    """Additions to the set-points of one axis, by wave and motor speed.

    Attributes:
        waves: The waves, those of the error's own orders first.
        step_rps: Distance of the table's speeds, which begin at 0.
        reference: G by speed, −N A_k included, in rad at the motor; shape (waves, speeds).
        torque: G of the torque offset, in N·m; shape (waves, speeds).
        motion: Amplitude of the motor's part in it, in rad; shape (waves, speeds). Read of the error's own orders.
        bend: What G changes by for each rad/s² by which |θ̇_m| grows; shape (waves, speeds). None: nothing.
        most_rad_s2: Largest acceleration for which it does.

    Raises:
        ValueError: The shapes do not fit, or a number is not finite.
    """

    waves: tuple[WaveLabel, ...]
    step_rps: float
    reference: Complex
    torque: Complex
    motion: Real
    bend: Complex | None = None
    most_rad_s2: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what the law cannot read."""
        shape = np.shape(self.reference)
        fits = len(shape) == 2 and shape[0] == len(self.waves) and shape[1] >= 2
        others = [self.torque, self.motion] + ([] if self.bend is None else [self.bend])
        if not fits or any(np.shape(part) != shape for part in others):
            shapes = ", ".join(str(np.shape(part)) for part in (self.reference, *others))
            raise ValueError(f"tables of shapes {shapes} for {len(self.waves)} waves")
        if not self.step_rps > 0.0:
            raise ValueError(f"step_rps = {self.step_rps} must be above 0")
        if not all(np.all(np.isfinite(part)) for part in (self.reference, *others)):
            raise ValueError("a table holds what is not finite")

    @property
    def orders(self) -> tuple[float, ...]:
        """The error's own orders k."""
        return tuple(wave.order for wave in self.waves if wave.degree == 1)

    @property
    def speeds_rps(self) -> NDArray[np.float64]:
        """Motor speeds of the table; shape (speeds,)."""
        return np.arange(np.shape(self.reference)[1], dtype=np.float64) * self.step_rps

    def scaled(self, gain: float) -> "CancellationTable":
        """The table of an error that is `gain` times as large."""
        by_wave = np.array([gain**wave.degree for wave in self.waves])[:, np.newaxis]
        return self._with(lambda part: by_wave * part, self.waves)

    def without(self, orders: Collection[float]) -> "CancellationTable | None":
        """The table with some orders left out, and what they mix with; None where no other is left."""
        out = frozenset(orders)
        kept = [index for index, wave in enumerate(self.waves) if not wave.sources & out]
        if not kept:
            return None
        return self._with(lambda part: part[kept], tuple(self.waves[index] for index in kept))

    def within_speed(self, limit_rps: float, up_to_rps: float, kept_hz: float) -> "CancellationTable":
        """The table whose set-points are no faster than a limit, where leaving out waves of high frequency can reach that.

        Args:
            limit_rps: Speed limit of the set-points.
            up_to_rps: Highest motor speed of the motion.
            kept_hz: Frequency k f_m up to which a wave stays as it is; above it the lowest orders come first.
        """
        frequency, own, fast = self._largest_speeds(up_to_rps)
        part = np.clip((FADED_OVER_KEPT - frequency / kept_hz) / (FADED_OVER_KEPT - 1.0), 0.0, 1.0)
        room = SPEED_USED * limit_rps - own - np.sum(part * fast, axis=0)
        for row in np.argsort([wave.order for wave in self.waves], kind="stable"):
            wanted = (1.0 - part[row]) * fast[row]
            granted = np.clip(room / np.maximum(wanted, 1e-12), 0.0, 1.0)
            part[row] += (1.0 - part[row]) * granted
            room = room - granted * wanted
        return self._with(lambda each: part * each, self.waves)

    def _with(self, change: Callable[[Any], Any], waves: tuple[WaveLabel, ...]) -> "CancellationTable":
        """The table with all its arrays changed alike."""
        parts = {name: change(getattr(self, name)) for name in ("reference", "torque", "motion")}
        return replace(self, waves=waves, bend=None if self.bend is None else change(self.bend), **parts)

    def largest_reference_rad(self, up_to_rps: float = math.inf) -> float:
        """The largest addition to the set-point up to a motor speed."""
        return self._largest(self._largest_gains(), up_to_rps) + self._first_rad()

    def largest_torque_nm(self, up_to_rps: float = math.inf) -> float:
        """The largest torque offset up to a motor speed."""
        return self._largest(self.torque, up_to_rps)

    def largest_speed_rps(self, up_to_rps: float) -> float:
        """The fastest set-point of a motion up to a motor speed, in rev/s: that of the motion, and the change of the addition."""
        _, own, fast = self._largest_speeds(up_to_rps)
        inside = self.speeds_rps <= up_to_rps + self.step_rps
        return float(np.max((own + np.sum(fast, axis=0))[inside]))

    def _largest_speeds(self, up_to_rps: float) -> tuple[Real, Real, Real]:
        """Frequency k f_m of each wave, set-points' speed without them, and how much faster each makes them, in Hz and rev/s.

        Without them it is the motor's own speed, and that at which the first addition is forgotten. Shapes (waves, speeds),
        (speeds,) and (waves, speeds).
        """
        speeds = np.minimum(self.speeds_rps, up_to_rps)
        frequency = np.array([wave.order for wave in self.waves])[:, np.newaxis] * speeds
        own = speeds + speeds * self._first_rad() / (2.0 * math.pi * FADE_REV)
        return frequency, own, frequency * self._largest_gains()

    def _first_rad(self) -> float:
        """The largest first addition, at rest, which is taken off."""
        return float(np.sum(np.abs(self.reference[:, 0])))

    def _largest_gains(self) -> Real:
        """|G| of the set-points at any acceleration for which it changes; shape (waves, speeds)."""
        more = 0.0 if self.bend is None else self.most_rad_s2 * np.abs(self.bend)
        return np.asarray(np.abs(self.reference) + more)

    def _largest(self, table: Complex | Real, up_to_rps: float) -> float:
        inside = self.speeds_rps <= up_to_rps + self.step_rps  # between two speeds it is between their values
        return float(np.max(np.sum(np.abs(table[:, inside]), axis=0)))


@inlined
def cancellation_step(
    c: CancellationConfigRow, s: CancellationStateRow, waves: Real, table: Real, period_s: float, angle: float
) -> tuple[float, float]:
    """One sample of one axis: the additions to its set-point in rad, and to its torque in N·m.

    Args:
        c: The axis' parameters.
        s: The axis' memory; changed in place.
        waves: Order and phase; shape (n_waves, 2).
        table: Re and Im of G for the set-point, then for the torque; the motor's part, which is 0 for mixed waves; Re and Im of
            the bend; shape (n_waves, n_speeds, 7).
        period_s: Sampling time.
        angle: θ_m in rad, as measured.
    """
    if s.is_running == 0:
        s.speed_rad_s, s.slower_rad_s, s.left_nm = 0.0, 0.0, 0.0
    speed = 2.0 * s.speed_rad_s - s.slower_rad_s
    column = min(abs(speed) / (2.0 * math.pi * c.step_rps), table.shape[1] - 1.0)
    low = min(int(column), table.shape[1] - 2)
    part = column - low
    smooth = angle
    for i in range(table.shape[0]):
        if table[i, 0, 4] > 0.0:
            moved = table[i, low, 4] + part * (table[i, low + 1, 4] - table[i, low, 4])
            smooth += moved * math.cos(waves[i, 0] * angle + waves[i, 1])
    if s.is_running == 0:
        s.smooth_angle_rad = smooth
    turned_rad = abs(smooth - s.smooth_angle_rad)
    blend = lowpass_blend(c.speed_lowpass_hz, period_s)
    s.speed_rad_s += blend * ((smooth - s.smooth_angle_rad) / period_s - s.speed_rad_s)
    s.slower_rad_s += blend * (s.speed_rad_s - s.slower_rad_s)
    speed = 2.0 * s.speed_rad_s - s.slower_rad_s  # on a ramp as late as neither
    s.smooth_angle_rad = smooth
    column = min(abs(speed) / (2.0 * math.pi * c.step_rps), table.shape[1] - 1.0)
    low = min(int(column), table.shape[1] - 2)
    part = column - low
    side = -1.0 if speed < 0.0 else 1.0
    # the difference of both is what a speed gains in the time of the low-pass
    gained = side * (s.speed_rad_s - s.slower_rad_s) * 2.0 * math.pi * c.speed_lowpass_hz
    gained = min(max(gained, -c.most_rad_s2), c.most_rad_s2)
    reference, torque = 0.0, 0.0
    for i in range(table.shape[0]):
        below, above = table[i, low], table[i, low + 1]
        turned = waves[i, 0] * smooth + waves[i, 1]
        cosine, sine = math.cos(turned), side * math.sin(turned)
        real = below[0] + part * (above[0] - below[0]) + gained * (below[5] + part * (above[5] - below[5]))
        imaginary = below[1] + part * (above[1] - below[1]) + gained * (below[6] + part * (above[6] - below[6]))
        reference += real * cosine - imaginary * sine
        torque += (below[2] + part * (above[2] - below[2])) * cosine - (below[3] + part * (above[3] - below[3])) * sine
    if s.is_running == 0:
        s.offset_rad, s.is_running = reference, 1
    s.offset_rad -= s.offset_rad * min(1.0, turned_rad / (2.0 * math.pi * c.fade_rev))
    reference -= s.offset_rad
    if c.torque_step_nm > 0.0:  # what is rounded off now is added next time: below 25 Hz nothing of it is left
        wanted = torque + s.left_nm
        torque = math.floor(wanted / c.torque_step_nm + 0.5) * c.torque_step_nm
        s.left_nm = wanted - torque
    return reference, torque


class InnerCancellation(NamedTuple):
    """Parameters of the cancellation inside a drive, orders 1, 2 and 4.

    Attributes:
        a2_rad: N A_2, at the motor.
        phi2_rad: φ_2.
        a4_rad: N A_4.
        phi4_rad: φ_4.
        inertia_kg_m2: J_m.
        damping_nm_s_rad: D_m.
        a1_rad: N A_1.
        phi1_rad: φ_1.
    """

    a2_rad: float
    phi2_rad: float
    a4_rad: float
    phi4_rad: float
    inertia_kg_m2: float
    damping_nm_s_rad: float
    a1_rad: float
    phi1_rad: float


@inlined
def inner_cancellation(
    known: InnerCancellation, lowpass_hz: float, period_s: float, angle: float, speed_rad_s: float
) -> tuple[float, float, float]:
    """One sample inside a drive, which knows angle and speed: Δθ_ref, Δθ̇_ff and Δτ, without a table.

    With Δθ_m = −Σ a_k cos(k θ_m + φ_k), a_k = N A_k: the set-point moves by Δθ_m, so that the position loop sees nothing of it;
    the velocity offset is F_lp s Δθ_m, as the loop measures it (F_lp as its delay, 1/2πf); the torque is J_m Δθ̈_m + D_m Δθ̇_m,
    half a period ahead for its hold. What the motion's own acceleration θ̈_0 adds to Δθ̈_m, a fraction of θ̈_0/(k θ̇_m²), is left
    out.

    Args:
        known: Amplitudes and phases, and the motor.
        lowpass_hz: Corner of F_lp.
        period_s: The drive's own sampling time.
        angle: θ_m as measured.
        speed_rad_s: θ̇_m as measured.
    """
    a2_rad, phi2_rad, a4_rad, phi4_rad, inertia_kg_m2, damping_nm_s_rad, a1_rad, phi1_rad = known
    reference = -a2_rad * math.cos(2.0 * angle + phi2_rad) - a4_rad * math.cos(4.0 * angle + phi4_rad)
    reference -= a1_rad * math.cos(angle + phi1_rad)
    late = angle - speed_rad_s / (2.0 * math.pi * lowpass_hz)
    rate = 2.0 * a2_rad * math.sin(2.0 * late + phi2_rad) + 4.0 * a4_rad * math.sin(4.0 * late + phi4_rad)
    rate += a1_rad * math.sin(late + phi1_rad)
    ahead = angle + 0.5 * period_s * speed_rad_s
    x1, x2, x4 = ahead + phi1_rad, 2.0 * ahead + phi2_rad, 4.0 * ahead + phi4_rad
    bend = 4.0 * a2_rad * math.cos(x2) + 16.0 * a4_rad * math.cos(x4) + a1_rad * math.cos(x1)
    slope = 2.0 * a2_rad * math.sin(x2) + 4.0 * a4_rad * math.sin(x4) + a1_rad * math.sin(x1)
    # θ_m + Σ a_k cos(k θ_m + φ_k) turns smoothly: θ̈_m (1 − slope) = θ̇_m² bend
    torque = inertia_kg_m2 * speed_rad_s * speed_rad_s * bend / max(1.0 - slope, 0.5) + damping_nm_s_rad * speed_rad_s * slope
    return reference, speed_rad_s * rate, torque


@compiled
def cancel(
    configs: Rows[CancellationConfigRow],
    states: Rows[CancellationStateRow],
    waves: Real,
    table: Real,
    period_s: float,
    values: Real,
) -> None:
    """Run `cancellation_step` for every axis.

    Args:
        configs: `CANCELLATION_CONFIG` array, shape (n_axes,).
        states: `CANCELLATION_STATE` array, shape (n_axes,).
        waves: Order and phase; shape (n_axes, n_waves, 2).
        table: As in `cancellation_step`; shape (n_axes, n_waves, n_speeds, 7).
        period_s: Sampling time.
        values: Row θ_m in; rows Δθ_ref and Δτ out; shape (3, n_axes).
    """
    for row in range(len(configs)):
        reference, torque = cancellation_step(configs[row], states[row], waves[row], table[row], period_s, values[0, row])
        values[1, row], values[2, row] = reference, torque


class CancellationLaw:
    """The cancellations of several axes with their states, one compiled call per control period."""

    def __init__(
        self,
        tables: Sequence[CancellationTable | None],
        period_s: float,
        torque_steps_nm: Sequence[float] | None = None,
        *,
        speed_lowpass_hz: float = SPEED_LOWPASS_HZ,
        fade_rev: float = FADE_REV,
    ) -> None:
        """Lay out the arrays; an axis whose table is None gets no additions.

        Args:
            tables: Table of each axis.
            period_s: Sampling time.
            torque_steps_nm: Step to which each axis' torque offset is rounded; 0: it is not rounded.
            speed_lowpass_hz: Corner of the low-pass that gives the motor speed.
            fade_rev: Motor revolutions in which the first addition is forgotten.

        Raises:
            ValueError: There is no axis, or a time is not above zero.
        """
        if not tables:
            raise ValueError("no axis to cancel for")
        if not (period_s > 0.0 and fade_rev > 0.0 and speed_lowpass_hz > 0.0):
            raise ValueError(
                f"period_s = {period_s}, fade_rev = {fade_rev} and speed_lowpass_hz = {speed_lowpass_hz} must be above 0"
            )
        given = [table for table in tables if table is not None]
        count = max((len(table.waves) for table in given), default=1)
        points = max((np.shape(table.reference)[1] for table in given), default=2)
        self.period_s = period_s
        self._config = np.zeros(len(tables), CANCELLATION_CONFIG)
        self._config["speed_lowpass_hz"], self._config["fade_rev"], self._config["step_rps"] = speed_lowpass_hz, fade_rev, 1.0
        if torque_steps_nm is not None:
            self._config["torque_step_nm"] = torque_steps_nm
        self._state = np.zeros(len(tables), CANCELLATION_STATE)
        self._waves = np.zeros((len(tables), count, 2))
        self._table = np.zeros((len(tables), count, points, 7))
        for row, table in enumerate(tables):
            if table is not None:
                self._write(row, table)
        self._values = np.zeros((3, len(tables)))
        self.step([0.0] * len(tables))  # compiled, or loaded, before the first cycle waits for it
        self.reset()

    def _write(self, row: int, table: CancellationTable) -> None:
        columns, given = len(table.waves), np.shape(table.reference)[1]
        self._config["step_rps"][row] = table.step_rps
        self._waves[row, :columns] = [(wave.order, wave.phase_rad) for wave in table.waves]
        is_own = np.array([wave.degree == 1 for wave in table.waves])
        self._table[row, :columns, :given, 4] = np.where(is_own[:, np.newaxis], table.motion, 0.0)
        self._config["most_rad_s2"][row] = table.most_rad_s2
        bend = np.zeros_like(table.reference) if table.bend is None else table.bend
        for part, values in ((0, table.reference), (2, table.torque), (5, bend)):
            self._table[row, :columns, :given, part], self._table[row, :columns, :given, part + 1] = values.real, values.imag
        self._table[row, :, given:] = self._table[row, :, given - 1 : given]

    def reset(self) -> None:
        """Forget angle and speed, and begin again where the motor stands."""
        self._state[:] = np.zeros(1, CANCELLATION_STATE)[0]

    def step(self, angles_rad: Sequence[float]) -> tuple[list[float], list[float]]:
        """Give the additions to set-points (rad) and torques (N·m) at the measured motor angles, in the order of the axes."""
        values = self._values
        values[0] = angles_rad
        cancel(self._config, self._state, self._waves, self._table, self.period_s, values)
        references, torques = values[1:].tolist()
        return references, torques
