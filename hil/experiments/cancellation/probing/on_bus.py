"""Run of `hil learn --motion`: learning on a motion."""

import cmath
import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedError, identified_axis, update_file
from hil.can.channel import Channel
from hil.control.order_keys import amplitude_key, phase_key
from hil.experiments.bus_demand import BusDemand
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.learn_run import known_model
from hil.experiments.cancellation.probing.learning import learn_on_motion, motion_scale
from hil.experiments.cancellation.probing.motion import peak_and_rms, resonances_hz, with_values
from hil.experiments.cancellation.probing.pace import paced_line
from hil.experiments.cancellation.probing.record import MotionLearning, RunKind
from hil.experiments.decision import MOST_RUNS
from hil.experiments.measurement import Measurement, MeasurementOutcome
from hil.experiments.motions import CONSTANT_ACCELERATION, constant_acceleration, line_motion
from hil.experiments.motor_inertia import given_inertia
from hil.master.motion import Motion, RunResult
from hil.reporter import SILENT, Reporter
from hil.results.base import MeasuredBench
from hil.results.learning import LearntOnMotion, MotionLearningResult, ProbedPart, ProbingRun
from hil.robot_tables import ORDERS


@dataclass(frozen=True)
class MotionLearnRequest:
    """Request of learning on a motion.

    Attributes:
        motion: `line-motion` or `constant-acceleration`.
        axis: The axis of the latter; None for a line.
        pace: Multiple of a line's time in which it is learnt as well; None: at its own pace alone.
    """

    motion: str
    axis: int | None = None
    orders: tuple[float, ...] = ORDERS
    probe_arcsec: float | None = None
    note: str = ""
    motor_inertias_kg_m2: Mapping[int, float] = field(default_factory=dict)
    pace: float | None = None

    def motion_of(self, bench: Bench) -> Motion:
        """The motion, from the bench file.

        Raises:
            NotPossibleError: The bench file has no such motion, or the arm cannot make it.
        """
        if self.motion == CONSTANT_ACCELERATION and self.axis is not None:
            return constant_acceleration(bench, self.axis, bench.bus.sync_period_s)
        return line_motion(bench, bench.bus.sync_period_s)


@dataclass(frozen=True)
class MotionLearningOutcome(MeasurementOutcome[MotionLearningResult]):
    """End of learning on a motion.

    Attributes:
        learning: Result of the learning; None if it ended early.
    """

    learning: MotionLearning | None


def learn_motion_on_bus(
    bench: Bench,
    request: MotionLearnRequest,
    out: Path,
    model: Path,
    *,
    plant: Path | None = None,
    channel: Channel | None = None,
    overload: bool = False,
    reporter: Reporter = SILENT,
) -> MotionLearningOutcome:
    """Learn on a motion, and write what makes the tip quieter.

    Args:
        model: The model file: read for the motors' inertia, where it exists, and written.
        plant: Model file with the plants of the axes, which are taken over into the model file; None: it has them, or the bench.

    Raises:
        HilError: Nothing has moved yet: nodes, limits or files do not allow it.
        ChannelError: The bus cannot be opened, or was lost before anything was recorded.
    """
    identified, motion = known_model(bench, model, plant), request.motion_of(bench)
    _check_known(bench, identified, request, motion)
    demand = BusDemand(f"learning on the {request.motion}", motion.axes, motion.period_s)
    learning: MotionLearning | None = None

    def begun(described: MeasuredBench) -> MotionLearningResult:
        return MotionLearningResult(bench=described, model=str(model), motion=request.motion, axis=request.axis)

    with (
        Measurement(bench, out, begun, channel=channel, reporter=reporter) as measurement,
        measurement.session([demand], overload=overload) as session,
    ):
        keeper = _MotionKeeper(measurement, request)
        try:
            learning = learn_on_motion(
                session, motion, request.axis, identified, orders=request.orders, probe_arcsec=request.probe_arcsec,
                inertias_kg_m2=request.motor_inertias_kg_m2, pace=request.pace, keep=keeper, read=keeper.read, reporter=reporter,
            )  # fmt: skip
        finally:
            keeper.enter()
        result, today = measurement.result, measurement.started.date()
        entries = _learnt(bench, learning, identified, request, today, result.emulated)
        for number, entry in entries.items():
            taken_over = identified_axis(identified, number).plant
            if plant is not None and taken_over is not None:
                update_file(model, bench.name, number, taken_over)
            update_file(model, bench.name, number, entry)
        result.learnt = [LearntOnMotion(axis=number, ate=entry) for number, entry in entries.items()]
    return MotionLearningOutcome(measurement.result, measurement.failure, learning)


def _check_known(bench: Bench, identified: Identified | None, request: MotionLearnRequest, motion: Motion) -> None:
    """Refuse a motion that cannot be learnt.

    A band, a gain or an inertia is missing, or the arm cannot follow the motion at the other pace.

    Raises:
        NotPossibleError: It is.
        LineError: It cannot.
        UnsafeRequestError: An axis comes too near to its limit of speed there.
    """
    motion_scale(bench, identified, request.axis)
    if request.pace is not None:
        paced_line(bench, request.pace)
    for number in motion.axes:
        bench.axis[number].gains(f"learning on axis {number}")
        given_inertia(bench, identified, number, request.motor_inertias_kg_m2.get(number))


def _learnt(
    bench: Bench,
    learning: MotionLearning,
    identified: Identified | None,
    request: MotionLearnRequest,
    on: datetime.date,
    emulated: bool | None,
) -> dict[int, IdentifiedError]:
    """Entries of the model file for axes with learnt orders."""
    assert learning.probed is not None  # noqa: S101 - there were runs
    values = {part: outcome.value for part, outcome in learning.outcomes.items()}
    known = Identified(robot=bench.name) if identified is None else identified
    model = with_values(known, learning.motion, values, learning.inertias, learning.scale.f_al_hz, learning.reactions)
    read = [run.recording for run in learning.of_kind("probe")[:MOST_RUNS]]
    resonances = resonances_hz(bench, model, learning.motion, read, learning.probed)
    runs = f"{len(learning.all_runs)} runs of {request.motion}"
    note = "; ".join(text for text in (on.isoformat(), runs, request.note) if text)
    entries = {}
    for number in learning.motion.axes:
        part = model.axis[number].ate
        if part is None or not part.values.amplitudes_arcsec():
            continue
        change = {
            "standard_error": _errors(learning, number), "correlation": None, "learnt_by": "probing", "note": note,
            "emulated": emulated, "arm_hz": resonances.get(number, part.arm_hz),
        }  # fmt: skip
        entries[number] = part.model_copy(update=change)
    return entries


def _errors(learning: MotionLearning, number: int) -> dict[str, float]:
    """Standard errors of an axis' learnt orders, by model file key."""
    errors = {}
    for part, outcome in learning.outcomes.items():
        if part.axis == number and outcome.amplitude_error is not None and outcome.phase_error_deg is not None:
            errors[amplitude_key(part.order)] = outcome.amplitude_error
            errors[phase_key(part.order)] = outcome.phase_error_deg
    return errors


class _MotionKeeper:
    """Keeper of a motion's runs in the result."""

    def __init__(self, measurement: Measurement[MotionLearningResult], request: MotionLearnRequest) -> None:
        self._measurement, self._request = measurement, request
        self._learning: MotionLearning | None = None

    def __call__(self, number: int, kind: RunKind, result: RunResult) -> None:
        made = self._measurement.made(result, f"learn-{self._request.motion}-{number:02d}-{kind}")
        self._measurement.result.runs.append(ProbingRun(number=number, what=kind, **made))

    def read(self, learning: MotionLearning) -> None:
        """Take the learning to which these runs belong."""
        self._learning = learning

    def enter(self) -> None:
        """Enter the results of the runs, however the learning ended."""
        learning, result = self._learning, self._measurement.result
        if learning is None:
            return
        for entry, run in zip(result.runs, learning.all_runs, strict=False):
            peak_mm, rms_mm = peak_and_rms(run.moved_mm)
            shown = {"tip_peak_mm": peak_mm, "tip_rms_mm": rms_mm, "is_kept": run is learning.applied, "pace": run.pace}
            result.runs[entry.number - 1] = entry.model_copy(update=shown)
        result.parts = [_part_entry(learning, part) for part in sorted(learning.outcomes)]
        result.probe_arcsec = learning.probe_arcsec or None
        result.noise_m_s2, result.left_m_s2 = learning.noise_m_s2, learning.left_m_s2
        if len(learning.of_kind("base")) > 1:
            result.base_peak_mm, result.base_rms_mm = learning.base_mm
            result.noise_mm = learning.noise_mm.rms


def _part_entry(learning: MotionLearning, part: Part) -> ProbedPart:
    found = learning.outcomes[part]
    is_learnt = found.outcome == "learnt"
    phase = math.degrees(cmath.phase(found.value)) % 360.0 if is_learnt else None
    return ProbedPart(
        axis=part.axis, order=part.order, outcome=found.outcome, a_arcsec=abs(found.value) if is_learnt else None,
        a_error_arcsec=found.amplitude_error, phi_deg=phase, phi_error_deg=found.phase_error_deg, seen_fraction=found.seen,
        words=found.words,
    )  # fmt: skip
