"""Trial of a cancellation at the tip.

A cancellation is used only after it has lowered the vibration.

An order whose cancellation is wrong by more than 60° vibrates more with it. So the motion runs without the cancellation, then
with a small fraction of it on all axes and on each, then with the whole. Each order of each axis is judged for itself
(`verdict`), by its own complex amplitude at the tip (`effect`). Orders that are wrong, or whose effect is too small to be
seen, are left out; if no order remains, the cancellation is refused, and the notch stays. An order that the motion hides is
judged on a slow ramp through its resonance (`ramp_trial`), if the limits leave room for one.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hil.analysis import TipScale
from hil.bench.model import Identified
from hil.control.arrays import Real
from hil.control.cancellation_table import CancellationTable
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.cancellation.cancellation import Cancellation, CancellationAdder
from hil.experiments.cancellation.effect import AxisWaves, Look, Part, Response, alike, refined, sight
from hil.experiments.cancellation.images import acting, images_m_s2
from hil.experiments.cancellation.inside import cancel_inside, inside_models
from hil.experiments.cancellation.line_trial import is_line_of_arm, refused_by_vector, verify_on_line
from hil.experiments.cancellation.ramp_trial import ramp_through, seen_by_direction
from hil.experiments.cancellation.remainder import TrialView, remainder
from hil.experiments.cancellation.verdict import PartVerdict, Seen, judge
from hil.experiments.cancellation.verification import CancellationRefusedError, Trial, Verification
from hil.experiments.cancellation.waves import judged_rows, response_of, seen_rows, vibration_m_s2, waves_of
from hil.experiments.decision import MOST_RUNS
from hil.experiments.judge import axis_scale, check_shown, vibration_scale
from hil.experiments.peaks import Windows
from hil.master.motion import FilterUse, Motion, RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter

ON_RAMPS = "with slow ramps, "
"""Where a part is judged that the motion hides: by the motion and slow ramps together."""
PROBE_GAIN = 0.3
"""Bound: fraction that is tried first: a correction three times too large, turned by 180°, adds 0.9 of the vibration."""


def averaged(recordings: Sequence[Recording]) -> Recording:
    """Average recordings of the same motion, row by row.

    The sensor's noise falls with the root of their number.

    Raises:
        ValueError: There is no recording, or they are not of the same motion.
    """
    shapes = {(tuple(recording.columns), len(recording.time_s)) for recording in recordings}
    if len(shapes) != 1:
        raise ValueError(f"recordings of {len(shapes)} shapes cannot be averaged; all {len(recordings)} must have the same shape")
    first = recordings[0].columns
    doubt = next((recording.doubt for recording in recordings if recording.doubt is not None), None)
    return Recording({name: np.mean([recording.columns[name] for recording in recordings], axis=0) for name in first}, doubt)


Runner = Callable[[Motion, float, int | None, frozenset[Part]], Recording]
"""What runs a motion: with a fraction of the cancellation, on one axis alone or on all, without some parts."""


class _Protocol:
    """Runs of a trial and their verdicts, for host and drives alike."""

    def __init__(
        self,
        session: Session,
        motion: Motion,
        parts: Sequence[Part],
        responses: Mapping[int, Response],
        scale: TipScale,
        run: Runner,
        reporter: Reporter,
        tables: Mapping[int, CancellationTable] | None = None,
    ) -> None:
        self._session, self._bench, self._motion, self._parts = session, session.bench, motion, tuple(parts)
        self._responses = responses
        self._scale, self._run, self._reporter = scale, run, reporter
        self._tables = tables or {}
        self._trials: list[Trial] = []
        self._looks: list[Look] = []
        self._axes: tuple[AxisWaves, ...] = ()
        self._rows = self._judged = np.zeros(0, dtype=np.bool_)

    def perform(self) -> Verification:
        """Make the runs that the verdicts need.

        Raises:
            NotPossibleError: The motion does not excite the arm, or the SYNC period is too long to show its vibration.
        """
        check_shown("a trial of the cancellation", self._motion.period_s, self._scale)
        alone = sorted({part.axis for part in self._parts})
        alone = alone if len(alone) > 1 else []
        least, most = 3 + len(alone), 1 + len(alone) + 2 * MOST_RUNS
        self._reporter.step(
            f"trial of the cancellation: untreated; {least} runs of {self._motion.time_s[-1]:.1f} s in all, at most {most}; "
            f"2 to {2 * MOST_RUNS} slow ramps more for each axis with an order that the motion hides"
        )
        self._add("untreated", 0.0)
        percent = f"{100.0 * PROBE_GAIN:g} % of the cancellation"
        for only, what in ((None, percent), *((axis, f"{percent} on axis {axis} alone") for axis in alone)):
            self._reporter.step(f"trial of the cancellation: {what}")
            self._add(what, PROBE_GAIN, only)
        self._refine(2 + len(alone))
        verdicts = self._verdicts()
        for number in range(1, MOST_RUNS + 1):
            wrong = _wrong(verdicts)
            if len(wrong) == len(self._parts):
                break
            if number > 1 and _open(verdicts, number - 1):
                self._reporter.step("trial of the cancellation: untreated, once more, for the mean")
                self._add("untreated, once more", 0.0)
            what = "the whole cancellation" + (f" but {', '.join(part.words for part in sorted(wrong))}" if wrong else "")
            self._reporter.step(f"trial of the cancellation: {what}")
            self._add(what, 1.0, None, wrong)
            verdicts = self._verdicts()
            if _wrong(verdicts) == wrong and not _open(verdicts, number):
                break
        verdicts |= self._on_ramps(verdicts)
        first = self._trials[0].recording
        windows = Windows.of(first, self._rows[: len(first.time_s)], self._scale)
        verdicts |= self._risen(windows, verdicts)
        used = tuple(part for part, verdict in verdicts.items() if verdict.verdict == "accepted")
        looks, rows = tuple(self._looks), self._rows
        seen = TrialView(looks, used, windows, first, rows, self._axes, self._scale)
        left = remainder(seen, self._tables, self._bench.specification.quiet_mm) if used else None
        return Verification(PROBE_GAIN, tuple(self._trials), tuple(verdicts.values()), left)

    def _on_ramps(self, verdicts: Mapping[Part, PartVerdict]) -> dict[Part, PartVerdict]:
        """Verdicts of parts that the motion hides, with slow ramps of their axis."""
        found: dict[Part, PartVerdict] = {}
        for axis in self._axes:
            hidden = [part for part, each in verdicts.items() if part.axis == axis.number and each.verdict == "not judged"]
            if not hidden:
                continue
            orders, scale = [part.order for part in hidden], axis_scale(self._bench, axis.number) or self._scale
            words = f"trial of the cancellation: axis {axis.number}, order {', '.join(f'{each:g}' for each in orders)}"
            stands_rad = self._session.axes[axis.number].position_rad()
            seen = {part.order: self._seen(part, 0) for part in hidden}
            try:
                ramp = ramp_through(self._bench, axis.number, orders, scale.f_al_hz, self._motion, stands_rad)
                for number in range(1, MOST_RUNS + 1):
                    for gain, what in ((0.0, "untreated"), (1.0, "with the whole cancellation")):
                        once_more = "" if number == 1 else ", once more, for the mean"
                        self._reporter.step(
                            f"{words}: hidden; a ramp to {ramp.ramp.end_rps:.2f} rev/s shows it, {what}{once_more}"
                        )
                        recording = self._run(ramp.motion, gain, axis.number, _wrong(verdicts))
                        acted = acting(self._tables, dict.fromkeys(set(self._parts) - _wrong(verdicts), gain))
                        read = seen_by_direction(
                            self._bench, recording, ramp, axis.response, axis.orders, orders, gain, scale, acted
                        )
                        for order, sights in read.items():
                            seen[order] += sights
                    judged = {part: replace(judge(part, 1.0, seen[part.order]), where=ON_RAMPS) for part in hidden}
                    if not _open(judged, number):
                        break
            except (NotPossibleError, UnsafeRequestError) as error:
                self._reporter.step(f"{words}: hidden, and no ramp can show it: {error}")
                continue
            found |= {part: verdict for part, verdict in judged.items() if verdict.verdict != "not judged"}
        return found

    def _risen(self, windows: Windows, verdicts: Mapping[Part, PartVerdict]) -> dict[Part, PartVerdict]:
        """Refusals of all parts if the tip's largest peak rises."""
        used = [part for part, verdict in verdicts.items() if verdict.verdict == "accepted"]
        change = None
        while used and (change is None or change.rises.is_open) and len(self._alike(used)) < MOST_RUNS:
            if change is not None and len(self._alike(())) <= len(self._alike(used)):
                self._reporter.step("trial of the cancellation: untreated, once more, for the tip's peak")
                self._add("untreated, once more", 0.0)
            if change is not None or not self._alike(used):
                what = "the accepted orders, for the tip's peak"
                self._reporter.step(f"trial of the cancellation: {what}")
                self._add(what, 1.0, None, frozenset(self._parts) - set(used))
            change = windows.largest(self._alike(()), self._alike(used))
        if change is None or not change.rises.is_likely:
            return {}
        return {part: replace(verdicts[part], verdict="refused", rise=change.words) for part in used}

    def _alike(self, used: Collection[Part]) -> list[Real]:
        """Vibration in the runs in which exactly these parts acted."""
        return [look.sighting.vibration for look in alike(self._looks, used)]

    def _add(self, what: str, gain: float, only: int | None = None, without: frozenset[Part] = frozenset()) -> None:
        """Make one run, and read it."""
        recording = self._run(self._motion, gain, only, without)
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
        self._looks.append(self._look(self._trials[-1]))

    def _refine(self, count: int) -> None:
        """Refine the responses on the first runs, and read those anew."""
        recordings = [trial.recording for trial in self._trials[:count]]
        rows = [self._rows[: len(recording.time_s)] for recording in recordings]
        images = [self._images(trial) for trial in self._trials[:count]]
        self._axes = refined(recordings, self._axes, rows, self._scale.band_hz, images)
        self._looks = [self._look(trial) for trial in self._trials]

    def _look(self, trial: Trial) -> Look:
        rows = self._rows[: len(trial.recording.time_s)]
        return Look(trial.gains, sight(trial.recording, self._axes, rows, self._scale.band_hz, self._images(trial)))

    def _images(self, trial: Trial) -> Real:
        """What images of the set-points do in a run."""
        return images_m_s2(trial.recording, self._axes, acting(self._tables, trial.gains))

    def _verdicts(self) -> dict[Part, PartVerdict]:
        return {part: judge(part, PROBE_GAIN, self._seen(part, 1)) for part in self._parts}

    def _seen(self, part: Part, direction: int) -> list[Seen]:
        """What all runs of the motion show of a part."""
        return [Seen.of(look.sighting, part, look.gains[part], direction) for look in self._looks]


def _wrong(verdicts: Mapping[Part, PartVerdict]) -> frozenset[Part]:
    return frozenset(part for part, verdict in verdicts.items() if verdict.verdict == "refused")


def _open(verdicts: Mapping[Part, PartVerdict], wholes: int) -> bool:
    """True if more runs with the whole could judge a part."""
    return any(verdict.could_be_judged(MOST_RUNS / wholes) for verdict in verdicts.values())


def verify(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    filters: FilterUse = "none",
    *,
    shows_filter: bool = True,
    reporter: Reporter = SILENT,
) -> Verification:
    """Try a cancellation on the robot.

    The motion runs without it, with a fraction, with that on each axis alone, and with the whole.

    Args:
        motion: The very motion that is to be run with it; it must excite the arm.

    Raises:
        NotPossibleError: The motion does not excite the arm.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """

    def run(moved: Motion, part_of: float, only: int | None, without: frozenset[Part]) -> Recording:
        adder = None
        if part_of > 0.0:
            made = cancellation.without(without)
            if moved is not motion:
                made = made.on(moved.axes)
                made.check(session.bench, moved, [session.axes[number].position_rad() for number in moved.axes])
            adder = made.adder(part_of, only)
        return _run(session, moved, filters, adder, shows_filter)

    is_arm = is_line_of_arm(session.bench, motion)
    if is_arm and cancellation.is_learnt_on_motion:
        return verify_on_line(session.bench, cancellation.parts, PROBE_GAIN, partial(run, motion), reporter)
    scale = cancellation.scale or vibration_scale(session.bench, motion.axes)
    protocol = _Protocol(session, motion, cancellation.parts, cancellation.responses, scale, run, reporter, cancellation.tables)
    found = protocol.perform()
    return refused_by_vector(session.bench, found) if is_arm else found


def _run(session: Session, motion: Motion, filters: FilterUse, adder: CancellationAdder | None, shows_filter: bool) -> Recording:
    session.check_interrupt()
    result: RunResult = session.run(motion, filters, "drive", adder, shows_filter=shows_filter)
    if result.stopped is not None:
        raise result.stopped
    return result.recording


@dataclass(frozen=True)
class Choice:
    """Parts of a cancellation that passed its trial, or the notch without any.

    Attributes:
        cancellation: Cancellation without the parts that did not pass; None if it was refused, or the drives cancel.
        filters: Filters of the drives that act.
        refusal: Reason why the cancellation is not used, or None.
    """

    cancellation: Cancellation | None
    filters: FilterUse
    verification: Verification
    refusal: CancellationRefusedError | None

    @property
    def adder(self) -> CancellationAdder | None:
        """Adder of one run, or None."""
        return None if self.cancellation is None else self.cancellation.adder()


def choose(
    session: Session,
    cancellation: Cancellation,
    motion: Motion,
    *,
    with_notch: bool = False,
    is_shaped: bool = False,
    shows_filter: bool = True,
    reporter: Reporter = SILENT,
) -> Choice:
    """Try a cancellation; choose the parts that pass, or the notch.

    Args:
        motion: The very motion that is to be run.
        with_notch: True if the filters act beside it; after a refusal they act alone, where the bench has any.
        is_shaped: True if a shaper has shaped the motion, for a loop without filters; after a refusal it acts alone.

    Raises:
        HilError: As `verify`.
    """
    filters: FilterUse = "notch" if with_notch else "none"
    verification = verify(session, cancellation, motion, filters, shows_filter=shows_filter, reporter=reporter)
    return _chosen(session, motion, filters, verification, cancellation, is_shaped=is_shaped)


def _chosen(
    session: Session,
    motion: Motion,
    filters: FilterUse,
    verification: Verification,
    cancellation: Cancellation | None,
    *,
    is_shaped: bool = False,
) -> Choice:
    try:
        verification.demand("the shaper" if is_shaped else "the notch")
    except CancellationRefusedError as refusal:
        if not is_shaped:
            filters = "notch" if any(session.bench.axis[number].notch for number in motion.axes) else "none"
        return Choice(None, filters, verification, refusal)
    kept = None if cancellation is None else cancellation.without(verification.left_out)
    return Choice(kept, filters, verification, None)


def choose_inside(session: Session, identified: Identified | None, motion: Motion, *, reporter: Reporter = SILENT) -> Choice:
    """Try a cancellation inside the drives; choose it, or the notch.

    Raises:
        HilError: As `verify`, and as `cancel_inside`.
    """
    bench = session.bench
    models = inside_models(bench, identified, motion.axes)
    parts = tuple(Part(number, order) for number, model in models.items() for order in model.ate.amplitudes_arcsec())

    def run(moved: Motion, part_of: float, only: int | None, without: frozenset[Part]) -> Recording:
        if part_of > 0.0:
            others = {part for part in parts if only is not None and part.axis != only}
            cancel_inside(session, identified, moved.axes, part_of, without | others)
        return _run(session, moved, "none", None, shows_filter=True)

    known = {number: response_of(bench, identified, number) for number in motion.axes}
    responses = {number: response for number, response in known.items() if response is not None}
    scale = vibration_scale(bench, motion.axes, identified)
    verification = _Protocol(session, motion, parts, responses, scale, run, reporter).perform()
    return _chosen(session, motion, "none", verification, None)
