"""Runs of experiments on a bench, one after the other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hil.analysis import TipScale
from hil.bench.bench import Bench
from hil.bench.model import with_identified
from hil.can.channel import Channel
from hil.control.treatments import treatment
from hil.errors import NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.experiments.cancellation.cancellation import Cancellation, cancellation_on, cancelled_orders
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.follow import FollowingSetUp, following_of
from hil.experiments.cancellation.follow_trial import FollowRun, try_following
from hil.experiments.cancellation.inside import cancel_inside
from hil.experiments.cancellation.trial import Choice, averaged, choose, choose_inside
from hil.experiments.filter_trial import at_rest, start_angles_rad, starting_at, try_filters
from hil.experiments.judge import RunJudge, check_shown, missing_words, motion_scale, vibration_scale
from hil.experiments.measurement import ClockName, Measurement, MeasurementOutcome
from hil.experiments.plan import NO_TRIAL, Experiment, TrialVerdict, claims, comparisons, entries, outside
from hil.experiments.shaping import check_stop, shaped_motion
from hil.experiments.treatment import Knowledge, TreatmentSetup, arm_remark, treatment_setup
from hil.master.motion import Motion, RunResult
from hil.master.request import check_motion
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.acted import CancelledOrder, acted_filters
from hil.results.runs import CancellationTrial, ExperimentsResult, PaperClaim, RunEntry, ShaperEntry


@dataclass(frozen=True)
class ExperimentsOutcome(MeasurementOutcome[ExperimentsResult]):
    """End of the runs of some experiments."""

    @property
    def stopped(self) -> SafetyStopError | None:
        """Stop that ended the runs early, or None."""
        return self.failure if isinstance(self.failure, SafetyStopError) else None

    @property
    def invalid(self) -> list[str]:
        """Reasons why windows could not be judged."""
        return [run.invalid for run in self.result.runs if run.invalid is not None]

    @property
    def unjudged(self) -> bool:
        """True if a run or a reachable order was not judged."""
        return any(run.invalid is not None or run.unjudged_orders for run in self.result.runs)

    @property
    def remarks(self) -> list[str]:
        """Sentences on treatments, cancellations, models and unjudged orders."""
        on_arm = [arm_remark(self.result.bench.file, run.treatment) for run in self.result.runs]
        sentences = [remark for remark in on_arm if remark is not None]
        for run in self.result.runs:
            where = "line motion" if run.axis is None else f"axis {run.axis}"
            if run.f_al_source == "own" and run.f_al_words is not None:
                sentences.append(f"{where}: {run.f_al_words}")
            sentences += [run.remark] if run.remark is not None and run.remark not in (run.invalid or "") else []
            sentences += [*(run.unjudged_orders or ()), *(run.unreached_orders or ())]
            if run.trial is not None and run.trial.remainder is not None:
                sentences.append(f"{where}: {run.trial.remainder.words}")
        for following in (run.following for run in self.result.runs if run.following is not None):
            sentences += [following.words or "", *(each.words for each in following.begins)]
            sentences += [each.words for each in following.orders]
        return [sentence for sentence in dict.fromkeys(sentences) if sentence]

    @property
    def trials(self) -> list[CancellationTrial]:
        """Trials of the cancellations, in their order."""
        tried = {run.recording: run.trial for run in self.result.runs if run.trial is not None}
        return list(tried.values())

    @property
    def outside(self) -> list[RunEntry]:
        """Runs with a treatment that leave the specification."""
        return outside(self.result.runs)

    @property
    def failed_claims(self) -> list[PaperClaim]:
        """Claims that do not hold."""
        return [claim for claim in self.result.paper if not claim.holds]


def run_experiments(
    bench: Bench,
    experiments: Sequence[Experiment],
    out: Path,
    *,
    is_paper: bool = False,
    reset_faults: bool = False,
    clock: ClockName | None = None,
    overload: bool = False,
    knowledge: Knowledge | None = None,
    repeat: int = 1,
    channel: Channel | None = None,
    reporter: Reporter = SILENT,
) -> ExperimentsOutcome:
    """Run experiments on one bus.

    Once a run has been recorded, its files and `result.json` are written, also after a failure.

    Args:
        is_paper: Check all claims of the paper, tables included; only for the robot of the paper.
        clock: The clock that the bus must have; None for whichever it has.
        knowledge: Knowledge beside the bench file; its identified models take precedence over the bench file's.
        repeat: Number of runs of each motion; the mean of their recordings is judged, in which the sensor's noise is less.

    Raises:
        ValueError: The paper's claims are asked of another robot.
        NotPossibleError: The bus has another clock or does not carry a run, or a treatment lacks its file; nothing was sent.
        HilError: Nodes, limits or set-up do not allow the first run; all changes have been undone.
        ChannelError: The bus cannot be opened, or was lost before that.
    """
    knowledge = knowledge or Knowledge()
    bench = _known(bench, knowledge, is_paper=is_paper)
    arm = None if knowledge.identified is None else knowledge.identified.arm
    setups, shaped = _set_up(bench, experiments, knowledge)
    motions = [motion for motion, _ in shaped]
    demands = [experiment.bus_demand(motion) for experiment, motion in zip(experiments, motions, strict=True)]
    with Measurement(
        bench,
        out,
        lambda described: ExperimentsResult(bench=described, arm=arm, files=knowledge.files),
        channel=channel,
        reporter=reporter,
    ) as measurement:
        result, judge = measurement.result, RunJudge(bench, knowledge.identified)
        measurement.check_clock(clock)
        for experiment, motion in zip(experiments, motions, strict=True):
            check_band(bench, experiment, motion)
        with measurement.session(demands, overload=overload, reset_faults=reset_faults) as session:
            for experiment, (motion, shaper), setup, shows in zip(
                experiments, shaped, setups, measurement.shows_filter, strict=True
            ):
                reporter.run(experiment.title)
                runs = _ExperimentRuns(session, experiment, motion, replace(setup, shows_filter=shows), reporter)
                runs.perform(repeat)
                _enter(measurement, judge, experiment, runs, shaper)
        if is_paper:
            result.paper = claims(bench, result.runs, result.comparisons)
    return ExperimentsOutcome(measurement.result, measurement.failure)


def _known(bench: Bench, knowledge: Knowledge, *, is_paper: bool) -> Bench:
    """Add the identified models to a bench."""
    if is_paper and not bench.is_paper:
        raise ValueError(f"bench {bench.name!r} has reference = {bench.reference!r}; expected 'paper'")
    identified = knowledge.identified
    if identified is None:
        return bench
    identified.check_robot(bench.name)
    return with_identified(bench, identified)


def _set_up(
    bench: Bench, experiments: Sequence[Experiment], knowledge: Knowledge
) -> tuple[list[TreatmentSetup], list[tuple[Motion, ShaperEntry | None]]]:
    setups, shaped = [], []
    for experiment in experiments:
        check_stop(experiment.is_stop, experiment.treatment, experiment.loop)
        motion = experiment.motion(bench)
        setups.append(treatment_setup(bench, experiment.treatment, knowledge, motion.period_s, experiment.loop))
        if setups[-1].is_designed:
            _trial_scale(setups[-1].bench, experiment, motion)
        shaped.append(shaped_motion(bench, experiment.treatment, motion, knowledge.identified))
    return setups, shaped


def _trial_scale(bench: Bench, experiment: Experiment, motion: Motion) -> TipScale:
    scale = motion_scale(bench, experiment.axis)
    if scale is None:
        what = f"{experiment.treatment}: designed filters are tried on the robot first, in the windows where orders meet f_al"
        raise NotPossibleError(f"{what}; {missing_words(motion.axes)}")
    return scale


class _ExperimentRuns:
    """Runs of one experiment with its treatment.

    Attributes:
        results: Results of the runs; where one was stopped, that one alone.
        count: Number of runs that were begun.
    """

    def __init__(
        self, session: Session, experiment: Experiment, motion: Motion, setup: TreatmentSetup, reporter: Reporter
    ) -> None:
        self._session, self._experiment, self._motion, self._setup, self._reporter = session, experiment, motion, setup, reporter
        self._cancellation: Cancellation | None = None
        self._following: FollowingSetUp | None = None
        self._is_inside = setup.is_inside
        self._without: frozenset[Part] = frozenset()
        self._filters = setup.filters
        self.cancelled: tuple[CancelledOrder, ...] = ()
        self.results: list[RunResult] = []
        self.trial: TrialVerdict = NO_TRIAL
        self.count = 0

    def perform(self, repeat: int) -> None:
        """Make the trial, then run the motion `repeat` times."""
        self._session.check_interrupt()
        self._session.adopt(self._setup.bench)
        self._try()
        for number in range(1, repeat + 1):
            if repeat > 1:
                self._reporter.step(f"run {number} of {repeat}")
            self.count = number
            result = self._run()
            if result.stopped is not None:
                self.results = [result]
                return
            self.results.append(result)
            self._session.check_interrupt()

    def _try(self) -> None:
        """Try the treatment; if refused, run without it."""
        session, setup, motion = self._session, self._setup, self._motion
        if setup.is_cancelled:
            with_notch = setup.filters == "notch"
            cancellation = cancellation_on(session, setup.cancel_with, motion, with_notch=with_notch)
            is_shaped = treatment(self._experiment.treatment).shaper is not None
            try:
                choice = choose(
                    session, cancellation, motion, with_notch=with_notch, is_shaped=is_shaped, shows_filter=setup.shows_filter,
                    reporter=self._reporter,
                )  # fmt: skip
            except NotPossibleError as error:
                raise NotPossibleError(f"{self._experiment.treatment}: {error}", error.causes) from None
            self._accept(choice)
            self._cancellation = choice.cancellation
            self.cancelled = cancelled_orders(session.bench, setup.cancel_with, choice.cancellation)
            if setup.follows and choice.cancellation is not None:
                self._try_following(following_of(session.bench, setup.cancel_with, choice.cancellation, motion))
        elif setup.is_inside:
            choice = choose_inside(session, setup.cancel_with, motion, reporter=self._reporter)
            self._accept(choice)
            self._is_inside, self._without = choice.refusal is None, choice.verification.left_out
        elif setup.is_designed:
            self._try_filters()

    def _try_following(self, following: FollowingSetUp) -> None:
        """Try a cancellation that follows beside the one that has passed."""
        cancellation = following.cancellation

        def run(follows: bool) -> FollowRun:
            self._session.check_interrupt()
            adder = (following if follows else following.listening()).adder()
            result = self._session.run(
                self._motion, self._filters, self._experiment.loop, adder, shows_filter=self._setup.shows_filter
            )
            if result.stopped is not None:
                raise result.stopped
            return FollowRun(result.recording, adder.watched())

        bench = self._session.bench
        scale = cancellation.scale or vibration_scale(bench, self._motion.axes)
        entry, begins = try_following(bench, scale, run, self._reporter)
        self._following = following.beginning(begins) if entry.is_used else None
        self.trial = replace(self.trial, following=entry)

    def _try_filters(self) -> None:
        session, bench, axis = self._session, self._session.bench, self._experiment.axis
        scale = _trial_scale(bench, self._experiment, self._motion)
        model = None if axis is None else bench.axis[axis].model
        orders = () if model is None else tuple(model.ate.amplitudes_arcsec())

        def run(start_rad: float | None, acts: bool) -> Recording:
            session.check_interrupt()
            motion = self._motion if start_rad is None else starting_at(self._motion, start_rad, self._stands_rad())
            filters = self._filters if acts else "none"
            result = session.run(motion, filters, self._experiment.loop, shows_filter=self._setup.shows_filter)
            if result.stopped is not None:
                raise result.stopped
            return result.recording

        starts = [partial(run, start_rad) for start_rad in self._starts_rad()]
        session.adopt(at_rest(bench, self._motion.axes))
        trial = try_filters(bench, scale, starts, orders, self._reporter)
        session.adopt(bench)
        self._filters = self._filters if trial.is_good else "none"
        self.trial = TrialVerdict(refusal=trial.words or None, filters=trial)

    def _stands_rad(self) -> float:
        """Motor angle at which the only axis of the motion stands."""
        return self._session.axes[self._motion.axes[0]].position_rad()

    def _starts_rad(self) -> list[float | None]:
        """Angles at which trials of filters start, on the side on which the limits leave room.

        A motion of the tool, and one without room, has one start: where the axes stand.
        """
        motion, axes = self._motion, [self._session.axes[number] for number in self._motion.axes]
        if motion.starts_at_home or len(axes) > 1:
            return [None]
        here, turned = self._stands_rad(), start_angles_rad()
        for side in (1.0, -1.0):
            try:
                check_motion(starting_at(motion, side * max(turned), 0.0), axes, [here])
            except UnsafeRequestError:
                continue
            return [here + side * each for each in turned]
        return [here]

    def _accept(self, choice: Choice) -> None:
        refusal = None if choice.refusal is None else str(choice.refusal)
        trials = choice.verification.trials
        plain = trials[0].recording if trials else None
        self._filters, self.trial = choice.filters, TrialVerdict(choice.verification.entry(), refusal, plain=plain)

    def _run(self) -> RunResult:
        setup, motion = self._setup, self._motion
        follower = None if self._following is None else self._following.adder()
        plain = None if self._cancellation is None or follower is not None else self._cancellation.adder()
        if self._is_inside:
            self.cancelled = cancel_inside(self._session, setup.cancel_with, motion.axes, without=self._without)
        result = self._session.run(
            motion, self._filters, self._experiment.loop, follower or plain, setup.fixed, shows_filter=setup.shows_filter
        )
        if follower is not None and self.trial.following is not None:
            entry = self.trial.following.model_copy(update={"orders": follower.followed()})
            self.trial = replace(self.trial, following=entry)
        return result


def _enter(
    measurement: Measurement[ExperimentsResult],
    judge: RunJudge,
    experiment: Experiment,
    runs: _ExperimentRuns,
    shaper: ShaperEntry | None,
) -> None:
    """Save the runs of an experiment, and enter them into the result.

    Raises:
        SafetyStopError: The last run was stopped.
    """
    result = measurement.result
    one, path = _keep(measurement, runs.results, experiment.file_name)
    made = entries(judge.bench, experiment, one, path, runs.trial, runs.count, judge)
    acted = {"shaper": shaper, "filters": acted_filters(experiment.loop, one.filters), "cancelled": runs.cancelled}
    result.runs += [entry.model_copy(update=acted) for entry in made]
    result.comparisons = comparisons(result.runs)
    if one.stopped is not None:
        raise one.stopped


def _keep(measurement: Measurement[ExperimentsResult], results: list[RunResult], file_name: str) -> tuple[RunResult, str]:
    """Save the runs of one motion, and choose the judged result."""
    stem = Path(file_name).stem
    result = results[0] if len(results) == 1 else mean_of(results)
    for number, each in enumerate(results if len(results) > 1 else (), start=1):
        measurement.keep(each.recording, f"{stem}-{number}")
    return result, measurement.keep(result.recording, stem)


def mean_of(results: list[RunResult]) -> RunResult:
    """Average several runs of the same motion."""
    return replace(
        results[-1],
        recording=averaged([result.recording for result in results]),
        missed_cycles=max(result.missed_cycles for result in results),
        sensor_missed=max(result.sensor_missed for result in results),
        dropped_cycles=max(result.dropped_cycles for result in results),
        discarded=max(result.discarded for result in results),
    )


def check_band(bench: Bench, experiment: Experiment, motion: Motion) -> None:
    """Refuse a SYNC period that is too long to judge vibration.

    Raises:
        NotPossibleError: The period is too long.
    """
    scale = motion_scale(bench, experiment.axis)
    if scale is None:
        return
    check_shown(experiment.title, motion.period_s, scale)
