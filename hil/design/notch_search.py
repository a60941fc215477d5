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
from hil.design.notch_design import BEYOND_RPS, SHAPES, Judge, NotchProblem, NotchVerdict, verdict

Real = NDArray[np.float64]

CHUNK = 3
"""Filters that a worker weighs at a time: those that break a limit take a tenth of the time of the others."""

TRIES = 6
"""Number of the best filters that are judged closely before the search gives up."""


@dataclass(frozen=True)
class Effort:
    """Size of a search.

    Attributes:
        population: Filters per generation on the believed plant.
        generations: Number of generations on the believed plant.
        robust_population: Filters per generation on all plants.
        robust_generations: Number of generations on all plants.
        seed: Equal seeds give equal filters, whatever the number of processes.
    """

    population: int = 40
    generations: int = 28
    robust_population: int = 20
    robust_generations: int = 20
    seed: int = 1

    @classmethod
    def quick(cls, seed: int = 1) -> "Effort":
        """A search that takes a tenth of the default's time."""
        return cls(24, 14, 10, 5, seed)

    @property
    def evaluations(self) -> int:
        """Cost of one shape of one order, in units of the time that one plant takes."""
        return self.population * (self.generations + 1) + 5 * self.robust_population * (self.robust_generations + 1)


@dataclass(frozen=True)
class Space:
    """The filters of one shape that are tried, as a unit cube; the dampings are logarithmic in it.

    Attributes:
        template: Filter that gives shape, order and all parameters that are not searched.
        low: Least values of offset_hz, zeta_rn, zeta_rdth, start_rps, end_rps, and ramp_rps of a trapezoid.
        high: Largest values of the same parameters.
    """

    template: Notch
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def around(cls, problem: NotchProblem, order: int, shape: str, f_al_hz: float, template: Notch) -> "Space":
        """Space of filters that act throughout the window in which the tip is judged, and not at rest.

        Args:
            problem: The axis.
            order: Order k of the filter.
            shape: `switched` or `trapezoid`.
            f_al_hz: Peak of |G_al|.
            template: Filter that gives the hysteresis and the corner of the speed's low-pass.

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
        """Number of parameters that are searched."""
        return len(self.low)

    def notch(self, point: Real) -> Notch:
        """The filter at a point of the unit cube, with the digits that a person would write."""
        low, high = np.array(self.low), np.array(self.high)
        values = low + point * (high - low)
        values[1:3] = low[1:3] * (high[1:3] / low[1:3]) ** point[1:3]
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

    def point(self, notch: Notch) -> Real:
        """The point of the unit cube that stands for a filter, or the nearest to it."""
        values = np.array([notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, notch.start_rps, notch.end_rps, notch.ramp_rps])
        values = values[: self.dimensions]
        low, high = np.array(self.low), np.array(self.high)
        point = (values - low) / (high - low)
        point[1:3] = np.log(values[1:3] / low[1:3]) / np.log(high[1:3] / low[1:3])
        return np.asarray(np.clip(point, 0.0, 1.0))


def _weigh(judge: Judge, notches: Sequence[Notch], members: int | None) -> list[float]:
    """Scores of some filters; runs in a worker."""
    return [judge.score(notch, members) for notch in notches]


@contextmanager
def workers(jobs: int) -> Iterator[Executor | None]:
    """Processes to search in; None where `jobs` is 0, for this process alone.

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


def pooled_verdict(
    problem: NotchProblem, notches: Sequence[Notch], orders: Sequence[int], pool: Executor | None = None
) -> NotchVerdict:
    """Judge filters as `verdict` does, in a worker where there is one.

    Args:
        problem: The axis.
        notches: All filters that act.
        orders: Orders for which constraint (5) and the tip peak are checked.
        pool: Workers; None judges in this process.
    """
    if pool is None:
        return verdict(problem, notches, orders)
    return pool.submit(verdict, problem, notches, orders).result()


class _Scores:
    """Scores of filters, each computed once."""

    def __init__(self, judge: Judge, space: Space, pool: Executor | None, count_weighed: Callable[[int], None]) -> None:
        self.judge, self.space, self.pool, self.count_weighed = judge, space, pool, count_weighed
        self.members: int | None = 1
        self.known: dict[Notch, float] = {}

    def stage(self, members: int | None) -> None:
        """Forget the scores, and weigh by the first `members` plants from now on; None for all."""
        self.members, self.known = members, {}

    def __call__(self, points: Real) -> Real:
        """Scores of points in the unit cube, shape (dimensions, filters), as scipy wants them."""
        notches = [self.space.notch(point) for point in points.T]
        new = list(dict.fromkeys(notch for notch in notches if notch not in self.known))
        chunks = [new[i : i + CHUNK] for i in range(0, len(new), CHUNK)]
        count = len(chunks)
        if self.pool is None:
            weighed: Iterator[list[float]] = map(_weigh, [self.judge] * count, chunks, [self.members] * count)
        else:
            weighed = self.pool.map(_weigh, [self.judge] * count, chunks, [self.members] * count)
        for chunk, scores in zip(chunks, weighed, strict=True):
            self.known.update(zip(chunk, scores, strict=True))
        self.count_weighed(len(notches) * (1 if self.members == 1 else 5))
        return np.array([self.known[notch] for notch in notches])

    def evolve(self, start: Real, generations: int, generator: np.random.Generator) -> Real:
        """Points after some generations of differential evolution, the best first; shape (filters, dimensions)."""
        weigh: Any = self  # the stubs do not know `vectorized`
        result = optimize.differential_evolution(
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
        order = np.argsort(result.population_energies, kind="stable")
        return np.asarray(result.population[order])


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        best: Verdict on the best filters that meet all requirements; where none do, on those that miss least.
        scores: Best score in the search, by shape.
    """

    best: NotchVerdict
    scores: Mapping[str, float]


def search(
    problem: NotchProblem,
    order: int,
    shapes: Sequence[str],
    f_al_hz: float,
    *,
    effort: Effort,
    pool: Executor | None = None,
    given: Sequence[Notch] = (),
    template: Notch | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SearchResult:
    """The filter of one order that leaves the smallest tip peak for the worst of all plants, within all requirements.

    Args:
        problem: The axis; its fixed filters act beside the new one.
        order: Order k of the filter.
        shapes: Shapes that are tried.
        f_al_hz: Peak of |G_al|, around which the search looks.
        effort: Size of the search.
        pool: Processes to use, from `workers`.
        given: Filters to start from, among others; the result is at least as good as those of them that meet all requirements.
        template: Filter that gives all parameters that are not searched.
        progress: Called with the fraction that is done.

    Raises:
        ValueError: The motion does not lead through the window.
    """
    base = template if template is not None else Notch(order=order)
    total, done = effort.evaluations * len(shapes), 0

    def count_weighed(count: int) -> None:
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
            start[row] = space.point(notch)
        weigh = _Scores(judge, space, pool, count_weighed)
        points = weigh.evolve(start, effort.generations, generator)
        weigh.stage(None)
        weigh.evolve(points[: effort.robust_population], effort.robust_generations, generator)
        candidates.update(weigh.known)
        scores[shape] = min(weigh.known.values())
    for notch in given:
        if notch.order == order:
            candidates.setdefault(notch, judge.score(notch))
    return SearchResult(_first_that_holds(problem, order, candidates, pool), scores)


def _first_that_holds(
    problem: NotchProblem, order: int, candidates: Mapping[Notch, float], pool: Executor | None
) -> NotchVerdict:
    """Verdict on the best of some filters that meets all requirements, else on the one that misses least."""
    seen: list[NotchVerdict] = []
    orders = sorted({order, *(notch.order for notch in problem.fixed if notch.order in problem.windows_rps)})
    for notch in sorted(candidates, key=lambda each: candidates[each])[:TRIES]:
        whole = pooled_verdict(problem, sorted((notch, *problem.fixed), key=lambda each: each.order), orders, pool)
        if whole.holds:
            return whole
        seen.append(whole)
        if candidates[notch] > 10.0:
            break  # the search has seen none that keeps everything
    return min(seen, key=lambda each: sum(check.violation for check in each.missed))
