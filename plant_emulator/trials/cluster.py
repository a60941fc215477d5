"""The workers of a Dask scheduler as executors (extra `cluster`)."""

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future
from types import TracebackType
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from drive_profiles.version import version_text
from plant_emulator.trials.executors import ExecutorsRefusedError, Result

if TYPE_CHECKING:
    from distributed import Client

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
        address: Address of the scheduler, such as tcp://127.0.0.1:8786.
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
