"""Learning of a known line at another pace.

Orders that the line hardly shows at its own pace may show more at another.

The known settings are the start, and their covariance is the spread that `hil.design.probing.step_to_nothing` asks for. An
order that only the other pace brings into the band has the spread of an unknown order. An order that the other pace does not
bring into the band is cancelled as before.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import Bench
from hil.control.arrays import Real
from hil.design.probing import ProbedStep, step_to_nothing
from hil.errors import UnsafeRequestError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.motion import values_by_part
from hil.experiments.cancellation.probing.runs import Runs, paced
from hil.experiments.cancellation.waves import LEAST_REACH_S
from hil.experiments.motions import line_motion
from hil.master.motion import Motion

SPEED_ROOM = 0.9
"""Fraction of an axis' limit of speed up to which a line may go at another pace: probes and what shakes need the rest."""


@dataclass(frozen=True)
class KnownSettings:
    """Settings of orders of axes, and how well they are known.

    Attributes:
        vector: A_k cos φ_k and A_k sin φ_k of each in turn, arcsec.
        seen: Fraction of each that the runs show.
    """

    parts: tuple[Part, ...]
    vector: Real
    covariance: Real
    seen: Real

    def with_others(self, parts: Sequence[Part], spread_arcsec: float) -> "KnownSettings":
        """Add parts of which only the spread is known."""
        more = tuple(part for part in parts if part not in self.parts)
        count, known = 2 * len(self.parts), 2 * len(self.parts) + 2 * len(more)
        covariance = spread_arcsec**2 * np.eye(known)
        covariance[:count, :count] = self.covariance
        pad = np.zeros(known - count)
        return KnownSettings(self.parts + more, np.concatenate([self.vector, pad]), covariance, np.concatenate([self.seen, pad]))

    def columns(self, parts: Sequence[Part]) -> NDArray[np.intp]:
        """Positions of the settings of some parts."""
        at = [self.parts.index(part) for part in parts]
        return np.array([each for index in at for each in (2 * index, 2 * index + 1)], dtype=np.intp)

    def changed(self, parts: Sequence[Part], step: ProbedStep, covariance: Real) -> "KnownSettings":
        """Apply a step of some parts to the settings."""
        own = self.columns(parts)
        vector, whole, seen = self.vector.copy(), self.covariance.copy(), self.seen.copy()
        vector[own] += step.settings
        whole[own], whole[:, own] = 0.0, 0.0
        whole[np.ix_(own, own)] = covariance
        seen[own] = np.maximum(seen[own], step.seen)
        return KnownSettings(self.parts, vector, whole, seen)


def paced_line(bench: Bench, pace: float) -> Motion:
    """Line in a multiple of its time, with room for probes and vibration.

    Raises:
        NotPossibleError: The bench file has no line.
        LineError: The arm cannot follow it at that pace.
        UnsafeRequestError: An axis comes too near to its limit of speed.
    """
    motion = line_motion(paced(bench, pace), bench.bus.sync_period_s)
    speeds = np.max(np.abs(np.gradient(motion.motor_angle_rad, motion.period_s, axis=0)), axis=0) / (2.0 * np.pi)
    for number, speed in zip(motion.axes, speeds.tolist(), strict=True):
        most = SPEED_ROOM * bench.axis[number].limits.speed_rps
        if speed > most:
            remedy = (
                "the rest of the limit is kept for vibration; choose --pace "
                f"{math.ceil(100.0 * pace * speed / most) / 100.0:.2f} or more"
            )
            raise UnsafeRequestError(f"axis {number} in {pace:g} times the line's time", speed, most, "rev/s", remedy)
    return motion


def learn_at_pace(runs: Runs, known: KnownSettings, orders: Sequence[float], spread_arcsec: float) -> KnownSettings:
    """Learn at another pace; known settings stay unless the tip becomes quieter."""
    learning = runs.learning
    runs.say(f"in {learning.pace:g} times the line's time")
    runs.base()
    assert learning.probed is not None  # noqa: S101 - of the base run
    reached = learning.probed.reached(runs.bench, learning.motion, orders)
    parts = tuple(part for part, time_s in reached.items() if time_s >= LEAST_REACH_S)
    if not parts:
        return known
    known_before, known = known, known.with_others(parts, spread_arcsec)
    own = known.columns(parts)
    level, covariance = known.vector[own], known.covariance[np.ix_(own, own)]
    values = values_by_part(known.parts, known.vector)
    runs.fixed = {part: value for part, value in values.items() if part not in parts}
    before = runs.applied(parts, level)
    effects = runs.probe(parts, runs.allowed(parts, np.full(len(parts), learning.probe_arcsec), level), level)
    step = step_to_nothing(effects, None, covariance)
    # one step from the level, which was run several times: a further one would follow the noise of a single run
    after = runs.applied(parts, level + step.settings)
    if after.rms_mm >= before.rms_mm:
        return known_before
    onward = step_to_nothing(effects, after.felt_m_s2, covariance)
    return known.changed(parts, step, step.covariance + np.outer(onward.settings, onward.settings))
