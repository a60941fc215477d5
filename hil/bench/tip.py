"""The tip's acceleration from the bench's sensor.

In the base frame, and along the lever of an axis that moves alone. Without an arm in the bench file a recording is left
unchanged.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from hil.arm.kinematics import Kinematics, LinkFrame
from hil.arm.mounting import along_lever, in_base
from hil.bench.bench import LEAST_LEVER_M, Bench
from hil.control.arrays import Real
from hil.recording import ALONG, SENSED, TIP, Recording

AT_RANGE = 0.998
"""Fraction of its range from which a sensor counts as saturated: a step of its resolution below."""
MOST_SATURATED_ROWS = 4
"""Number of rows that it may be there."""
STANDSTILL_RAD, STANDSTILL_ROWS = 1e-5, 20
"""Turn of a joint up to which nothing moves, and rows at the beginning that tell where a sensor's weight is."""
MOST_ASKEW_RAD = math.radians(10.0)
"""Angle by which a sensor's weight may be elsewhere: more than any glue, gear or drawing is askew."""

NO_ANGLES: Mapping[int, float] = MappingProxyType({})


def sensor_frame(bench: Bench, arm: Kinematics) -> LinkFrame:
    """Return place and axes of the bench's sensor."""
    mounting = bench.accelerometer.mounting
    return arm.tip if mounting is None or bench.arm is None else mounting.frame(bench.arm)


def joint_angles(bench: Bench, recording: Recording, standing_rad: Mapping[int, float] = NO_ANGLES) -> Real:
    """Angles of all joints of the bench's arm; shape (n, joints).

    `standing_rad` has the motor angles of axes that were not recorded; an axis that is in neither is at home.

    Raises:
        ValueError: The bench has no arm.
    """
    if bench.arm is None:
        raise ValueError(f"bench {bench.name!r} has no arm")
    angles = np.tile(bench.arm.home_rad(), (len(recording.time_s), 1))
    for number, table in bench.axis.items():
        is_recorded = number in recording.axes
        angle_rad = recording.axis(number, "position_rad") if is_recorded else np.asarray(standing_rad.get(number, 0.0))
        angles[:, bench.arm.axes.index(number)] += angle_rad / table.reduction_ratio
    return angles


def with_tip(bench: Bench, recording: Recording, standing_rad: Mapping[int, float] = NO_ANGLES) -> Recording:
    """Return a recording with the tip's acceleration in the base frame.

    The kinematics of the bench's arm gives it. The signals of a mounted sensor along its own axes are kept in columns of their
    own. If one axis moves alone, a further column has the acceleration along its lever, in proportion to the lever at home: it
    is valid with the bench's lever, wherever the other axes are. `standing_rad` has the motor angles of axes that did not move;
    those that are not given are at home.
    """
    if bench.arm is None or not len(recording.time_s):
        return recording
    arm, angles, columns = Kinematics.of(bench.arm), joint_angles(bench, recording, standing_rad), dict(recording.columns)
    of, mounting = sensor_frame(bench, arm), bench.accelerometer.mounting
    felt = np.stack([columns[name] for name in TIP], axis=1)
    if mounting is not None:
        gravity = np.array(bench.arm.gravity_m_s2) * mounting.gravity
        columns |= {name: felt[:, i] for i, name in enumerate(SENSED)}
        felt = in_base(arm, of, angles, felt, gravity)
        columns |= {name: felt[:, i] for i, name in enumerate(TIP)}
    if len(recording.axes) == 1 and bench.axis[recording.axes[0]].tip_lever_m >= LEAST_LEVER_M:
        joint = bench.arm.axes.index(recording.axes[0])
        lever_m = float(np.linalg.norm(arm.jacobian(angles[0], of)[:3, joint]))
        if lever_m >= LEAST_LEVER_M:
            scale = bench.axis[recording.axes[0]].tip_lever_m / lever_m
            columns[ALONG] = scale * along_lever(arm, of, angles, joint, felt)
    doubt = recording.doubt
    return Recording(columns, doubt if doubt is not None or mounting is None else _doubt(bench, recording, angles, of, felt))


def _doubt(bench: Bench, recording: Recording, angles: Real, of: LinkFrame, acceleration_m_s2: Real) -> str | None:
    """Return a reason not to trust a mounted sensor, or None."""
    sensor, arm, mounting = bench.accelerometer, bench.arm, bench.accelerometer.mounting
    raw = np.stack([recording.columns[name] for name in TIP], axis=1)
    if sensor.range_m_s2 is not None:
        count = int(np.count_nonzero(np.any(np.abs(raw) >= AT_RANGE * sensor.range_m_s2, axis=1)))
        if count > MOST_SATURATED_ROWS:
            return (
                f"the accelerometer was at the end of its range of {sensor.range_m_s2:g} m/s² in {count} rows: move more slowly"
            )
    still = int(np.argmax(np.max(np.abs(angles - angles[0]), axis=1) > STANDSTILL_RAD)) or len(angles)
    if still < STANDSTILL_ROWS or arm is None or mounting is None:
        return None
    weight, found = np.array(arm.gravity_m_s2), float(np.linalg.norm(np.mean(raw[:still], axis=0)))
    expected = float(np.linalg.norm(weight))
    if mounting.gravity is not (found > 0.5 * expected) and expected > 0.0:
        shown = f"at rest the accelerometer shows {found:.2f} m/s²"
        return (
            f"{shown}, which is gravity; state gravity = true"
            if not mounting.gravity
            else f"{shown}, which is not gravity; check the sensor, or state gravity = false"
        )
    away = float(np.linalg.norm(np.mean(acceleration_m_s2[:still], axis=0)))
    if mounting.gravity and away > 2.0 * math.sin(0.5 * MOST_ASKEW_RAD) * expected:
        degrees, most = math.degrees(2.0 * math.asin(min(1.0, 0.5 * away / expected))), math.degrees(MOST_ASKEW_RAD)
        return (
            f"at rest the accelerometer shows gravity {degrees:.0f}° off its mounting; at most {most:g}° is allowed; check "
            "axis and rpy_deg of accelerometer.mounting, and home_deg of the arm"
        )
    return None


def vertical_levers_m(bench: Bench, recording: Recording) -> list[Real]:
    """Return the vertical lever of each axis that moved.

    It moves the sensor upwards, along the motion; one of shape (n,) for each axis.

    Raises:
        ValueError: The bench has no arm.
    """
    angles = joint_angles(bench, recording)
    assert bench.arm is not None  # noqa: S101 - or there were no angles
    arm = Kinematics.of(bench.arm)
    upwards = arm.jacobian(angles, sensor_frame(bench, arm))[:, 2]
    return [upwards[:, bench.arm.axes.index(number)] for number in recording.axes]
