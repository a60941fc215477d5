"""Robots and benches of any number of axes: copies of the reference robot's."""

import math
from typing import Literal

import numpy as np

from drive_profiles.address import Address
from hil.bench.bench import Bench, load_bench
from hil.master.motion import Motion
from hil.robot_tables import Control
from plant_emulator.robots.robot import Robot, load_robot

SINGLE, PATTERN = 2, (2, 3, 5)
"""The only axis of a robot of one; the axes that are copied in turn."""
FIRST_NODE = 20
TURN = 2.0 * math.pi
AMPLITUDE_REV, FREQUENCY_HZ = 1.0, 0.5
"""What every axis does: it swings."""


def numbers(count: int) -> list[int]:
    """Axis numbers of a robot: 2, 3 and 5 come first, since they are the chain that moves the tip."""
    if count <= len(PATTERN):
        return list(PATTERN[:count])
    others = [number for number in range(1, count + 1) if number not in PATTERN]
    return sorted([*PATTERN, *others[: count - len(PATTERN)]])


def _model(number: int) -> int:
    return number if number in PATTERN else PATTERN[number % len(PATTERN)]


def robot_of(count: int, sync_period_s: float = 0.001) -> Robot:
    """The reference robot with so many axes; above six is more than a robot file may have, and only for measuring."""
    reference, bench = load_robot("reference"), load_bench("reference")
    axes = {}
    for number in numbers(count):
        model = _model(number)
        control = Control(**bench.axis[model].control.model_dump())
        axes[number] = reference.axis[model].model_copy(update={"node_id": FIRST_NODE + number, "control": control})
    changes: dict[str, object] = {"axis": axes, "sync_period_s": sync_period_s}
    if count < len(PATTERN):
        changes |= {"geometry": None, "line_motion": None}
    return reference.model_copy(update=changes)


def bench_of(count: int, address: Address | None = None, sync_period_s: float = 0.001) -> Bench:
    """The bench of that robot."""
    reference = load_bench("reference")
    axes = {
        number: reference.axis[_model(number)].model_copy(update={"node_id": FIRST_NODE + number}) for number in numbers(count)
    }
    bus = reference.bus.model_copy(update={"sync_period_s": sync_period_s})
    if address is not None:
        bus = bus.model_copy(update={"address": str(address)})
    return reference.model_copy(update={"axis": axes, "bus": bus, "settle_s": 0.05})


def swing(count: int, period_s: float, duration_s: float) -> Motion:
    """All axes to and fro, beginning and ending at rest."""
    times = np.arange(round(duration_s / period_s) + 1) * period_s
    ramp = np.minimum(1.0, np.minimum(times, times[-1] - times) / 0.35)
    angle = AMPLITUDE_REV * TURN * np.sin(TURN * FREQUENCY_HZ * times) * ramp * ramp * (3.0 - 2.0 * ramp)
    return Motion(tuple(numbers(count)), times, np.repeat(angle[:, np.newaxis], count, axis=1), starts_at_home=False)


Loop = Literal["drive", "host"]
