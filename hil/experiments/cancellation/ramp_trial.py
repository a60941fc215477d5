"""Ramps on which a trial judges orders that its motion hides.

An order may ring where the motion's own jerk shakes the arm far more, or not ring at all. A slow ramp through its resonance shows
it by itself, as the passes of `hil learn` do: without the cancellation, and with the whole of it. The motion's own runs are
judged beside the ramps.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.analysis import TipScale
from hil.bench.bench import Bench
from hil.control.cancellation_table import LIMIT_USED, CancellationTable
from hil.design.ringing import BEYOND_RESONANCE, RINGING
from hil.errors import NotPossibleError
from hil.experiments.ate.motion import Ramps, ramps
from hil.experiments.ate.ramp import RampLimits, plan_ramp
from hil.experiments.cancellation.effect import Part, Response, sight
from hil.experiments.cancellation.images import images_m_s2
from hil.experiments.cancellation.verdict import Seen
from hil.experiments.cancellation.waves import waves_of
from hil.master.motion import Motion
from hil.recording import Recording


def ramp_through(bench: Bench, axis: int, orders: Sequence[float], f_al_hz: float, motion: Motion, stands_rad: float) -> Ramps:
    """Slow ramp of one axis through the resonance of some orders.

    It has no more travel and speed than the motion, and lies in the middle of that travel: whoever allowed the motion has allowed
    the ramp.

    Raises:
        NotPossibleError: The motion or the limits leave no room for it.
    """
    angle_rev, stands_rev = motion.motor_angle_rad[:, motion.axes.index(axis)] / math.tau, stands_rad / math.tau
    own, top_rps = RampLimits.of(bench, axis), float(np.max(np.abs(np.diff(angle_rev)))) / motion.period_s
    limits = replace(
        own, speed_rps=min(own.speed_rps, top_rps / LIMIT_USED), position_rev=min(own.position_rev, float(np.ptp(angle_rev)))
    )
    needed = BEYOND_RESONANCE * f_al_hz / min(orders)
    ramp = plan_ramp(limits, limits.suited(f_al_hz), RINGING * f_al_hz / min(orders), needed)
    if ramp.end_rps < needed:
        raise NotPossibleError(
            f"axis {axis} needs {needed:.2f} rev/s for it; within limits, travel and speed of the motion it reaches "
            f"{ramp.end_rps:.2f} rev/s"
        )
    home_rev = 0.0 if motion.starts_at_home else stands_rev
    return ramps(bench, stands_rev, ramp, home_rev + 0.5 * float(angle_rev.min() + angle_rev.max()))


def seen_by_direction(
    bench: Bench,
    recording: Recording,
    motion: Ramps,
    response: Response,
    fitted: Collection[float],
    orders: Collection[float],
    gain: float,
    scale: TipScale,
    tables: Mapping[int, CancellationTable],
) -> dict[float, list[Seen]]:
    """Read some of a pass' fitted orders in each direction of turning.

    `gain` is the fraction of the cancellation that acted, `tables` are those of it: their images are taken off.
    """
    axis, directions = motion.ramp.limits.axis, motion.direction()[: len(recording.time_s)]
    waves = waves_of(bench, {axis: response}, {axis: fitted}, motion.motion, recording)
    images, found = images_m_s2(recording, waves, tables), {order: list[Seen]() for order in orders}
    for way in (1, -1):
        sighting = sight(recording, waves, directions == way, scale.band_hz, images)
        for order, sights in found.items():
            sights.append(Seen.of(sighting, Part(axis, order), gain, way))
    return found
