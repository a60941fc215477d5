"""Many runs of studies, on all cores.

The result does not depend on the number of processes.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager

from plant_emulator.processes import deaf_children, one_thread
from plant_emulator.studies.robustness import PlantRunResult, Study

CHUNK = 5
"""Runs that a worker is given at once: a tenth of a second, which is also how long Ctrl-C takes."""

_studies: list[Study] = []
"""Studies of this process; filled when a worker starts."""


def _begin(studies: Sequence[Study]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent ends its workers
    _studies[:] = studies


def _judge(number: int, indices: Sequence[int]) -> list[PlantRunResult]:
    """Judge some runs of one study, in a worker process."""
    study = _studies[number]
    return [study.judge(index) for index in indices]


@contextmanager
def _workers(jobs: int, studies: Sequence[Study]) -> Iterator[Executor]:
    """Start processes that know the studies.

    They are spawned, since a fork of a process with threads may hang.
    """
    pool = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_begin, initargs=(tuple(studies),)
    )
    with one_thread():
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def run_all(
    studies: Sequence[Study], runs: int, jobs: int = 1, on_done: Callable[[int], None] = lambda count: None
) -> list[list[PlantRunResult]]:
    """Run 0, 1, … of each study in several processes.

    The result does not depend on their number.

    Args:
        studies: Each gets as many runs.
        runs: Number of runs of each study.
        jobs: Processes; 1 is this one.
        on_done: Called with the number of runs that have been done since it was called before.

    Raises:
        ValueError: No runs, or no processes.
    """
    if runs < 1:
        raise ValueError(f"{runs} runs; at least 1 is needed")
    if jobs < 1:
        raise ValueError(f"{jobs} processes; at least 1 is needed")
    found: list[list[PlantRunResult]] = [[] for _ in studies]
    if jobs == 1:
        for number, study in enumerate(studies):
            for index in range(runs):
                found[number].append(study.judge(index))
                on_done(1)
        return found
    with _workers(jobs, studies) as pool:
        with deaf_children():
            pending = [
                pool.submit(_judge, number, range(start, min(start + CHUNK, runs)))
                for number in range(len(studies))
                for start in range(0, runs, CHUNK)
            ]
        study_of = dict(zip(pending, _studies_of_chunks(len(studies), runs), strict=True))
        for future in as_completed(pending):
            judged = future.result()
            found[study_of[future]] += judged
            on_done(len(judged))
    return [sorted(each, key=lambda judged: judged.index) for each in found]


def _studies_of_chunks(studies: int, runs: int) -> list[int]:
    """Return the study of each chunk, in the order of dispatch."""
    return [number for number in range(studies) for _ in range(0, runs, CHUNK)]
