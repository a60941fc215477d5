"""Trial of a cancellation on the accelerometer: it is trusted only after it has lowered the vibration.

An order whose cancellation is wrong by more than 60° vibrates more with it. So the motion runs without it, then with a small
fraction of it on all axes and on each, then with the whole; and each order of each axis is judged for itself (`verdict`), by its
own complex amplitude at the tip (`effect`). What is wrong is taken out, as is what does too little to be seen; where nothing is
left the cancellation is refused, and the notch stays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.analysis import TipScale, band_passed, line_window_s, motor_speed_rps
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.errors import HilError, NotPossibleError
from hil.experiments.cancellation.cancellation import Cancellation, CancellationAdder, cancel_inside, inside_parts
from hil.experiments.cancellation.effect import AxisWaves, Part, Response, refined, sight
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judged
from hil.experiments.cancellation.waves import response_of, seen_rows, waves_of
from hil.experiments.judge import vibration_scale
from hil.master.motion import FilterUse, Motion, RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.runs import CancellationTrial, TrialPart, TrialRun

Rows = NDArray[np.bool_]

PROBE_GAIN = 0.3
MOST_WHOLE = 4
"""Most runs with the whole cancellation: where an order cannot be judged above the sensor's noise, the mean of so many may."""
PARTS_TOLD = 4


class CancellationRefusedError(HilError):
    """The cancellation failed its trial on the accelerometer: it is not used, and the notch stays."""

    exit_code = 9

    def __init__(self, what: str, verdicts: Sequence[PartVerdict]) -> None:
        """Keep the cancellation in words, and the verdicts on its orders."""
        self.what, self.verdicts = what, tuple(verdicts)
        told = "; ".join(verdict.words for verdict in self.verdicts[:PARTS_TOLD])
        more = "" if len(self.verdicts) <= PARTS_TOLD else f"; and {len(self.verdicts) - PARTS_TOLD} more"
        super().__init__(f"cancellation refused: of {what} no order passes; the notch stays. {told}{more}")


@dataclass(frozen=True)
class Trial:
    """One run of a trial.

    Attributes:
        what: Cancellation of this run, in words.
        recording: Recording of the run.
        gains: Fraction of each part that acted.
        rms_m_s2: Vibration of the tip in the rows that are judged, in the band around f_al.
    """

    what: str
    recording: Recording
    gains: Mapping[Part, float]
    rms_m_s2: float


@dataclass(frozen=True)
class Verification:
    """Runs of a trial, and the verdict on each part.

    Attributes:
        gain: Fraction of the cancellation that was tried first.
        trials: All runs, the first without the cancellation.
        verdicts: Verdict on each order of each axis.
    """

    gain: float
    trials: tuple[Trial, ...]
    verdicts: tuple[PartVerdict, ...]

    @property
    def is_good(self) -> bool:
        """True where something of the cancellation may be trusted."""
        return any(verdict.verdict == "accepted" for verdict in self.verdicts)

    @property
    def left_out(self) -> frozenset[Part]:
        """Parts that are not to be used: those that are wrong, and those that could not be judged."""
        return frozenset(verdict.part for verdict in self.verdicts if verdict.verdict != "accepted")

    def entry(self) -> CancellationTrial:
        """The trial as a result file has it."""
        before = self.trials[0].rms_m_s2
        runs = tuple(
            TrialRun(what=trial.what, rms_m_s2=trial.rms_m_s2, reduction_fraction=1.0 - trial.rms_m_s2 / max(before, 1e-30))
            for trial in self.trials[1:]
        )
        parts = tuple(part_entry(verdict) for verdict in self.verdicts)
        return CancellationTrial(before_m_s2=before, gain=self.gain, is_good=self.is_good, trials=runs, parts=parts)

    def demand(self, what: str = "it") -> None:
        """Refuse a cancellation of which nothing has lowered the vibration.

        Raises:
            CancellationRefusedError: No order of any axis passes.
        """
        if not self.is_good:
            raise CancellationRefusedError(what, self.verdicts)


def part_entry(verdict: PartVerdict) -> TrialPart:
    """The verdict on one part as a result file has it."""
    return TrialPart(
        axis=verdict.part.axis,
        order=verdict.part.order,
        verdict=verdict.verdict,
        expected_fall_fraction=verdict.gain,
        fall_fraction=verdict.fall,
        fall_error=verdict.fall_error,
        left_fraction=verdict.left,
        left_error=verdict.left_error,
        factor=verdict.factor,
        factor_error=verdict.factor_error,
        turn_deg=verdict.turn_deg,
        turn_error_deg=verdict.turn_error_deg,
        words=verdict.words,
    )


def judged_rows(bench: Bench, recording: Recording, scale: TipScale) -> Rows:
    """Rows in which vibration is compared: the line motion's window, or a single axis' speeds at which an order excites the arm.

    Args:
        bench: The bench file.
        recording: Recording of the motion.
        scale: Scale of the axes that moved.

    Raises:
        NotPossibleError: The motion does not pass such a speed.
    """
    if len(recording.axes) > 1 and bench.line_motion is not None:
        time, start = recording.time_s, bench.line_motion.dwell_s
        begin, end = (start + each for each in line_window_s(bench.line_motion.duration_s))
        return np.asarray((time >= begin) & (time <= end))
    speed = np.abs(motor_speed_rps(recording, recording.axes[0]))
    rows = np.zeros(len(speed), dtype=np.bool_)
    for low, high in scale.windows_rps.values():
        rows |= (speed >= low) & (speed <= high)
    if np.count_nonzero(rows) * recording.period_s < 0.1:
        raise NotPossibleError("a motion that does not excite the arm shows nothing of a cancellation")
    return rows


def vibration_m_s2(recording: Recording, rows: Rows, scale: TipScale) -> float:
    """Root mean square of the tip's vertical acceleration in the band around f_al, in some rows."""
    band = band_passed(recording.columns["tip_z_m_s2"], recording.period_s, scale.band_hz)
    return float(np.sqrt(np.mean(band[rows] ** 2)))


def averaged(recordings: Sequence[Recording]) -> Recording:
    """The mean of recordings of the same motion, row by row: the sensor's noise falls with the root of their number.

    Raises:
        ValueError: There is no recording, or they are not of the same motion.
    """
    shapes = {(tuple(recording.columns), len(recording.time_s)) for recording in recordings}
    if len(shapes) != 1:
        raise ValueError(f"{len(recordings)} recordings of {len(shapes)} kinds have no mean")
    first = recordings[0].columns
    return Recording({name: np.mean([recording.columns[name] for recording in recordings], axis=0) for name in first})


Runner = Callable[[float, int | None, frozenset[Part]], Recording]
"""What runs the motion: with a fraction of the cancellation, on one axis alone or on all, without some parts."""


class _Protocol:
    """The runs of a trial and what they show, whoever cancels."""

    def __init__(
        self,
        bench: Bench,
        motion: Motion,
        parts: Sequence[Part],
        responses: Mapping[int, Response],
        scale: TipScale,
        gain: float,
        run: Runner,
        reporter: Reporter,
    ) -> None:
        self._bench, self._motion, self._parts, self._responses = bench, motion, tuple(parts), responses
        self._scale, self._gain, self._run, self._reporter = scale, gain, run, reporter
        self._trials: list[Trial] = []
        self._seen: dict[Part, list[Seen]] = {part: [] for part in parts}
        self._axes: tuple[AxisWaves, ...] = ()
        self._rows = self._judged = np.zeros(0, dtype=np.bool_)

    def perform(self) -> Verification:
        """Make the runs that the verdicts need.

        Raises:
            NotPossibleError: The motion does not excite the arm.
        """
        alone = sorted({part.axis for part in self._parts})
        alone = alone if len(alone) > 1 else []
        least, most = 3 + len(alone), 1 + len(alone) + 2 * MOST_WHOLE
        self._reporter.step(
            f"trial of the cancellation: without; {least} runs of {self._motion.time_s[-1]:.1f} s in all, at most {most}"
        )
        self._add("without", 0.0)
        percent = f"{100.0 * self._gain:g} % of it"
        for only, what in ((None, percent), *((axis, f"{percent} on axis {axis} alone") for axis in alone)):
            self._reporter.step(f"trial of the cancellation: {what}")
            self._add(what, self._gain, only)
        self._refine(2 + len(alone))
        verdicts = judged(self._gain, self._seen)
        for number in range(1, MOST_WHOLE + 1):
            wrong = _wrong(verdicts)
            if len(wrong) == len(self._parts):
                break
            if number > 1 and _open(verdicts, number - 1):
                self._reporter.step("trial of the cancellation: without, once more, for the mean")
                self._add("without, once more", 0.0)
            what = "the whole of it" + (f" but {', '.join(part.words for part in sorted(wrong))}" if wrong else "")
            self._reporter.step(f"trial of the cancellation: {what}")
            self._add(what, 1.0, None, wrong)
            verdicts = judged(self._gain, self._seen)
            if _wrong(verdicts) == wrong and not _open(verdicts, number):
                break
        return Verification(self._gain, tuple(self._trials), tuple(verdicts.values()))

    def _add(self, what: str, gain: float, only: int | None = None, without: frozenset[Part] = frozenset()) -> None:
        """Make one run, and read it."""
        recording = self._run(gain, only, without)
        if not self._trials:
            self._judged = judged_rows(self._bench, recording, self._scale)
            self._rows = seen_rows(self._bench, recording, self._scale.f_al_hz)
            orders: dict[int, list[float]] = {}
            for part in self._parts:
                orders.setdefault(part.axis, []).append(part.order)
            self._axes = waves_of(self._bench, self._responses, orders, self._motion, recording)
        rms_m_s2 = vibration_m_s2(recording, self._judged[: len(recording.time_s)], self._scale)
        gains = {part: gain if only in {None, part.axis} and part not in without else 0.0 for part in self._parts}
        self._trials.append(Trial(what, recording, gains, rms_m_s2))
        self._see(self._trials[-1])

    def _refine(self, count: int) -> None:
        """Refine the responses on the first runs, and read those anew."""
        recordings = [trial.recording for trial in self._trials[:count]]
        rows = [self._rows[: len(recording.time_s)] for recording in recordings]
        self._axes = refined(recordings, self._axes, rows, self._scale.band_hz)
        for sights in self._seen.values():
            sights.clear()
        for trial in self._trials:
            self._see(trial)

    def _see(self, trial: Trial) -> None:
        sighting = sight(trial.recording, self._axes, self._rows[: len(trial.recording.time_s)], self._scale.band_hz)
        for part, sights in self._seen.items():
            sights.append(Seen(1, trial.gains[part], sighting.amplitude[part], sighting.variance(part)))


def _wrong(verdicts: Mapping[Part, PartVerdict]) -> frozenset[Part]:
    return frozenset(part for part, verdict in verdicts.items() if verdict.verdict == "refused")


def _open(verdicts: Mapping[Part, PartVerdict], wholes: int) -> bool:
    """True where more runs with the whole than these could still judge a part."""
    return any(verdict.could_be_judged(MOST_WHOLE / wholes) for verdict in verdicts.values())


def verify(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    filters: FilterUse = "none",
    *,
    gain: float = PROBE_GAIN,
    shows_filter: bool = True,
    reporter: Reporter = SILENT,
) -> Verification:
    """Try a cancellation on the robot: the motion without it, with a fraction, with that on each axis alone, and with the whole.

    Args:
        session: Session that has been brought up.
        cancellation: Cancellation of the motion's axes.
        motion: The very motion that is to be run with it; it must excite the arm.
        filters: Filters of the drives that act, in all of these runs.
        gain: Fraction that is tried first.
        shows_filter: True where the drives report their filters' state.
        reporter: Listener of each run.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """

    def run(part_of: float, only: int | None, without: frozenset[Part]) -> Recording:
        adder = cancellation.without(without).adder(part_of, only) if part_of > 0.0 else None
        return _run(session, motion, filters, adder, shows_filter)

    scale = cancellation.scale or vibration_scale(session.bench, motion.axes)
    return _Protocol(session.bench, motion, cancellation.parts, cancellation.responses, scale, gain, run, reporter).perform()


def _run(session: Session, motion: Motion, filters: FilterUse, adder: CancellationAdder | None, shows_filter: bool) -> Recording:
    session.check_interrupt()
    result: RunResult = session.run(motion, filters, "drive", adder, shows_filter=shows_filter)
    if result.stopped is not None:
        raise result.stopped
    return result.recording


@dataclass(frozen=True)
class Choice:
    """Choice after a trial: what of the cancellation passed, or the notch where nothing did.

    Attributes:
        cancellation: Cancellation without the parts that did not pass; None where it was refused, or the drives cancel.
        filters: Filters of the drives that act.
        verification: Runs of the trial.
        refusal: Reason why the cancellation is not used, or None.
    """

    cancellation: Cancellation | None
    filters: FilterUse
    verification: Verification
    refusal: CancellationRefusedError | None

    @property
    def adder(self) -> CancellationAdder | None:
        """Adder of one run, each needs a new one; None where the cancellation was refused, or the drives cancel."""
        return None if self.cancellation is None else self.cancellation.adder()


def choose(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    *,
    with_notch: bool = False,
    gain: float = PROBE_GAIN,
    shows_filter: bool = True,
    reporter: Reporter = SILENT,
) -> Choice:
    """Try a cancellation, and choose for the motion: what of it passes, or the notch where nothing does.

    Args:
        session: Session that has been brought up.
        cancellation: Cancellation of the motion's axes.
        motion: The very motion that is to be run.
        with_notch: True where the filters act beside it; after a refusal they act alone, where the bench has any.
        gain: Fraction that is tried first.
        shows_filter: True where the drives report their filters' state.
        reporter: Listener of each run.

    Raises:
        HilError: As `verify`.
    """
    filters: FilterUse = "notch" if with_notch else "none"
    verification = verify(session, cancellation, motion, filters, gain=gain, shows_filter=shows_filter, reporter=reporter)
    return _chosen(session, motion, filters, verification, cancellation)


def _chosen(
    session: Session, motion: Motion, filters: FilterUse, verification: Verification, cancellation: Cancellation | None
) -> Choice:
    try:
        verification.demand()
    except CancellationRefusedError as refusal:
        has_notch = any(session.bench.axis[number].notch for number in motion.axes)
        return Choice(None, "notch" if has_notch else "none", verification, refusal)
    kept = None if cancellation is None else cancellation.without(verification.left_out)
    return Choice(kept, filters, verification, None)


def choose_inside(
    session: Session,
    identified: Identified | None,
    motion: Motion,
    *,
    gain: float = PROBE_GAIN,
    reporter: Reporter = SILENT,
) -> Choice:
    """Try a cancellation inside the drives; where it is refused, the notch is what a motion is run with.

    Args:
        session: Session that has been brought up.
        identified: The model file; None for the bench file's own model.
        motion: The very motion that is to be run.
        gain: Fraction that is tried first.
        reporter: Listener of each run.

    Raises:
        HilError: As `verify`, and as `cancel_inside`.
    """
    bench = session.bench
    parts = inside_parts(bench, identified, motion.axes)

    def run(part_of: float, only: int | None, without: frozenset[Part]) -> Recording:
        if part_of > 0.0:
            others = {part for part in parts if only is not None and part.axis != only}
            cancel_inside(session, identified, motion.axes, part_of, without | others)
        return _run(session, motion, "none", None, shows_filter=True)

    known = {number: response_of(bench, identified, number) for number in motion.axes}
    responses = {number: response for number, response in known.items() if response is not None}
    scale = vibration_scale(bench, motion.axes, identified)
    verification = _Protocol(bench, motion, parts, responses, scale, gain, run, reporter).perform()
    return _chosen(session, motion, "none", verification, None)
