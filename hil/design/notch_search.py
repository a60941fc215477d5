"""Search for a notch by differential evolution, in parallel processes.

The search uses the nominal plant first, then the worst of all plants.
"""

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.design.notch_design import SHAPES, Judge, NotchVerdict, verdict
from hil.design.notch_problem import RISE, NotchProblem
from hil.design.paper import TABLE_3

CHUNK = 4
"""Accuracy: filters that a worker weighs at a time, for time alone: side by side their simulations take two thirds of it."""

LEAST_EVALUATIONS = 80
"""Bound: evaluations of the smallest search: 10 (2 + 1) of the nominal plant, and 5 · 5 (1 + 1) of all plants."""

TRIES = 6
"""Measured: number of the best filters that are judged closely before the search gives up: on seven drawn robots (10700, 10712,
10730, 10735, 51206, 51213, 51261) the first decides."""


PAPER_FILTERS = tuple(TABLE_3.values())
"""Filters of the paper, which are candidates on every robot."""

STARTS = (
    (0.26, 0.045, 0.26, 0.59, 1.65, 0.5, 0.08),
    (0.30, 0.084, 0.41, 0.55, 1.53, 4.2, 0.14),
    (0.24, 0.096, 0.40, 0.61, 1.53, 4.2, 0.20),
    (0.27, 0.096, 0.40, 0.57, 1.56, 4.2, 0.20),
    (0.042, 0.028, 0.10, 0.68, 1.52, 4.2, 0.10),
    (0.061, 0.036, 0.10, 0.68, 1.52, 4.2, 0.10),
    (0.12, 0.06, 0.20, 0.62, 1.52, 4.2, 0.15),
    (0.20, 0.15, 0.60, 0.60, 1.45, 4.2, 0.30),
    (0.06, 0.10, 0.20, 0.60, 1.50, 4.2, 0.20),
    (0.03, 0.10, 0.15, 0.60, 1.50, 4.2, 0.20),
)
"""Filters from which a search starts, good on several robots, and the paper's: ω_d/2π, ζ_rn, ζ_rdth, f_s, f_e, corner of the
speed's low-pass, slopes; the first and the sixth in units of f_al, speeds in units of f_al/k."""

LOGARITHMIC = [1, 2, 5]
"""Parameters of a `Space` that are logarithmic in it."""

HYSTERESIS = 0.025
"""Hysteresis in units of f_al/k, where none is given; a given one counts up to twice as much. The speed's low-pass is then
that of the second of `STARTS`."""


@dataclass(frozen=True)
class Effort:
    """Size of a search.

    Attributes:
        population: Filters per generation on the nominal plant.
        generations: Number of generations on the nominal plant.
        seed: Equal seeds give equal filters, whatever the number of processes.
    """

    population: int = 40
    generations: int = 28
    robust_population: int = 20
    robust_generations: int = 20
    seed: int = 1

    @classmethod
    def quick(cls, seed: int = 1) -> "Effort":
        """Search that takes a fifth of the default's time."""
        return cls(16, 10, 8, 4, seed)

    @classmethod
    def within(cls, evaluations: int, seed: int = 1) -> "Effort":
        """Choose the largest search of at most so many evaluations.

        The number counts for one shape of one order; half of the evaluations are on the nominal plant.

        >>> Effort.within(500), Effort.within(500).evaluations
        (Effort(population=16, generations=14, robust_population=8, robust_generations=5, seed=1), 480)

        Raises:
            ValueError: It is too little for any search.
        """
        if evaluations < LEAST_EVALUATIONS:
            raise ValueError(f"{evaluations} evaluations are too few for a search; at least {LEAST_EVALUATIONS} are needed")
        population = min(40, max(10, evaluations // 30))
        robust = max(5, population // 2)
        generations = max(1, evaluations // (2 * population) - 1)
        left = evaluations - population * (generations + 1)
        return cls(population, generations, robust, max(1, left // (5 * robust) - 1), seed)

    @property
    def evaluations(self) -> int:
        """Cost of one shape of one order, in simulations of one plant."""
        return self.population * (self.generations + 1) + 5 * self.robust_population * (self.robust_generations + 1)


@dataclass(frozen=True)
class Space:
    """Filters of one shape that the search covers, as a unit cube.

    The dampings and the speed's low-pass are logarithmic in it.

    Attributes:
        template: Filter that gives shape, order and all parameters that are not searched.
        low: Least values of offset_hz, zeta_rn, zeta_rdth, start_rps, end_rps, speed_lowpass_hz, and ramp_rps of a trapezoid.
        high: Largest values of the same parameters.
    """

    template: Notch
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def around(cls, problem: NotchProblem, order: int, shape: str, f_al_hz: float, template: Notch) -> "Space":
        """Build the space of filters that act throughout the judged window.

        Args:
            shape: `switched` or `trapezoid`.
            f_al_hz: Peak of |G_al|.
            template: Filter that gives the hysteresis.
        """
        resonant = f_al_hz / order
        low, high = problem.window_rps(order)
        high = min(high, 1.5 * resonant)
        hysteresis = min(template.hysteresis_rps, 2.0 * HYSTERESIS * resonant)
        start = max(min(0.45 * resonant, 0.8 * low), 2.0 * hysteresis)
        bounds = [(0.0, 0.4 * f_al_hz), (0.005, 0.4), (0.02, 1.5), (start, low), (high, 1.75 * resonant)]
        bounds.append((0.45 * f_al_hz, max(5.0 * f_al_hz, 1.01 * template.speed_lowpass_hz)))
        if SHAPES[shape] == NOTCH_TRAPEZOID:
            bounds.append((0.03 * resonant, 0.35 * resonant))
        made = replace(
            template, mode=SHAPES[shape], order=order, start_rps=0.5 * (start + low), end_rps=high, hysteresis_rps=hysteresis
        )
        return cls(made, tuple(a for a, _ in bounds), tuple(b for _, b in bounds))

    def starts(self, f_al_hz: float) -> list[Notch]:
        """Filters from which a search starts, for an f_al."""
        scaled = []
        for offset, zeta_rn, zeta_rdth, start, end, lowpass, ramp in STARTS:
            resonant = f_al_hz / self.template.order
            scaled.append(replace(
                self.template, offset_hz=offset * f_al_hz, zeta_rn=zeta_rn, zeta_rdth=zeta_rdth, start_rps=start * resonant,
                end_rps=end * resonant, speed_lowpass_hz=lowpass * f_al_hz, ramp_rps=ramp * resonant,
            ))  # fmt: skip
        return scaled

    @property
    def dimensions(self) -> int:
        """Number of parameters that are searched."""
        return len(self.low)

    def notch(self, point: Real) -> Notch:
        """Filter at a point of the unit cube, with rounded parameters."""
        low, high = np.array(self.low), np.array(self.high)
        values = low + point * (high - low)
        values[LOGARITHMIC] = low[LOGARITHMIC] * (high[LOGARITHMIC] / low[LOGARITHMIC]) ** point[LOGARITHMIC]
        offset, zeta_rn, zeta_rdth, start, end, lowpass, *ramp = (float(f"{value:.4g}") for value in values)
        return replace(
            self.template,
            offset_hz=round(offset, 3),
            zeta_rn=float(f"{zeta_rn:.3g}"),
            zeta_rdth=float(f"{zeta_rdth:.3g}"),
            start_rps=start,
            end_rps=end,
            speed_lowpass_hz=float(f"{lowpass:.3g}"),
            ramp_rps=float(f"{ramp[0]:.3g}") if ramp else self.template.ramp_rps,
        )

    def point(self, notch: Notch) -> Real:
        """Point of the unit cube for a filter, or the nearest one."""
        values = np.array(
            [
                notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, notch.start_rps, notch.end_rps, notch.speed_lowpass_hz,
                notch.ramp_rps,
            ]
        )  # fmt: skip
        values = values[: self.dimensions]
        low, high = np.array(self.low), np.array(self.high)
        point = (values - low) / (high - low)
        ratio = high[LOGARITHMIC] / low[LOGARITHMIC]
        point[LOGARITHMIC] = np.log(np.maximum(values[LOGARITHMIC], 1e-9) / low[LOGARITHMIC]) / np.log(ratio)
        return np.asarray(np.clip(point, 0.0, 1.0))


def _weigh(judge: Judge, notches: Sequence[tuple[Notch, float]], members: int | None) -> list[float]:
    """Scores of some filters, see `Judge.scores`; runs in a worker."""
    return judge.scores(notches, members)


@contextmanager
def workers(jobs: int) -> Iterator[Executor | None]:
    """Start the processes of a search; None if `jobs` is 0.

    If `jobs` is 0, the search runs in this process.

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
    """Judge filters as `verdict` does, in a worker if there is one.

    Args:
        pool: Workers; None judges in this process.
    """
    if pool is None:
        return verdict(problem, notches, orders)
    return pool.submit(verdict, problem, notches, orders).result()


class _Scores:
    """Scores of filters, each computed once.

    Differential evolution compares each filter of a generation with the one in its place before. A score above that one's is
    neither computed to its end nor kept.
    """

    def __init__(self, judge: Judge, space: Space, pool: Executor | None, count_weighed: Callable[[int], None]) -> None:
        self.judge, self.space, self.pool, self.count_weighed = judge, space, pool, count_weighed
        self.members: int | None = 1
        self.known: dict[Notch, float] = {}
        self.survivors: Real | None = None

    def stage(self, members: int | None) -> None:
        """Forget all scores and select the plants for the next ones.

        These are the first `members` plants; None for all.
        """
        self.members, self.known, self.survivors = members, {}, None

    def __call__(self, points: Real) -> Real:
        """Score points of the unit cube, shape (dimensions, filters)."""
        notches = [self.space.notch(point) for point in points.T]
        at_most = np.full(len(notches), math.inf) if self.survivors is None else self.survivors
        wanted: dict[Notch, float] = {}
        for notch, most in zip(notches, at_most.tolist(), strict=True):
            if notch not in self.known:
                wanted[notch] = max(most, wanted.get(notch, -math.inf))
        new = list(wanted.items())
        size = max(1, len(new)) if self.pool is None else CHUNK
        chunks = [new[i : i + size] for i in range(0, len(new), size)]
        count, weigh = len(chunks), map if self.pool is None else self.pool.map
        weighed = weigh(_weigh, [self.judge] * count, chunks, [self.members] * count)
        bounds: dict[Notch, float] = {}
        for chunk, scores in zip(chunks, weighed, strict=True):
            for (notch, most), score in zip(chunk, scores, strict=True):
                (self.known if score <= most else bounds)[notch] = score
        self.count_weighed(len(notches) * (1 if self.members == 1 else 5))
        return np.array([self.known[notch] if notch in self.known else bounds[notch] for notch in notches])

    def _survived(self, intermediate_result: scipy.optimize.OptimizeResult) -> None:
        """Note the scores with which those of the next generation are compared, each in its place."""
        self.survivors = np.array(intermediate_result.population_energies)

    def evolve(self, start: Real, generations: int, generator: np.random.Generator) -> Real:
        """Run some generations of differential evolution.

        Returns the points, the best first; shape (filters, dimensions).
        """
        weigh: Any = self  # the stubs do not know `vectorized`
        result = scipy.optimize.differential_evolution(
            weigh,
            scipy.optimize.Bounds(np.zeros(self.space.dimensions), np.ones(self.space.dimensions)),
            init=start,
            maxiter=generations,
            tol=0.0,
            atol=0.0,
            polish=False,
            vectorized=True,
            updating="deferred",
            callback=self._survived,
            rng=generator,
        )
        order = np.argsort(result.population_energies, kind="stable")
        return np.asarray(result.population[order])


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        best: Verdict on the best filters that meet all requirements; where none do, on the best that harm nothing, else on those
            that miss least.
        ratio: Weighted tip peak with them over that without the filter: 1 and more where it is no better than none.
        scores: Best score in the search, by shape.
    """

    best: NotchVerdict
    ratio: float
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
    """Search the filter of one order with the smallest worst tip peak.

    Args:
        problem: The axis; its fixed filters act beside the new one.
        f_al_hz: Peak of |G_al|, around which the search looks.
        pool: Processes to use, from `workers`.
        given: Filters to start from, among others; the result is at least as good as those of them that meet all requirements.
        template: Filter that gives all parameters that are not searched.
        progress: Called with the fraction that is done.
    """
    hysteresis, lowpass = HYSTERESIS * f_al_hz / order, STARTS[1][5] * f_al_hz
    base = template or Notch(
        order=order, start_rps=0.7 * f_al_hz / order, end_rps=1.5 * f_al_hz / order, hysteresis_rps=float(f"{hysteresis:.2g}"),
        speed_lowpass_hz=float(f"{lowpass:.2g}"),
    )  # fmt: skip
    total, done = effort.evaluations * len(shapes), 0

    def count_weighed(count: int) -> None:
        nonlocal done
        done += count
        progress(min(1.0, done / total))

    judge = Judge(problem, order)
    paper = PAPER_FILTERS if "switched" in shapes else ()
    known = [notch for notch in (*given, *paper) if notch.order == order]
    scores: dict[str, float] = {}
    candidates = {notch: judge.score(notch) for notch in known}
    for shape in shapes:
        space = Space.around(problem, order, shape, f_al_hz, base)
        generator = np.random.default_rng([effort.seed, order, SHAPES[shape]])
        start = np.asarray(scipy.stats.qmc.LatinHypercube(space.dimensions, rng=generator).random(effort.population))
        first = [*known[: effort.population // 4], *space.starts(f_al_hz)][: effort.population]
        for row, notch in enumerate(first):
            start[row] = space.point(notch)
        weigh = _Scores(judge, space, pool, count_weighed)
        points = weigh.evolve(start, effort.generations, generator)
        weigh.stage(None)
        weigh.evolve(points[: effort.robust_population], effort.robust_generations, generator)
        candidates.update(weigh.known)
        scores[shape] = min(weigh.known.values())
    best = _first_that_holds(problem, order, candidates, pool)
    own = next(notch for notch in best.notches if notch.order == order)
    return SearchResult(best, candidates[own], scores)


def _first_that_holds(
    problem: NotchProblem, order: int, candidates: Mapping[Notch, float], pool: Executor | None
) -> NotchVerdict:
    """Choose the best filter that meets all requirements, and its verdict.

    If there is none, the best that harms nothing is chosen, else the one that misses least.
    """
    seen: list[NotchVerdict] = []
    orders = sorted({order, *(notch.order for notch in problem.fixed if notch.order in problem.orders)})
    for notch in sorted(candidates, key=lambda each: candidates[each])[:TRIES]:
        whole = pooled_verdict(problem, sorted((notch, *problem.fixed), key=lambda each: each.order), orders, pool)
        if whole.holds:
            return whole
        seen.append(whole)
        if candidates[notch] > 2.0:
            break  # the search has seen none that keeps everything
        if whole.is_harmless and any(check.value > RISE * check.limit for check in whole.missed):
            break  # those that follow miss it as well
    harmless = [whole for whole in seen if whole.is_harmless]
    return harmless[0] if harmless else min(seen, key=lambda each: sum(check.violation for check in each.missed))
