"""First motion of an identification: a third of a motor turn."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.bench.bench import Bench
from hil.control.angles import ARCSEC
from hil.control.arrays import Real
from hil.design.estimation import SURE_SIGMAS, inverse
from hil.experiments.plant.motion import SLOW_RPS, MotionBuilder, PlannedMotion, PlantRequest, planned
from hil.recording import Recording

PROBE_RPS = SLOW_RPS[0]
"""Speed of the probe: that of the slowest turn."""
PROBE_S = 0.4
"""Bound: duration of its part at constant speed in either direction: with its ramps it is 0.36 rev, within `MARGIN_REV`."""
CORRELATED_ROWS = 10.0
"""Measured: rows for which the torque of a slow turn keeps its deviation: 1 to 2.6 on 13 drawn robots (10700, 10712, 10730,
10735, 10740 to 10749), 20 on one."""
WOUND_FRACTION = 0.7
"""Measured: torque per radian of the motor by torque limit over N: gravity's is 0.11 at most on the drawn robots 10700 to
10764."""
ERROR_BEND = 4.0 * 100.0 * ARCSEC
"""Largest d²θ_sync/dθ_m² in 1/rad, that of 100″ at order 2: times the gear's torque it is a spring at the motor."""
WOUND_OVER_FRICTION = 3.0
"""Measured with `CORRELATED_ROWS`, 0.6 at most: torque wound up in the probe over friction's: gravity on the slope of the
transmission error rises by as much as friction, an arm that is held by the gear's whole stiffness."""
STILL_FRACTION = 0.2
"""Measured: fraction of the travel below which the motor has not turned: 0.998 to 1.01 on the drawn robots 10700 to 10764."""


@dataclass(frozen=True)
class ProbeTrouble:
    """Reason why an axis must not be moved on.

    Attributes:
        about: Part that is not as it must be.
    """

    about: Literal["brake", "encoder", "torque", "arm"]
    sentence: str


def probe_motion(bench: Bench, request: PlantRequest, start_rev: float) -> PlannedMotion:
    """Motion of the probe, towards the middle of the travel and back."""
    limits = bench.axis[request.axis].limits
    sign = 1.0 if start_rev <= 0.5 * (limits.position_min_rev + limits.position_max_rev) else -1.0
    builder = MotionBuilder(bench.bus.sync_period_s)
    builder.rest(0.1)
    count = max(4, round(PROBE_S / bench.bus.sync_period_s))
    speeds = [sign * PROBE_RPS, -sign * PROBE_RPS]
    stretches = [builder.cruise(speed, count) for speed in speeds]
    builder.rest(0.1)
    return planned(builder, request, "torque", stretches, speeds)


def probe_trouble(
    motion: PlannedMotion, recording: Recording, axis: int, torque_limit_nm: float, reduction_ratio: float
) -> ProbeTrouble | None:
    """Reason why the axis must not be moved on, or None.

    Args:
        recording: Recording of the motion, also of one that was stopped.
    """
    angle, torque = recording.axis(axis, "position_rad"), recording.axis(axis, "torque_nm")
    if len(angle) < len(motion.bias_rad):
        return _stopped_trouble(angle, torque, motion, torque_limit_nm)
    travelled = float(np.ptp(angle)) / float(np.ptp(motion.bias_rad))
    largest = float(np.max(np.abs(torque)))
    if travelled < STILL_FRACTION:
        return ProbeTrouble(
            "brake",
            f"the motor angle showed {100.0 * travelled:.0f} % of a motion of {np.ptp(motion.bias_rad) / math.tau:.2g} rev at "
            f"up to {largest:.3g} N·m; check that the brake is open, the arm free, and the encoder the axis' own",
        )
    friction, slope = slow_torque(angle, torque, motion)
    if friction[0] < -SURE_SIGMAS * friction[1]:
        return ProbeTrouble(
            "torque",
            f"the torque pushed against the motion, {friction[0]:.3g} ± {friction[1]:.1g} N·m, but friction requires a torque "
            f"along it; the encoder counts backwards, or the drive reports the torque with the wrong sign (607Eh, "
            "6077h, motor phases)",
        )
    load_nm = reduction_ratio * abs(float(np.mean(np.concatenate([torque[each] for each in motion.stretches]))))
    free = WOUND_FRACTION * torque_limit_nm / reduction_ratio + ERROR_BEND * load_nm
    wound_nm = slope[0] * float(np.ptp(angle))
    if slope[0] - SURE_SIGMAS * slope[1] > free and wound_nm > WOUND_OVER_FRICTION * abs(friction[0]):
        return ProbeTrouble(
            "arm",
            f"the motor acted against a spring of {slope[0]:.3g} ± {slope[1]:.1g} N·m/rad, and gravity explains at most "
            f"{free:.2g}; the arm is held (a brace, a stop, a second brake)",
        )
    return None


def _stopped_trouble(angle: Real, torque: Real, motion: PlannedMotion, torque_limit_nm: float) -> ProbeTrouble | None:
    """Reason why a probe was stopped, or None."""
    if len(angle) < 2:
        return None
    moved, largest = float(angle[-1] - angle[0]), float(np.max(np.abs(torque)))
    tail = slice(-max(3, len(torque) // 10), None)
    pushed = float(np.mean(torque[tail]))
    if abs(moved) > 0.1 * float(np.ptp(motion.bias_rad)) and moved * pushed < 0.0 and abs(pushed) > 0.3 * largest:
        return ProbeTrouble(
            "encoder",
            f"the motor ran {moved / math.tau:+.2g} rev against a torque of {pushed:+.3g} N·m until it was stopped: the encoder "
            "counts backwards (607Eh, motor phases)",
        )
    if abs(moved) <= STILL_FRACTION * float(np.ptp(motion.bias_rad)) and largest > 0.8 * torque_limit_nm:
        return ProbeTrouble(
            "brake",
            f"the motor did not turn under {largest:.3g} N·m until it was stopped; check that the brake is open and the arm free",
        )
    return None


def slow_torque(angle: Real, torque: Real, motion: PlannedMotion) -> tuple[tuple[float, float], tuple[float, float]]:
    """Friction and torque per angle in a probe, with standard errors.

    They are fitted to the slow stretches, in N·m and N·m/rad.

    Args:
        angle: Motor angle; shape (n,).
        torque: Motor torque; shape (n,).
    """
    rows, wanted = [], []
    for stretch, speed in zip(motion.stretches, motion.speeds_rps, strict=True):
        part = angle[stretch]
        rows.append(np.column_stack([np.full(len(part), math.copysign(1.0, speed)), part, np.ones(len(part))]))
        wanted.append(torque[stretch])
    matrix, values = np.concatenate(rows), np.concatenate(wanted)
    found = np.linalg.lstsq(matrix, values, rcond=None)[0]
    left = values - matrix @ found
    power = float(np.mean(left**2)) * CORRELATED_ROWS
    errors = np.sqrt(np.diag(inverse(matrix.T @ matrix)) * power)
    return (float(found[0]), float(errors[0])), (float(found[1]), float(errors[1]))
