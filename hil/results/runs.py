"""Result of `hil run` and of the demo's first part."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from hil.analysis import PAPER_WINDOWS_RPS, Direction, DirectionMetrics
from hil.bench.model import IdentifiedArm
from hil.control.shapers import SwingingMode
from hil.master.lateness import WallClockTiming
from hil.results.acted import ActedFilter, CancelledOrder, SourceFile
from hil.results.base import MadeRun, MeasuredResult, ResultPart
from hil.results.following import FollowingEntry


@dataclass(frozen=True)
class RunTiming(WallClockTiming):
    """Punctuality of a run on the wall clock, and the motion's dropped cycles."""

    dropped_cycles: int


class TrialRun(ResultPart):
    """One run of a trial against the run without cancellation.

    Attributes:
        reduction_fraction: Fraction by which the vibration is below that of the run without.
    """

    what: str
    rms_m_s2: float
    reduction_fraction: float


class TrialPart(ResultPart):
    """One order of one axis in the trial: `hil.experiments.cancellation.verdict.PartVerdict`.

    Attributes:
        verdict: `accepted`; `refused` if it is wrong; `not judged` if its effect is too small to measure. Only accepted orders
            are used.
        expected_fall_fraction: Fraction by which a right cancellation lowers this order when the tried fraction of it acts.
        fall_fraction: Fraction by which this order fell with it.
        left_fraction: Fraction of this order that the whole cancellation leaves.
    """

    axis: int
    order: float
    verdict: Literal["accepted", "refused", "not judged"]
    expected_fall_fraction: float
    fall_fraction: float
    fall_error: float
    left_fraction: float
    left_error: float
    factor: float | None
    factor_error: float | None
    turn_deg: float | None
    turn_error_deg: float | None
    words: str


RemainderCause = Literal[
    "speed limit", "frequency limit", "order left out", "gear reaction", "estimate", "sensor noise", "not explained"
]
"""Causes of what a cancellation leaves: `hil.experiments.cancellation.remainder`."""


class CancellationRemainder(ResultPart):
    """Vibration that a cancellation leaves, by its trial's own recordings.

    Attributes:
        order: Order of the window in which most is left; None for the only one of a line motion.
        left_mm: The tip's peak in it, the sensor's noise taken off.
        asked_mm: Required tip peak: that of the bench file, or 1.3 times `jolt_mm`.
        jolt_mm: The tip's peak by the motion itself, without any order.
        noise_mm: Tip's peak that may hide in the sensor's noise.
        causes: Causes of a larger peak, that of the worst window first; empty without one.
        words: All of it as a line of text, with what to do.
    """

    order: float | None
    left_mm: float
    asked_mm: float
    jolt_mm: float
    noise_mm: float
    causes: tuple[RemainderCause, ...]
    words: str


class CancellationTrial(ResultPart):
    """Trial of a cancellation at the tip, before the run.

    Attributes:
        before_m_s2: Vibration without it.
        is_good: True if at least one order of one axis is accepted, and used.
        trials: Runs with the tried fraction on all axes, on each alone if there are several, and with the whole.
        remainder: Remaining vibration, and its causes; None without cancellation.
    """

    before_m_s2: float
    gain: float
    is_good: bool
    trials: tuple[TrialRun, ...]
    parts: tuple[TrialPart, ...] = ()
    remainder: CancellationRemainder | None = None

    @property
    def refused(self) -> tuple[TrialPart, ...]:
        """Orders of axes whose cancellation is wrong, and is not used."""
        return tuple(part for part in self.parts if part.verdict == "refused")

    @property
    def left_out(self) -> tuple[TrialPart, ...]:
        """Orders of axes that are not cancelled."""
        return tuple(part for part in self.parts if part.verdict != "accepted")


class FilterTrialPeak(ResultPart):
    """The tip's peak in one window without and with filters.

    Attributes:
        order: Order of the window; None for the only one of a line motion.
        after_mm: Peak with the filters.
    """

    order: float | None
    before_mm: float
    after_mm: float
    error_mm: float


class FilterTrial(ResultPart):
    """Trial of designed filters at the tip, before the run.

    Attributes:
        is_good: True if the tip's peak rises in no window and falls in one; else the run is made without them.
        peaks: The peak in each window from the start that is worst for it, the worst first.
        words: Refusal in words; empty if they are good.
    """

    is_good: bool
    runs: int
    peaks: tuple[FilterTrialPeak, ...]
    words: str


class ShaperEntry(ResultPart):
    """An input shaper of a motion, and its cost: `hil.control.shapers`.

    Attributes:
        name: Its name: `zv`, `zvd`, `mzv`, `ei` or `two-hump-ei`.
        left: Other modes.
        duration_s: Additional duration of the motion.
        remaining_fraction: Remaining vibration V of the modes, as a part of that without shaper.
        remaining_low_fraction: The same if their frequencies are a tenth lower than assumed.
        remaining_high_fraction: The same if they are a tenth higher.
        path_error_mm: Largest distance of the set-points' tip from the line; None if a single axis moves.
    """

    name: str
    modes: tuple[SwingingMode, ...]
    left: tuple[SwingingMode, ...] = ()
    amplitudes: tuple[float, ...]
    times_s: tuple[float, ...]
    duration_s: float
    delay_s: float
    remaining_fraction: float
    remaining_low_fraction: float
    remaining_high_fraction: float
    path_error_mm: float | None = None


class RingingMode(ResultPart):
    """Ringing of a mode after a stop: `hil.design.modes.ring_down`.

    Attributes:
        amplitude_mm: Amplitude of the tip when the set-points stop.
    """

    frequency_hz: float
    damping: float
    amplitude_mm: float
    error_mm: float


class RunEntry(MadeRun):
    """One run in one window.

    Attributes:
        experiment: `constant-acceleration`, `line-motion` or `point-to-point`, whose tip peak is what rings after the stop.
        axis: The axis that moves alone; None for the line motion.
        order: Order k of the window; None for the line motion, and for a run that was stopped.
        tip_peak_mm: Largest tip displacement, see `hil.analysis.Metrics` like the next four; None if it could not be judged.
        spectrum_area: Area of the spectrum, m/s²·Hz.
        within_spec: True if the tip keeps the specification; None if the run was not judged.
        bus_errors: Error reports of the CAN controller, with their counts.
        timing: Punctuality of the cycles; None in lock-step.
        repeated: Number of runs in the recording's mean.
        ramp_peak_mm: Largest tip displacement on the whole ramp, without the jerks at its ends; None for the line motion.
        f_al_hz: Frequency by which the run is judged: the peak of |G_al|; None if it is not known, and nothing is judged.
        f_al_source: `model`, or `own` from the run's own vibration.
        f_al_error_hz: Standard error of an f_al from the run's own vibration.
        f_al_words: f_al and its source, as a line.
        remark: Sentence on an f_al of a model that the run itself does not show.
        window_rps: Motor speeds of the window; None for the line motion.
        order_mm: Largest amplitude of the order itself in the window, as a displacement; None if it cannot be tracked.
        directions: The tip along x, y and z of the base frame and along the worst direction, on a bench with an arm; the numbers
            above are then those of the worst.
        unjudged_orders: Sentences on orders that the limits let meet f_al and the ramp does not: the run is not within.
        unreached_orders: Sentences on orders that cannot meet f_al within the limits.
        following: Effect of a cancellation that follows on each order, and its trial; None without one.
        filters: Filters that acted; empty if none did.
    """

    experiment: str
    axis: int | None
    treatment: str
    loop: str
    sync_period_s: float
    control_period_s: float
    order: int | None
    tip_peak_mm: float | None
    tip_rms_mm: float | None
    spectrum_peak_m_s2: float | None
    spectrum_peak_hz: float | None
    spectrum_area: float | None
    within_spec: bool | None
    motion_s: float
    bus_errors: dict[str, int] | None = None
    discarded_positions: int | None = None
    timing: RunTiming | None = None
    invalid: str | None = None
    trial: CancellationTrial | None = None
    filter_trial: FilterTrial | None = None
    repeated: int | None = None
    ramp_peak_mm: float | None = None
    f_al_hz: float | None = None
    f_al_source: Literal["model", "own"] | None = None
    f_al_error_hz: float | None = None
    f_al_words: str | None = None
    remark: str | None = None
    window_rps: tuple[float, float] | None = None
    band_hz: tuple[float, float] | None = None
    order_mm: float | None = None
    order_error_mm: float | None = None
    noise_mm: float | None = None
    directions: dict[Direction, DirectionMetrics] | None = None
    unjudged_orders: tuple[str, ...] | None = None
    unreached_orders: tuple[str, ...] | None = None
    following: FollowingEntry | None = None
    shaper: ShaperEntry | None = None
    ringing: tuple[RingingMode, ...] | None = None
    filters: tuple[ActedFilter, ...] = ()
    cancelled: tuple[CancelledOrder, ...] = ()


def leading(runs: Iterable[RunEntry]) -> list[RunEntry]:
    """Return the leading window of each run in their order.

    In the paper's windows it is that of order 2, by which the paper judges. Otherwise it is one that could not be judged,
    or that of the largest tip peak: a run keeps a limit only if every order keeps it.
    """
    by_run: dict[str, list[RunEntry]] = {}
    for run in runs:
        by_run.setdefault(run.recording, []).append(run)
    return [_leading(windows) for windows in by_run.values()]


def _leading(windows: list[RunEntry]) -> RunEntry:
    paper = [run for run in windows if run.order == 2 and run.window_rps == PAPER_WINDOWS_RPS[2]]
    if paper:
        return paper[0]
    open_ = [run for run in windows if run.tip_peak_mm is None or run.invalid is not None]
    return open_[0] if open_ else max(windows, key=lambda run: run.tip_peak_mm or 0.0)


class TreatmentComparison(ResultPart):
    """Change by a treatment in percent of an untreated run."""

    experiment: str
    axis: int | None
    loop: str
    treatment: str
    tip_peak_reduction_pct: float
    spectrum_area_reduction_pct: float


class PaperClaim(ResultPart):
    """A number of the paper beside the bench's.

    Attributes:
        source: Section, figure or table of the paper.
        holds: True if the bench's number confirms the claim; None if it could not be judged.
    """

    claim: str
    source: str
    paper: int | float | str | None
    bench: int | float | str | None
    unit: str
    holds: bool | None


class ExperimentsResult(MeasuredResult):
    """Result of runs on one bench, one after the other.

    Attributes:
        runs: Entry for each window of each run.
        paper: Claims that the runs concern; empty if they ended early.
        arm: Masses of the arm as the model file had them; None without.
        files: Files that the runs took something from.
    """

    kind: Literal["run"] = "run"
    runs: list[RunEntry] = Field(default_factory=list)
    comparisons: list[TreatmentComparison] = Field(default_factory=list)
    paper: list[PaperClaim] = Field(default_factory=list)
    arm: IdentifiedArm | None = None
    files: tuple[SourceFile, ...] = ()
