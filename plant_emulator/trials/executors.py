"""Executors of tasks.

They are processes of this machine, or the workers of a Dask scheduler.

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
from typing import Any, Protocol, Self, TypeVar

from plant_emulator.processes import deaf_children, one_thread

MOST_JOBS = 256
START = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
"""How a process starts: as a fork of a server without threads, where the system has that; a fork beside threads may hang."""
SLOW_IMPORTS = ("scipy.linalg", "scipy.optimize", "scipy.signal", "plant_emulator.studies.many")
"""Modules that the server imports once for all processes: they take most of a start, and begin no thread, as others do."""

Result = TypeVar("Result")


class ExecutorsLostError(Exception):
    """Loss of all executors, for instance of the scheduler."""

    def __init__(self, where: str) -> None:
        super().__init__(f"{where} is lost")
        self.where = where


class ExecutorsRefusedError(Exception):
    """Workers that cannot be used.

    The message states which workers, why, and what to do.
    """


class Executors(Protocol):
    """Executors of tasks; a context that ends them."""

    @property
    def name(self) -> str:
        """Name for messages."""

    @property
    def died(self) -> tuple[type[Exception], ...]:
        """Errors of a future whose process died."""

    def __enter__(self) -> Self:
        """Start the executors."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Cancel the waiting tasks, and end."""

    def capacity(self) -> int:
        """Return the number of tasks that may be submitted at once."""

    def submit(self, task: Callable[..., Result], *values: object) -> "Future[Result]":
        """Submit a task: a function of a module, and plain values."""


class LocalProcesses:
    """Processes of this machine, each an executor of its own.

    A process that dies loses only its own task.
    """

    died: tuple[type[Exception], ...] = (BrokenProcessPool,)

    def __init__(self, jobs: int) -> None:
        if not 1 <= jobs <= MOST_JOBS:
            raise ValueError(f"{jobs} processes; expected 1 to {MOST_JOBS}")
        self.name = f"{jobs} {'process' if jobs == 1 else 'processes'} of this machine"
        self._jobs = jobs
        self._free: list[ProcessPoolExecutor] = []
        self._busy: dict[Future[Any], ProcessPoolExecutor] = {}
        self._settings = ExitStack()

    def __enter__(self) -> Self:
        """Start the processes, with one thread each for linear algebra.

        There is one process per core.
        """
        self._settings.enter_context(one_thread())
        multiprocessing.set_forkserver_preload([*SLOW_IMPORTS])
        self._free = [_process() for _ in range(self._jobs)]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End all processes; after an error, running tasks are killed."""
        everyone = [*self._free, *self._busy.values()]
        if kind is not None:
            for each in everyone:
                for process in list((each._processes or {}).values()):  # no public way before Python 3.14
                    process.kill()
        for each in everyone:
            each.shutdown(wait=True, cancel_futures=True)
        self._settings.close()

    def capacity(self) -> int:
        """Return the number of processes."""
        return self._jobs

    def submit(self, task: Callable[..., Result], *values: object) -> "Future[Result]":
        """Submit a task to a free process.

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
            future = pool.submit(task, *values)
            self._busy[future] = pool
        return future


def _process() -> ProcessPoolExecutor:
    """Return an executor of one process, which starts with its first task."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(START), initializer=_begin)


def _begin() -> None:
    """Ignore Ctrl-C, and end together with the parent process.

    The parent handles Ctrl-C and ends its processes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
