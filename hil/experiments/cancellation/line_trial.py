"""Trial of a cancellation on an arm's line.

The tip is judged as a vector: a cancellation that raises its peak along x, y or z is not used.

A cancellation that was learnt on a motion is judged as a whole: that motion is quiet with all its orders together, and no
model of the arm separates them. The trial runs without it, with a fraction, and with all of it, and repeats the first and the
last while the sensor's noise leaves the result open. Orders that were identified axis by axis are read one by one first
(`trial`), and then judged by the vector as well, since that reading covers one direction only.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.bench.bench import Bench
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.verdict import PartVerdict, Verdict
from hil.experiments.cancellation.verification import Trial, Verification
from hil.experiments.cancellation.waves import ProbedRows
from hil.experiments.decision import MOST_RUNS
from hil.experiments.judge import line_scale
from hil.experiments.peaks import PeakChange
from hil.experiments.window import NOISE_PEAK, noise_variance
from hil.master.motion import Motion
from hil.recording import Recording
from hil.reporter import Reporter
from hil.results.runs import CancellationRemainder, RemainderCause
from hil.tip_vector import noise_rms_mm, tip_acceleration

LineRunner = Callable[[float, int | None, frozenset[Part]], Recording]
"""What runs the motion: with a fraction of the cancellation, on one axis alone or on all, without some parts."""

WAYS = ("x", "y", "z", "the worst direction")


def is_line_of_arm(bench: Bench, motion: Motion) -> bool:
    """True for a line of an arm whose band is known."""
    return bench.arm is not None and len(motion.axes) > 1 and bench.line_motion is not None and line_scale(bench) is not None


def verify_on_line(bench: Bench, parts: Sequence[Part], gain: float, run: LineRunner, reporter: Reporter) -> Verification:
    """Try a cancellation on an arm's line as a whole."""
    trials: list[Trial] = []

    def add(what: str, fraction: float) -> Trial:
        reporter.step(f"trial of the cancellation: {what}")
        recording = run(fraction, None, frozenset())
        felt = _probed(bench, recording).acceleration_m_s2(recording)
        rms_m_s2 = math.sqrt(float(np.mean(np.sum(np.square(felt), axis=0))))
        made = Trial(what, recording, dict.fromkeys(parts, fraction), rms_m_s2)
        trials.append(made)
        return made

    without, part_of = [add("untreated", 0.0)], add(f"{100.0 * gain:g} % of the cancellation", gain)
    tried = _changes(bench, without, [part_of])
    if any(each.rises.holds for each in tried):
        return _judged(bench, gain, trials, parts, tried)
    whole = [add("the whole cancellation", 1.0)]
    while any(each.rises.is_open and each.rises.is_likely for each in _changes(bench, without, whole)) and len(whole) < MOST_RUNS:
        without.append(add("untreated, once more", 0.0))
        whole.append(add("the whole cancellation, once more", 1.0))
    return _judged(bench, gain, trials, parts, _changes(bench, without, whole))


def refused_by_vector(bench: Bench, found: Verification) -> Verification:
    """Refuse a cancellation that raises the tip's peak in any direction."""
    used = {verdict.part for verdict in found.verdicts if verdict.verdict == "accepted"}
    without = [trial for trial in found.trials if not any(trial.gains.values())]
    whole = [trial for trial in found.trials if all(gain == float(part in used) for part, gain in trial.gains.items())]
    if not used or not without or not whole:
        return found
    rise = _worst(_changes(bench, without, whole))
    if rise is None:
        return found
    verdicts = [replace(each, verdict="refused", rise=rise) if each.part in used else each for each in found.verdicts]
    return replace(found, verdicts=tuple(verdicts), remainder=None)


def _judged(
    bench: Bench, gain: float, trials: Sequence[Trial], parts: Sequence[Part], changes: Sequence[PeakChange]
) -> Verification:
    """The verdict on all parts as one."""
    size = {
        fraction: _rms([trial for trial in trials if set(trial.gains.values()) == {fraction}]) for fraction in (0.0, gain, 1.0)
    }
    before = size[0.0] or 1e-30
    tried, left = (size[gain] or before) / before, (size[1.0] or before) / before
    rise = _worst(changes)
    falls = rise is None and size[1.0] is not None and (left < 1.0 and not changes[-1].after_mm > changes[-1].before_mm)
    verdict: Verdict = "accepted" if falls else "refused"
    words = rise or f"the tip does not become quieter: {WAYS[-1]} {changes[-1].change}"
    verdicts = [
        PartVerdict(part, gain, 1.0 - tried, 0.0, left, 0.0, 0.0, None, None, None, None, verdict, "" if falls else words)
        for part in parts
    ]
    rest = _remainder(bench, changes[-1], [each for each in trials if set(each.gains.values()) == {1.0}]) if falls else None
    return Verification(gain, tuple(trials), tuple(verdicts), rest)


def _remainder(bench: Bench, worst: PeakChange, whole: Sequence[Trial]) -> CancellationRemainder:
    asked_mm, noise_mm = bench.specification.quiet_mm, NOISE_PEAK * _noise_mm(bench, whole)
    causes: tuple[RemainderCause, ...] = ()
    if worst.after_mm > asked_mm:
        causes = ("sensor noise",) if worst.after_mm - noise_mm <= asked_mm else ("not explained",)
    words = f"the cancellation leaves {worst.after_mm:.4f} mm in the worst direction (goal: {asked_mm:.4f} mm); "
    words += f"up to {noise_mm:.4f} mm are sensor noise"
    return CancellationRemainder(
        order=None, left_mm=worst.after_mm, asked_mm=asked_mm, jolt_mm=0.0, noise_mm=noise_mm, causes=causes, words=words
    )


def _rms(trials: Sequence[Trial]) -> float | None:
    return float(np.mean([trial.rms_m_s2 for trial in trials])) if trials else None


def _worst(changes: Sequence[PeakChange]) -> str | None:
    """Rise that counts, in words; None if there is none.

    One along x, y or z has to be as good as certain, that of the worst direction more probable than not.
    """
    named = zip(WAYS, changes, strict=True)
    risen = [f"the tip's peak along {way} {each.change}" for way, each in named if each.rises.holds]
    if not risen and changes[-1].rises.is_likely:
        risen = [f"the tip's peak along {WAYS[-1]} {changes[-1].change}"]
    return risen[0] if risen else None


def _changes(bench: Bench, without: Sequence[Trial], with_it: Sequence[Trial]) -> list[PeakChange]:
    """Changes of the tip's peak along x, y, z and worst direction."""
    before, after = (_peaks_mm(bench, trials) for trials in (without, with_it))
    error_mm = _noise_mm(bench, without[:1]) * np.sqrt(1.0 / len(without) + 1.0 / len(with_it))
    return [PeakChange(None, one, other, float(error_mm)) for one, other in zip(before, after, strict=True)]


def _peaks_mm(bench: Bench, trials: Sequence[Trial]) -> list[float]:
    recordings = [trial.recording for trial in trials]
    moved = np.mean([_probed(bench, each).displacement_mm(each) for each in recordings], axis=0)
    return [*np.max(np.abs(moved), axis=1).tolist(), float(np.max(np.linalg.norm(moved, axis=0)))]


def _noise_mm(bench: Bench, trials: Sequence[Trial]) -> float:
    """Root mean square of the sensor's noise in the mean displacement of runs."""
    recording = trials[0].recording
    variances = [noise_variance(column, recording) / len(trials) for column in tip_acceleration(recording).T]
    return noise_rms_mm(variances, recording.period_s, _probed(bench, recording).band_hz)


def _probed(bench: Bench, recording: Recording) -> ProbedRows:
    line, scale = bench.line_motion, line_scale(bench)
    assert line is not None and scale is not None  # noqa: S101, PT018 - is_line_of_arm
    return ProbedRows.of_line(line, recording, scale)
