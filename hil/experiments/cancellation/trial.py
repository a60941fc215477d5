"""Trial of a cancellation on the accelerometer: it is trusted only after it has lowered the vibration.

A cancellation that is wrong by more than 60° makes the vibration worse. So the motion runs without it, then with a small fraction
of it on all axes and on each. Where the vibration falls by less than half of what it should, the cancellation is refused, and the
notch stays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.analysis import TipScale, band_passed, line_window_s, motor_speed_rps
from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.errors import HilError, NotPossibleError
from hil.experiments.cancellation.cancellation import Cancellation, CancellationAdder, cancel_inside
from hil.experiments.judge import vibration_scale
from hil.master.motion import FilterUse, Motion, RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.runs import CancellationTrial, TrialRun

Rows = NDArray[np.bool_]

PROBE_GAIN = 0.3
LEAST_FRACTION = 0.5
"""Least fraction of the reduction that a right cancellation brings: 45° of phase error still pass, 60° do not."""
WORSE = 0.02
"""Largest apparent rise of the vibration by one axis' cancellation: sensor noise, on an axis that contributes little."""


class CancellationRefusedError(HilError):
    """The cancellation failed its trial on the accelerometer: it is not used, and the notch stays."""

    exit_code = 9

    def __init__(self, what: str, reduction_fraction: float, needed: float) -> None:
        """Keep the cancellation in words, the fraction by which the vibration fell, and the least fraction."""
        self.what, self.reduction_fraction, self.needed = what, reduction_fraction, needed
        change = (
            f"fell by {100.0 * reduction_fraction:.1f} %"
            if reduction_fraction >= 0.0
            else f"rose by {-100.0 * reduction_fraction:.1f} %"
        )
        super().__init__(
            f"cancellation refused: with {what} the vibration {change}, a reduction of at least {100.0 * needed:.1f} % is "
            "needed; the notch stays"
        )


@dataclass(frozen=True)
class Trial:
    """One run of a trial against the run without cancellation.

    Attributes:
        what: Cancellation of this run, in words.
        rms_m_s2: Vibration of the tip in the window, in the band around f_al.
        reduction_fraction: Fraction by which the vibration is below that of the run without.
        needed_fraction: Least fraction that is needed.
    """

    what: str
    rms_m_s2: float
    reduction_fraction: float
    needed_fraction: float

    @property
    def is_good(self) -> bool:
        """True where the vibration fell far enough."""
        return self.reduction_fraction >= self.needed_fraction


@dataclass(frozen=True)
class Verification:
    """Runs of a trial and their vibration.

    Attributes:
        before_m_s2: Vibration without the cancellation.
        gain: Fraction of the cancellation that was tried.
        trials: Runs with all axes, then with each alone where there are several.
        runs: Recordings by name.
    """

    before_m_s2: float
    gain: float
    trials: tuple[Trial, ...]
    runs: Mapping[str, Recording]

    @property
    def is_good(self) -> bool:
        """True where the cancellation may be trusted."""
        return all(trial.is_good for trial in self.trials)

    def entry(self) -> CancellationTrial:
        """The trial as a result file has it."""
        trials = tuple(TrialRun(**vars(trial), is_good=trial.is_good) for trial in self.trials)
        return CancellationTrial(before_m_s2=self.before_m_s2, gain=self.gain, is_good=self.is_good, trials=trials)

    def demand(self) -> None:
        """Refuse a cancellation that has not lowered the vibration.

        Raises:
            CancellationRefusedError: A run of the trial fell short.
        """
        for trial in self.trials:
            if not trial.is_good:
                raise CancellationRefusedError(trial.what, trial.reduction_fraction, trial.needed_fraction)


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
    """Try a small fraction of a cancellation on the robot: the motion without it, with it, and with it on each axis alone.

    Args:
        session: Session that has been brought up.
        cancellation: Cancellation of the motion's axes.
        motion: The very motion that is to be run with it; it must excite the arm.
        filters: Filters of the drives that act, in all of these runs.
        gain: Fraction that is tried.
        shows_filter: True where the drives report their filters' state.
        reporter: Listener of each run.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    reporter.step("trial of the cancellation: without")
    first = _run(session, motion, filters, None, shows_filter)
    scale = cancellation.scale or vibration_scale(session.bench, motion.axes)
    rows = judged_rows(session.bench, first, scale)
    before = vibration_m_s2(first, rows, scale)
    runs, trials = {"without": first}, []
    several = len(cancellation.tables) > 1
    for only in (None, *(cancellation.tables if several else ())):
        what = f"{100.0 * gain:g} % of it" + ("" if only is None else f" on axis {only} alone")
        reporter.step(f"trial of the cancellation: {what}")
        recording = _run(session, motion, filters, cancellation.adder(gain, only), shows_filter)
        runs["all" if only is None else f"axis{only}"] = recording
        rms_m_s2 = vibration_m_s2(recording, rows[: len(recording.time_s)], scale)
        trials.append(
            Trial(what, rms_m_s2, 1.0 - rms_m_s2 / max(before, 1e-30), LEAST_FRACTION * gain if only is None else -WORSE)
        )
    return Verification(before, gain, tuple(trials), runs)


def _run(session: Session, motion: Motion, filters: FilterUse, adder: CancellationAdder | None, shows_filter: bool) -> Recording:
    session.check_interrupt()
    result: RunResult = session.run(motion, filters, "drive", adder, shows_filter=shows_filter)
    if result.stopped is not None:
        raise result.stopped
    return result.recording


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


@dataclass(frozen=True)
class Choice:
    """Choice after a trial: the cancellation, or the notch where it was refused.

    Attributes:
        adder: Adder of one run, each needs a new one (`Cancellation.adder`); None where the cancellation was refused.
        filters: Filters of the drives that act.
        verification: Runs of the trial.
        refusal: Reason why the cancellation is not used, or None.
    """

    adder: CancellationAdder | None
    filters: FilterUse
    verification: Verification
    refusal: CancellationRefusedError | None


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
    """Try a cancellation, and choose for the motion: the cancellation, or the notch where it is refused.

    Args:
        session: Session that has been brought up.
        cancellation: Cancellation of the motion's axes.
        motion: The very motion that is to be run.
        with_notch: True where the filters act beside it; after a refusal they act alone, where the bench has any.
        gain: Fraction that is tried.
        shows_filter: True where the drives report their filters' state.
        reporter: Listener of each run.

    Raises:
        HilError: As `verify`.
    """
    filters: FilterUse = "notch" if with_notch else "none"
    verification = verify(session, cancellation, motion, filters, gain=gain, shows_filter=shows_filter, reporter=reporter)
    try:
        verification.demand()
    except CancellationRefusedError as refusal:
        has_notch = any(session.bench.axis[number].notch for number in motion.axes)
        return Choice(None, "notch" if has_notch else "none", verification, refusal)
    return Choice(cancellation.adder(), filters, verification, None)


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
        gain: Fraction that is tried.
        reporter: Listener of each run.

    Raises:
        HilError: As `verify`, and as `cancel_inside`.
    """
    reporter.step("trial of the cancellation in the drives: without")
    first = _run(session, motion, "none", None, shows_filter=True)
    scale = vibration_scale(session.bench, motion.axes, identified)
    rows = judged_rows(session.bench, first, scale)
    before, what = vibration_m_s2(first, rows, scale), f"{100.0 * gain:g} % of it in the drives"
    reporter.step(f"trial of the cancellation: {what}")
    cancel_inside(session, identified, motion.axes, gain)
    second = _run(session, motion, "none", None, shows_filter=True)
    rms_m_s2 = vibration_m_s2(second, rows[: len(second.time_s)], scale)
    trial = Trial(what, rms_m_s2, 1.0 - rms_m_s2 / max(before, 1e-30), LEAST_FRACTION * gain)
    verification = Verification(before, gain, (trial,), {"without": first, "all": second})
    if trial.is_good:
        return Choice(None, "none", verification, None)
    has_notch = any(session.bench.axis[number].notch for number in motion.axes)
    refusal = CancellationRefusedError(trial.what, trial.reduction_fraction, trial.needed_fraction)
    return Choice(None, "notch" if has_notch else "none", verification, refusal)
