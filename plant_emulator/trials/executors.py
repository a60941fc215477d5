"""Executors of tasks.

Both take a function of a module and plain values, and give a future of `concurrent.futures`. A task whose process died is
tried once more.
"""

import logging
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar
from urllib.parse import urlsplit

from drive_profiles.version import version_text

if TYPE_CHECKING:
    from distributed import Client


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


PREFIX = "dask:"
PATIENCE_S = 30.0
"""Longest wait for a scheduler, and for the first of its workers."""
CLOSING_S = 5.0
"""Longest wait for the goodbye to a scheduler."""
AHEAD = 2
"""Tasks given out per thread of the workers, so that none waits for the next."""


def scheduler_address(text: str) -> str:
    """Return the scheduler's address in `dask:tcp://HOST:PORT`.

    >>> scheduler_address("dask:tcp://127.0.0.1:8786")
    'tcp://127.0.0.1:8786'

    Raises:
        ValueError: The text names no scheduler.
    """
    address = text.removeprefix(PREFIX)
    parts = urlsplit(address)
    try:
        is_whole = parts.scheme in {"tcp", "tls"} and parts.hostname and parts.port and not parts.path
    except ValueError:  # a port that is none
        is_whole = False
    if not text.startswith(PREFIX) or not is_whole:
        raise ValueError(f"{text}: expected dask:tcp://HOST:PORT, such as dask:tcp://127.0.0.1:8786")
    return address


class DaskWorkers:
    """Workers of a Dask scheduler.

    This class only connects to the scheduler: it starts nothing, and nothing listens here.

    If a worker dies, the scheduler gives its tasks to others, by default three times, before it reports the loss.

    Args:
        patience_s: Longest wait for the scheduler, and for the first of its workers.
    """

    def __init__(self, address: str, patience_s: float = PATIENCE_S) -> None:
        self.name = f"the scheduler at {address}"
        self._address, self._patience_s = address, patience_s
        self._client: Client | None = None
        self._executor: Executor | None = None
        self.died: tuple[type[Exception], ...] = ()

    def __enter__(self) -> Self:
        """Connect to the scheduler, and check its workers.

        Raises:
            ExecutorsRefusedError: There is no scheduler or no worker, or one that cannot be used.
        """
        try:
            from distributed import Client, KilledWorker  # noqa: PLC0415 - an extra
        except ImportError:
            raise ExecutorsRefusedError("dask: needs the package distributed; pip install 'hil-bench[cluster]'") from None
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a scheduler that is lost is said by us, in a line
        try:
            self._client = Client(self._address, timeout=self._patience_s, set_as_default=False)
        except OSError as error:
            raise ExecutorsRefusedError(f"{self._address}: no Dask scheduler answers ({error})") from None
        try:
            self._look()
        except BaseException:
            self._client.close(timeout=CLOSING_S)
            raise
        self.died = (KilledWorker,)
        self._executor = self._client.get_executor(pure=False, retries=0)
        return self

    def _look(self) -> None:
        """Refuse workers with several threads, or another version.

        They would run two tasks in one process, or give other results.
        """
        client = self._connected()
        how = f"dask worker {self._address} --nworkers 4 --nthreads 1"
        try:
            client.wait_for_workers(1, timeout=self._patience_s)
        except TimeoutError:
            raise ExecutorsRefusedError(f"{self._address}: the scheduler has no workers; start some: {how}") from None
        for worker, threads in client.nthreads().items():
            if threads != 1:
                raise ExecutorsRefusedError(f"worker {worker} has {threads} threads; each task needs a process of its own: {how}")
        try:
            versions = client.run(version_text)
        except ImportError as error:
            raise ExecutorsRefusedError(f"{self._address}: a worker lacks hil-bench ({error}); install it there") from None
        for worker, version in versions.items():
            if version != version_text():
                raise ExecutorsRefusedError(
                    f"worker {worker} has hil-bench {version}; here it is {version_text()}: install the same"
                )

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=False)  # cancels
        if self._client is not None:
            self._client.close(timeout=CLOSING_S)

    def _connected(self) -> "Client":
        if self._client is None:
            raise RuntimeError("not connected: enter the context first")
        return self._client

    def capacity(self) -> int:
        """Return twice the number of worker threads, at least 1.

        Workers come and go.
        """
        try:
            return max(1, AHEAD * sum(map(int, self._connected().nthreads().values())))
        except OSError:
            return 1

    def submit(self, task: Callable[..., Result], *values: object) -> "Future[Result]":
        """Submit a task to the scheduler.

        Raises:
            RuntimeError: Not connected.
        """
        if self._executor is None:
            raise RuntimeError("not connected: enter the context first")
        return self._executor.submit(task, *values)


Executors = LocalProcesses | DaskWorkers
"""Each is a context, in which its tasks run."""
Key = TypeVar("Key", bound=Hashable)

ATTEMPTS = 2
"""Processes that a task may cost before it counts as crashed."""
CRASHED_WORDS = f"its process died {ATTEMPTS} times"
SHARES = 8
"""Bundles of tasks per executor at least, so that all end together."""


def run_all(
    keys: Iterable[Key],
    task: Callable[..., Any],
    values: tuple[object, ...],
    executors: Executors,
    on_result: Callable[[Result], None],
    crashed: Callable[[Key], Result],
    most_together: int = 1,
    *,
    takes_bundles: bool = False,
) -> None:
    """Run a task for each key; hand each result over at once.

    Args:
        keys: First argument of each task, such as a seed.
        task: Function of a module: a key and the values to a result; or a list of keys to a list of results.
        values: Plain values that all tasks share.
        executors: Executors of the tasks.
        on_result: Takes each result, and keeps it.
        crashed: Result of a key whose process died each time; it may raise.
        most_together: Most tasks of a bundle, which gets the values once. After a death tasks go one by one.
        takes_bundles: True if the task takes a list of keys.

    Raises:
        ExecutorsLostError: All executors are lost; the tasks that they had begun have no result.
    """
    waiting, deaths = deque(keys), Counter[Key]()
    size = min(most_together, max(1, len(waiting) // (SHARES * executors.capacity())))
    running: dict[Future[list[Result]], list[Key]] = {}
    run: Callable[..., list[Result]] = task if takes_bundles else partial(_run_bundle, task)
    while waiting or running:
        for _ in range(executors.capacity() - len(running)):
            if bundle := [waiting.popleft() for _ in range(min(len(waiting), 1 if deaths else size))]:
                running[executors.submit(run, bundle, *values)] = bundle
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


def _run_bundle(task: Callable[..., Result], bundle: list[Key], *values: object) -> list[Result]:
    return [task(key, *values) for key in bundle]
