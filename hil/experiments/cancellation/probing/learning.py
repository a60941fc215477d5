"""Learning on a motion by runs with small known cancellations.

From the tip's motion in these runs follows the right cancellation.

The method needs no plant, no lever and no sensor frame; it needs each motor's inertia, from which the set-points of a
cancellation are computed. Base runs without any cancellation show the noise. Probing runs change all orders of all axes at
once, by a design; they show the effect of each order on the tip's displacement along x, y and z. Some further runs apply the
resulting cancellation, which is kept only if the tip is quieter with it. For the method see docs/learning.md and
`hil.design.probing`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.analysis import TipScale
from hil.bench.bench import Bench
from hil.bench.model import Identified, with_identified
from hil.control.arrays import Real
from hil.design.estimation import FAR_SIGMAS
from hil.design.notch_problem import RISE
from hil.design.probing import Effects, ProbedStep, step_to_nothing
from hil.design.uncertainty import CORNER_SIGMAS
from hil.errors import HilError, NotPossibleError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.motion import GearReaction, PartOutcome, peak_and_rms, told_part
from hil.experiments.cancellation.probing.pace import KnownSettings, learn_at_pace, paced_line
from hil.experiments.cancellation.probing.reaction import shown_reactions
from hil.experiments.cancellation.probing.record import MotionLearning, MotionRun, MotionRunKeeper
from hil.experiments.cancellation.probing.runs import Runs
from hil.experiments.cancellation.waves import LEAST_REACH_S
from hil.experiments.decision import MOST_RUNS
from hil.experiments.judge import axis_scale, line_scale, missing_words
from hil.experiments.motor_inertia import given_inertia
from hil.master.motion import Motion
from hil.master.session import Session
from hil.reporter import SILENT, Reporter
from hil.robot_tables import ORDERS

PROBE_ARCSEC, PROBE_ARCSEC_PER_MM = (3.0, 15.0), 30.0
"""Amplitude of a probe at least and at most, and for each mm of the tip's peak without cancellation: of the size of that."""
LARGEST_PROBE = 6.0
"""Largest probe of the second round over that of the first: of orders that have hardly shown."""
MOST_ARCSEC = 180.0
"""Bound: sum of what is cancelled on an axis and its probes: beyond 200″ no gear's error is cancelled."""
SPREAD_ARCSEC = 30.0
"""Bound: rms of A_k cos φ_k and A_k sin φ_k before anything is known: gears have 20″ to 100″ in all."""
FIRST_RUNS = 2
"""Most runs with what follows from the first round."""
WEAKEST_SIGMAS = 1.0
"""Probability: standard errors from which an order may be kept because the tip is quieter with it."""


class MotionNotLearntError(HilError):
    """Error: nothing learnt on a motion makes its tip quieter; nothing is kept."""

    exit_code = 9


def learn_on_motion(
    session: Session,
    motion: Motion,
    axis: int | None,
    identified: Identified | None = None,
    *,
    orders: Sequence[float] = ORDERS,
    probe_arcsec: float | None = None,
    inertias_kg_m2: Mapping[int, float] | None = None,
    pace: float | None = None,
    keep: MotionRunKeeper | None = None,
    read: Callable[[MotionLearning], None] | None = None,
    reporter: Reporter = SILENT,
) -> MotionLearning:
    """Learn the transmission errors of all axes of a motion by running it.

    Args:
        axis: The axis of a ramp; None for a line of the tip.
        identified: The model file: the motors' inertias; None: the bench file's models.
        probe_arcsec: Amplitude of a probe; None: by what the tip does without cancellation.
        inertias_kg_m2: J_m from data sheets by axis, where neither file has a plant.
        pace: Multiple of a line's time in which it is learnt as well; None: none.
        keep: Keeper of every run, a stopped one included, before it is checked.
        read: Reader of the learning, which is given it before the first run, as it may end early.

    Raises:
        NotPossibleError: An inertia is missing, no band is known, or the motion reaches no order or shows too little.
        UnsafeRequestError: A probe, or the learnt cancellation, could exceed a limit.
        MotionNotLearntError: No order is significant, or the tip is not quieter with the learnt values.
        SafetyStopError: A run was stopped.
        HilError: Limits or nodes do not allow a run.
    """
    bench = session.bench
    given = inertias_kg_m2 or {}
    inertias = {number: given_inertia(bench, identified, number, given.get(number)) for number in motion.axes}
    known = Identified(robot=bench.name) if identified is None else identified
    learning = MotionLearning(motion, motion_scale(bench, identified, axis), inertias)
    learning.reactions = {number: GearReaction() for number in motion.axes}  # until the motors' torque has shown them
    if read is not None:
        read(learning)
    runs = Runs(session, learning, known, keep, reporter)
    runs.base()
    parts = _reached_parts(bench, learning, orders)
    learning.probe_arcsec = probe_arcsec or float(np.clip(PROBE_ARCSEC_PER_MM * learning.runs[0].peak_mm, *PROBE_ARCSEC))
    led = _two_rounds(bench, known, runs, tuple(parts))
    if pace is not None:
        line = paced_line(bench, pace)
        there = replace(learning, motion=line, probed=None, runs=[], outcomes={}, applied=None, pace=pace)  # counted together
        others = Runs(session, there, known, keep, reporter)
        led = _at_another_pace(runs, others, led, orders)
    _keep(learning, runs, led)
    return learning


def _two_rounds(bench: Bench, known: Identified, runs: Runs, parts: tuple[Part, ...]) -> "_Led":
    """Probe without cancellation and about its result, then run the quietest settings."""
    learning = runs.learning
    effects = runs.probe(parts, np.full(len(parts), learning.probe_arcsec))
    learning.noise_m_s2 = effects.noise_rms
    first = _lead(runs, _Led(parts, effects, (step := _step(effects)).settings, step), FIRST_RUNS)
    level = len(learning.runs)
    runs.applied(parts, first.vector)
    wanted = _second_probes(parts, effects, first.vector, learning.probe_arcsec)
    effects = runs.probe(parts, runs.allowed(parts, wanted, first.vector), first.vector)
    led = replace(first, effects=effects, step=_step(effects))
    led = _with_reactions(bench, known, learning, led, learning.runs[level:])
    return _lead(runs, led, MOST_RUNS)


def motion_scale(bench: Bench, identified: Identified | None, axis: int | None) -> TipScale:
    """Scale of a motion by the bench's band, or by the axes' models.

    `axis` is that of a ramp; None for a line of the tip.

    Raises:
        NotPossibleError: Neither is known.
    """
    known = with_identified(bench, identified)
    scale = line_scale(known) if axis is None else axis_scale(known, axis)
    if scale is None:
        asked = bench.chain_axes if axis is None else (axis,)
        band = ". On a bench with an arm, band_hz in [specification] is enough" if axis is None else ""
        raise NotPossibleError(missing_words(asked) + band)
    return scale


def _reached_parts(bench: Bench, learning: MotionLearning, orders: Sequence[float]) -> list[Part]:
    """List the orders in the band of the motion; others are `not reached`."""
    assert learning.probed is not None  # noqa: S101 - of the first base run
    low, high = learning.scale.band_hz
    parts = []
    for part, time_s in learning.probed.reached(bench, learning.motion, orders).items():
        if time_s >= LEAST_REACH_S:
            parts.append(part)
            continue
        words = (
            f"{part.words}: left at 0: k f_m is in the band, {low:g} to {high:g} Hz, for {time_s:.2f} s only; at "
            f"least {LEAST_REACH_S:g} s is needed"
        )
        learning.outcomes[part] = PartOutcome(part, "not reached", words=words)
    if not parts:
        raise NotPossibleError(
            f"no order stays in the band, {low:g} to {high:g} Hz, for {LEAST_REACH_S:g} s; choose another pace or motion"
        )
    return parts


@dataclass(frozen=True)
class _Led:
    """Settings to which runs have led.

    Attributes:
        vector: Settings of all parts.
        step: The last step to the settings, with its errors.
        run: Run with them; None before one.
    """

    parts: tuple[Part, ...]
    effects: Effects
    vector: Real
    step: ProbedStep
    run: MotionRun | None = None


def _step(effects: Effects, run: MotionRun | None = None) -> ProbedStep:
    """Settings that leave least, from the level or from a run."""
    try:
        return step_to_nothing(effects, None if run is None else run.felt_m_s2, SPREAD_ARCSEC)
    except ValueError as error:
        raise NotPossibleError(f"not learnt: {error}; give fewer --orders") from error


def _lead(runs: Runs, led: _Led, most: int) -> _Led:
    """Run with the settings while the tip becomes quieter; return the quietest run.

    A fall that would be harmless as a rise is the last.
    """
    tried: list[tuple[_Led, ProbedStep]] = []
    vector = led.vector
    for number in range(1, most + 1):
        runs.say(f"run {number} of at most {most} with the values found so far")
        run = runs.applied(led.parts, vector)
        onward = _step(led.effects, run)
        tried.append((replace(led, vector=vector, run=run), onward))
        if number > 1 and RISE * run.rms_mm > _run_of(tried[-2][0]).rms_mm:
            break
        vector = vector + onward.settings
    best, onward = min(tried, key=lambda each: _run_of(each[0]).rms_mm)
    # by what the run itself would still change the settings, they are not known any better
    known = onward.covariance + np.outer(onward.settings, onward.settings)
    return replace(best, step=replace(onward, covariance=known))


def _at_another_pace(runs: Runs, others: Runs, led: _Led, orders: Sequence[float]) -> _Led:
    """Learn the line at another pace as well.

    The new settings count if the tip stays as quiet at the line's own pace.
    """
    known = KnownSettings(led.parts, led.vector, led.step.covariance, led.step.seen)
    found = learn_at_pace(others, known, orders, SPREAD_ARCSEC)
    if found is known:
        return led
    runs.say("at the line's own pace with the values found so far")
    run = runs.applied(found.parts, found.vector)
    if run.rms_mm > RISE * _run_of(led).rms_mm:
        return led
    step = replace(led.step, settings=np.zeros(len(found.vector)), covariance=found.covariance, seen=found.seen)
    return _Led(found.parts, led.effects, found.vector, step, run)


def _with_reactions(bench: Bench, known: Identified, learning: MotionLearning, led: _Led, runs: Sequence[MotionRun]) -> _Led:
    """Add a step to the settings, with the reactions that the torque shows."""
    shown = shown_reactions(bench, known, learning, led.parts, led.vector, led.step.settings, runs)
    learning.reactions |= {number: each.estimate for number, each in shown.items()}
    change = sum((each.change for each in shown.values() if each.is_seen), np.zeros(len(led.vector)))
    return replace(led, vector=led.vector + led.step.settings + change)


def _second_probes(parts: Sequence[Part], effects: Effects, vector: Real, size: float) -> Real:
    """Amplitudes of the probes of the second round."""
    shown = np.sqrt(np.mean(effects.effects**2, axis=(1, 2)).reshape(-1, 2).mean(axis=1))
    wanted = size * np.clip(np.median(shown) / np.maximum(shown, 1e-12), 0.5, LARGEST_PROBE)
    amplitude = np.hypot(vector[0::2], vector[1::2])
    for number in {part.axis for part in parts}:
        own = np.array([part.axis == number for part in parts])
        room = max(MOST_ARCSEC - float(np.sum(amplitude[own])), float(np.sum(own)) * PROBE_ARCSEC[0])
        wanted[own] *= min(1.0, room / float(np.sum(wanted[own])))
    return np.asarray(wanted)


def _told(learning: MotionLearning, led: _Led, least: float = CORNER_SIGMAS) -> Real:
    """Set insignificant orders to 0, and enter all outcomes.

    `least` are the standard errors from which an order is significant.
    """
    vector = led.vector.copy()
    for index, part in enumerate(led.parts):
        learning.outcomes[part] = told_part(part, index, vector, led.step, least)
        if learning.outcomes[part].outcome != "learnt":
            vector[2 * index : 2 * index + 2] = 0.0
    if not np.any(vector):
        said = "; ".join(outcome.words for outcome in learning.outcomes.values())
        raise MotionNotLearntError(f"nothing is learnt: no order is significant on this motion. {said}")
    return vector


def _keep(learning: MotionLearning, runs: Runs, led: _Led) -> None:
    """Keep the significant orders, or also others if the tip is quieter so."""
    vector, run = _told(learning, led), _run_of(led)
    if not np.array_equal(vector, led.vector):
        runs.say("once more with the significant orders only")
        without = runs.applied(led.parts, vector)
        if without.rms_mm > run.rms_mm:
            vector = _told(learning, led, WEAKEST_SIGMAS)
            run = run if np.array_equal(vector, led.vector) else runs.applied(led.parts, vector)
        else:
            run = without
    _check_quieter(learning, run)
    learning.applied, learning.left_m_s2 = run, led.step.left_rms


def _run_of(led: _Led) -> MotionRun:
    assert led.run is not None  # noqa: S101 - it was run
    return led.run


def _check_quieter(learning: MotionLearning, run: MotionRun) -> None:
    """Refuse a result that does not make the tip quieter.

    The peak must fall, and the whole must fall beyond the noise.
    """
    (peak, rms), (peak_with, rms_with) = learning.base_mm, peak_and_rms(run.moved_mm)
    noise = learning.noise_mm
    if peak_with >= peak or rms**2 - rms_with**2 <= FAR_SIGMAS * noise.power_error(rms):
        raise MotionNotLearntError(
            f"the learnt cancellation does not help, so nothing is kept; without and with it: peak {peak:.4f} and "
            f"{peak_with:.4f} mm, root mean square {rms:.4f} and {rms_with:.4f} mm; noise {noise.rms:.4f} mm"
        )
