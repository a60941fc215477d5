"""Study of tracking cancellations on drawn robots."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.control.following import FollowingLaw
from hil.control.trajectory import Smooth
from hil.errors import NotPossibleError
from hil.experiments.cancellation.follow import NEVER
from hil.experiments.cancellation.follow_trial import LOUDER_MM, FollowRun, HeardOrder, try_following
from hil.experiments.judge import vibration_scale
from plant_emulator.rehearsal.following.laws import FilteredLms, Repetition
from plant_emulator.rehearsal.following.rig import NO_BEGINS, Assumed, Follower, Rig, RigRun
from plant_emulator.robots.fleet import draw

LAWS = ("observer", "filtered-x LMS", "repetition")
SPREAD = (0.01, 1.0, 0.01, 0.15, 0.5e-3)
"""Standard deviations of what is assumed: of A_k, φ_k in degrees, ln f_al, ln ζ, and the sensor's delay in s."""
STEP_DEG, STEP_AT = 30.0, 0.5
"""Step of all φ_k, and when, as a part of the time at constant speed."""
CONSTANT_REV = 40.0
"""Motor revolutions at constant speed."""
RISE_RPS_S = 4.0
LEAST_REV, WANTED_REV = 8, 5
AFTER_TRIAL = 4712
"""Revolutions after the step in which the recovery is looked for."""
RECOVERED, FLOOR_MM = 1.3, 0.001
"""Vibration over that before the step that counts as recovered, and what counts as nothing beside it."""


@dataclass(frozen=True)
class Outcome:
    """A law on a robot's motion; lengths are true tip in mm.

    Attributes:
        nothing_mm: Peak without a cancellation.
        alone_mm: Peak with the feed-forward alone.
        following_mm: Peak with the law.
        worse_mm: Largest rise over the feed-forward alone in any window.
        is_used: True if its trial, on the sensor, has let it be used.
        has_moved: True if it has changed anything in a run after that.
        used_worse_mm: The rise in a run after the trial, of what is used.
        recovery_rev: Motor revolutions after a step until it is back; nan if it is not within eight.
        bound_rev: The same for a law that knew at once: the arm's own ring-down.
    """

    seed: int
    law: str
    motion: str
    nothing_mm: float
    alone_mm: float
    following_mm: float
    worse_mm: float
    is_used: bool = True
    has_moved: bool = True
    used_worse_mm: float = 0.0
    recovery_rev: float = math.nan
    bound_rev: float = math.nan


def assumed(seed: int) -> Assumed:
    """Draw, by seed, the errors of an identification."""
    random = np.random.default_rng((seed, 15))
    a, phi, f, damping, delay = (float(each) * spread for each, spread in zip(random.standard_normal(5), SPREAD, strict=True))
    return Assumed(1.0 + a, phi, math.exp(f), math.exp(damping), delay)


def rig_of(seed: int, off: Assumed | None = None) -> Rig:
    """Return a drawn robot of any kind, with assumed values."""
    return Rig(draw(seed), assumed(seed) if off is None else off)


def law_of(name: str, rig: Rig, begins: Mapping[float, float] = NO_BEGINS) -> Follower:
    """Return one of the laws for an axis.

    The observer follows orders from the parts of them on that `begins` states.
    """
    if name == "observer":
        return rig.follower(begins)
    kinds: Mapping[str, type[FilteredLms | Repetition]] = {"filtered-x LMS": FilteredLms, "repetition": Repetition}
    return kinds[name](rig.known_model(), rig.followed(), rig.band(), rig.sync_s)


def ramp(rig: Rig) -> Real:
    """Return the bench's own constant-acceleration motion."""
    table = rig.bench.constant_acceleration
    assert table is not None  # noqa: S101 - every bench of the fleet has one
    trajectory = table.trajectory()
    return trajectory.motor_angle(_instants(rig, trajectory.duration_s))


def constant(rig: Rig, order: float = 2.0, revolutions: float = CONSTANT_REV) -> Real:
    """Return a constant speed (after a rise) in resonance with an order."""
    speed = rig.f_al_hz / order
    rise = speed / RISE_RPS_S
    time = _instants(rig, 0.2 + rise + revolutions / speed)
    return np.asarray(math.tau * np.cumsum(speed * np.clip((time - 0.2) / rise, 0.0, 1.0)) * rig.sync_s)


def point_to_point(rig: Rig) -> Real:
    """Return moves back and forth through the resonance of order 2."""
    speed = 1.2 * rig.f_al_hz / 2.0
    distance, rise = 8.0, 0.5
    duration = distance / speed + rise
    there = distance * Smooth(duration, min(rise, 0.5 * duration)).position(_instants(rig, duration))
    rest = round(0.3 / rig.sync_s)
    legs = [np.concatenate([np.full(rest, leg[0]), leg]) for leg in (there, distance - there) * 2]
    return math.tau * np.concatenate([*legs, np.full(rest, 0.0)])


def _instants(rig: Rig, duration_s: float) -> Real:
    return np.arange(round(duration_s / rig.sync_s), dtype=np.float64) * rig.sync_s


def outcomes(seeds: Iterable[int], laws: Iterable[str] = LAWS) -> Iterator[Outcome]:
    """Run every law on every motion of some robots."""
    names = tuple(laws)
    for seed in seeds:
        rig = rig_of(seed)
        for motion, angles in (("ramp", ramp(rig)), ("point to point", point_to_point(rig))):
            yield from _compared(seed, rig, names, motion, angles, 0.0)
            yield from _compared(seed, rig, names, f"{motion}, 30° off", angles, STEP_DEG)
        yield from _stepped(seed, rig, names)


def _compared(seed: int, rig: Rig, laws: tuple[str, ...], motion: str, angles: Real, turn_deg: float) -> Iterator[Outcome]:
    def turned(time_s: float) -> float:
        return turn_deg

    nothing, alone = rig.run(angles, None, turned, cancels=False), rig.run(angles, None, turned)
    for law in laws:
        follows = rig.run(angles, law_of(law, rig), turned)
        worse = max(_peak(follows, rows) - _peak(alone, rows) for rows in _windows(rig, alone))
        moving, begins, used, has_moved = _windows(rig, alone)[0], _tried(rig, law, angles, turned), 0.0, False
        if begins is not None:  # the run that follows its trial has another noise
            again = [rig.run(angles, each, turned, noise_seed=AFTER_TRIAL) for each in (None, law_of(law, rig, begins))]
            used = max(_peak(again[1], rows) - _peak(again[0], rows) for rows in _windows(rig, again[0]))
            has_moved = again[1].has_moved
        peaks = _peak(nothing, moving), _peak(alone, moving), _peak(follows, moving)
        yield Outcome(seed, law, motion, *peaks, worse, begins is not None, has_moved, used)


def _tried(rig: Rig, law: str, angles: Real, turned: Callable[[float], float]) -> dict[float, float] | None:
    """Run the product's trial of a law.

    The result has the parts of the orders from which on they are tracked; None if the trial refuses.

    The other laws do not state how well they know the remainder; for them the trial takes all or nothing.
    """
    noises, number = count(AFTER_TRIAL + 1), rig.number
    orders = [each.order for each in rig.followed()]

    def run(follows: bool) -> FollowRun:
        follower = law_of(law, rig, NO_BEGINS if follows else dict.fromkeys(orders, NEVER))
        listens = isinstance(follower, FollowingLaw)
        made = rig.run(angles, follower if follows or listens else None, turned, noise_seed=next(noises))
        left = follower.nearest(0) if isinstance(follower, FollowingLaw) else dict.fromkeys(orders, 0.0 if follows else NEVER)
        watched = [HeardOrder(number, order, left[order], bool(np.any(made.factors[order] != 1.0))) for order in orders]
        return FollowRun(made.recording, watched)

    try:
        entry, begins = try_following(rig.bench, vibration_scale(rig.bench, (number,)), run)
    except NotPossibleError:  # a motion that shows nothing
        return None
    return {order: part for (_, order), part in begins.items()} if entry.is_used else None


def _stepped(seed: int, rig: Rig, laws: tuple[str, ...]) -> Iterator[Outcome]:
    angles, speed = constant(rig), rig.f_al_hz / 2.0
    begin = 0.2 + speed / RISE_RPS_S
    at = begin + STEP_AT * CONSTANT_REV / speed

    def turned(time_s: float) -> float:
        return STEP_DEG if time_s >= at else 0.0

    def per_rev(run: RigRun) -> Callable[[int], float]:
        return lambda number: _peak(run, (run.time_s >= at + number / speed) & (run.time_s < at + (number + 1) / speed))

    nothing, alone = (rig.run(angles, None, turned, cancels=cancels, only=2) for cancels in (False, True))
    steady = alone.time_s > begin + 0.25 * CONSTANT_REV / speed
    for law in laws:
        follows = rig.run(angles, law_of(law, rig), turned, only=2)
        before, after = steady & (follows.time_s < at), follows.time_s > at + LEAST_REV / speed
        wanted = RECOVERED * max(_peak(follows, before), FLOOR_MM)
        revs = [
            number + 1.0
            for number in range(LEAST_REV)
            if all(per_rev(follows)(each) <= wanted for each in range(number + 1, LEAST_REV + 1))
        ]
        turned_mm = 2.0 * math.sin(math.radians(0.5 * STEP_DEG)) * _peak(nothing, before)
        bound = max(0.0, math.log(turned_mm / wanted)) * rig.resonance.ring_down_s * speed
        yield Outcome(
            seed, law, "constant speed, φ₂ steps by 30°", _peak(nothing, after), _peak(alone, after), _peak(follows, after),
            _peak(follows, before) - _peak(alone, before), True, True, 0.0, min(revs, default=math.nan), bound,
        )  # fmt: skip


class LawSummary(NamedTuple):
    """One law on one motion of all robots.

    Lengths are in mm at the true tip; values are medians, except counts and worst.
    """

    motion: str
    law: str
    robots: int
    nothing_mm: float
    alone_mm: float
    following_mm: float
    quieter: int
    worse: int
    used: int
    moved: int
    used_and_worse: int
    worst_mm: float
    back_in_5_rev: int | None
    bound_5_rev: int | None


def summary(found: Sequence[Outcome]) -> Iterator[LawSummary]:
    """Yield counts and medians of outcomes, by law and motion."""
    for motion in dict.fromkeys(each.motion for each in found):
        for law in dict.fromkeys(each.law for each in found):
            own = [each for each in found if each.motion == motion and each.law == law]
            steps = [each for each in own if not math.isnan(each.bound_rev)]
            sizes = (
                float(np.median([getattr(each, name) for each in own])) for name in ("nothing_mm", "alone_mm", "following_mm")
            )
            nothing, alone, follows = sizes
            yield LawSummary(
                motion, law, len(own), nothing, alone, follows,
                sum(each.following_mm < each.alone_mm - LOUDER_MM for each in own),
                sum(each.worse_mm > LOUDER_MM for each in own),
                sum(each.is_used for each in own),
                sum(each.has_moved for each in own),
                sum(each.is_used and each.used_worse_mm > LOUDER_MM for each in own),
                max(each.used_worse_mm for each in own),
                sum(each.recovery_rev <= WANTED_REV for each in steps) if steps else None,
                sum(each.bound_rev <= WANTED_REV for each in steps) if steps else None,
            )  # fmt: skip


def _peak(run: RigRun, rows: NDArray[np.bool_]) -> float:
    return float(np.max(np.abs(run.tip_mm[rows]), initial=0.0))


def _windows(rig: Rig, run: RigRun) -> list[NDArray[np.bool_]]:
    """Return the rows in which a run is judged.

    They are all before the last braking, and, for each order, the speeds there at which it meets the resonance.

    In the braking of a ramp the motion's own vibration and an order's add or cancel by chance.
    """
    speed = np.abs(run.speed_rps)
    fast = np.flatnonzero(speed > 0.98 * np.max(speed))
    judged = (run.time_s > 0.0) & (np.arange(len(speed)) < fast[-1])
    return [
        judged,
        *(judged & (speed > 0.76 * rig.f_al_hz / k) & (speed < 1.27 * rig.f_al_hz / k) for k in rig.error.amplitudes_arcsec()),
    ]
