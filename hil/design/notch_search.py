"""The search for a notch: differential evolution, first on the believed plant, then on the worst of all; in parallel."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.stats import qmc

from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.design.notch_design import BEYOND_RPS, SHAPES, Judge, Problem, Verdict, verdict

Real = NDArray[np.float64]

CHUNK = 3
"""Filters that a worker weighs at a time: those that break a limit take a tenth of the time of the others."""

TRIES = 6
"""How many of the best filters are looked at closely before the search gives up."""


@dataclass(frozen=True)
class Effort:
    """How long is searched.

    Attributes:
        population: Filters per generation on the believed plant.
        generations: On the believed plant.
        robust_population: Filters per generation on all plants.
        robust_generations: On all plants.
        seed: Equal seeds give equal filters, whatever the number of processes.
    """

    population: int = 40
    generations: int = 28
    robust_population: int = 20
    robust_generations: int = 20
    seed: int = 1

    @classmethod
    def quick(cls, seed: int = 1) -> "Effort":
        """A tenth of the time."""
        return cls(24, 14, 10, 5, seed)

    @property
    def evaluations(self) -> int:
        """Of one shape of one order, in units of the time that one plant takes."""
        return self.population * (self.generations + 1) + 5 * self.robust_population * (self.robust_generations + 1)


@dataclass(frozen=True)
class Space:
    """The filters of one shape that are tried, as a unit cube; the dampings are logarithmic in it.

    Attributes:
        template: Shape, order, and whatever is not searched.
        low: Of offset_hz, zeta_rn, zeta_rdth, start_rps, end_rps, and ramp_rps of a trapezoid.
        high: The same.
    """

    template: Notch
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def around(cls, problem: Problem, order: int, shape: str, f_al_hz: float, template: Notch) -> "Space":
        """Filters that are in throughout the window in which the tip is judged, and out before the motor stands.

        Args:
            problem: The axis.
            order: k.
            shape: `switched` or `trapezoid`.
            f_al_hz: Peak of |G_al|.
            template: Hysteresis and corner of the speed's low-pass are its.

        Raises:
            ValueError: The window is not within what the motion and the speed limit leave.
        """
        low, high = problem.windows_rps[order]
        resonant = f_al_hz / order
        fastest = float(np.max(np.diff(problem.reference_rad))) / problem.period_s / (2.0 * np.pi)
        top = min(1.7 * resonant, fastest - BEYOND_RPS, problem.speed_limit_rps - template.hysteresis_rps)
        if not high < top:
            raise ValueError(
                f"a filter of order {order} has to be in up to {high:g} rev/s and watched beyond; the motion reaches "
                f"{fastest:.3g} rev/s, the speed limit is {problem.speed_limit_rps:g} rev/s"
            )
        start = min(0.45 * resonant, 0.8 * low)
        bounds = [(0.0, 4.0), (0.005, 0.3), (0.02, 1.0), (max(start, 2.0 * template.hysteresis_rps), low), (high, top)]
        if SHAPES[shape] == NOTCH_TRAPEZOID:
            bounds.append((0.2, 2.0))
        made = replace(template, mode=SHAPES[shape], order=order, start_rps=0.5 * (start + low), end_rps=high)
        return cls(made, tuple(a for a, _ in bounds), tuple(b for _, b in bounds))

    @property
    def dimensions(self) -> int:
        """How many numbers are searched."""
        return len(self.low)

    def notch(self, place: Real) -> Notch:
        """The filter at a place of the unit cube, with the digits that a person would write."""
        low, high = np.array(self.low), np.array(self.high)
        values = low + place * (high - low)
        values[1:3] = low[1:3] * (high[1:3] / low[1:3]) ** place[1:3]
        offset, zeta_rn, zeta_rdth, start, end, *ramp = (float(value) for value in values)
        return replace(
            self.template,
            offset_hz=round(offset, 2),
            zeta_rn=float(f"{zeta_rn:.3g}"),
            zeta_rdth=float(f"{zeta_rdth:.3g}"),
            start_rps=round(start, 2),
            end_rps=round(end, 2),
            ramp_rps=round(ramp[0], 2) if ramp else self.template.ramp_rps,
        )

    def place(self, notch: Notch) -> Real:
        """Where a filter is in the cube, or the nearest place of it."""
        values = np.array([notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, notch.start_rps, notch.end_rps, notch.ramp_rps])
        values = values[: self.dimensions]
        low, high = np.array(self.low), np.array(self.high)
        place = (values - low) / (high - low)
        place[1:3] = np.log(values[1:3] / low[1:3]) / np.log(high[1:3] / low[1:3])
        return np.asarray(np.clip(place, 0.0, 1.0))


def _weigh(judge: Judge, notches: Sequence[Notch], members: int | None) -> list[float]:
    """What a worker does."""
    return [judge.score(notch, members) for notch in notches]


@contextmanager
def workers(jobs: int) -> Iterator[Executor | None]:
    """Processes to search in; None for this one alone where `jobs` is 0.

    They are spawned: a fork of a process with threads, as a progress bar has, may stop for ever. Each has one thread for linear
    algebra: for matrices of ten rows a second one takes forty times as long as the work on a busy machine.
    """
    if jobs <= 0:
        yield None
        return
    name = "OPENBLAS_NUM_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def judged(problem: Problem, notches: Sequence[Notch], orders: Sequence[int], pool: Executor | None = None) -> Verdict:
    """`verdict`, in a worker where there is one."""
    if pool is None:
        return verdict(problem, notches, orders)
    return pool.submit(verdict, problem, notches, orders).result()


class _Scores:
    """Scores of filters, each computed once."""

    def __init__(self, judge: Judge, space: Space, pool: Executor | None, told: Callable[[int], None]) -> None:
        self.judge, self.space, self.pool, self.told = judge, space, pool, told
        self.members: int | None = 1
        self.known: dict[Notch, float] = {}

    def stage(self, members: int | None) -> None:
        """Forget the scores, and weigh by the first plants from here on; None for all."""
        self.members, self.known = members, {}

    def __call__(self, places: Real) -> Real:
        """Of places in the cube, shape (dimensions, filters), as scipy wants it."""
        notches = [self.space.notch(place) for place in places.T]
        new = list(dict.fromkeys(notch for notch in notches if notch not in self.known))
        chunks = [new[i : i + CHUNK] for i in range(0, len(new), CHUNK)]
        count = len(chunks)
        if self.pool is None:
            found: Iterator[list[float]] = map(_weigh, [self.judge] * count, chunks, [self.members] * count)
        else:
            found = self.pool.map(_weigh, [self.judge] * count, chunks, [self.members] * count)
        for chunk, scores in zip(chunks, found, strict=True):
            self.known.update(zip(chunk, scores, strict=True))
        self.told(len(notches) * (1 if self.members == 1 else 5))
        return np.array([self.known[notch] for notch in notches])

    def evolve(self, start: Real, generations: int, generator: np.random.Generator) -> Real:
        """Places after some generations of differential evolution, the best first; shape (filters, dimensions)."""
        weigh: Any = self  # the stubs do not know `vectorized`
        found = optimize.differential_evolution(
            weigh,
            optimize.Bounds(np.zeros(self.space.dimensions), np.ones(self.space.dimensions)),
            init=start,
            maxiter=generations,
            tol=0.0,
            atol=0.0,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=generator,
        )
        order = np.argsort(found.population_energies, kind="stable")
        return np.asarray(found.population[order])


@dataclass(frozen=True)
class Found:
    """What a search gave.

    Attributes:
        best: The best filters that keep everything; where none does, those that miss least.
        scores: By shape: the best score that the search itself saw.
    """

    best: Verdict
    scores: Mapping[str, float]


def search(
    problem: Problem,
    order: int,
    shapes: Sequence[str],
    f_al_hz: float,
    *,
    effort: Effort,
    pool: Executor | None = None,
    given: Sequence[Notch] = (),
    template: Notch | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Found:
    """The filter of one order that leaves the smallest tip peak for the worst of all plants, within all requirements.

    Args:
        problem: The axis; its fixed filters act beside the new one.
        order: k.
        shapes: Which are tried.
        f_al_hz: Peak of |G_al|, where the search looks.
        effort: How long.
        pool: Processes to use, from `workers`.
        given: Filters to start from, among others; the result is at least as good as those of them that keep everything.
        template: What is not searched is taken from it.
        progress: Called with the share that is done.

    Raises:
        ValueError: The motion does not lead through the window.
    """
    base = template if template is not None else Notch(order=order)
    total, done = effort.evaluations * len(shapes), 0

    def told(count: int) -> None:
        nonlocal done
        done += count
        progress(min(1.0, done / total))

    judge = Judge(problem, order)
    scores: dict[str, float] = {}
    candidates: dict[Notch, float] = {}
    for shape in shapes:
        space = Space.around(problem, order, shape, f_al_hz, base)
        generator = np.random.default_rng([effort.seed, order, SHAPES[shape]])
        start = np.asarray(qmc.LatinHypercube(space.dimensions, rng=generator).random(effort.population))
        for row, notch in enumerate(given):
            start[row] = space.place(notch)
        weigh = _Scores(judge, space, pool, told)
        places = weigh.evolve(start, effort.generations, generator)
        weigh.stage(None)
        weigh.evolve(places[: effort.robust_population], effort.robust_generations, generator)
        candidates.update(weigh.known)
        scores[shape] = min(weigh.known.values())
    for notch in given:
        if notch.order == order:
            candidates.setdefault(notch, judge.score(notch))
    return Found(_first_that_holds(problem, order, candidates, pool), scores)


def _first_that_holds(problem: Problem, order: int, candidates: Mapping[Notch, float], pool: Executor | None) -> Verdict:
    """The best of some filters that keeps everything when looked at closely, else the one that misses least."""
    seen: list[Verdict] = []
    orders = sorted({order, *(notch.order for notch in problem.fixed if notch.order in problem.windows_rps)})
    for notch in sorted(candidates, key=lambda each: candidates[each])[:TRIES]:
        found = judged(problem, sorted((notch, *problem.fixed), key=lambda each: each.order), orders, pool)
        if found.holds:
            return found
        seen.append(found)
        if candidates[notch] > 10.0:
            break  # the search has seen none that keeps everything
    return min(seen, key=lambda each: sum(check.violation for check in each.missed))
