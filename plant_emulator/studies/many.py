"""Many runs of studies by any executors.

The result depends neither on the executors nor on their number.
"""

from collections.abc import Callable, Sequence
from itertools import product

from plant_emulator.studies.robustness import Study
from plant_emulator.trials.executors import Executors
from plant_emulator.trials.rows import Row, number
from plant_emulator.trials.running import CRASHED_WORDS, run_all

MOST_TOGETHER = 50
"""Most plants of a bundle.

Each bundle prepares its study anew: 5 ms with a filter; a plant takes 27 ms (medians of 15, one core of a two-core machine).
"""

Plant = tuple[int, int]
"""Number of a study, and index of a plant."""


def judge_all(
    studies: Sequence[Study], runs: int, executors: Executors, on_done: Callable[[int], None] = lambda count: None
) -> list[list[Row]]:
    """Judge plants 0, 1, … of each study.

    Raises:
        ValueError: No runs.
        RuntimeError: A process died twice at the same plant.
        ExecutorsLostError: All executors are lost.
    """
    if runs < 1:
        raise ValueError(f"{runs} runs; at least 1 is needed")
    found: list[list[Row]] = [[] for _ in studies]

    def keep(judged: tuple[int, Row]) -> None:
        found[judged[0]].append(judged[1])
        on_done(1)

    with executors:
        run_all(product(range(len(studies)), range(runs)), _judge, (tuple(studies),), executors, keep, _crashed, MOST_TOGETHER)
    return [sorted(each, key=lambda row: number(row, "index") or 0.0) for each in found]


def _judge(plant: Plant, studies: Sequence[Study]) -> tuple[int, Row]:
    number, index = plant
    return number, studies[number].judge(index)


def _crashed(plant: Plant) -> tuple[int, Row]:
    raise RuntimeError(f"plant {plant[1]}: {CRASHED_WORDS}")
