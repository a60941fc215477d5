"""Cancellation table of one axis, for the pace of a motion."""

import math
from typing import NamedTuple

import numpy as np

from hil.analysis import TipScale
from hil.bench.bench import Bench, Model
from hil.control.angles import ARCSEC
from hil.control.cancellation_table import CancellationTable, MotorLoad
from hil.design.inverse import HIGHEST_HZ, Actuation, CyclicTiming, cancellation_table
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.judge import scale_at
from hil.master.motion import Motion
from hil.robot_tables import TransmissionErrorTable

MAX_ERROR_ARCSEC = 200.0
"""Largest ΣA_k that is cancelled: harmonic gears have a tenth to a half of it, so more is a slip in a model file."""
KEPT_OVER_RESONANCE = 1.3
"""k f_m up to which an order is cancelled whatever the speed limit leaves, in units of f_al: there the arm resonates with it."""
HIGHEST_OVER_RESONANCE = 3.2
"""Highest k f_m of a cancellation in units of f_al, where that is more than the usual one.

An order fades over the fifth below: up to 2.5 f_al, where the vibration's band lets nothing more through, it is whole."""
MAX_TORQUE_FRACTION = 0.2
"""Largest torque offset as a fraction of the torque limit."""
TORQUE_USED = 0.95
"""Fraction of that up to which waves are fitted in."""
ORDINARY = 0.98
"""Fraction of a motion's samples that has no larger acceleration than the largest that counts."""


class Pace(NamedTuple):
    """Speed and acceleration of a motion.

    Attributes:
        peak_rps: Highest motor speed; 0 if it is not known.
        most_rad_s2: Largest acceleration, likewise.
    """

    peak_rps: float = 0.0
    most_rad_s2: float = 0.0


def table_of(
    bench: Bench,
    number: int,
    model: Model,
    timing: CyclicTiming,
    pace: Pace,
    actuation: Actuation,
    *,
    with_notch: bool,
    by_torque: bool = False,
    torque_lag_s: float = 0.0,
    load: MotorLoad | None = None,
) -> tuple[CancellationTable, TipScale]:
    """Table of an axis, and the scale of its vibration.

    Args:
        bench: The bench file.
        number: Axis number.
        model: Model of the axis.
        timing: Delays of the set-points.
        pace: Pace of the motion.
        actuation: `reference` for the set-point alone, `torque` with a torque offset.
        with_notch: True if the drive's filters act.
        by_torque: True if a torque offset may do what the set-points' speed limit has no room for.
        torque_lag_s: Lag of the drive's current loop.
        load: Gear torque that reacts on the motor; None if it is not known to.

    Raises:
        NotPossibleError: There is nothing to cancel, or no loop.
        UnsafeRequestError: The model has an error that no gear has.
    """
    table = bench.axis[number].model_copy(update={"model": model})
    table.gains(f"cancellation on axis {number}")
    _check_size(number, model.ate)
    loop = table.loop(timing.control_period_s, with_notch=with_notch)
    assert loop is not None  # noqa: S101 - it has a model and gains
    scale, limits = scale_at(bench, number, loop.peak_hz()), table.limits
    highest_hz = max(HIGHEST_HZ, HIGHEST_OVER_RESONANCE * scale.f_al_hz)

    def by(way: Actuation) -> CancellationTable:
        error, chirp = (amplitudes_rad(model.ate), _phases_rad(model.ate)), pace.most_rad_s2
        try:
            return cancellation_table(loop, *error, timing, limits.speed_rps, way, highest_hz, chirp, torque_lag_s, load)
        except ValueError as error_of:
            raise NotPossibleError(f"axis {number}: {error_of}", ("nothing to cancel",)) from error_of

    kept_hz = KEPT_OVER_RESONANCE * scale.f_al_hz
    alone, room_nm = by("torque alone") if by_torque else None, TORQUE_USED * MAX_TORQUE_FRACTION * limits.torque_nm
    return by(actuation).within_speed(limits.speed_rps, pace.peak_rps, kept_hz, alone, room_nm), scale


def _check_size(number: int, ate: TransmissionErrorTable) -> None:
    """Refuse an error that no gear has.

    Raises:
        UnsafeRequestError: ΣA_k is beyond `MAX_ERROR_ARCSEC`.
    """
    total = sum(ate.amplitudes_arcsec().values())
    if total > MAX_ERROR_ARCSEC:
        remedy = "no gear has as much; check the model file"
        raise UnsafeRequestError(f"the transmission error of axis {number}, ΣA_k,", total, MAX_ERROR_ARCSEC, "arcsec", remedy)


def pace_of(bench: Bench, motion: Motion, column: int) -> Pace:
    """Pace of an axis in a motion and in its approach.

    Jerks of the motion are left out.
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
