"""Many runs of studies by any executors.

The result depends neither on the executors nor on their number.
"""

from collections.abc import Callable, Sequence
from itertools import chain

from plant_emulator.studies.robustness import Study
from plant_emulator.trials.executors import Executors
from plant_emulator.trials.rows import Row, number
from plant_emulator.trials.running import run_all

MOST_TOGETHER, SHARES = 50, 8
"""Most plants of a task, and tasks per executor, so that all end together.

Each task prepares its study anew: 5 ms with a filter, where a plant takes 27 ms (medians of 15, one core of a two-core machine).
"""

Chunk = tuple[int, int, int]
"""Number of a study, its first plant, and the one after the last."""


def judge_all(
    studies: Sequence[Study], runs: int, executors: Executors, on_done: Callable[[int], None] = lambda count: None
) -> list[list[Row]]:
    """Judge plants 0, 1, … of each study.

    Args:
        studies: Each gets as many runs.
        runs: Number of runs of each study.
        executors: Executors of the runs.
        on_done: Called with the number of runs that have been done since it was called before.

    Raises:
        ValueError: No runs.
        RuntimeError: A process died twice at the same plants.
        ExecutorsLostError: All executors are lost.
    """
    if runs < 1:
        raise ValueError(f"{runs} runs; at least 1 is needed")
    found: list[list[Row]] = [[] for _ in studies]

    def keep(judged: tuple[int, list[Row]]) -> None:
        found[judged[0]] += judged[1]
        on_done(len(judged[1]))

    with executors:
        size = min(MOST_TOGETHER, max(1, len(studies) * runs // (SHARES * executors.capacity())))
        chunks = (((number, first, min(first + size, runs)) for first in range(0, runs, size)) for number in range(len(studies)))
        run_all(chain.from_iterable(chunks), _judge, (tuple(studies),), executors, keep, _crashed)
    return [sorted(each, key=lambda row: number(row, "index") or 0.0) for each in found]


def _judge(chunk: Chunk, studies: Sequence[Study]) -> tuple[int, list[Row]]:
    number, first, end = chunk
    return number, [studies[number].judge(index) for index in range(first, end)]


def _crashed(chunk: Chunk) -> tuple[int, list[Row]]:
    _, first, end = chunk
    raise RuntimeError(f"the process that simulates plants {first} to {end - 1} died twice")
