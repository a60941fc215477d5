"""Recorded passes as input of the fit."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.design.ate.model import Signs, Sweep, resolution_rad
from hil.design.late_samples import on_time
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import check_accelerometer
from hil.experiments.ate.motion import Ramps
from hil.recording import Recording
from hil.robot_tables import ORDERS

Real = NDArray[np.float64]

SKIP_TORQUE = 0.12
"""Fraction of a ramp, from its beginning, that does not count without an accelerometer: there the torque is friction's."""


def sweep_of(motion: Ramps, recording: Recording, axis: int, *, sensorless: bool, sensor: str = "accelerometer") -> Sweep:
    """Recording of a pass as input of the fit.

    Args:
        motion: Ramps of the pass.
        recording: Recording of the pass.
        axis: Axis number.
        sensorless: True to fit the motor torque instead of the tip acceleration.
        sensor: Name of the tip's sensor.

    Raises:
        AteNotIdentifiedError: The sensor is dead or saturated.
        NotPossibleError: The sensor is not mounted as in the bench file.
    """
    if sensorless:
        torque = recording.axis(axis, "torque_nm")
        return sweep_on_time(recording, axis, torque, motion.direction(SKIP_TORQUE))
    if recording.doubt is not None:
        raise NotPossibleError(f"not identified: {recording.doubt}", ("wrong axis or wiring",))
    tip = recording.felt_m_s2
    check_accelerometer(tip, sensor)
    return sweep_on_time(recording, axis, tip, motion.direction(), recording.axis(axis, "torque_nm"))


def sweep_on_time(recording: Recording, axis: int, signal: Real, direction: Signs, torque_nm: Real | None = None) -> Sweep:
    """Input of the fit; late motor angles are moved back in time.

    Args:
        recording: Recording of the pass.
        axis: Axis number.
        signal: The signal of the tip or the motor; shape (n,).
        direction: Direction of the ramp at each sample; shape (n,).
        torque_nm: Torque of the motor beside a tip acceleration; None without.
    """
    angle = recording.axis(axis, "position_rad")
    found = on_time(angle, recording.period_s, resolution_rad(angle), max(ORDERS))
    return Sweep(found.angle_rad, signal, recording.period_s, direction, torque_nm, found.count, found.delay_s)


def late_words(sweeps: Sequence[Sweep]) -> list[str]:
    """Sentence on late samples of the motor angle; empty without any."""
    late = sum(each.late for each in sweeps)
    if not late:
        return []
    late_ms = 1e3 * max(each.late_s for each in sweeps)
    return [
        f"{late} of {sum(len(each.signal) for each in sweeps)} motor angles were sampled late, by about {late_ms:.2f} ms, "
        "and were moved back in time: other frames delay SYNC; `hil plan` shows the load of the bus"
    ]
