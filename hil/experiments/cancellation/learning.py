"""Adaptive cancellation of one axis.

The axis moves back and forth; its transmission error is learnt from pass to pass, then frozen.

The first pass is without cancellation, the second with half of it, every later one with all of it. After each pass each order
of it is judged as in a trial (`verdict`), and one whose cancellation is wrong is left out from there on. The first two are fitted
for what is not known; what a later one leaves corrects the correction (`correction`), until next to nothing is left.
Learning is between passes only: a cancellation that adapted during acceleration would follow the motion, not the error. For the
method see docs/learning.md.
"""

import datetime
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hil.analysis import TipScale
from hil.bench.bench import AxisTable, Bench
from hil.bench.model import (
    Identified,
    IdentifiedError,
    IdentifiedPlant,
    identified_axis,
    significant,
    update_file,
    with_identified,
)
from hil.control.cancellation_table import CancellationTable
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.ate.motion import motion_factor
from hil.design.frequency import CONTROL_PERIOD_S
from hil.design.inverse import Actuation, made_error
from hil.design.ringing import RINGING
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import check_factor
from hil.experiments.ate.identify import SEARCHED_PASSES, checked_on_gear, standard_errors
from hil.experiments.ate.motion import PassKeeper, Ramps, ramps
from hil.experiments.ate.order_scan import OrderWatch, identify_orders, is_passed, is_significant
from hil.experiments.ate.ramp import ACCELERATION_RPS_S, Ramp, RampLimits, plan_ramp, resonance_ramp
from hil.experiments.ate.request import axis_knowledge, modal_arm
from hil.experiments.ate.sweeps import late_words, run_pass
from hil.experiments.cancellation.cancellation import Cancellation, cancellation_on, treated_model
from hil.experiments.cancellation.correction import Correction, OrderValue, error_of
from hil.experiments.cancellation.effect import Part, Response, refined
from hil.experiments.cancellation.ramp_trial import seen_by_direction
from hil.experiments.cancellation.reaction_watch import ReactionWatch
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge, part_entry
from hil.experiments.cancellation.verification import CancellationRefusedError
from hil.experiments.cancellation.waves import judged_rows, response_of, vibration_m_s2, waves_of
from hil.experiments.judge import axis_scale, scale_at, shown_rps
from hil.experiments.motor_inertia import given_inertia
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.learning import LearningPass, LearntAxis
from hil.robot_tables import ORDERS, TransmissionErrorTable

LOWEST = 2.0
"""Bound: order whose resonance every ramp passes, that of a wave generator's two lobes; a lower one's where the limits allow."""

PASSES = 5
"""Most passes unless another number is asked for: without, with a part, and three with the whole cancellation."""
FIRST_GAINS = (0.0, 0.5)
"""Bound: parts of the cancellation in the first passes: half of it, turned by 180°, would add half of the vibration."""
MADE_BY = ("motor_inertia_kg_m2", "motor_damping_nm_s_rad", "torque_lag_s")
"""Values of a plant by which the motor makes a correction."""
FIRST_WHOLE = len(FIRST_GAINS) + 1
"""Number of the first pass with the whole cancellation."""


class PassJudge:
    """Judge of the passes of one axis.

    A pass may be to another speed than the first, so each is read with its own waves; and each direction for itself, since an
    unknown delay turns one against the other.
    """

    def __init__(self, bench: Bench, identified: Identified | None, axis: int, known: Collection[float] = ()) -> None:
        self._known_orders = tuple(known)
        self._bench, self._axis, self._known = bench, axis, response_of(bench, identified, axis)
        self._response: Response | None = None
        self._without: dict[float, list[Seen]] = {}

    def begin(self, recording: Recording, motion: Ramps, estimate: JointEstimate, scale: TipScale) -> None:
        """Read the first pass, with which the others are compared."""
        self._response = self._first(recording, motion, estimate, scale)
        self._without = self.read(recording, motion, {*estimate.error.amplitude_arcsec, *self._known_orders}, 0.0, scale, {})

    def read(
        self,
        recording: Recording,
        motion: Ramps,
        orders: Collection[float],
        gain: float,
        scale: TipScale,
        tables: Mapping[int, CancellationTable],
    ) -> dict[float, list[Seen]]:
        """Read what is left of each order in each direction; `tables` are those of the whole cancellation."""
        assert self._response is not None  # noqa: S101 - made by the first pass
        fitted, acted = {*orders, *self._without}, {number: table.scaled(gain) for number, table in tables.items()}
        return seen_by_direction(self._bench, recording, motion, self._response, fitted, orders, gain, scale, acted)

    def verdicts(self, seen: Mapping[float, Sequence[Seen]], gain: float) -> tuple[PartVerdict, ...]:
        """Verdict on each order of a pass, against the first one."""
        axis = self._axis
        return tuple(judge(Part(axis, k), gain, [*self._without[k], *sights]) for k, sights in seen.items())

    def _first(self, recording: Recording, motion: Ramps, estimate: JointEstimate, scale: TipScale) -> Response:
        """The response, refined on the first pass."""
        arm = estimate.arm
        bare = Response(Arm(arm.resonance_hz, arm.damping, gear_fraction=arm.gear_fraction))
        start = replace(self._known or bare, delay_s=arm.delay_s)
        orders = {self._axis: tuple(estimate.error.amplitude_arcsec)}
        waves = waves_of(self._bench, {self._axis: start}, orders, motion.motion, recording)
        return refined([recording], waves, [motion.direction() != 0], scale.band_hz, [None])[0].response


@dataclass(frozen=True)
class LearntPass:
    """One pass and the estimate after it.

    Attributes:
        gain: Fraction of the cancellation that acted.
        vibration_m_s2: Vibration of the tip, both ramps, in the band around f_al, at the speeds that excite the arm.
        estimate: Last fit of the passes.
        values: Amplitude and phase of each order as they are known after this pass.
        verdicts: Verdict on each order that was cancelled in it.
    """

    gain: float
    vibration_m_s2: float
    estimate: JointEstimate
    set_point_delay_s: float
    values: Mapping[float, OrderValue]
    verdicts: tuple[PartVerdict, ...] = ()

    def entry(self) -> LearningPass:
        """Entry of the pass for the result file."""
        error = error_of(self.values)
        return LearningPass(
            gain=self.gain, vibration_m_s2=self.vibration_m_s2, set_point_delay_s=self.set_point_delay_s,
            values=TransmissionErrorTable.of(error.amplitude_arcsec, error.phase_deg),
            parts=tuple(part_entry(verdict) for verdict in self.verdicts),
        )  # fmt: skip


@dataclass
class AxisLearning:
    """Passes of one axis, and the transmission error learnt from them.

    Attributes:
        emulated: True if the robot is emulated; None if that is not known.
        motor_inertia_kg_m2: J_m as it was given, where no plant is known.
        left_out: Orders that are not cancelled, with the verdicts on them.
        correction: What is known of the correction of each order.
        reaction: Reaction of the gear on its motor; None before the learning begins.
    """

    axis: int
    passes: list[LearntPass] = field(default_factory=list)
    emulated: bool | None = None
    motor_inertia_kg_m2: float | None = None
    left_out: dict[float, PartVerdict] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    correction: Correction = field(default_factory=Correction)
    reaction: ReactionWatch | None = None

    @property
    def estimate(self) -> JointEstimate:
        """Last fit of the passes."""
        return self.passes[-1].estimate

    def is_to_be_fitted(self, sweeps: Sequence[Sweep], verdicts: Sequence[PartVerdict], orders: Sequence[float]) -> bool:
        """True if the passes so far are to be fitted.

        They are while the whole cancellation has not acted and an order is not known, if a value was refused, and if an order's
        resonance is reached for the first time.
        """
        number = len(self.passes) + 1
        if number == 1 or (number < FIRST_WHOLE and not self.correction.is_known):
            return True
        is_refused = any(verdict.verdict == "refused" for verdict in verdicts)
        return is_refused or not self.reached(sweeps, orders, self.estimate) <= self.correction.passed

    @staticmethod
    def reached(sweeps: Sequence[Sweep], orders: Sequence[float], estimate: JointEstimate) -> frozenset[float]:
        """Orders whose resonance the passes reach."""
        return frozenset(order for order in orders if is_passed(sweeps, estimate.arm.resonance_hz, order))

    @property
    def reduction_fraction(self) -> float:
        """Fraction by which the last pass' vibration is below the first's."""
        return 1.0 - self.passes[-1].vibration_m_s2 / max(self.passes[0].vibration_m_s2, 1e-30)

    def values(self) -> dict[float, OrderValue]:
        """Amplitude and phase of each order that is not left out."""
        return {order: value for order, value in self.correction.values().items() if order not in self.left_out}

    def kept(self) -> tuple[str, ...]:
        """Orders that were known before, and are kept, in words."""
        return tuple(
            f"order {order:g} keeps its known values, {value.words(order)}: {value.why}"
            for order, value in self.values().items()
            if value.source == "known"
        )

    def part(self, note: str = "", on: datetime.date | None = None) -> IdentifiedError:
        """Entry of the model file.

        The note is of load or temperature; the date is today's unless it is given.
        """
        estimate, values = self.estimate, self.values()
        errors, cancelled = standard_errors(estimate), error_of(values)
        for order, value in values.items():
            for key, error in ((amplitude_key(order), value.amplitude_error), (phase_key(order), value.phase_error)):
                errors.pop(key, None)
                errors |= {} if error is None else {key: error}
        kept = [f"{order:g}" for order, value in values.items() if value.source == "known"]
        before = f"order {', '.join(kept)} with its known values" if kept else ""
        wrong = sorted(order for order, verdict in self.left_out.items() if verdict.verdict == "refused")
        without = f"without order {', '.join(f'{order:g}' for order in wrong)}" if wrong else ""
        for order in self.left_out:  # of it nothing is stated: its amplitude is 0 because it is not cancelled
            errors.pop(amplitude_key(order), None)
            errors.pop(phase_key(order), None)
        reaction = self.correction.reaction
        if reaction is not None and reaction.standard_error:
            errors["gear_reaction"] = reaction.standard_error
        errors["set_point_delay_s"] = self.correction.delay_error_s
        date = (on or datetime.datetime.now(datetime.UTC).date()).isoformat()
        return IdentifiedError(
            values=TransmissionErrorTable.of(cancelled.amplitude_arcsec, cancelled.phase_deg),
            standard_error=errors,
            correlation=self.correction.correlation(values),
            arm_hz=estimate.arm.resonance_hz, damping=estimate.arm.damping, accelerometer_delay_s=estimate.arm.delay_s,
            set_point_delay_s=self.correction.set_point_delay_s,
            gear_reaction=0.0 if reaction is None else max(0.0, reaction.value),
            learnt_by="adaptive", motor_inertia_kg_m2=self.motor_inertia_kg_m2,
            note="; ".join(text for text in (date, f"{len(self.passes)} passes", before, without, note) if text),
            emulated=self.emulated,
        )  # fmt: skip

    def store(self, path: Path, robot: str, note: str = "", on: datetime.date | None = None) -> Identified:
        """Write the transmission error into the model file.

        Raises:
            FileError: The file is not a model file, or cannot be written.
            NotPossibleError: The file is another robot's.
        """
        return update_file(path, robot, self.axis, self.part(note, on))

    def entry(self, note: str = "", on: datetime.date | None = None) -> LearntAxis:
        """Entry of the axis for the result file."""
        return LearntAxis(
            axis=self.axis, reduction_fraction=self.reduction_fraction, passes=tuple(each.entry() for each in self.passes),
            ate=self.part(note, on), left_out=tuple(verdict.words for verdict in self.left_out.values()), kept=self.kept(),
            notes=tuple(self.notes),
        )  # fmt: skip


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
    keep: PassKeeper | None = None,
    reporter: Reporter = SILENT,
) -> AxisLearning:
    """Learn the transmission error of one axis by cancelling it.

    Args:
        identified: The model file: the motor's inertia, and orders that the passes may not better. None: the bench file's model.
        passes: Number of passes, each back and forth; two at least.
        motor_inertia_kg_m2: J_m from a data sheet, where neither file has a plant.
        keep: Keeper of every pass, a stopped one included, before it is checked.

    Raises:
        NotPossibleError: Fewer than two passes, no motor inertia, or limits that keep the motor from the resonance.
        AteNotIdentifiedError: The runs do not identify the transmission error.
        CancellationRefusedError: No order's cancellation lowered its vibration.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench, table = session.bench, _table_of(session.bench, axis, passes)
    inertia_kg_m2, known = given_inertia(bench, identified, axis, motor_inertia_kg_m2), identified_axis(identified, axis)
    ramp, scale = learning_ramp(bench, identified, axis, acceleration_rps_s), axis_scale(bench, axis)
    knowledge = axis_knowledge(bench, axis, identified, sensorless=False)
    watch = OrderWatch(table.reduction_ratio, Sensing(table.felt_lever_m(f"learn --axis {axis}"), 0.0, *knowledge.delay_s), ramp)
    reaction, correction = (
        ReactionWatch.of(axis, knowledge.side, known.ate),
        Correction(known.ate, bench.bus.sync_period_s, _made_error(bench, identified, axis)),
    )
    correction.torque_shows = reaction.known
    learning = AxisLearning(axis, motor_inertia_kg_m2=inertia_kg_m2, correction=correction, reaction=reaction)
    passes_judge = PassJudge(bench, identified, axis, correction.known)
    for number in range(1, passes + 1):
        gain = FIRST_GAINS[number - 1] if number < FIRST_WHOLE else 1.0
        session.check_interrupt()
        motion = ramps(bench, session.axes[axis].position_rad() / math.tau, ramp)
        words = f"axis {axis} to {ramp.end_rps:.2f} rev/s, {100.0 * gain:g} % of the cancellation{ramp.bound}"
        reporter.step(f"pass {number} of at most {passes}: {words}")
        cancellation = _cancellation(session, identified, learning, motion, actuation)
        adder = None if cancellation is None else cancellation.adder(gain)
        recording, sweep = run_pass(session, motion, number, keep, adder)
        watch.sweeps.append(sweep)
        seen = (
            passes_judge.read(recording, motion, tuple(correction.acted), gain, scale, cancellation.tables)
            if scale is not None and cancellation is not None
            else {}
        )
        verdicts = passes_judge.verdicts(seen, gain)
        begun: set[float] = set()
        if learning.is_to_be_fitted(watch.sweeps, verdicts, orders):
            estimate = _fitted(watch, learning, orders, known.plant)
            estimate = checked_on_gear(watch, estimate, knowledge, passes_left=passes - number)
            begun = correction.begin(estimate, learning.reached(watch.sweeps, orders, estimate))
        else:
            check_factor(*motion_factor(watch.sweeps[-1:], table.reduction_ratio, watch.sensing, orders, estimate.arm))
        arm_hz = estimate.arm.resonance_hz
        scale = scale or scale_at(bench, axis, arm_hz)  # of the first: all are judged alike
        if not learning.passes:
            passes_judge.begin(recording, motion, estimate, scale)
        vibration = vibration_m_s2(recording, judged_rows(bench, recording, scale) & (motion.direction() != 0), scale)
        if number >= FIRST_WHOLE:
            left = {k: each for k, each in seen.items() if k not in begun}
            correction.take(left, arm_hz, _per_reaction(bench, identified, learning, recording, motion))
        wanted = significant(learning.part()).amplitudes_arcsec() if learning.passes else {}
        is_last = number == passes or (number >= FIRST_WHOLE and not correction.is_open(verdicts, wanted, arm_hz))
        learning.passes.append(LearntPass(gain, vibration, estimate, correction.set_point_delay_s, learning.values(), verdicts))
        _leave_out_wrong(learning, number, is_last=is_last)
        if is_last:
            break
        watch.ramp, ramp = ramp, _next_ramp(bench, learning, ramp)
    return replace(learning, notes=[*correction.notes(), *watch.notes(estimate, watch.scan(estimate)), *late_words(watch.sweeps)])


def learning_ramp(bench: Bench, identified: Identified | None, axis: int, acceleration_rps_s: float) -> Ramp:
    """Plan the ramp of the first pass.

    Raises:
        NotPossibleError: There is no room for any ramp.
        UnsafeRequestError: The acceleration is beyond its limit.
    """
    plant = identified_axis(identified, axis).plant
    return _ramp(RampLimits.of(bench, axis), acceleration_rps_s, None if plant is None else plant.antiresonance_hz)


def _ramp(limits: RampLimits, asked_rps_s: float, arm_hz: float | None, end_rps: float = 0.0) -> Ramp:
    """Plan a ramp to an end with room, beyond f_m2 if possible."""
    end = max(resonance_ramp(limits, arm_hz, asked_rps_s, is_raised=limits.is_arm).beyond(None).end_rps, end_rps)
    return plan_ramp(limits, asked_rps_s, end, end)


def _next_ramp(bench: Bench, learning: AxisLearning, last: Ramp) -> Ramp:
    """Plan the ramp of the next pass.

    It goes through f_m2. Once they are cancelled, it goes through the resonance of lower orders too: of those that the bench's
    own motion meets, and as far as limits let it.
    """
    arm_hz, asked, ends = learning.estimate.arm.resonance_hz, last.asked_rps_s, [_low_end(last.end_rps, learning.estimate)]
    # until the whole cancellation acts, the vibration of a lower order would hide what the higher ones do
    if len(learning.passes) + 1 >= FIRST_WHOLE:
        orders = {*learning.correction.known, *learning.estimate.error.amplitude_arcsec}
        ends += [last.limits.low_order_end(arm_hz, k, asked) for k in orders if k < LOWEST and shown_rps(bench) >= arm_hz / k]
    return _ramp(last.limits, asked, arm_hz, max(ends))


def _low_end(end_rps: float, estimate: JointEstimate) -> float:
    """End speed for a reached order below 2 in later ramps, or 0."""
    arm_hz = estimate.arm.resonance_hz
    low = [k for k in estimate.error.amplitude_arcsec if k < LOWEST and end_rps >= arm_hz / k and is_significant(estimate, k)]
    return min(end_rps, RINGING * arm_hz / min(low)) if low else 0.0


def _leave_out_wrong(learning: AxisLearning, number: int, *, is_last: bool) -> None:
    """Leave out wrong orders, after the last pass also those not judged."""
    verdicts = learning.passes[-1].verdicts
    learning.left_out |= learning.correction.judged(verdicts, is_last=is_last)
    if number > 1 and not significant(learning.part()).amplitudes_arcsec():
        raise CancellationRefusedError(f"the result of pass {number - 1} for axis {learning.axis}", verdicts)


def _table_of(bench: Bench, axis: int, passes: int) -> AxisTable:
    if passes < 2:
        raise NotPossibleError(f"{passes} passes are too few to learn; at least 2 are needed, the first without cancellation")
    bench.check_axis(axis)
    return bench.axis[axis]


def _cancellation(
    session: Session, identified: Identified | None, learning: AxisLearning, motion: Ramps, actuation: Actuation
) -> Cancellation | None:
    """Cancellation of what has been learnt; None before the first pass."""
    if not learning.passes:
        return None
    part = learning.part()
    so_far = _known_with(session.bench, identified, learning.axis, part)
    made, values = cancellation_on(session, so_far, motion.motion, actuation=actuation), learning.values()
    learning.correction.acted = {order: values[order] for order in made.tables[learning.axis].orders}
    learning.correction.acted_delay_s = learning.correction.set_point_delay_s
    learning.correction.acted_reaction = part.gear_reaction
    return made


def _known_with(bench: Bench, identified: Identified | None, axis: int, part: IdentifiedError) -> Identified:
    """The model file with what has been learnt."""
    return (Identified(robot=bench.name) if identified is None else identified).with_part(axis, part)


def _made_error(bench: Bench, identified: Identified | None, axis: int) -> float:
    """Standard error of the part of a correction that the motor makes, at the arm's frequency; 0 without an identified plant."""
    plant, loop = (
        identified_axis(identified, axis).plant,
        with_identified(bench, identified).axis[axis].loop(CONTROL_PERIOD_S, with_notch=False),
    )
    if plant is None or loop is None:
        return 0.0
    errors = np.array([plant.standard_error.get(name, 0.0) for name in MADE_BY])
    return made_error(loop, plant.antiresonance_hz, plant.torque_lag_s, plant.correlations(MADE_BY) * np.outer(errors, errors))


def _per_reaction(
    bench: Bench, identified: Identified | None, learning: AxisLearning, recording: Recording, motion: Ramps
) -> dict[tuple[float, int], complex]:
    """What the reaction by the pass' torque adds to each cancelled order."""
    correction, watch = learning.correction, learning.reaction
    assert watch is not None  # noqa: S101 - it has begun
    watch.take(recording, error_of(learning.values()))
    correction.torque_shows = watch.known
    axis = learning.axis
    model = treated_model(bench, _known_with(bench, identified, axis, learning.part()), axis)
    loop = bench.axis[axis].model_copy(update={"model": model}).loop(CONTROL_PERIOD_S, with_notch=False)
    if loop is None:
        return {}
    return watch.per_error(recording, motion.direction(), loop, correction.acted, learning.estimate.arm.resonance_hz)


def _fitted(watch: OrderWatch, learning: AxisLearning, orders: Sequence[float], plant: IdentifiedPlant | None) -> JointEstimate:
    """Fit the transmission error to the passes so far.

    For an arm with several modes, those of its plant count beside it.
    """
    start = learning.estimate.arm if learning.passes else None if plant is None else modal_arm(plant)
    is_near = len(learning.passes) >= SEARCHED_PASSES
    try:
        return identify_orders(watch.sweeps, watch.reduction_ratio, watch.sensing, start, orders, is_near=is_near)
    except ValueError as error:
        raise NotPossibleError(f"not learnt: {error}", ("limits",)) from error
