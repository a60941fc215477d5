"""Runs of a motion that is probed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hil.bench.bench import Bench
from hil.bench.model import Identified
from hil.control.arrays import Real
from hil.counting import counted
from hil.design.probing import Effects, balanced_signs, effects_of
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.ate.checks import check_run
from hil.experiments.cancellation.cancellation import Cancellation, cancellation_on
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.motion import settings_of, smoothed, values_by_part, with_values
from hil.experiments.cancellation.probing.record import MotionLearning, MotionRun, MotionRunKeeper, RunKind
from hil.experiments.cancellation.waves import ProbedRows
from hil.experiments.window import check_range
from hil.master.session import Session
from hil.reporter import Reporter

BASE_RUNS = 3
"""Bound: runs without any cancellation: before the probes, in their middle, and behind them, so that a drift is noise as well."""


def paced(bench: Bench, pace: float) -> Bench:
    """Slow down or speed up the line of a bench file."""
    line = bench.line_motion
    if pace == 1.0 or line is None:
        return bench
    return bench.model_copy(update={"line_motion": line.model_copy(update={"duration_s": pace * line.duration_s})})


class Runs:
    """The runs of a motion that is probed.

    Args:
        learning: Its record, to which each run is added.
    """

    def __init__(
        self, session: Session, learning: MotionLearning, known: Identified, keep: MotionRunKeeper | None, reporter: Reporter
    ) -> None:
        self._session, self.learning, self._known = session, learning, known
        self._keep, self._reporter = keep, reporter
        self.bench = paced(session.bench, learning.pace)
        """The bench file with the motion as these runs make it."""
        self.fixed: Mapping[Part, complex] = {}
        """What is cancelled in every run but the base runs, beside what is probed."""

    def say(self, what: str) -> None:
        """Announce the next step to the listener."""
        self._reporter.step(what)

    def base(self) -> MotionRun:
        """Run without any cancellation."""
        count = len(self.learning.of_kind("base")) + 1
        which = f"base run {count} of {BASE_RUNS}" if self.learning.pace == 1.0 else "base run"
        self._reporter.step(f"{which}: without any cancellation")
        return self._run("base", {})

    def probe(self, parts: Sequence[Part], probes_arcsec: Real, level: Real | None = None) -> Effects:
        """Make probing runs, and runs at the level.

        The amplitude is that of each part's probe, which is added to the level; without a level, its runs are base runs.
        """
        middle = np.zeros(2 * len(parts)) if level is None else level
        settings, made = self._probes(parts, probes_arcsec, middle)  # all are checked before one moves
        seconds = float(self.learning.motion.time_s[-1])
        amplitudes = " to ".join(dict.fromkeys(f"{each:.1f}" for each in (np.min(probes_arcsec), np.max(probes_arcsec))))
        self._reporter.step(
            f"{len(settings)} probing runs of {seconds:.1f} s for {counted(len(parts), 'order')} of the axes, each cancelled by "
            f"{amplitudes}″ at one of four phases"
        )
        first = len(self.learning.runs) - 1  # the level has been run once
        for number, (row, cancellation) in enumerate(zip(settings, made, strict=True), start=1):
            self._reporter.step(f"probing run {number} of {len(settings)}")
            self._run("probe", values_by_part(parts, middle + row), cancellation)
            if 2 * number == len(settings):
                self._at_level(parts, level)
        self._at_level(parts, level)
        runs = self.learning.runs[first:]
        vectors = np.array([settings_of(parts, run.values) - middle for run in runs])
        found = effects_of(vectors, np.stack([run.felt_m_s2 for run in runs]))
        probed = self.learning.probed
        assert probed is not None  # noqa: S101 - of the first base run
        return smoothed(found, parts, runs[0].recording, probed.rows)

    def allowed(self, parts: Sequence[Part], probes_arcsec: Real, level: Real) -> Real:
        """Reduce probes about a level to fit the limits.

        They are as large as requested, or half of that. If neither fits, they are a quarter, which is not checked here.
        """
        for part_of in (1.0, 0.5):
            try:
                self._probes(parts, part_of * probes_arcsec, level)
            except UnsafeRequestError:
                continue
            return part_of * probes_arcsec
        return 0.25 * probes_arcsec

    def _probes(self, parts: Sequence[Part], probes_arcsec: Real, level: Real) -> tuple[Real, list[Cancellation]]:
        settings = np.repeat(probes_arcsec, 2) / math.sqrt(2.0) * balanced_signs(2 * len(parts))
        return settings, [self.cancellation(values_by_part(parts, level + row), "a probe") for row in settings]

    def _at_level(self, parts: Sequence[Part], level: Real | None) -> None:
        if level is None:
            self.base()
        else:
            self._reporter.step("once more with the values found so far")
            self.applied(parts, level)

    def applied(self, parts: Sequence[Part], vector: Real) -> MotionRun:
        """Run with settings of all parts."""
        values = values_by_part(parts, vector)
        return self._run("applied", values, self.cancellation(values, "the learnt cancellation"))

    def cancellation(self, values: Mapping[Part, complex], what: str) -> Cancellation:
        """Cancellation of some values, checked against the limits.

        Raises:
            UnsafeRequestError: It could exceed a limit.
        """
        learning = self.learning
        whole = {**self.fixed, **values}
        model = with_values(self._known, learning.motion, whole, learning.inertias, learning.scale.f_al_hz, learning.reactions)
        try:
            return cancellation_on(self._session, model, learning.motion)
        except UnsafeRequestError as error:
            remedy = "choose a smaller --probe-arcsec" if what == "a probe" else "check the motor's inertia"
            raise UnsafeRequestError(f"{what}: {error.what}", error.value, error.limit, error.unit, remedy) from error

    def _run(self, kind: RunKind, values: Mapping[Part, complex], cancellation: Cancellation | None = None) -> MotionRun:
        """Make one run, keep it and read it."""
        session, learning = self._session, self.learning
        session.check_interrupt()
        adder = None if cancellation is None else cancellation.adder()
        result = session.run(learning.motion, "none", "drive", adder, shows_filter=False)
        if self._keep is not None:
            self._keep(len(learning.all_runs) + 1, kind, result)
        if result.stopped is not None:
            raise result.stopped
        check_run(result, sensorless=False, sensor=session.bench.accelerometer.title)
        try:
            check_range(session.bench, result.recording)
            if learning.probed is None:
                learning.probed = ProbedRows.of(self.bench, result.recording, learning.scale)
            felt = learning.probed.acceleration_m_s2(result.recording)
            moved = learning.probed.displacement_mm(result.recording)
        except ValueError as error:
            raise NotPossibleError(f"not learnt: {error}") from error
        run = MotionRun(kind, dict(values), result.recording, felt, moved, learning.pace)
        learning.runs.append(run)
        learning.all_runs.append(run)
        return run
