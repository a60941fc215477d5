"""Ramps from which the transmission error is identified.

One ramp goes forwards, one back, within the bench file's limits.

On an arm a ramp turns the joint by no more than `identification_travel_deg` to either side, since further on it rings at other
frequencies; it accelerates as fast as that takes, and ends where it began.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import AxisTable, Bench
from hil.control.trajectory import ConstantAcceleration, Smooth, sample_times
from hil.errors import NotPossibleError
from hil.master.motion import Motion
from hil.master.run import APPROACH_RAMP_S

Real = NDArray[np.float64]

BEYOND_RESONANCE = 1.15
"""Least end speed of a ramp over f_m2: the vibration has its largest amplitude behind the resonance."""
END_OVER_RESONANCE = 1.35
"""End speed of a ramp over f_m2 where f_a is known: a faster ramp gives no more information."""
MARGIN_REV = 0.5
"""Distance of a ramp from the bench file's position limits: a motor lags its set-point, 0.4 rev at 10 rps and K_pp = 25/s."""
FIRST_ORDER_END, PASSED = 1.2, 1.08
"""End speed of a ramp over f_a where order 1 is to pass the resonance as well, and the least with which it does."""
ACCELERATION_RPS_S, ACCELERATION_AT_HZ = 4.0, 12.0
"""Acceleration of a first pass, and the arm's frequency for which it is meant; it goes with the square of the frequency."""
SLOWEST_RPS_S = 0.3
ARM_HURRY = 2.0
"""Acceleration over that of a first pass up to which a ramp on an arm goes on to a lower order: others show less on it."""
DEFAULT_END_RPS, DEFAULT_DECELERATION_RPS_S = 10.0, 20.0
LEAST_END_RPS = 1.0
SPEED_FRACTION = 0.95
"""Fraction of the speed limit that a ramp uses."""
DWELL_S, TAIL_S = 0.3, 0.5


@dataclass(frozen=True)
class Ramps:
    """One pass: a ramp in either direction.

    Attributes:
        trajectory: The ramp forwards.
        motion: Motion of the robot, the approach to the ramp's beginning included.
        forward: Rows of the ramp forwards.
        backward: Rows of the ramp back.
        low_rev: Lower turning point of the motor, absolute.
        high_rev: Upper turning point of the motor, absolute.
    """

    trajectory: ConstantAcceleration
    motion: Motion
    forward: slice
    backward: slice
    low_rev: float
    high_rev: float

    def direction(self, skip: float = 0.0) -> NDArray[np.int8]:
        """Direction of each row of a rising speed; shape (n,).

        It is +1 and −1 in the rows of the ramps without their first fraction `skip`, else 0.
        """
        signs = np.zeros(len(self.motion.time_s), dtype=np.int8)
        period, ramp = self.motion.period_s, self.trajectory.ramp_s
        for rows, sign in ((self.forward, 1), (self.backward, -1)):
            time = np.arange(rows.stop - rows.start) * period - self.trajectory.dwell_s
            signs[rows] = sign * ((time >= skip * ramp) & (time <= ramp))
        return signs


def travel_rev(acceleration_rps_s: float, deceleration_rps_s: float, end_rps: float) -> float:
    """Motor revolutions of a ramp: v²/2 (1/a + 1/d)."""
    return 0.5 * end_rps**2 * (1.0 / acceleration_rps_s + 1.0 / deceleration_rps_s)


def room_rev(bench: Bench, axis: int) -> float:
    """Motor revolutions that a ramp may take.

    They lie between the position limits and within the travel of an arm's joint.
    """
    return min(_between_limits_rev(bench.axis[axis]), bench.travel_rev(axis))


def _between_limits_rev(table: AxisTable) -> float:
    return table.limits.position_max_rev - table.limits.position_min_rev - 2.0 * MARGIN_REV


def _is_held_by_arm(bench: Bench, axis: int) -> bool:
    """True if the arm's joint limits a ramp more than the axis.

    The travel of the joint then leaves less room than the position limits.
    """
    return bench.travel_rev(axis) < _between_limits_rev(bench.axis[axis])


def room_words(bench: Bench, axis: int) -> str:
    """Describe the room of a ramp and its limit."""
    what = f"±{bench.travel_deg:g}° of the joint leave" if _is_held_by_arm(bench, axis) else "the position limits leave"
    return f"{what} {room_rev(bench, axis):.1f}"


def binding_limit(bench: Bench, axis: int, acceleration_rps_s: float, end_rps: float) -> str:
    """Name the limit that a ramp uses up; empty if none.

    Args:
        bench: The bench file.
        axis: Axis number.
        acceleration_rps_s: Acceleration of the ramp.
        end_rps: Speed at its end.
    """
    if end_rps >= 0.99 * SPEED_FRACTION * bench.axis[axis].limits.speed_rps:
        return f"its speed limit, {bench.axis[axis].limits.speed_rps:g} rev/s"
    if travel_rev(acceleration_rps_s, deceleration(bench), end_rps) < 0.99 * room_rev(bench, axis):
        return ""
    if _is_held_by_arm(bench, axis):
        return f"the travel of the arm's joint, ±{bench.travel_deg:g}° (identification_travel_deg)"
    return "its position limits"


def binding_limit_of(bench: Bench, axis: int, motion: Ramps) -> str:
    """Name the limit that a pass uses up.

    The words end a sentence; they are empty if no limit is used up.
    """
    bound = binding_limit(bench, axis, motion.trajectory.acceleration_rps_s, motion.trajectory.end_rps)
    return f"; the limit is {bound}" if bound else ""


def slowest(bench: Bench, axis: int, end_rps: float) -> float:
    """Smallest acceleration in rps/s with room for a ramp.

    The ramp ends at `end_rps`; infinite if not even the braking has room.
    """
    left = 2.0 * room_rev(bench, axis) / end_rps**2 - 1.0 / deceleration(bench)
    return 1.0 / left if left > 0.0 else math.inf


def acceleration_for(bench: Bench, arm_hz: float | None) -> float:
    """Acceleration of a first pass in rev/s².

    It gives the same number of periods in the resonance at any f_a; without an f_a it is 4.

    It is no larger than the deceleration with which every ramp ends.
    """
    if arm_hz is None:
        return ACCELERATION_RPS_S
    wanted = ACCELERATION_RPS_S * (arm_hz / ACCELERATION_AT_HZ) ** 2
    return min(max(wanted, SLOWEST_RPS_S), deceleration(bench))


def with_room(bench: Bench, axis: int, acceleration_rps_s: float, end_rps: float) -> float:
    """Raise an acceleration until the ramp has room.

    It is raised no further than the deceleration.

    Args:
        bench: The bench file.
        axis: Axis number.
        acceleration_rps_s: Acceleration that is wanted.
        end_rps: Speed at the ramp's end.
    """
    least = 1.001 * slowest(bench, axis, end_rps)
    return max(acceleration_rps_s, min(least, deceleration(bench)))


def unknown_end(bench: Bench, axis: int) -> float:
    """End speed of a ramp on an arm without known resonance.

    It passes f_m2 of a resonance at `ACCELERATION_AT_HZ`.

    Args:
        bench: The bench file.
        axis: Axis number.
    """
    return min(END_OVER_RESONANCE * ACCELERATION_AT_HZ / 2.0, SPEED_FRACTION * bench.axis[axis].limits.speed_rps)


def further_end(bench: Bench, axis: int, arm_hz: float, order: float) -> float | None:
    """End speed at which a low order passes the resonance, or None.

    It is None if speed limit or travel do not allow it.

    Args:
        bench: The bench file.
        axis: Axis number.
        arm_hz: f_a.
        order: The order.
    """
    end = min(FIRST_ORDER_END * arm_hz / order, SPEED_FRACTION * bench.axis[axis].limits.speed_rps)
    fastest = deceleration(bench) if bench.arm is None else ARM_HURRY * acceleration_for(bench, arm_hz)
    has_room = slowest(bench, axis, end) < fastest
    return end if has_room and end >= PASSED * arm_hz / order else None


def deceleration(bench: Bench) -> float:
    """Deceleration at the end of a ramp, rev/s²."""
    table = bench.constant_acceleration
    return DEFAULT_DECELERATION_RPS_S if table is None else table.deceleration_rps_s


def end_speed(bench: Bench, axis: int, acceleration_rps_s: float, arm_hz: float | None) -> float:
    """Choose the end speed of a ramp in rev/s.

    It lies beyond f_m2 = f_a/2 if f_a is known, else as far as the limits allow.

    Args:
        bench: The bench file.
        axis: Axis number.
        acceleration_rps_s: Acceleration of the ramp.
        arm_hz: f_a; None if it is not known.

    Raises:
        NotPossibleError: Limits keep it from passing f_m2; with the number needed.
    """
    table = bench.axis[axis]
    if not math.isfinite(acceleration_rps_s) or acceleration_rps_s <= 0.0:
        raise NotPossibleError(f"an acceleration of {acceleration_rps_s:g} rev/s² makes no ramp; it must be above 0")
    motion = bench.constant_acceleration
    # the end speed of that other experiment is no limit
    wanted = max(DEFAULT_END_RPS, 0.0 if motion is None else motion.end_rps)
    if arm_hz is not None:
        wanted = END_OVER_RESONANCE * arm_hz / 2.0
    room, braking = max(room_rev(bench, axis), 0.0), deceleration(bench)
    by_room = math.sqrt(2.0 * room / (1.0 / acceleration_rps_s + 1.0 / braking))
    reached = min(wanted, SPEED_FRACTION * table.limits.speed_rps, by_room)
    if arm_hz is not None and reached < BEYOND_RESONANCE * arm_hz / 2.0:
        raise NotPossibleError(too_short(bench, axis, acceleration_rps_s, arm_hz, reached), ("limits",))
    if reached < 0.5:
        wider = "a wider identification_travel_deg is" if _is_held_by_arm(bench, axis) else "wider position limits are"
        raise NotPossibleError(
            f"axis {axis} has {room:.2f} rev of travel and reaches {reached:.2f} rev/s at {acceleration_rps_s:g} "
            f"rev/s²; at least 0.5 rev/s is needed: {wider} needed",
            ("limits",),
        )
    return reached


def furthest_end(bench: Bench, axis: int, acceleration_rps_s: float, arm_hz: float | None) -> float:
    """End speed of `end_speed`, or as near to it as possible.

    The limits may keep the ramp from passing f_m2.

    Args:
        bench: The bench file.
        axis: Axis number.
        acceleration_rps_s: Acceleration of the ramp.
        arm_hz: f_a; None if it is not known.

    Raises:
        NotPossibleError: There is no room for any ramp.
    """
    if bench.arm is not None:
        end_rps = unknown_end(bench, axis) if arm_hz is None else END_OVER_RESONANCE * arm_hz / 2.0
        acceleration_rps_s = with_room(bench, axis, acceleration_rps_s, end_rps)
    reached = end_speed(bench, axis, acceleration_rps_s, None)
    if arm_hz is None:
        return reached
    room = max(room_rev(bench, axis), 0.0)
    by_room = math.sqrt(2.0 * room / (1.0 / acceleration_rps_s + 1.0 / deceleration(bench)))
    wanted = max(END_OVER_RESONANCE * arm_hz / 2.0, LEAST_END_RPS)
    return min(wanted, SPEED_FRACTION * bench.axis[axis].limits.speed_rps, by_room)


def too_short(bench: Bench, axis: int, acceleration_rps_s: float, arm_hz: float, reached_rps: float) -> str:
    """Describe why f_m2 is not passed and what is needed.

    Args:
        bench: The bench file.
        axis: Axis number.
        acceleration_rps_s: Acceleration of the ramp.
        arm_hz: f_a.
        reached_rps: Speed that the ramp reaches.
    """
    table, needed = bench.axis[axis], BEYOND_RESONANCE * arm_hz / 2.0
    head = f"axis {axis} reaches {reached_rps:.2f} rev/s; to pass f_m2 = {arm_hz / 2.0:.2f} rev/s, {needed:.2f} rev/s are needed"
    if SPEED_FRACTION * table.limits.speed_rps < needed:
        return f"{head}: its limit speed_rps is {table.limits.speed_rps:g}; at least {needed / SPEED_FRACTION:.2f} is needed"
    room, taken = room_rev(bench, axis), travel_rev(acceleration_rps_s, deceleration(bench), needed)
    if taken <= room:
        return f"{head}: at {acceleration_rps_s:g} rev/s² there is room for that, so the motor did not follow its set-points"
    least = slowest(bench, axis, needed)
    remedy = f"accelerate with {least:.2f} rev/s² or more, or " if least < 50.0 else ""
    taken_at = f"{taken:.1f} rev at {acceleration_rps_s:g} rev/s²"
    if _is_held_by_arm(bench, axis):
        within = f"within ±{bench.travel_deg:g}° of the joint"
        return f"{head}: that takes {taken_at}; {within} there are {room:.1f} rev; {remedy}raise identification_travel_deg"
    return f"{head}: that takes {taken_at}; between its position limits there are {room:.1f} rev; {remedy}widen them"


def ramps(bench: Bench, axis: int, start_rev: float, acceleration_rps_s: float, end_rps: float, period_s: float) -> Ramps:
    """Plan one pass from the present position.

    The motor moves to the ramp's beginning, then forwards and back. The ramp is centred at the present position as far as the
    limits allow.

    On an arm it ends where it began, so that the next one, and those of other axes, find it in the same posture.

    Args:
        bench: The bench.
        axis: Axis number.
        start_rev: Present position of its motor, rev.
        acceleration_rps_s: Acceleration of the ramp.
        end_rps: Speed at its end.
        period_s: SYNC period.

    Raises:
        NotPossibleError: The ramp has no room.
    """
    table = bench.axis[axis]
    trajectory = ConstantAcceleration(acceleration_rps_s, end_rps, deceleration(bench), DWELL_S, TAIL_S)
    travel = travel_rev(acceleration_rps_s, trajectory.deceleration_rps_s, end_rps)
    room = room_rev(bench, axis)
    if travel > room + 1e-6:
        raise NotPossibleError(
            f"a ramp to {end_rps:.2f} rev/s at {acceleration_rps_s:g} rev/s² takes {travel:.1f} rev; axis {axis} "
            f"has {room:.1f} rev of travel",
            ("limits",),
        )
    lowest = table.limits.position_min_rev + MARGIN_REV
    low = min(max(start_rev - 0.5 * travel, lowest), table.limits.position_max_rev - MARGIN_REV - travel)
    turn = 2.0 * math.pi
    away = turn * (low - start_rev)
    there = _approach(away, bench.approach_rps, table.limits.acceleration_rps_s, period_s)
    up = trajectory.motor_angle(sample_times(trajectory.duration_s, period_s))
    home = away - there[1:] if bench.arm is not None else np.zeros(0)
    angle = np.concatenate([there, away + up, away + up[-1] - up, home])
    first, second = len(there), len(there) + len(up)
    times = np.arange(len(angle), dtype=np.float64) * period_s
    motion = Motion((axis,), times, angle[:, np.newaxis], starts_at_home=False)
    return Ramps(trajectory, motion, slice(first, second), slice(second, second + len(up)), low, low + travel)


def _approach(away_rad: float, speed_rps: float, most_rps_s: float | None, period_s: float) -> Real:
    distance = abs(away_rad) / (2.0 * math.pi)
    if distance < 1e-3:
        return np.full(1, away_rad)
    smooth = Smooth.way(distance, speed_rps, APPROACH_RAMP_S, most_rps_s)
    return np.asarray(away_rad * smooth.position(sample_times(smooth.duration_s, period_s)))
