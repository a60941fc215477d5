"""Reaction of gears on their motors, from a probed motion.

The motors' torque shows it beside the motion of the tip.

A gear whose torque τ_g reacts through its error loads the motor with τ_g (1/N + r θ_sync′). The motor's torque without that
of its own inertia, τ_m − J_m θ̈_m, is that load plus friction. Settings c that bring the tip to rest cancel the error
together with the reaction's effect on the motor's motion,

    A = c + r q,    q = j k τ_g A/(N (J_m s² + C)),

C being the law. With these settings the load has the reaction itself, less the gear's torque by r q, which the probes have
shown. Gears give back nearly all power, r = 1, or react as if they gave none. The reaction itself shows the size of τ_g, and
τ_g = N (slow torque − friction) then gives the friction.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from hil.analysis import band_passed
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.control.angles import ARCSEC
from hil.control.arrays import Complex, Real
from hil.design.ate.reaction import felt_as
from hil.design.estimation import SURE_SIGMAS
from hil.design.frequency import CONTROL_PERIOD_S
from hil.design.probing import Effects, autocovariance, effects_of
from hil.experiments.cancellation.cancellation import treated_model
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.motion import GearReaction, settings_of, values_by_part, with_values
from hil.experiments.cancellation.probing.record import MotionLearning, MotionRun
from hil.experiments.cancellation.waves import ProbedRows
from hil.recording import Recording

LOAD_HZ = 1.5
"""Bound: frequency up to which a gear's load is that of gravity and of the motion."""
REACTS_POWER, REACTS_LOAD = 0.4, 0.3
"""Fraction of the load's power in the band that a reaction explains from which it counts as seen, and the least load for that."""
LEAST_FRICTION = -REACTS_LOAD
"""Least friction that a seen reaction may leave, over the slow torque: friction opposes the motion, and less is not seen."""


class ShownReaction(NamedTuple):
    """The reaction of one axis' gear.

    Attributes:
        load: τ_g as the reaction shows it, over N times the slow torque of the motor; 0 if there is none.
        power: Fraction of the load's power in the band that it explains.
        turned_nm: Slow torque of the motor in the direction in which it turns.
        change: Settings of all parts, as A_k cos φ_k and A_k sin φ_k in turn, by which those that bring the tip to rest change
            where it is allowed for; in arcsec.
    """

    load: float
    standard_error: float
    power: float
    turned_nm: float
    change: Real

    @property
    def is_seen(self) -> bool:
        """True if the gear reacts on its motor for certain."""
        is_there = abs(self.load) >= max(SURE_SIGMAS * self.standard_error, REACTS_LOAD) and self.power >= REACTS_POWER
        return is_there and self.friction_nm >= LEAST_FRICTION * abs(self.turned_nm)

    @property
    def friction_nm(self) -> float:
        """Friction at the motor if the gear reacts with all torque."""
        return (1.0 - self.load) * self.turned_nm

    @property
    def estimate(self) -> GearReaction:
        """R and the friction."""
        return GearReaction(1.0, max(self.friction_nm, 0.0)) if self.is_seen else GearReaction(0.0, 0.0)


class _Axis:
    """Load of one axis, and the effect of a reaction on it."""

    def __init__(self, bench: Bench, model: Identified, probed: ProbedRows, runs: Sequence[MotionRun], number: int) -> None:
        known = treated_model(bench, model, number)
        assert known is not None  # noqa: S101 - it has an error
        loop = bench.axis[number].model_copy(update={"model": known}).loop(CONTROL_PERIOD_S, with_notch=False)
        assert loop is not None  # noqa: S101 - gains were asked for
        self.number, self._loop, self._probed = number, loop, probed
        self._inertia = known.motor_inertia_kg_m2
        self._ratio = bench.axis[number].reduction_ratio
        loads = [self.load_nm(run.recording) for run in runs]
        angle = runs[0].recording.axis(number, "position_rad")[probed.rows]
        self._way = math.copysign(1.0, float(angle[-1] - angle[0]))
        self._slow_nm = self._ratio * _slow(np.mean(loads, axis=0), runs[0].recording.period_s)

    def load_nm(self, recording: Recording) -> Real:
        """Torque at the motor without that of its inertia; shape (n,)."""
        angle, period_s = recording.axis(self.number, "position_rad"), recording.period_s
        padded = np.concatenate([[angle[0]], angle, [angle[-1]]])
        return recording.axis(self.number, "torque_nm") - self._inertia * np.diff(padded, 2) / period_s**2

    def rows_nm(self, recording: Recording) -> Real:
        """Load torque in the band, in the rows that count."""
        return self._in_band(self.load_nm(recording), recording.period_s)

    def _in_band(self, values: Real, period_s: float) -> Real:
        return band_passed(values, period_s, self._probed.band_hz)[self._probed.rows]

    @property
    def turned_nm(self) -> float:
        """Slow torque at the motor in the direction in which it turns."""
        return float(np.mean(self._slow_nm[self._probed.rows])) * self._way / self._ratio

    def reaction_nm(self, recording: Recording, orders: Mapping[float, complex]) -> Real:
        """Load by a whole reaction without friction, in the band.

        τ_g Σ Re j k A e^{j(k θ_m + φ)}
        """
        angle = recording.axis(self.number, "position_rad")
        waves = [(1j * k * ARCSEC * value * np.exp(1j * k * angle)).real for k, value in orders.items()]
        return self._in_band(self._slow_nm * np.sum(waves, axis=0), recording.period_s)

    def felt_as(self, recording: Recording, order: float, value: complex) -> Complex:
        """Setting q of an order that equals the reaction's effect.

        The effect is that on the motor's motion; in arcsec, shape (rows,).
        """
        angle = _slow(recording.axis(self.number, "position_rad"), recording.period_s)
        speed = np.gradient(angle, recording.period_s)[self._probed.rows]
        frequency = np.maximum(order * np.abs(speed) / (2.0 * math.pi), 0.5)
        return value * felt_as(self._loop, order, frequency, speed, self._slow_nm[self._probed.rows])


def shown_reactions(
    bench: Bench,
    known: Identified,
    learning: MotionLearning,
    parts: Sequence[Part],
    vector: Real,
    step: Real,
    runs: Sequence[MotionRun],
) -> dict[int, ShownReaction]:
    """Find the gear reaction of each axis with learnt orders.

    Args:
        parts: Orders of axes that were probed.
        vector: Settings about which they were.
        step: What has to be added to them, so that the tip comes to rest.
        runs: Runs at that level, and probes about it.
    """
    probed = learning.probed
    assert probed is not None  # noqa: S101 - there were runs
    values = values_by_part(parts, vector + step)
    model = with_values(known, learning.motion, values, learning.inertias, learning.scale.f_al_hz)
    vectors = np.array([settings_of(parts, run.values) - vector for run in runs])
    found = {}
    for number in learning.motion.axes:
        if any(part.axis == number and values[part] for part in parts):
            axis = _Axis(bench, model, probed, learning.of_kind("base"), number)
            loads = effects_of(vectors, np.array([[axis.rows_nm(run.recording)] for run in runs]))
            found[number] = _shown(axis, parts, values, loads, step, runs[0].recording)
    return found


def _shown(
    axis: _Axis, parts: Sequence[Part], values: Mapping[Part, complex], loads: Effects, step: Real, recording: Recording
) -> ShownReaction:
    at_rest = loads.level[0] + np.tensordot(step, loads.effects[:, 0], axes=1)
    own = {part.order: values[part] for part in parts if part.axis == axis.number}
    column, change = axis.reaction_nm(recording, own), np.zeros(2 * len(parts))
    for at, part in enumerate(parts):
        if part.axis == axis.number:
            felt = axis.felt_as(recording, part.order, values[part])
            column = column - loads.effects[2 * at, 0] * felt.real - loads.effects[2 * at + 1, 0] * felt.imag
            change[2 * at : 2 * at + 2] = float(np.mean(felt.real)), float(np.mean(felt.imag))
    size = max(float(column @ column), 1e-30)
    load = float(column @ at_rest) / size
    left = at_rest - load * column
    correlation = autocovariance(left)
    correlated = correlation[0] + 2.0 * float(np.sum(np.abs(correlation[1 : max(len(left) // 8, 2)])))
    power = 1.0 - float(left @ left) / max(float(at_rest @ at_rest), 1e-30)
    return ShownReaction(load, math.sqrt(correlated / size), power, axis.turned_nm, load * change)


def _slow(values: Real, period_s: float) -> Real:
    return np.asarray(scipy.signal.sosfiltfilt(scipy.signal.butter(2, LOAD_HZ, fs=1.0 / period_s, output="sos"), values))
