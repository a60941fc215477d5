"""Encoders on the joints: checks, and the tip's acceleration from them.

An encoder on a joint measures the joint's angle, without the bending of links and tool behind it. On an arm every joint swings,
also one whose motor is braked, so all encoders are recorded: the kinematics has the tip from the angles of all of them.

A lost answer is not a measurement: its angle is NaN in the recording. For the tip, a cubic spline through the joint's angle less
that of the motor bridges a short gap, which counts among the missed cycles; a run with a long gap is not judged.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
import scipy

from hil.arm.kinematics import Kinematics
from hil.bench.bench import Bench, with_levers
from hil.bench.tip import NO_ANGLES, joint_angles
from hil.control.arrays import Real
from hil.errors import NotPossibleError
from hil.recording import TIP, Recording

LOWPASS_HZ = 60.0
"""Highest frequency of an acceleration from angles: above it, steps of 20 bits are larger than any arm's vibration."""
LOWPASS_FRACTION = 0.2
"""Highest part of the sampling rate."""
LOWPASS_ORDER = 8

LEAST_TRAVEL_RAD, LEAST_TRAVEL_COUNTS = 2e-3, 50
"""Turn of a joint from which it is seen how its encoder counts."""
COUNTING_TOLERANCE = 0.01
WIND_UP_RAD = 2e-3
"""Turn that wind-up, transmission error and the encoder's own error may add to any travel: seven arc minutes."""

LONGEST_GAP_ROWS = 3
"""Answers of an encoder in a row that may be lost; by default a run stops if so many of a drive are missing (`missing_limit`)."""
LEAST_KNOWN_ROWS = 4
"""Rows from which a cubic spline bridges a gap."""


def watched_axes(bench: Bench, moved: Collection[int]) -> tuple[int, ...]:
    """Return the axes that do not move, but are recorded."""
    if bench.arm is None or not bench.accelerometer.from_load_encoders:
        return ()
    return tuple(number for number in sorted(bench.axis) if number not in moved)


def with_load_encoders(bench: Bench, recording: Recording, standing_rad: Mapping[int, float] = NO_ANGLES) -> Recording:
    """Check a recording's load encoders against the motors.

    Return it; without a sensor, with the tip from the encoders. `standing_rad` has the motor angles of axes that did not move;
    those that are not given are at home.

    Raises:
        NotPossibleError: An encoder counts the wrong way, or has another scale than in the bench file.
    """
    for number in recording.axes:
        if f"axis{number}_load_rad" in recording.columns:
            check_counting(bench, recording, number)
    if not bench.accelerometer.from_load_encoders or len(recording.time_s) < 2:
        return recording
    angles, doubt = bridged(recording)
    if angles is None:
        return replace(recording, doubt=doubt)
    tip = tip_of_joints(bench, recording, angles, standing_rad)
    return Recording(recording.columns | dict(zip(TIP, tip.T, strict=True)), doubt or recording.doubt)


def bridged(recording: Recording) -> tuple[dict[int, Real] | None, str | None]:
    """Return gapless angles of all encoders, and a doubt.

    By axis, each of shape (n,); the doubt is the reason not to trust them, or None. None instead of the angles if an encoder has
    hardly answered at all. A gap is bridged in the joint's angle less that of its motor through the gear, if the motor moved; at
    the ends the nearest value is used.
    """
    angles, doubt = {}, None
    for name, values in recording.columns.items():
        if not name.endswith("_load_rad"):
            continue
        number, known = int(name.removeprefix("axis").removesuffix("_load_rad")), np.isfinite(values)
        angles[number] = values
        if np.all(known):
            continue
        if np.count_nonzero(known) < LEAST_KNOWN_ROWS:
            return None, f"the second encoder of axis {number} has not answered: check its cable and supply"
        rows, at = np.arange(len(values)), np.flatnonzero(known)
        longest = int(np.max(np.diff(np.concatenate([[-1], at, [len(values)]])))) - 1
        if longest > LONGEST_GAP_ROWS:
            doubt = (
                f"the second encoder of axis {number} did not answer in {longest} cycles in a row; at most {LONGEST_GAP_ROWS} "
                f"are allowed"
            )
        beside = np.zeros(len(values))
        if number in recording.axes:
            motor = recording.axis(number, "position_rad")
            moved = motor - np.mean(motor)
            beside = moved * float(moved[known] @ (values[known] - np.mean(values[known]))) / max(float(moved @ moved), 1e-300)
        spline = scipy.interpolate.CubicSpline(at, (values - beside)[known])
        angles[number] = np.where(known, values, beside + spline(np.clip(rows, at[0], at[-1])))
    return angles, doubt


def by_load_encoders(bench: Bench, axes: Collection[int]) -> Bench:
    """Return a bench with the tip from the joints' encoders.

    Raises:
        NotPossibleError: An axis has no load_encoder table; of an arm, any axis.
    """
    for number in axes if bench.arm is None else bench.axis:
        if number in bench.axis and bench.axis[number].load_encoder is None:
            why = "" if number in axes else ", and on an arm every joint vibrates"
            raise NotPossibleError(
                f"axis {number} has no second encoder{why}; state [axis.{number}.load_encoder] in the bench file"
            )
    sensor = bench.accelerometer.model_copy(
        update={"node_id": None, "serial": None, "range_m_s2": None, "mounting": None, "from_load_encoders": True}
    )
    found = bench.model_copy(update={"accelerometer": sensor})
    return found if found.arm is None else with_levers(found, found.arm)  # a mounted sensor is elsewhere than the tip


def check_counting(bench: Bench, recording: Recording, number: int) -> None:
    """Refuse an encoder whose angle contradicts that of the motor.

    Raises:
        NotPossibleError: It counts the wrong way, or another turn; the message has the numbers.
    """
    table = bench.axis[number]
    encoder = table.load_encoder
    if encoder is None:
        return
    joint, load = recording.axis(number, "position_rad") / table.reduction_ratio, recording.axis(number, "load_rad")
    travel = float(np.ptp(joint)) if len(joint) else 0.0
    if travel < max(LEAST_TRAVEL_RAD, LEAST_TRAVEL_COUNTS * abs(encoder.rad_per_count)):
        return
    known = np.isfinite(load)
    if np.count_nonzero(known) < LEAST_KNOWN_ROWS:
        return
    centred = joint[known] - np.mean(joint[known])
    scale = float(centred @ (load[known] - np.mean(load[known])) / (centred @ centred))
    tolerance = COUNTING_TOLERANCE + WIND_UP_RAD / travel
    if abs(scale - 1.0) <= tolerance:
        return
    seen = (
        f"axis {number}: the load encoder turned {scale:.4g} times as far as motor angle / reduction_ratio "
        f"{table.reduction_ratio:g} ({math.degrees(travel):.2f}° of travel)"
    )
    if abs(scale + 1.0) <= tolerance:
        raise NotPossibleError(
            f"{seen}: it counts the wrong way; state load_encoder.is_reversed = {str(not encoder.is_reversed).lower()}"
        )
    if abs(scale) <= tolerance:
        raise NotPossibleError(f"{seen}: it does not move; load_encoder.object may be that of another joint, or of none")
    raise NotPossibleError(
        f"{seen}; correct reduction_ratio to {table.reduction_ratio / abs(scale):.4g}, "
        f"or load_encoder.counts_per_rev from {encoder.counts_per_rev} to {encoder.counts_per_rev * abs(scale):.0f}"
    )


def tip_of_joints(
    bench: Bench, recording: Recording, angles: Mapping[int, Real], standing_rad: Mapping[int, float] = NO_ANGLES
) -> Real:
    """Compute the tip's acceleration from the joints' encoders.

    Along x, y and z in m/s²; shape (n, 3). On an arm, the links have the tip from all joints. Without one, an axis that moves
    alone moves it by its lever, and several axes move it as the planar chain of the geometry. Angles of the encoders have no
    gaps; each of shape (n,). `standing_rad` has the motor angles of axes that did not move, on a bench with an arm.
    """
    axes, period_s = recording.axes, recording.period_s
    tip = np.zeros((len(recording.time_s), 3))
    if bench.arm is not None:
        first = joint_angles(bench, recording, standing_rad)[0]  # an encoder counts from anywhere, the motor from home
        joints = np.tile(first, (len(tip), 1))
        for number, angle in angles.items():
            joints[:, bench.arm.axes.index(number)] += angle - angle[0]
        points, _ = Kinematics.of(bench.arm).pose(joints)
        return np.stack([second_derivative(way, period_s) for way in np.asarray(points).T], axis=1)
    if len(axes) == 1 or bench.geometry is None or bench.line_motion is None:
        for number in axes:
            tip[:, 2] += bench.axis[number].tip_lever_m * second_derivative(angles[number], period_s)
        return tip
    chain, start = bench.geometry.chain(), bench.line_motion.start_m
    joints = np.tile(chain.joints(np.array([start.x, start.z])), (len(tip), 1))
    for column, number in enumerate(bench.geometry.axes):
        if number in angles:
            motor = recording.axis(number, "position_rad")[0] / bench.axis[number].reduction_ratio
            joints[:, column] += angles[number] - angles[number][0] + motor
    points = chain.tip(joints)
    tip[:, 0], tip[:, 2] = (second_derivative(way, period_s) for way in points.T)
    return tip


def second_derivative(values: Real, period_s: float) -> Real:
    """Compute the second derivative of evenly sampled values; shape (n,).

    Without delay, up to `LOWPASS_HZ`. The values are continued oddly about both ends, where a motion rests, and −(2π f)²/(1
    + (f/f_c)⁸) is applied to their spectrum. In the band it is as exact as the samples are; differences of neighbouring
    samples lose a tenth at a tenth of the sampling rate.

    >>> import numpy as np
    >>> t = 0.002 * np.arange(1000)
    >>> bell = np.exp(-((t - 1.0) / 0.05) ** 2)
    >>> exact = (4.0 * (t - 1.0) ** 2 / 0.05**4 - 2.0 / 0.05**2) * bell
    >>> bool(np.max(np.abs(second_derivative(bell, 0.002) - exact)) < 1e-3 * np.max(np.abs(exact)))
    True
    """
    line = np.linspace(values[0], values[-1], len(values))
    rest = values - line  # both ends 0, so that the continuation has no jump
    whole = np.concatenate([rest, -rest[-2:0:-1]])
    frequency = np.fft.rfftfreq(len(whole), period_s)
    corner = min(LOWPASS_HZ, LOWPASS_FRACTION / period_s)
    gain = -((2.0 * math.pi * frequency) ** 2) / (1.0 + (frequency / corner) ** LOWPASS_ORDER)
    return np.asarray(np.fft.irfft(gain * np.fft.rfft(whole), len(whole))[: len(values)])
