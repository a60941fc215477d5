"""Waves of a motion's axes, for the fit of `effect`."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.analysis import BRAKING_S, TipScale, band_passed, line_window_s, motor_speed_rps
from hil.bench.bench import Bench
from hil.bench.model import Identified, identified_axis, with_identified
from hil.bench.tip import vertical_levers_m
from hil.control.arrays import Real, Rows
from hil.design.ate.model import Arm
from hil.design.estimation import DIFFERENCE_STEP
from hil.design.frequency import CONTROL_PERIOD_S
from hil.errors import NotPossibleError
from hil.experiments.cancellation.effect import AxisWaves, Part, Response
from hil.master.motion import Motion
from hil.recording import Recording
from hil.robot_tables import ORDERS, LineMotion
from hil.tip_vector import displacement_mm, steady_window_s, tip_acceleration

REACH = (0.45, 1.2)
"""Bound: frequencies that count as in the band, by its ends, where the band-pass lets 1.7 % and 25 % through: what is large shows
there, and so do sums of orders."""
SLOWEST = 0.05
"""Accuracy: motor speed below which nothing is read, in rev/s, as a fraction of f_al in Hz, since there the start's jerk is all
that rings: a factor of 2 changes 0.16, and no tip by 0.0002 mm."""
LEAST_REACH_S = 0.1
"""Bound: least time for which k f_m must lie in the band of the vibration: about the period of what swings there."""


def response_of(bench: Bench, identified: Identified | None, number: int) -> Response | None:
    """Response of an axis to its transmission error; None of an unknown arm."""
    error = identified_axis(identified, number).ate
    delay_s = 0.0 if error is None else error.accelerometer_delay_s
    loop = with_identified(bench, identified).axis[number].loop(CONTROL_PERIOD_S, with_notch=False)
    if loop is not None:
        return Response(loop, delay_s=delay_s)
    if error is None or error.arm_hz is None or error.damping is None:
        return None
    return Response(Arm(error.arm_hz, error.damping), delay_s=delay_s)


def waves_of(
    bench: Bench, responses: Mapping[int, Response], orders: Mapping[int, Collection[float]], motion: Motion, recording: Recording
) -> tuple[AxisWaves, ...]:
    """Waves of all axes of a motion with a known response.

    Orders that are usual are fitted though they are not cancelled, so that their vibration is not taken for another order's.
    """
    if len(motion.axes) > 1 and bench.arm is not None:
        levers = vertical_levers_m(bench, recording)
    else:
        levers = _levers(bench, motion, np.stack([recording.axis(number, "position_rad") for number in motion.axes], axis=1))
    made = []
    for column, number in enumerate(motion.axes):
        if number not in responses:
            continue
        table = bench.axis[number]
        planned = motion.motor_angle_rad[:, column] - motion.motor_angle_rad[0, column]
        rate = getattr(table.control, "position_gain_per_s", 0.0)
        planned = _late(planned, rate, motion.period_s) / table.reduction_ratio
        count = len(recording.time_s)
        planned = np.pad(planned[:count], (0, max(count - len(planned), 0)), mode="edge")
        fitted = tuple(sorted({*ORDERS, *orders.get(number, ())}))
        made.append(AxisWaves(number, fitted, levers[column], responses[number], planned))
    return tuple(made)


def _late(angle_rad: Real, gain_per_s: float, period_s: float) -> Real:
    """Pass a set-point through a position loop, if it has a gain."""
    if gain_per_s <= 0.0:
        return angle_rad
    blend = 1.0 - math.exp(-period_s * gain_per_s)
    return np.asarray(scipy.signal.lfilter([blend], [1.0, blend - 1.0], angle_rad))


def planned_levers(bench: Bench, motion: Motion) -> Real:
    """Lever of each axis along a planned motion without links; shape (n, axes)."""
    levers = _levers(bench, motion, motion.motor_angle_rad)
    return np.stack([np.broadcast_to(each, len(motion.time_s)) for each in levers], axis=1)


def _levers(bench: Bench, motion: Motion, angle_rad: Real) -> list[Real]:
    """Lever of each axis: the tip's distance, or ∂z/∂q along a chain's line.

    The shapes are () and (n,). Motor angles count from the beginning of the line; shape (n, axes).
    """
    if len(motion.axes) == 1 or bench.geometry is None or motion.axes != bench.chain_axes or bench.line_motion is None:
        return [np.asarray(bench.axis[number].tip_lever_m) for number in motion.axes]
    chain, turned_rad = bench.geometry.chain(), angle_rad / [bench.axis[number].reduction_ratio for number in motion.axes]
    joints, levers = bench.line_motion.line(chain).joints(np.zeros(1))[0] + turned_rad, []
    for column in range(len(motion.axes)):
        step = np.zeros(len(motion.axes))
        step[column] = DIFFERENCE_STEP
        levers.append((chain.tip(joints + step)[:, 1] - chain.tip(joints - step)[:, 1]) / (2.0 * DIFFERENCE_STEP))
    return levers


def seen_rows(bench: Bench, recording: Recording, f_al_hz: float) -> Rows:
    """Rows of a recording in which orders are read.

    f_al is the lowest of the axes that moved.

    Raises:
        NotPossibleError: The motion is too slow or too short to show anything.
    """
    speed = np.abs(motor_speed_rps(recording, recording.axes[0]))
    top = int(np.argmax(speed)) - round(BRAKING_S / recording.period_s)
    return _of_line(bench, recording, (speed >= SLOWEST * f_al_hz) & (np.arange(len(speed)) < top))


def judged_rows(bench: Bench, recording: Recording, scale: TipScale) -> Rows:
    """Rows of a recording in which vibration is compared.

    Raises:
        NotPossibleError: The motion does not pass such a speed.
    """
    speed = np.abs(motor_speed_rps(recording, recording.axes[0]))
    excites = [(speed >= low) & (speed <= high) for low, high in scale.windows_rps.values()]
    return _of_line(bench, recording, np.any(excites, axis=0))


def _of_line(bench: Bench, recording: Recording, of_axis: Rows) -> Rows:
    """The rows of a line's window, or those of a single axis."""
    if len(recording.axes) > 1 and bench.line_motion is not None:
        begin, end = (bench.line_motion.dwell_s + each for each in line_window_s(bench.line_motion.duration_s))
        return np.asarray((recording.time_s >= begin) & (recording.time_s <= end))
    excited_s = np.count_nonzero(of_axis) * recording.period_s
    if excited_s < LEAST_REACH_S:
        raise NotPossibleError(
            f"the motion excites the arm for {excited_s:.2g} s; at least {LEAST_REACH_S:g} s are needed to judge a cancellation"
        )
    return of_axis


def vibration_m_s2(recording: Recording, rows: Rows, scale: TipScale) -> float:
    """Root mean square of the tip's vertical acceleration in the band around f_al."""
    band = band_passed(recording.felt_m_s2, recording.period_s, scale.band_hz)
    return float(np.sqrt(np.mean(band[rows] ** 2)))


@dataclass(frozen=True)
class ProbedRows:
    """Tip's motion in the rows of every run of one motion.

    Settings are learnt from its acceleration, in which a sensor's noise is alike at all frequencies; a displacement would hardly
    show orders in the band's upper half. The displacement judges a run.

    Attributes:
        rows: The rows, in one piece.
    """

    band_hz: tuple[float, float]
    rows: slice

    @classmethod
    def of(cls, bench: Bench, recording: Recording, scale: TipScale) -> "ProbedRows":
        """The rows of a motion, from one recording of it.

        Raises:
            NotPossibleError: The motion does not excite the arm.
        """
        line = bench.line_motion
        if len(recording.axes) > 1 and line is not None and bench.arm is not None:
            return cls.of_line(line, recording, scale)
        return cls._of(seen_rows(bench, recording, scale.f_al_hz), scale)

    @classmethod
    def of_line(cls, line: LineMotion, recording: Recording, scale: TipScale) -> "ProbedRows":
        """The rows of an arm's line: those of its constant speed."""
        begin_s, end_s = (line.dwell_s + each for each in steady_window_s(line.duration_s, line.ramp_s))
        return cls._of((recording.time_s >= begin_s) & (recording.time_s <= end_s), scale)

    @classmethod
    def _of(cls, counts: NDArray[np.bool_], scale: TipScale) -> "ProbedRows":
        counted = np.flatnonzero(counts)
        return cls(scale.band_hz, slice(int(counted[0]), int(counted[-1]) + 1))

    def acceleration_m_s2(self, recording: Recording) -> Real:
        """Acceleration of the tip along x, y and z; shape (3, rows).

        Raises:
            ValueError: The sampling period is too long for the band.
        """
        felt = tip_acceleration(recording).T
        return np.stack([band_passed(each, recording.period_s, self.band_hz)[self.rows] for each in felt])

    def displacement_mm(self, recording: Recording) -> Real:
        """Displacement of the tip along x, y and z; shape (3, rows).

        Raises:
            ValueError: The sampling period is too long for the band.
        """
        moved = displacement_mm(tip_acceleration(recording), recording.period_s, self.band_hz)
        return np.asarray(moved[self.rows].T)

    def reached(self, bench: Bench, motion: Motion, orders: Sequence[float]) -> dict[Part, float]:
        """Time in s for which each order lies in the band."""
        found = {}
        for column, number in enumerate(motion.axes):
            turns = np.gradient(motion.motor_angle_rad[:, column], motion.period_s)[self.rows] / (2.0 * np.pi)
            for order in orders:
                frequency = order * np.abs(turns)
                inside = (frequency >= REACH[0] * self.band_hz[0]) & (frequency <= REACH[1] * self.band_hz[1])
                found[Part(number, order)] = motion.period_s * float(np.count_nonzero(inside))
        return found
