"""The trial of a cancellation on the accelerometer: nothing is trusted that has not lowered the vibration.

A correction that is wrong by more than 60° makes the vibration worse. So the motion runs without it, then with a small share of
it, of all axes and of each. Where the vibration does not fall by at least half of what it should, the correction is refused, and
the notch stays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.analysis import LINE_WINDOW_S, WINDOWS_RPS, band_passed, motor_speed_rps
from hil.errors import HilError, NotPossibleError
from hil.experiments.cancellation import Cancellation, Canceller, cancel_inside
from hil.master.bench import Bench
from hil.master.identified import Identified
from hil.master.motion import Motion, RunResult
from hil.master.session import Compensation, Session
from hil.recording import Recording

Rows = NDArray[np.bool_]

PROBE_GAIN = 0.3
LEAST_SHARE = 0.5
"""Of the fall that a right correction brings: 45° of phase error still pass, 60° do not."""
WORSE = 0.02
"""By how much one axis' share may seem to raise the vibration: noise of the sensor, on an axis that has little part in it."""


class CancellationRefusedError(HilError):
    """The trial on the accelerometer speaks against the correction: it is not used, and the notch stays."""

    exit_code = 9

    def __init__(self, what: str, fall: float, needed: float) -> None:
        """Keep which correction, how far the vibration fell as a share, and how far it should have at least."""
        self.what, self.fall, self.needed = what, fall, needed
        change = f"fell by {100.0 * fall:.1f} %" if fall >= 0.0 else f"rose by {-100.0 * fall:.1f} %"
        super().__init__(
            f"cancellation refused: with {what} the vibration {change}, a fall of at least {100.0 * needed:.1f} % is needed; "
            "the notch stays"
        )


@dataclass(frozen=True)
class Trial:
    """One run of a trial against the run without correction.

    Attributes:
        what: What was corrected, in words.
        rms_m_s2: Vibration of the tip in the window, 6 to 25 Hz.
        fall: By which share it is below that of the run without.
        needed: By which it had to be.
    """

    what: str
    rms_m_s2: float
    fall: float
    needed: float

    @property
    def is_good(self) -> bool:
        """Whether it fell far enough."""
        return self.fall >= self.needed


@dataclass(frozen=True)
class Verification:
    """What a trial gave.

    Attributes:
        before_m_s2: Vibration without the correction.
        gain: Share of the correction that was tried.
        trials: All axes, then each alone where there are several.
        runs: Recordings by name.
    """

    before_m_s2: float
    gain: float
    trials: tuple[Trial, ...]
    runs: Mapping[str, Recording]

    @property
    def is_good(self) -> bool:
        """Whether the correction may be trusted."""
        return all(trial.is_good for trial in self.trials)

    def record(self) -> dict[str, Any]:
        """As result.json holds it."""
        trials = [{**vars(trial), "is_good": trial.is_good} for trial in self.trials]
        return {"before_m_s2": self.before_m_s2, "gain": self.gain, "is_good": self.is_good, "trials": trials}

    def demand(self) -> None:
        """Go on only with a good one.

        Raises:
            CancellationRefusedError: A trial speaks against it.
        """
        for trial in self.trials:
            if not trial.is_good:
                raise CancellationRefusedError(trial.what, trial.fall, trial.needed)


def judged_rows(bench: Bench, recording: Recording) -> Rows:
    """Rows in which vibration is compared: the line motion's window, or a single axis' speeds at which an order excites the arm.

    Raises:
        NotPossibleError: The motion passes no such speed.
    """
    if len(recording.axes) > 1 and bench.line_motion is not None:
        time, start = recording.time_s, bench.line_motion.dwell_s
        return np.asarray((time >= start + LINE_WINDOW_S[0]) & (time <= start + LINE_WINDOW_S[1]))
    speed = np.abs(motor_speed_rps(recording, recording.axes[0]))
    rows = np.zeros(len(speed), dtype=np.bool_)
    for low, high in WINDOWS_RPS.values():
        rows |= (speed >= low) & (speed <= high)
    if np.count_nonzero(rows) * recording.period_s < 0.1:
        raise NotPossibleError("a motion that does not excite the arm tells nothing of a correction")
    return rows


def vibration_m_s2(recording: Recording, rows: Rows) -> float:
    """Root mean square of the tip's vertical acceleration from 6 to 25 Hz in some rows."""
    return float(np.sqrt(np.mean(band_passed(recording.columns["tip_z_m_s2"], recording.period_s)[rows] ** 2)))


def verify(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    compensation: Compensation = "none",
    *,
    gain: float = PROBE_GAIN,
    shows_filter: bool = True,
    announce: Callable[[str], None] = lambda text: None,
) -> Verification:
    """Try a small share of a correction on the robot: the motion without, with, and with each axis' alone.

    Args:
        session: Brought up.
        cancellation: For the axes of the motion.
        motion: One that excites the arm: the very motion that is to be run with it.
        compensation: Whether the drives' filters act, in all of these runs.
        gain: The share.
        shows_filter: Whether the drives tell what their filters do.
        announce: Called before each run.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    announce("trial of the cancellation: without")
    first = _run(session, motion, compensation, None, shows_filter)
    rows = judged_rows(session.bench, first)
    before = vibration_m_s2(first, rows)
    runs, trials = {"without": first}, []
    several = len(cancellation.corrections) > 1
    for only in (None, *(cancellation.corrections if several else ())):
        what = f"{100.0 * gain:g} % of it" + ("" if only is None else f" on axis {only} alone")
        announce(f"trial of the cancellation: {what}")
        recording = _run(session, motion, compensation, cancellation.corrector(gain, only), shows_filter)
        runs["all" if only is None else f"axis{only}"] = recording
        found = vibration_m_s2(recording, rows[: len(recording.time_s)])
        trials.append(Trial(what, found, 1.0 - found / max(before, 1e-30), LEAST_SHARE * gain if only is None else -WORSE))
    return Verification(before, gain, tuple(trials), runs)


def _run(
    session: Session, motion: Motion, compensation: Compensation, corrector: Canceller | None, shows_filter: bool
) -> Recording:
    session.check_interrupt()
    result: RunResult = session.run(motion, compensation, "drive", corrector, shows_filter=shows_filter)
    if result.stopped is not None:
        raise result.stopped
    return result.recording


def averaged(recordings: Sequence[Recording]) -> Recording:
    """The mean of recordings of the same motion, row by row: the sensor's noise falls with the root of their number.

    Raises:
        ValueError: None, or not of the same motion.
    """
    shapes = {(tuple(recording.columns), len(recording.time_s)) for recording in recordings}
    if len(shapes) != 1:
        raise ValueError(f"{len(recordings)} recordings of {len(shapes)} kinds have no mean")
    first = recordings[0].columns
    return Recording({name: np.mean([recording.columns[name] for recording in recordings], axis=0) for name in first})


@dataclass(frozen=True)
class Choice:
    """What a motion is run with, after a trial.

    Attributes:
        corrector: For one run, each needs a new one (`Cancellation.corrector`); None where the cancellation was refused.
        compensation: Whether the drives' filters act.
        verification: What the trial gave.
        refusal: Why the cancellation is not used, or None.
    """

    corrector: Canceller | None
    compensation: Compensation
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
    announce: Callable[[str], None] = lambda text: None,
) -> Choice:
    """Try a cancellation, and say what the motion is to be run with: the cancellation, or where it is refused the notch.

    Args:
        session: Brought up.
        cancellation: For the axes of the motion.
        motion: The very motion that is to be run.
        with_notch: Whether the filters act beside it; a refused cancellation leaves them alone at work, where the bench has any.
        gain: Share that is tried.
        shows_filter: Whether the drives tell what their filters do.
        announce: Called before each run.

    Raises:
        HilError: As `verify`.
    """
    compensation: Compensation = "notch" if with_notch else "none"
    found = verify(session, cancellation, motion, compensation, gain=gain, shows_filter=shows_filter, announce=announce)
    try:
        found.demand()
    except CancellationRefusedError as refusal:
        has_notch = any(session.bench.axis[number].notch for number in motion.axes)
        return Choice(None, "notch" if has_notch else "none", found, refusal)
    return Choice(cancellation.corrector(), compensation, found, None)


def choose_inside(
    session: Session,
    identified: Identified | None,
    motion: Motion,
    *,
    gain: float = PROBE_GAIN,
    announce: Callable[[str], None] = lambda text: None,
) -> Choice:
    """Try a cancellation inside the drives; where it is refused, the notch is what a motion is run with.

    Args:
        session: Brought up.
        identified: The model file; None: what the bench file believes.
        motion: The very motion that is to be run.
        gain: Share that is tried.
        announce: Called before each run.

    Raises:
        HilError: As `verify`, and as `cancel_inside`.
    """
    announce("trial of the cancellation in the drives: without")
    first = _run(session, motion, "none", None, shows_filter=True)
    rows = judged_rows(session.bench, first)
    before, what = vibration_m_s2(first, rows), f"{100.0 * gain:g} % of it in the drives"
    announce(f"trial of the cancellation: {what}")
    cancel_inside(session, identified, motion.axes, gain)
    second = _run(session, motion, "none", None, shows_filter=True)
    found = vibration_m_s2(second, rows[: len(second.time_s)])
    trial = Trial(what, found, 1.0 - found / max(before, 1e-30), LEAST_SHARE * gain)
    verification = Verification(before, gain, (trial,), {"without": first, "all": second})
    if trial.is_good:
        return Choice(None, "none", verification, None)
    has_notch = any(session.bench.axis[number].notch for number in motion.axes)
    refusal = CancellationRefusedError(trial.what, trial.fall, trial.needed)
    return Choice(None, "notch" if has_notch else "none", verification, refusal)
