"""Part of a robot: some of its axes alone."""

from collections.abc import Collection

from plant_emulator.robots.robot import Robot


def part_of(robot: Robot, axes: Collection[int]) -> Robot:
    """Return a robot with some axes alone.

    Without all axes of its geometry it has no line motion.

    Raises:
        ValueError: Its links couple the axes.
    """
    if robot.links is not None and set(axes) != robot.axis.keys():
        raise ValueError("the links of this robot couple all axes, so they cannot be served one by one; leave --axis out")
    changes: dict[str, object] = {"axis": {number: table for number, table in robot.axis.items() if number in axes}}
    if not set(robot.chain_axes) <= set(axes):
        changes |= {"geometry": None, "line_motion": None}
    return robot.model_copy(update=changes)
