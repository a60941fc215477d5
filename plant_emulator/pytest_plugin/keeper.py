"""The sender of an enabled drive's cycles.

It is the test itself in virtual time, and a separate thread by the wall clock.
"""

import queue
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Protocol, TypeVar

T = TypeVar("T")

SWITCH_INTERVAL_S = 0.2e-3
"""Time that a computing test may keep the thread that owes a cycle; Python's own 5 ms are cycles."""
KEEPER_TIMEOUT_S = 30.0
"""Time that the thread that owes cycles may take to end."""


class Keeper(Protocol):
    """Executor of actions on the bus, one at a time.

    Between them it calls `idle` as long as that returns True.
    """

    idle: Callable[[], bool] | None

    def call(self, action: Callable[[], T]) -> T:
        """Do something on the bus and wait for it."""
        ...

    def close(self) -> None:
        """Perform no more actions."""
        ...


class VirtualKeeper:
    """Keeper for virtual time.

    Virtual time passes by cycles only, so nothing is done between them.
    """

    def __init__(self) -> None:
        """Start without an idle function."""
        self.idle: Callable[[], bool] | None = None

    def call(self, action: Callable[[], T]) -> T:
        """Perform the action at once."""
        return action()

    def close(self) -> None:
        """Hold nothing that must be closed."""


class WallKeeper:
    """Keeper with a thread that owns the bus.

    A drive whose master is silent stops, so the thread sends cycles while the test does other work.
    """

    def __init__(self) -> None:
        """Start the thread."""
        self.idle: Callable[[], bool] | None = None
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._thread = threading.Thread(target=self._work, name="hil-bench", daemon=True)
        self._thread.start()

    def call(self, action: Callable[[], T]) -> T:
        """Perform an action between two cycles, and wait for its result.

        Raises:
            BaseException: The action raises it, or an idle cycle has raised it before.
        """
        error, self._error = self._error, None
        if error is not None:
            raise error
        done: Future[T] = Future()
        self._jobs.put((action, done))
        return done.result()

    def close(self) -> None:
        """End the thread."""
        self._jobs.put(None)
        self._thread.join(KEEPER_TIMEOUT_S)
        sys.setswitchinterval(self._before_s)

    def _work(self) -> None:
        while True:
            try:
                job = self._jobs.get(block=self.idle is None)
            except queue.Empty:
                self._idle()
                continue
            if job is None:
                return
            action, done = job
            try:
                done.set_result(action())
            except BaseException as error:  # noqa: BLE001 - whoever waits for it gets it
                done.set_exception(error)

    def _idle(self) -> None:
        try:
            if self.idle is not None and not self.idle():
                self.idle = None
        except BaseException as error:  # noqa: BLE001 - the next call gets it
            self.idle, self._error = None, error


def keeper_for(*, is_lock_step: bool) -> Keeper:
    """Make the keeper that a bus needs."""
    return VirtualKeeper() if is_lock_step else WallKeeper()
