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
CRASHED_WORDS = f"its process died {ATTEMPTS} times"
SHARES = 8
"""Bundles of tasks per executor at least, so that all end together."""


def run_all(
    keys: Iterable[Key],
    task: Callable[..., Result],
    values: tuple[object, ...],
    executors: Executors,
    on_result: Callable[[Result], None],
    crashed: Callable[[Key], Result],
    most_together: int = 1,
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
        most_together: Most tasks of a bundle, which gets the values once. After a death tasks go one by one.

    Raises:
        ExecutorsLostError: All executors are lost; the tasks that they had begun have no result.
    """
    waiting, deaths = deque(keys), Counter[Key]()
    size = min(most_together, max(1, len(waiting) // (SHARES * executors.capacity())))
    running: dict[Future[list[Result]], list[Key]] = {}
    while waiting or running:
        for _ in range(executors.capacity() - len(running)):
            if bundle := [waiting.popleft() for _ in range(min(len(waiting), 1 if deaths else size))]:
                running[executors.submit(_run_bundle, task, bundle, values)] = bundle
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            bundle = running.pop(future)
            try:
                results = future.result()
            except CancelledError:
                raise ExecutorsLostError(executors.name) from None
            except executors.died:
                deaths.update(bundle)
                waiting.extend(key for key in bundle if deaths[key] < ATTEMPTS)
                results = [crashed(key) for key in bundle if deaths[key] >= ATTEMPTS]
            for result in results:
                on_result(result)


def _run_bundle(task: Callable[..., Result], bundle: list[Key], values: tuple[object, ...]) -> list[Result]:
    return [task(key, *values) for key in bundle]
