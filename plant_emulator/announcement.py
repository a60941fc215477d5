"""Announcement of a served robot at its start."""

from collections.abc import Iterator

from drive_profiles.standard.shown import spans
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World

FEW = 8
"""Axes that are named one by one."""


def announced(robot: Robot, world: World, address: str) -> Iterator[str]:
    """Yield the lines of the announcement."""
    nodes = robot.node_ids
    drives = [f"axis {axis} at {node_name(robot, node)}" for axis, node in nodes.items()]
    if len(drives) > FEW:
        drives = [f"{len(nodes)} axes at nodes {spans(nodes.values())}"]
    sensor = node_name(robot, robot.accelerometer.node_id)
    yield f"serving {robot.name} on {address}: {', '.join(drives)}, accelerometer at {sensor}"
    kinds: dict[tuple[str, ...], list[int]] = {}
    for axis, node in nodes.items():
        family = world.drives[axis].family
        words = (family.profile, *family.notes, *unusual(robot.axis[axis].behaviour))
        kinds.setdefault(words if len(nodes) > FEW else (*words, str(node)), []).append(node)
    for words, held in kinds.items():
        name, *notes = words if len(nodes) > FEW else words[:-1]
        yield f"node{'s' if len(held) > 1 else ''} {spans(held)}: {name}"
        for note in notes:
            yield f"  {note}"


def node_name(robot: Robot, node: int) -> str:
    """Return a node's name, with a note if it has no node-ID."""
    return f"node {node} (without a node-ID: LSS)" if node in robot.unconfigured else f"node {node}"


def unusual(behaviour: Behaviour) -> Iterator[str]:
    """Yield the robot file's deviations from ideal drive behaviour."""
    if behaviour.given:
        yield "behaviour: " + ", ".join(f"{key} = {str(value).lower()}" for key, value in behaviour.given.items())
