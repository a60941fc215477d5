"""Adaptive cancellation: an axis goes to and fro, and its transmission error is learnt from pass to pass, then frozen.

The first pass is without cancellation, the second with half of it, every later one with all of it. After each pass each order
of it is judged as in a trial (`verdict`), and one whose cancellation is wrong is left out from there on. And the fit is made anew
from all passes and from the motor angle as it was measured: it finds the transmission error itself, and not what the cancellation
leaves of it. Learning is between passes only: a cancellation that adapted during acceleration would follow the motion, not the
error. For the method see docs/cancellation.md.
"""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.analysis import motor_speed_rps
from hil.bench.bench import AxisTable, Bench
from hil.bench.model import Identified, IdentifiedError, significant, update_file
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.inverse import Actuation
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import check_moved, check_run
from hil.experiments.ate.identify import standard_errors, sweep_of
from hil.experiments.ate.motion import ACCELERATION_RPS_S, END_OVER_RESONANCE, Ramps, furthest_end, ramps
from hil.experiments.ate.order_scan import identify_orders, is_significant
from hil.experiments.ate.orders import OrderWatch, checked
from hil.experiments.ate.passes import PassKeeper, keep_nothing
from hil.experiments.cancellation.cancellation import Cancellation, cancellation_on, given_inertia
from hil.experiments.cancellation.pass_judge import PassJudge
from hil.experiments.cancellation.trial import CancellationRefusedError, judged_rows, part_entry, vibration_m_s2
from hil.experiments.cancellation.verdict import PartVerdict
from hil.experiments.judge import axis_scale, scale_at
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.learning import LearningPass, LearntAxis
from hil.robot_tables import ORDERS, TransmissionErrorTable, amplitude_key, phase_key

Real = NDArray[np.float64]

PASSES = 5
SECOND_GAIN = 0.5
LEAST_DELAY_S = 1e-4
"""Least delay of the motor that is not the gear's effect on it: 0.03 ms on the reference robot, and 0.4° at 12 Hz."""
LOWEST = 2.0
"""Order whose resonance every ramp passes; a lower one's where the limits allow."""
EDGE_S = 0.3
"""Beginning and end of a ramp that say nothing on how the motor follows: there the motion itself is in the band."""


@dataclass(frozen=True)
class LearntPass:
    """One pass and the estimate after it.

    Attributes:
        gain: Fraction of the cancellation that acted.
        vibration_m_s2: Vibration of the tip, both ramps, in the band around f_al, at the speeds that excite the arm.
        estimate: Estimate from all passes so far.
        set_point_delay_s: Delay of the set-points as estimated after this pass.
        following: Motor's motion over the intended one, after a pass with the whole cancellation; 1 where the motor follows.
        verdicts: Verdict on each order that was cancelled in it.
    """

    gain: float
    vibration_m_s2: float
    estimate: JointEstimate
    set_point_delay_s: float
    following: float | None
    verdicts: tuple[PartVerdict, ...] = ()

    def entry(self) -> LearningPass:
        """The pass as a result file has it."""
        error = self.estimate.error
        return LearningPass(
            gain=self.gain,
            vibration_m_s2=self.vibration_m_s2,
            set_point_delay_s=self.set_point_delay_s,
            following=self.following,
            values=TransmissionErrorTable.of(error.amplitude_arcsec, error.phase_deg),
            parts=tuple(part_entry(verdict) for verdict in self.verdicts),
        )


@dataclass
class AxisLearning:
    """Passes of one axis, and the transmission error learnt from them.

    Attributes:
        axis: Axis number.
        passes: Passes in their order.
        emulated: True where the robot is emulated; None where that is not known.
        motor_inertia_kg_m2: J_m as it was given, where no plant is known.
        left_out: Orders that are not cancelled, with the verdicts on them.
        notes: Sentences for the engineer.
    """

    axis: int
    passes: list[LearntPass] = field(default_factory=list)
    emulated: bool | None = None
    motor_inertia_kg_m2: float | None = None
    left_out: dict[float, PartVerdict] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def estimate(self) -> JointEstimate:
        """Estimate from all passes."""
        return self.passes[-1].estimate

    @property
    def reduction_fraction(self) -> float:
        """Fraction by which the last pass' vibration is below the first's."""
        return 1.0 - self.passes[-1].vibration_m_s2 / max(self.passes[0].vibration_m_s2, 1e-30)

    def part(self, note: str = "", on: datetime.date | None = None) -> IdentifiedError:
        """Entry of the model file.

        Args:
            note: Load, temperature: a note of the engineer.
            on: Date of the passes; today's unless it is given.
        """
        estimate, last = self.estimate, self.passes[-1]
        found = estimate.error.amplitude_arcsec
        kept = {order: found[order] for order in found if order not in self.left_out}
        wrong = sorted(order for order, verdict in self.left_out.items() if verdict.verdict == "refused")
        without = f"without order {', '.join(f'{order:g}' for order in wrong)}" if wrong else ""
        # of an order that is left out nothing is stated: its amplitude is 0 because it is not cancelled
        stated = standard_errors(estimate) | self._amplitude_errors()
        silent = {key(order) for order in self.left_out for key in (amplitude_key, phase_key)}
        date = (on or datetime.datetime.now(datetime.UTC).date()).isoformat()
        return IdentifiedError(
            values=TransmissionErrorTable.of(kept, estimate.error.phase_deg),
            standard_error={name: error for name, error in stated.items() if name not in silent},
            arm_hz=estimate.arm.resonance_hz,
            damping=estimate.arm.damping,
            accelerometer_delay_s=estimate.arm.delay_s,
            set_point_delay_s=last.set_point_delay_s,
            learnt_by="adaptive",
            motor_inertia_kg_m2=self.motor_inertia_kg_m2,
            note="; ".join(text for text in (date, f"{len(self.passes)} passes", without, note) if text),
            emulated=self.emulated,
        )

    def _amplitude_errors(self) -> dict[str, float]:
        """Standard errors of the amplitudes by what the last pass' cancellation took away, where that knows them better.

        The fit's hold how far the gear is from a spring, by which both directions differ. An accepted verdict is of the order
        itself: the arm shook less by what was cancelled, times a factor with its own standard error.
        """
        if len(self.passes) < 2:
            return {}
        estimate, known, errors = self.estimate, standard_errors(self.estimate), dict[str, float]()
        cancelled, found = self.passes[-2].estimate.error.amplitude_arcsec, estimate.error.amplitude_arcsec
        for verdict in self.passes[-1].verdicts:
            order, key = verdict.part.order, amplitude_key(verdict.part.order)
            if verdict.verdict != "accepted" or verdict.factor is None or verdict.factor_error is None or order not in found:
                continue
            seen = math.hypot(found[order] - verdict.factor * cancelled[order], verdict.factor_error * cancelled[order])
            errors[key] = min(seen, known.get(key, seen))
        return errors

    def store(self, path: Path, robot: str, note: str = "", on: datetime.date | None = None) -> Identified:
        """Write the transmission error into the model file.

        Args:
            path: The model file; made where it is missing.
            robot: Name of the bench.
            note: Load, temperature: a note of the engineer.
            on: Date of the passes; today's unless it is given.

        Raises:
            FileError: The file is no model file, or cannot be written.
            NotPossibleError: The file is another robot's.
        """
        return update_file(path, robot, self.axis, self.part(note, on))

    def entry(self, note: str = "", on: datetime.date | None = None) -> LearntAxis:
        """The axis as a result file has it."""
        return LearntAxis(
            axis=self.axis,
            reduction_fraction=self.reduction_fraction,
            passes=tuple(each.entry() for each in self.passes),
            ate=self.part(note, on),
            left_out=tuple(verdict.words for verdict in self.left_out.values()),
            notes=tuple(self.notes),
        )


def learn(
    session: Session,
    axis: int,
    identified: Identified | None = None,
    *,
    passes: int = PASSES,
    acceleration_rps_s: float = ACCELERATION_RPS_S,
    actuation: Actuation = "reference",
    motor_inertia_kg_m2: float | None = None,
    orders: Sequence[float] = ORDERS,
    keep: PassKeeper = keep_nothing,
    reporter: Reporter = SILENT,
) -> AxisLearning:
    """Learn the transmission error of one axis by cancelling it.

    Args:
        session: Session that has been brought up.
        axis: Axis number.
        identified: The model file, for the motor's inertia; its transmission error is not used. None: the bench file's model.
        passes: Number of passes, each to and fro; two at least.
        acceleration_rps_s: Acceleration of every ramp.
        actuation: `reference` for the set-point alone, `torque` with a torque offset.
        motor_inertia_kg_m2: J_m from a data sheet, where neither file has a plant.
        orders: Orders that are learnt.
        keep: Keeper of every pass, a stopped one included, before it is checked.
        reporter: Listener of each pass.

    Raises:
        NotPossibleError: Fewer than two passes, no motor inertia, or limits that keep the motor from the resonance.
        AteNotIdentifiedError: The runs do not identify the transmission error.
        CancellationRefusedError: No order's cancellation lowered its vibration.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench, table = session.bench, _table_of(session.bench, axis, passes)
    learning = AxisLearning(axis, motor_inertia_kg_m2=given_inertia(bench, identified, axis, motor_inertia_kg_m2))
    end = furthest_end(bench, axis, acceleration_rps_s, _known_hz(identified, axis))
    watch = OrderWatch(bench, axis, Sensing(table.tip_lever_m), acceleration_rps_s=acceleration_rps_s)
    delay_s, scale, judge = 0.0, axis_scale(bench, axis), PassJudge(bench, identified, axis)
    for number in range(1, passes + 1):
        gain = (0.0, SECOND_GAIN)[number - 1] if number <= 2 else 1.0
        reporter.step(f"pass {number} of {passes}: axis {axis} to {end:.2f} rev/s, {100.0 * gain:g} % of the cancellation")
        motion = _ramps_from_here(session, axis, acceleration_rps_s, end)
        cancellation = _cancellation(session, identified, learning, delay_s, motion, actuation)
        result = session.run(motion.motion, "none", "drive", None if cancellation is None else cancellation.adder(gain))
        recording, following = _kept(number, result, motion, axis, table, keep), None
        if cancellation is not None and gain == 1.0 and scale is not None:
            following, late_s = motor_following(recording, motion, axis, table.reduction_ratio, learning.estimate, scale.band_hz)
            delay_s += late_s if abs(late_s) > LEAST_DELAY_S else 0.0
        watch.sweeps.append(sweep_of(motion, recording, axis, sensorless=False))
        estimate = _fitted(watch.sweeps, table, learning.passes[-1].estimate.arm if learning.passes else None, orders)
        checked(watch, estimate, sensorless=False, passes_left=passes - number)
        scale = scale or scale_at(bench, axis, estimate.arm.resonance_hz)  # of the first pass: all are judged alike
        vibration = vibration_m_s2(recording, judged_rows(bench, recording, scale) & (motion.direction() != 0), scale)
        acted = () if cancellation is None else cancellation.tables[axis].orders
        verdicts = judge.judge(recording, motion, acted, gain, estimate, scale)
        learning.passes.append(LearntPass(gain, vibration, estimate, delay_s, following, verdicts))
        _leave_out(learning, number, is_last=number == passes)
        end = max(furthest_end(bench, axis, acceleration_rps_s, estimate.arm.resonance_hz), _low_end(end, estimate))
    return replace(learning, notes=watch.notes(estimate, watch.scan(estimate)))


def _known_hz(identified: Identified | None, axis: int) -> float | None:
    """f_a of an axis' identified plant; None without one."""
    part = None if identified is None or axis not in identified.axis else identified.axis[axis].plant
    return None if part is None else part.antiresonance_hz


def _low_end(end_rps: float, estimate: JointEstimate) -> float:
    """End of the next pass' ramps for an order below 2 that is there and was reached; 0 where there is none."""
    arm_hz = estimate.arm.resonance_hz
    low = [k for k in estimate.error.amplitude_arcsec if k < LOWEST and end_rps >= arm_hz / k and is_significant(estimate, k)]
    return min(end_rps, END_OVER_RESONANCE * arm_hz / min(low)) if low else 0.0


def _ramps_from_here(session: Session, axis: int, acceleration_rps_s: float, end_rps: float) -> Ramps:
    """Ramps from where the axis stands."""
    session.check_interrupt()
    here_rev = session.axes[axis].position_rad() / (2.0 * math.pi)
    return ramps(session.bench, axis, here_rev, acceleration_rps_s, end_rps, session.bench.bus.sync_period_s)


def _kept(number: int, result: RunResult, motion: Ramps, axis: int, table: AxisTable, keep: PassKeeper) -> Recording:
    """Recording of a pass, once it is kept; what stopped the pass, or what it lacks, is raised."""
    keep(number, result, motion)
    check_moved(motion, result, axis, table.limits)
    if result.stopped is not None:
        raise result.stopped
    check_run(result, sensorless=False)
    return result.recording


def _leave_out(learning: AxisLearning, number: int, *, is_last: bool) -> None:
    """Leave out the orders whose cancellation is wrong, after the last pass those too that could not be judged.

    Raises:
        CancellationRefusedError: None is left.
    """
    verdicts = learning.passes[-1].verdicts
    for verdict in verdicts:
        if verdict.verdict == "refused" or (is_last and verdict.verdict == "not judged"):
            learning.left_out[verdict.part.order] = verdict
    if number > 1 and not significant(learning.part()).amplitudes_arcsec():
        raise CancellationRefusedError(f"what pass {number - 1} has learnt of axis {learning.axis}", verdicts)


def _table_of(bench: Bench, axis: int, passes: int) -> AxisTable:
    """The table of the axis that is to be learnt in so many passes.

    Raises:
        NotPossibleError: The passes are too few, or there is no such axis.
    """
    if passes < 2:
        raise NotPossibleError(f"{passes} pass cannot learn: the first is without cancellation, so 2 are needed at least")
    if axis not in bench.axis:
        raise NotPossibleError(f"bench {bench.name!r} has no axis {axis}; it has {', '.join(map(str, bench.axis))}")
    return bench.axis[axis]


def _cancellation(
    session: Session,
    identified: Identified | None,
    learning: AxisLearning,
    delay_s: float,
    motion: Ramps,
    actuation: Actuation,
) -> Cancellation | None:
    """Cancellation of what has been learnt so far; None before the first pass."""
    if not learning.passes:
        return None
    so_far = _with_estimate(session, identified, learning, delay_s)
    return cancellation_on(session, so_far, motion.motion, actuation=actuation)


def _fitted(sweeps: Sequence[Sweep], table: AxisTable, start: Arm | None, orders: Sequence[float]) -> JointEstimate:
    """The transmission error from all passes so far.

    Raises:
        NotPossibleError: The passes do not carry a fit.
    """
    try:
        return identify_orders(sweeps, table.reduction_ratio, Sensing(table.tip_lever_m), start, orders)
    except ValueError as error:
        raise NotPossibleError(f"not learnt: {error}") from error


def _with_estimate(session: Session, identified: Identified | None, learning: AxisLearning, delay_s: float) -> Identified:
    """Model file with the estimate that has been learnt so far."""
    model = Identified(robot=session.bench.name) if identified is None else identified
    part_of = learning.part().model_copy(update={"set_point_delay_s": delay_s})
    return model.with_part(learning.axis, part_of)


def motor_following(
    recording: Recording,
    motion: Ramps,
    axis: int,
    reduction_ratio: float,
    estimate: JointEstimate,
    band_hz: tuple[float, float],
) -> tuple[float, float]:
    """Factor and delay with which a motor made the intended motion Δθ_m = −N θ_sync(θ_m).

    Least squares of the measured angle on the intended motion and its derivative, g Δθ_m − g δ Δθ̇_m, both band-passed around
    f_al.

    Args:
        recording: Recording of a pass with the whole cancellation.
        motion: Ramps of the pass.
        axis: Axis number.
        reduction_ratio: N.
        estimate: Estimate that was cancelled with.
        band_hz: Band of the vibration.

    Returns:
        g and δ in s.
    """
    period, angle = recording.period_s, recording.axis(axis, "position_rad")
    intended = -reduction_ratio * estimate.error.angle_rad(angle)
    from scipy import signal  # noqa: PLC0415 - see hil/analysis.py

    band = signal.butter(2, band_hz, "bandpass", fs=1.0 / period, output="sos")
    measured, wanted, rate = signal.sosfiltfilt(band, np.stack([angle, intended, np.gradient(intended, period)]))
    rows = motion.direction(EDGE_S / motion.trajectory.ramp_s) != 0
    rows &= np.roll(rows, -round(EDGE_S / period))  # the end of a ramp says nothing either
    # an order below 2 comes into the band at a higher speed; below it, it is filtered off on both sides
    lowest = min(max(order, LOWEST) for order in estimate.error.amplitude_arcsec)
    rows &= np.abs(motor_speed_rps(recording, axis)) > band_hz[0] / lowest
    columns = np.stack([wanted[rows], rate[rows]], axis=1)
    solution = np.linalg.lstsq(columns, measured[rows], rcond=None)[0]
    gain = float(solution[0])
    return gain, -float(solution[1]) / gain if gain > 0.1 else 0.0
