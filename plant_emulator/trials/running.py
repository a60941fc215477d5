"""Runs of many tasks by any executors.

A task whose process died is tried once more.
"""

from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from typing import TypeVar

from plant_emulator.trials.executors import Executors, ExecutorsLostError, Result

Key = TypeVar("Key", bound=Hashable)

ATTEMPTS = 2
"""Processes that a task may cost before it counts as crashed."""


def run_all(
    keys: Iterable[Key],
    task: Callable[..., Result],
    values: tuple[object, ...],
    executors: Executors,
    on_result: Callable[[Result], None],
    crashed: Callable[[Key], Result],
) -> None:
    """Run a task for each key.

    Each result is handed over as soon as it exists, in any order.

    Args:
        keys: First argument of each task, such as a seed.
        task: Function of a module: a key and the values to a result.
        values: Plain values that all tasks share.
        executors: Executors of the tasks.
        on_result: Takes each result, and keeps it.
        crashed: Result of a key whose process died each time; it may raise.

    Raises:
        ExecutorsLostError: All executors are lost; the tasks that they had begun have no result.
    """
    waiting, deaths = deque(keys), Counter[Key]()
    running: dict[Future[Result], Key] = {}
    while waiting or running:
        for _ in range(min(len(waiting), executors.capacity() - len(running))):
            key = waiting.popleft()
            running[executors.submit(task, key, *values)] = key
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            key = running.pop(future)
            try:
                result = future.result()
            except CancelledError:
                raise ExecutorsLostError(executors.name) from None
            except executors.died:
                deaths[key] += 1
                if deaths[key] < ATTEMPTS:
                    waiting.append(key)
                    continue
                result = crashed(key)
            on_result(result)
