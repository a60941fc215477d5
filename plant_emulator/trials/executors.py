"""Executors of tasks.

They are processes of this machine, or the workers of a Dask scheduler.

Both take a function of a module and plain values, and give a future of `concurrent.futures`. A task whose process died is
tried once more.
"""

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread in processes started here."""
    name = "OPENBLAS_NUM_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


@contextmanager
def deaf_children() -> Iterator[None]:
    """Block Ctrl-C in processes that are started in this context.

    They inherit the mask, so they are protected from their first instruction. In this process Ctrl-C waits until the context
    ends.

    A mask belongs to one thread, but any thread may receive Ctrl-C, so the handler only records it meanwhile. Otherwise it
    could interrupt this thread between starting a process and recording it.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    heard: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    is_ours = handler is not None and threading.current_thread() is threading.main_thread()
    if is_ours:
        signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_ours:
            signal.signal(signal.SIGINT, handler)
        if heard:
            signal.raise_signal(signal.SIGINT)


MOST_JOBS = 256
START = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
"""How a process starts: as a fork of a server without threads, where the system has that; a fork beside threads may hang."""
SLOW_IMPORTS = ("scipy.linalg", "scipy.optimize", "scipy.signal", "plant_emulator.studies.robustness")
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
        """Start the processes, with one thread each for linear algebra."""
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
    """Run a task for each key; hand each result over at once.

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
