"""Cancellation of the transmission error by additions to set-point and torque.

The addition follows from the measured motor angle and speed.

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

import numpy as np

from hil.control.arrays import Real
from hil.control.cancellation_table import FADE_REV, CancellationTable, MotorLoad
from hil.core.library import CORE

CANCELLATION_CONFIG, CANCELLATION_STATE = CORE.dtype("cancellation_config"), CORE.dtype("cancellation_state")
WAVE_COLUMNS: int = CORE.call.WAVE_COLUMNS

SPEED_LOWPASS_HZ = 20.0
"""At 4 rps/s the lag of 8 ms is 0.03 rps of 6: 0.5 % of G_k. One count of a 17-bit encoder in 1 ms is 0.008 rps."""
LOAD_LOWPASS_HZ = 1.0
"""Corner of the low-pass that gives τ_g: it changes with the posture, over seconds; what shakes is at 4 Hz and more."""
SMALLEST_FACTOR = 1e-6
"""Least factor of an order's amplitude."""


def _turns(table: CancellationTable | None) -> tuple[tuple[float, ...], Real, Real, Real]:
    """Return the orders of a table and how waves depend on them.

    Phase of each wave, and how often the phase and the size of each order are in it.
    """
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
    """Cancellations of several axes with their states.

    Attributes:
        data: The core's record of all of them; it must not outlive the law.
    """

    def __init__(
        self,
        tables: Sequence[CancellationTable | None],
        period_s: float,
        torque_steps_nm: Sequence[float] | None = None,
        *,
        speed_lowpass_hz: float = SPEED_LOWPASS_HZ,
        fade_rev: float = FADE_REV,
    ) -> None:
        """Lay out the arrays.

        Args:
            torque_steps_nm: Step to which each axis' torque offset is rounded; 0: it is not rounded.
            speed_lowpass_hz: Corner of the low-pass that gives the motor speed.
            fade_rev: Motor revolutions in which the first addition is forgotten.

        Raises:
            ValueError: There is no axis, or a time is not above zero.
        """
        if not tables:
            raise ValueError("a cancellation for 0 axes; expected at least 1")
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
        self._table = np.zeros((len(tables), count, points, WAVE_COLUMNS))
        self._turns = [_turns(table) for table in tables]
        for row, table in enumerate(tables):
            if table is not None:
                self._write(row, table)
        self._config["load_lowpass_hz"] = LOAD_LOWPASS_HZ
        self._values = np.zeros((2, len(tables)))
        self._values_by = CORE.pointer(self._values)
        self.data = CORE.new("cancellation")
        self._kept = (
            CORE.pointer(self._config, "cancellation_config"), CORE.pointer(self._state, "cancellation_state"),
            CORE.pointer(self._waves), CORE.pointer(self._table),
        )  # fmt: skip
        self.data.configs, self.data.states, self.data.waves, self.data.table = self._kept
        self.data.count, self.data.wave_count, self.data.speeds, self.data.period_s = len(tables), count, points, period_s

    def _write(self, row: int, table: CancellationTable) -> None:
        columns, given = len(table.waves), np.shape(table.reference)[1]
        self._config["step_rps"][row] = table.step_rps
        self._waves[row, :columns] = [(wave.order, wave.phase_rad, 1.0) for wave in table.waves]
        is_own = np.array([wave.degree == 1 for wave in table.waves])
        sampled = table.motion + (0.0 if table.image is None else np.sum(table.image, axis=0))
        self._table[row, :columns, :given, 4] = np.where(is_own[:, np.newaxis], np.real(sampled), 0.0)
        self._table[row, :columns, :given, 13] = np.where(is_own[:, np.newaxis], np.imag(sampled), 0.0)
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
        """Multiply the cancellation of each order by a complex factor.

        Args:
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
        """Return the additions to set-points (rad) and torques (N·m).

        They are in the order of the axes.

        Args:
            torques_nm: Measured motor torques; None: 0.
        """
        values = self._values
        values[0], values[1] = angles_rad, 0.0 if torques_nm is None else torques_nm
        CORE.call.cancel(self.data, self._values_by)
        references, torques = values.tolist()
        return references, torques
