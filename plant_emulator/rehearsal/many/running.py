"""Runs of many robots by any executors.

Each row is saved at once; a robot whose process died is tried once more.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait

from plant_emulator.rehearsal.many.executors import Executors, ExecutorsLostError
from plant_emulator.rehearsal.many.rows import CRASHED, Row

ATTEMPTS = 2
"""Processes that a robot may cost before it is recorded as crashed."""


def run_all(
    seeds: Iterable[int],
    task: Callable[..., Row],
    values: tuple[object, ...],
    executors: Executors,
    on_row: Callable[[Row], None],
) -> None:
    """Run each seed's robot.

    Each row is handed over as soon as it exists, in any order.

    Args:
        seeds: Seeds of the robots.
        task: Function of a module: a seed and the values to a row.
        values: Plain values that all tasks share.
        executors: Executors of the tasks.
        on_row: Takes each row, and keeps it.

    Raises:
        ExecutorsLostError: All executors are lost; the robots that they had begun have no row.
    """
    waiting, deaths = deque(seeds), Counter[int]()
    running: dict[Future[Row], int] = {}
    while waiting or running:
        for _ in range(min(len(waiting), executors.capacity() - len(running))):
            seed = waiting.popleft()
            running[executors.submit(task, seed, *values)] = seed
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            seed = running.pop(future)
            try:
                row = future.result()
            except CancelledError:
                raise ExecutorsLostError(executors.name) from None
            except executors.died:
                deaths[seed] += 1
                if deaths[seed] < ATTEMPTS:
                    waiting.append(seed)
                    continue
                row = crashed(seed)
            on_row(row)


def crashed(seed: int) -> Row:
    """Return the row of a robot whose process died each time."""
    return {"seed": seed, "walk": CRASHED, "walk_words": f"its process died {ATTEMPTS} times"}
