"""The robot without the causes that the product states.

Causes are true if the robot without them ends within the goal, or loses at least half of the excess over it.
"""

import math
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.experiments.cancellation import cancellation
from hil.experiments.cancellation.effect import Part
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.robots.robot import Robot

Pair = tuple[Robot, Bench]

FASTER, SHORT_SYNC_S, MBIT = 3.0, 0.001, 1_000_000
"""Factor of a speed limit that binds no more; SYNC period of a quick bus, and its bit rate."""
HIGH_OVER_RESONANCE = 5.0
"""Highest k f_m of a cancellation that nothing limits, in units of f_al."""
HALF = 0.5
"""Part of what is above the goal that goes with a true cause at least."""


def without_reaction(robot: Robot, bench: Bench, axis: int) -> Pair:
    """Return the robot without the gear's reaction."""
    table = robot.axis[axis].model_copy(update={"gear_reaction": False})
    return robot.model_copy(update={"axis": {**robot.axis, axis: table}}), bench


def without_speed_limit(robot: Robot, bench: Bench, axis: int) -> Pair:
    """Return the bench with higher limits of speed and following error."""
    table = bench.axis[axis]
    limits = table.limits.model_copy(
        update={
            "speed_rps": FASTER * table.limits.speed_rps,
            "following_error_rev": FASTER * table.limits.following_error_rev,
        }
    )
    axes = {**bench.axis, axis: table.model_copy(update={"limits": limits})}
    return robot, bench.model_copy(update={"axis": axes})


def with_quick_bus(robot: Robot, bench: Bench, axis: int) -> Pair:
    """Return robot and bench with a short SYNC period."""
    table = robot.axis[axis]
    behaviour = table.behaviour.model_copy(update={"tpdo_delay_us": 0})
    quick = robot.model_copy(
        update={
            "sync_period_s": SHORT_SYNC_S,
            "bus": robot.bus.model_copy(update={"bitrate": MBIT}),
            "axis": {**robot.axis, axis: table.model_copy(update={"behaviour": behaviour})},
        }
    )
    address = f"{bench.bus.address.partition('@')[0]}@{MBIT}"
    bus = bench.bus.model_copy(update={"sync_period_s": SHORT_SYNC_S, "address": address})
    return quick, bench.model_copy(update={"bus": bus})


REMOVED: dict[str, Callable[[Robot, Bench, int], Pair]] = {
    "gear reaction": without_reaction,
    "speed limit": without_speed_limit,
    "frequency limit": with_quick_bus,  # and a cancellation that ends further up: `_up_to`
}
"""Functions that remove a cause from robot or bench; the cancellation is unchanged."""
KNOWN_BETTER = frozenset({"estimate", "order left out"})
"""Causes that vanish if the robot's whole true ATE is cancelled."""


@contextmanager
def _up_to(over_resonance: float) -> Iterator[None]:
    """Let cancellations extend to a multiple of f_al in this context."""
    before = cancellation.HIGHEST_OVER_RESONANCE
    cancellation.HIGHEST_OVER_RESONANCE = over_resonance
    try:
        yield
    finally:
        cancellation.HIGHEST_OVER_RESONANCE = before


@dataclass(frozen=True)
class PathEnd:
    """End of a path: a cancellation on a robot."""

    robot: Robot
    bench: Bench
    axis: int
    model: Identified
    left_out: Collection[Part] = ()


def tip_without(causes: Collection[str], end: PathEnd, rerun: Callable[[Robot, Bench], float | None]) -> float | None:
    """Return the largest true tip without some causes, mm, or None.

    Args:
        causes: Names of the causes, of `hil.results.runs.RemainderCause`.
        rerun: Tip with which the path ends on another robot.
    """
    robot, bench, axis, model, left_out = end.robot, end.bench, end.axis, end.model, end.left_out
    for cause in causes:
        if cause in REMOVED:
            robot, bench = REMOVED[cause](robot, bench, axis)
    if "sensor noise" in causes:
        still = robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
        return rerun(robot.model_copy(update={"accelerometer": still}), bench)
    known = model.axis[axis].ate
    if KNOWN_BETTER & set(causes) and known is not None:
        true = known.model_copy(update={"values": robot.axis[axis].apparent_ate, "standard_error": {}, "correlation": None})
        model, left_out = model.with_part(axis, true), ()
    elif not REMOVED.keys() & set(causes):
        return None
    with _up_to(HIGH_OVER_RESONANCE if "frequency limit" in causes else cancellation.HIGHEST_OVER_RESONANCE):
        return max(Survey(robot, bench, axis).cancelled(model, left_out).values(), default=None)


def is_true(end_mm: float, goal_mm: float, without_mm: float | None) -> bool:
    """Return True if the excess over the goal vanishes with the cause.

    >>> is_true(0.020, 0.010, 0.014), is_true(0.020, 0.010, 0.016), is_true(0.011, 0.010, 0.0099)
    (True, False, True)
    """
    without = math.inf if without_mm is None else without_mm
    return without <= goal_mm or end_mm - without >= HALF * (end_mm - goal_mm)
