"""The paper's two motions as the bench file describes them: constant acceleration of one axis, and the line of the tip."""

import numpy as np

from hil.bench.bench import Bench
from hil.control.trajectory import sample_times
from hil.errors import NotPossibleError
from hil.master.motion import Motion

CONSTANT_ACCELERATION, LINE_MOTION = "constant-acceleration", "line-motion"


def constant_acceleration(bench: Bench, axis: int, period_s: float) -> Motion:
    """One motor through the resonant speeds and back to rest, from its present position (the paper, sections 3.2 and 5.1).

    Raises:
        NotPossibleError: The bench file has no such motion or axis.
    """
    table = bench.constant_acceleration
    if table is None:
        raise NotPossibleError(f"bench {bench.name!r} has no constant_acceleration table")
    if axis not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {axis}; it has {', '.join(map(str, bench.axis))}")
    trajectory = table.trajectory()
    times = sample_times(trajectory.duration_s, period_s)
    return Motion((axis,), times, trajectory.motor_angle(times)[:, np.newaxis], starts_at_home=False)


def line_motion(bench: Bench, period_s: float) -> Motion:
    """The tip along a straight line by the axes of the geometry (the paper, section 5.2).

    Raises:
        NotPossibleError: The bench file has no such motion.
        UnreachableError: The line leaves the arm's reach.
    """
    if bench.line_motion is None or bench.geometry is None:
        missing = [name for name in ("geometry", "line_motion") if getattr(bench, name) is None]
        raise NotPossibleError(
            f"bench {bench.name!r} has no {' and no '.join(missing)} table: a line needs the lengths of the arm, with "
            "axes = [shoulder, elbow, wrist], and its ends"
        )
    line = bench.line_motion.line(bench.geometry.chain())
    times = sample_times(line.duration_s, period_s)
    joints = line.joints(times)
    ratios = np.array([bench.axis[number].reduction_ratio for number in bench.chain_axes])
    return Motion(bench.chain_axes, times, (joints - joints[0]) * ratios, starts_at_home=True)
