"""Conditions in which a learnt cancellation is tested."""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from hil.arm.straight_line import LineError
from hil.bench.bench import Bench
from hil.control.arrays import Real
from hil.experiments.motions import line_motion
from hil.robot_tables import LineMotion, Point
from plant_emulator.robots.arm_motions import point_of
from plant_emulator.robots.robot import ArmRobot

LEARNT = "line"
"""The condition in which it is learnt: the bench file's line, with the whole payload."""
PACES = {"quick": 0.8, "slow": 1.4}
"""Factors of the line's duration."""
PAYLOADS = {"no_payload": 0.0, "half_payload": 0.5}
"""Factors of the payload."""
NAMES = (LEARNT, "beside", "elsewhere", *PAYLOADS, *PACES)
"""Names of all conditions."""
AWAY_M = (0.12, 0.08, 0.05)
"""How far another line is from the first, as far as the arm can follow it."""
ALONG = 0.9
"""Cosine of the angle to the line from which a direction is the line's own."""


class Condition(NamedTuple):
    """A condition."""

    name: str
    robot: ArmRobot
    bench: Bench


def conditions_of(robot: ArmRobot, bench: Bench) -> list[Condition]:
    """Return all conditions of the arm, the learnt one first.

    The other lines are one beside the first, which begins elsewhere, and one from the same start to another end.
    """
    line = bench.line_motion
    assert line is not None  # noqa: S101 - it has been learnt on
    found = [Condition(LEARNT, robot, bench)]
    for name, moves_start in (("beside", True), ("elsewhere", False)):
        other = next(_others(bench, line, moves_start=moves_start), None)
        found += [] if other is None else [Condition(name, robot, other)]
    found += [Condition(name, with_payload(robot, factor), bench) for name, factor in PAYLOADS.items()]
    for name, factor in PACES.items():
        paced = _with_line(bench, line.model_copy(update={"duration_s": factor * line.duration_s}))
        found += [Condition(name, robot, paced)] if _can_follow(paced) else []
    return found


def with_payload(robot: ArmRobot, factor: float) -> ArmRobot:
    """Return the robot with a fraction of its payload."""
    load = robot.arm.payload
    if load is None:
        return robot
    inertia = load.inertia_kg_m2
    less = inertia.model_copy(update={name: factor * getattr(inertia, name) for name in type(inertia).model_fields})
    left = load.model_copy(update={"mass_kg": factor * load.mass_kg, "inertia_kg_m2": less}) if factor > 0.0 else None
    return robot.model_copy(update={"arm": robot.arm.model_copy(update={"payload": left})})


def _others(bench: Bench, line: LineMotion, *, moves_start: bool) -> Iterator[Bench]:
    """Yield bench files with other lines to follow, the furthest first."""
    start, end = _vector(line.start_m), _vector(line.end_m)
    own = (end - start) / np.linalg.norm(end - start)
    ways = [sign * unit for unit, sign in product(np.eye(3)[[2, 1, 0]], (-1.0, 1.0)) if abs(float(unit @ own)) < ALONG]
    for away_m, way in product(AWAY_M, ways):
        begins = point_of(start + away_m * way) if moves_start else line.start_m
        other = _with_line(bench, line.model_copy(update={"start_m": begins, "end_m": point_of(end + away_m * way)}))
        if _can_follow(other):
            yield other


def _with_line(bench: Bench, line: LineMotion) -> Bench:
    return bench.model_copy(update={"line_motion": line})


def _can_follow(bench: Bench) -> bool:
    try:
        line_motion(bench, bench.bus.sync_period_s)
    except LineError:
        return False
    return True


def _vector(point: Point) -> Real:
    return np.array([point.x, point.y, point.z])
