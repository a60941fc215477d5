"""The table of one axis' cancellation, for the pace of a motion."""

import math
from typing import NamedTuple

import numpy as np

from hil.analysis import TipScale
from hil.bench.bench import Bench, Model
from hil.control.angles import ARCSEC
from hil.control.cancellation import CancellationTable
from hil.design.inverse import HIGHEST_HZ, Actuation, CyclicTiming, cancellation_table
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.judge import scale_at
from hil.master.motion import Motion
from hil.robot_tables import TransmissionErrorTable

MAX_ERROR_ARCSEC = 200.0
"""Largest ΣA_k that is cancelled: harmonic gears have a tenth to a half of it, so more is a slip in a model file."""
KEPT_OVER_RESONANCE = 1.3
"""k f_m up to which an order is cancelled whatever the speed limit leaves, in units of f_al: there the arm resonates with it."""
HIGHEST_OVER_RESONANCE = 2.1
"""Highest k f_m of a cancellation in units of f_al, where that is more than the usual one: the end of the vibration's band."""
HIGHEST_OVER_SYNC = 0.4
"""The same in units of the SYNC rate, of which half is the most that set-points can have."""
ORDINARY = 0.98
"""Fraction of a motion's samples that has no larger acceleration than the largest that counts."""


class Pace(NamedTuple):
    """Speed and acceleration of a motion.

    Attributes:
        peak_rps: Highest motor speed; 0 where it is not known.
        most_rad_s2: Largest acceleration, likewise.
    """

    peak_rps: float = 0.0
    most_rad_s2: float = 0.0


def table_of(
    bench: Bench, number: int, model: Model, timing: CyclicTiming, pace: Pace, actuation: Actuation, *, with_notch: bool
) -> tuple[CancellationTable, TipScale]:
    """Table of an axis, and the scale of its vibration.

    Args:
        bench: The bench file.
        number: Axis number.
        model: What is known of the axis.
        timing: Delays of the set-points.
        pace: Pace of the motion.
        actuation: `reference` for the set-point alone, `torque` with a torque offset.
        with_notch: True where the drive's filters act.

    Raises:
        NotPossibleError: There is nothing to cancel, or no loop.
        UnsafeRequestError: The model has an error that no gear has.
    """
    table = bench.axis[number].model_copy(update={"model": model})
    table.gains(f"cancellation on axis {number}")
    _check_size(number, model.ate)
    loop = table.loop(timing.control_period_s, with_notch=with_notch)
    assert loop is not None  # noqa: S101 - it has a model and gains
    scale, limit_rps = scale_at(bench, number, loop.peak_hz()), table.limits.speed_rps
    error = amplitudes_rad(model.ate), _phases_rad(model.ate)
    try:
        highest_hz = max(HIGHEST_HZ, min(HIGHEST_OVER_RESONANCE * scale.f_al_hz, HIGHEST_OVER_SYNC / timing.sync_period_s))
        whole = cancellation_table(loop, *error, timing, limit_rps, actuation, highest_hz, pace.most_rad_s2)
    except ValueError as error_of:
        raise NotPossibleError(f"axis {number}: {error_of}") from error_of
    return whole.within_speed(limit_rps, pace.peak_rps, KEPT_OVER_RESONANCE * scale.f_al_hz), scale


def _check_size(number: int, ate: TransmissionErrorTable) -> None:
    """Refuse an error that no gear has.

    Raises:
        UnsafeRequestError: ΣA_k is beyond `MAX_ERROR_ARCSEC`.
    """
    total = sum(ate.amplitudes_arcsec().values())
    if total > MAX_ERROR_ARCSEC:
        remedy = "no gear has as much: is the model file right?"
        raise UnsafeRequestError(f"the transmission error of axis {number}, ΣA_k,", total, MAX_ERROR_ARCSEC, "arcsec", remedy)


def pace_of(bench: Bench, motion: Motion, column: int) -> Pace:
    """Pace of an axis in a motion, its jerks left out, and in the approach to its start.

    Args:
        bench: The bench file.
        motion: The motion.
        column: Column of the axis in it.
    """
    angle, period_s = motion.motor_angle_rad[:, column], motion.period_s
    fastest = float(np.max(np.abs(np.diff(angle)))) / period_s / (2.0 * math.pi)
    rising = np.abs(np.gradient(np.gradient(angle, period_s), period_s))
    return Pace(max(fastest, bench.approach_rps), float(np.quantile(rising, ORDINARY)))


def amplitudes_rad(ate: TransmissionErrorTable) -> dict[float, float]:
    """A_k in rad, by order; only amplitudes above 0."""
    return {order: size * ARCSEC for order, size in ate.amplitudes_arcsec().items()}


def _phases_rad(ate: TransmissionErrorTable) -> dict[float, float]:
    """φ_k from 0 to 2π."""
    return {order: math.radians(degrees) for order, degrees in phases_deg(ate).items()}


def phases_deg(ate: TransmissionErrorTable) -> dict[float, float]:
    """φ_k from 0 to 360°."""
    return {order: degrees % 360.0 for order, degrees in ate.phases_deg().items()}
