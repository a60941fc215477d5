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

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.control.cancellation_table import FADE_REV, CancellationTable, MotorLoad
from hil.control.compiled import compiled, inlined
from hil.control.notch import lowpass_blend
from hil.control.records import Rows, record_dtype

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class CancellationConfigRow(Protocol):
    """Parameters of one axis' cancellation.

    Distance of the table's speeds; corner of the low-pass that gives f_m; revolutions in which the first addition is forgotten;
    step to which a torque is rounded; largest acceleration for which G changes. How τ_g is told: corner of its low-pass,
    reduction ratio, motor's inertia, damping and friction, the gear's reaction, largest load.
    """

    step_rps: float
    speed_lowpass_hz: float
    fade_rev: float
    torque_step_nm: float
    most_rad_s2: float
    load_lowpass_hz: float
    reduction_ratio: float
    motor_inertia_kg_m2: float
    motor_damping_nm_s_rad: float
    coulomb_friction_nm: float
    reaction: float
    most_nm: float


class CancellationStateRow(Protocol):
    """Memory of one axis' cancellation.

    Last angle without what was added; low-passed speed; what is left of the first addition; remainder that rounding has left of
    the torque; low-passed torque of the motor.
    """

    smooth_angle_rad: float
    speed_rad_s: float
    slower_rad_s: float
    offset_rad: float
    left_nm: float
    torque_nm: float
    slower_nm: float
    is_running: int


CANCELLATION_CONFIG = record_dtype(CancellationConfigRow)
CANCELLATION_STATE = record_dtype(CancellationStateRow)

SPEED_LOWPASS_HZ = 20.0
"""At 4 rps/s the lag of 8 ms is 0.03 rps of 6: 0.5 % of G_k. One count of a 17-bit encoder in 1 ms is 0.008 rps."""
LOAD_LOWPASS_HZ = 1.0
"""Corner of the low-pass that gives τ_g: it changes with the posture, over seconds; what shakes is at 4 Hz and more."""
FRICTION_RAD_S = 0.5
"""Motor speed from which on Coulomb friction is whole."""
SMALLEST_FACTOR = 1e-6
"""Least factor of an order's amplitude."""
FADE_S = 0.2
"""Time to full strength inside a drive: a cancellation that began at once would be a step of N A_k, 3 mrad at the motor."""


@inlined
def gear_torque(
    c: CancellationConfigRow, s: CancellationStateRow, period_s: float, torque: float, speed: float, gained: float
) -> float:
    """τ_g as its slow part shows in the motor's torque, in N·m at the arm, within what counts.

    Args:
        c: The axis' parameters.
        s: The axis' memory; changed in place.
        period_s: Sampling time.
        torque: Motor torque as measured.
        speed: θ̇_m.
        gained: θ̈_m.
    """
    if s.is_running == 0:
        s.torque_nm, s.slower_nm = torque, torque
    blend = lowpass_blend(c.load_lowpass_hz, period_s)
    s.torque_nm += blend * (torque - s.torque_nm)
    s.slower_nm += blend * (s.torque_nm - s.slower_nm)
    friction = c.coulomb_friction_nm * min(max(speed / FRICTION_RAD_S, -1.0), 1.0)
    own = c.motor_inertia_kg_m2 * gained + c.motor_damping_nm_s_rad * speed + friction
    return min(max(c.reduction_ratio * (2.0 * s.torque_nm - s.slower_nm - own), -c.most_nm), c.most_nm)


@inlined
def speed_column(c: CancellationConfigRow, table: Real, speed: float) -> tuple[int, float]:
    """Column of a table at or below a motor speed, and the fraction of the way to the next."""
    column = min(abs(speed) / (2.0 * math.pi * c.step_rps), table.shape[1] - 1.0)
    low = min(int(column), table.shape[1] - 2)
    return low, column - low


@inlined
def smooth_angle(waves: Real, table: Real, angle: float, low: int, part: float) -> float:
    """The angle without what has been added: θ_m less the motor's part of every order of the error itself.

    Args:
        waves: As in `cancellation_step`, like `table`.
        table: G by wave and speed.
        angle: θ_m.
        low: Column at or below the speed.
        part: Fraction of the way to the next.
    """
    smooth = angle
    for i in range(table.shape[0]):
        if table[i, 0, 4] > 0.0:
            moved = table[i, low, 4] + part * (table[i, low + 1, 4] - table[i, low, 4])
            smooth += waves[i, 2] * moved * math.cos(waves[i, 0] * angle + waves[i, 1])
    return smooth


@inlined
def added(
    waves: Real, table: Real, low: int, part: float, smooth: float, side: float, gained: float, load: float
) -> tuple[float, float]:
    """All waves together: addition to the set-point in rad, torque offset in N·m.

    Args:
        waves: As in `cancellation_step`, like `table`.
        table: G by wave and speed.
        low: Column at or below the speed.
        part: Fraction of the way to the next.
        smooth: Angle without what was added.
        side: −1 backwards, else 1.
        gained: What |θ̇_m| gains, rad/s².
        load: r τ_g, turned round backwards: its sine is of the angle alone, and knows no direction as what delays it does.
    """
    reference, torque = 0.0, 0.0
    for i in range(table.shape[0]):
        below, above = table[i, low], table[i, low + 1]
        turned = waves[i, 0] * smooth + waves[i, 1]
        cosine, sine = waves[i, 2] * math.cos(turned), waves[i, 2] * side * math.sin(turned)
        real = below[0] + part * (above[0] - below[0]) + gained * (below[5] + part * (above[5] - below[5]))
        imaginary = below[1] + part * (above[1] - below[1]) + gained * (below[6] + part * (above[6] - below[6]))
        real += load * (below[9] + part * (above[9] - below[9]))
        imaginary += load * (below[10] + part * (above[10] - below[10]))
        reference += real * cosine - imaginary * sine
        real = below[2] + part * (above[2] - below[2]) + gained * (below[7] + part * (above[7] - below[7]))
        imaginary = below[3] + part * (above[3] - below[3]) + gained * (below[8] + part * (above[8] - below[8]))
        real += load * (below[11] + part * (above[11] - below[11]))
        imaginary += load * (below[12] + part * (above[12] - below[12]))
        torque += real * cosine - imaginary * sine
    return reference, torque


@inlined
def cancellation_step(
    c: CancellationConfigRow,
    s: CancellationStateRow,
    waves: Real,
    table: Real,
    period_s: float,
    angle: float,
    measured_nm: float,
) -> tuple[float, float]:
    """One sample of one axis: the additions to its set-point in rad, and to its torque in N·m.

    Args:
        c: The axis' parameters.
        s: The axis' memory; changed in place.
        waves: Order, phase, and factor of the amplitude; shape (n_waves, 3).
        table: Re and Im of G for the set-point, then for the torque; the motor's part, which is 0 for mixed waves; Re and Im of
            the bend of either; Re and Im for each N·m of τ_g, of either; shape (n_waves, n_speeds, 13).
        period_s: Sampling time.
        angle: θ_m in rad, as measured.
        measured_nm: Motor torque, as measured.
    """
    if s.is_running == 0:
        s.speed_rad_s, s.slower_rad_s, s.left_nm = 0.0, 0.0, 0.0
    low, part = speed_column(c, table, 2.0 * s.speed_rad_s - s.slower_rad_s)
    smooth = smooth_angle(waves, table, angle, low, part)
    if s.is_running == 0:
        s.smooth_angle_rad = smooth
    turned_rad = abs(smooth - s.smooth_angle_rad)
    blend = lowpass_blend(c.speed_lowpass_hz, period_s)
    s.speed_rad_s += blend * ((smooth - s.smooth_angle_rad) / period_s - s.speed_rad_s)
    s.slower_rad_s += blend * (s.speed_rad_s - s.slower_rad_s)
    speed = 2.0 * s.speed_rad_s - s.slower_rad_s  # on a ramp as late as neither
    s.smooth_angle_rad = smooth
    low, part = speed_column(c, table, speed)
    side = -1.0 if speed < 0.0 else 1.0
    # the difference of both is what a speed gains in the time of the low-pass
    gained = side * (s.speed_rad_s - s.slower_rad_s) * 2.0 * math.pi * c.speed_lowpass_hz
    gained = min(max(gained, -c.most_rad_s2), c.most_rad_s2)
    load = side * c.reaction * gear_torque(c, s, period_s, measured_nm, speed, side * gained)
    reference, torque = added(waves, table, low, part, smooth, side, gained, load)
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
        waves: Order, phase and factor; shape (n_axes, n_waves, 3).
        table: As in `cancellation_step`; shape (n_axes, n_waves, n_speeds, 13).
        period_s: Sampling time.
        values: Rows θ_m and measured torque in, which become Δθ_ref and Δτ; shape (2, n_axes).
    """
    for row in range(len(configs)):
        angle, measured_nm = values[0, row], values[1, row]
        reference, torque = cancellation_step(configs[row], states[row], waves[row], table[row], period_s, angle, measured_nm)
        values[0, row], values[1, row] = reference, torque


def _turns(table: CancellationTable | None) -> tuple[tuple[float, ...], Real, Real, Real]:
    """Orders of a table, phase of each wave, and how often the phase and the size of each order are in it."""
    if table is None:
        return (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    each = [wave.turns(table.orders) for wave in table.waves]
    phases = np.array([wave.phase_rad for wave in table.waves])
    return (
        table.orders,
        phases,
        np.array([net for net, _ in each], dtype=float),
        np.array([size for _, size in each], dtype=float),
    )


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
        self._waves = np.zeros((len(tables), count, 3))
        self._table = np.zeros((len(tables), count, points, 13))
        self._turns = [_turns(table) for table in tables]
        for row, table in enumerate(tables):
            if table is not None:
                self._write(row, table)
        self._config["load_lowpass_hz"] = LOAD_LOWPASS_HZ
        self._values = np.zeros((2, len(tables)))
        self.step([0.0] * len(tables))  # compiled, or loaded, before the first cycle waits for it
        self.reset()

    def _write(self, row: int, table: CancellationTable) -> None:
        columns, given = len(table.waves), np.shape(table.reference)[1]
        self._config["step_rps"][row] = table.step_rps
        self._waves[row, :columns] = [(wave.order, wave.phase_rad, 1.0) for wave in table.waves]
        is_own = np.array([wave.degree == 1 for wave in table.waves])
        self._table[row, :columns, :given, 4] = np.where(is_own[:, np.newaxis], table.motion, 0.0)
        self._config["most_rad_s2"][row] = table.most_rad_s2
        if table.motor_load is not None:
            for name in (each.name for each in fields(MotorLoad)):
                self._config[name][row] = getattr(table.motor_load, name)
        for part, name in (
            (0, "reference"),
            (2, "torque"),
            (5, "bend"),
            (7, "torque_bend"),
            (9, "load_reference"),
            (11, "load_torque"),
        ):
            values = getattr(table, name)
            if values is None:
                continue
            self._table[row, :columns, :given, part], self._table[row, :columns, :given, part + 1] = values.real, values.imag
        self._table[row, :, given:] = self._table[row, :, given - 1 : given]

    def multiply(self, row: int, by_order: Mapping[float, complex]) -> None:
        """Multiply the cancellation of each order of an axis by a complex factor, and what it mixes with accordingly.

        Args:
            row: Row of the axis.
            by_order: Factor of each order; 1 where it is not given.
        """
        orders, phases, net, size = self._turns[row]
        factors = [by_order.get(order, 1.0 + 0.0j) for order in orders]
        waves = self._waves[row, : len(phases)]
        waves[:, 1] = phases + net @ [cmath.phase(each) for each in factors]
        waves[:, 2] = np.exp(size @ [math.log(max(abs(each), SMALLEST_FACTOR)) for each in factors])

    def reset(self) -> None:
        """Forget angle and speed, and begin again where the motor stands."""
        self._state[:] = np.zeros(1, CANCELLATION_STATE)[0]

    def step(self, angles_rad: Sequence[float], torques_nm: Sequence[float] | None = None) -> tuple[list[float], list[float]]:
        """Give the additions to set-points (rad) and torques (N·m), in the order of the axes.

        Args:
            angles_rad: Measured motor angles.
            torques_nm: Measured motor torques; None: 0.
        """
        values = self._values
        values[0], values[1] = angles_rad, 0.0 if torques_nm is None else torques_nm
        cancel(self._config, self._state, self._waves, self._table, self.period_s, values)
        references, torques = values.tolist()
        return references, torques
