"""Executors that walk robots: processes of this machine, or the workers of a Dask scheduler.

Both take a function of a module and plain values, and give a future of `concurrent.futures`.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from types import TracebackType
from typing import Protocol, Self

from plant_emulator.processes import deaf_children, one_thread
from plant_emulator.rehearsal.many.rows import Row

MOST_JOBS = 256


class ExecutorsLostError(Exception):
    """All who walk are gone, for instance the scheduler.

    Args:
        where: Address that does not answer any more.
    """

    def __init__(self, where: str) -> None:
        super().__init__(f"{where} is lost")
        self.where = where


class ExecutorsRefusedError(Exception):
    """Workers that cannot be used; the message says which, why, and what to do."""


class Executors(Protocol):
    """Executors of walks; a context that ends them."""

    @property
    def name(self) -> str:
        """Name for messages."""

    @property
    def died(self) -> tuple[type[Exception], ...]:
        """Errors of a future whose process died."""

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Cancel what has not begun, and end."""

    def capacity(self) -> int:
        """Walks that may be given out at once."""

    def submit(self, walk: Callable[..., Row], *values: object) -> "Future[Row]":
        """Give a walk out: a function of a module, and plain values."""


class LocalProcesses:
    """Processes of this machine, each an executor of its own: one that dies takes only its own robot with it.

    Args:
        jobs: Number of processes.
    """

    name = "the pool of processes"
    died: tuple[type[Exception], ...] = (BrokenProcessPool,)

    def __init__(self, jobs: int) -> None:
        if not 1 <= jobs <= MOST_JOBS:
            raise ValueError(f"{jobs} processes; 1 to {MOST_JOBS} are possible")
        self._jobs = jobs
        self._free: list[ProcessPoolExecutor] = []
        self._busy: dict[Future[Row], ProcessPoolExecutor] = {}
        self._settings = ExitStack()

    def __enter__(self) -> Self:
        """Begin: linear algebra has one thread in each process, as there is a process per core."""
        self._settings.enter_context(one_thread())
        self._free = [_process() for _ in range(self._jobs)]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End all; after an error nobody waits for walks that nobody wants any more."""
        everyone = [*self._free, *self._busy.values()]
        if kind is not None:
            for each in everyone:
                for process in list((each._processes or {}).values()):  # no public way before Python 3.14
                    process.kill()
        for each in everyone:
            each.shutdown(wait=True, cancel_futures=True)
        self._settings.close()

    def capacity(self) -> int:
        """The number of processes: a robot is given to a process that is free."""
        return self._jobs

    def submit(self, walk: Callable[..., Row], *values: object) -> "Future[Row]":
        """Give a walk to a process that is free.

        Raises:
            RuntimeError: None is free.
        """
        with deaf_children():  # a Ctrl-C that comes meanwhile acts at the end: then every process is among those that are ended
            for done in [future for future in self._busy if future.done()]:
                pool = self._busy.pop(done)
                if isinstance(done.exception(), BrokenProcessPool):
                    pool.shutdown(wait=True)
                    pool = _process()
                self._free.append(pool)
            if not self._free:
                raise RuntimeError(f"all {self._jobs} processes are busy")
            pool = self._free.pop()
            future = pool.submit(walk, *values)
            self._busy[future] = pool
        return future


def _process() -> ProcessPoolExecutor:
    """One process, spawned, since a fork of a process with threads may stop."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """Leave Ctrl-C to the parent, which ends its processes, and end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
