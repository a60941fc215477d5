"""Real time on Linux, as far as this process may have it: what was asked for, what was granted, and all undone afterwards."""

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 29, 30
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14
SWITCH_INTERVAL_S = 1e-4
"""After how long another thread hands the interpreter over to the loop, instead of Python's 5 ms."""
TIMER_SLACK_NS = 1
"""By how much the kernel may delay a wake-up to save power; 50 µs where nobody asks."""


class Clock(Protocol):
    """What the cyclic path asks of time."""

    def now(self) -> float:
        """Seconds of a clock that nobody sets."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Come back at this instant of `now`, or as soon after it as may be; at once where it is past."""
        ...


class MonotonicClock:
    """The system's monotonic clock; a step of the date does not touch it.

    Args:
        spin_s: How long before a deadline the loop stops sleeping and polls: it costs that much of a core per period, and saves
            the time in which a core wakes up.
    """

    def __init__(self, spin_s: float = 0.0) -> None:
        self.spin_s = spin_s

    def now(self) -> float:
        """CLOCK_MONOTONIC in s."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep, and poll for the last `spin_s`."""
        while (left := deadline_s - self.spin_s - time.monotonic()) > 0.0:
            time.sleep(left)
        while time.monotonic() < deadline_s:
            pass


@dataclass(frozen=True)
class Settings:
    """What is asked of the system.

    Attributes:
        priority: Of SCHED_FIFO; 0 leaves the scheduler alone.
        cpus: The cores to stay on; empty for any.
        lock_memory: Keep every page in memory that has been used once.
    """

    priority: int = 80
    cpus: tuple[int, ...] = ()
    lock_memory: bool = True


@dataclass(frozen=True)
class Measure:
    """One thing that was asked for.

    Attributes:
        name: What.
        is_granted: Whether the system has granted it.
        detail: What holds now; where it was refused, why and what to do.
    """

    name: str
    is_granted: bool
    detail: str


class System:
    """The calls to the system; each raises OSError where it is not permitted or not there."""

    def __init__(self) -> None:
        """Find the C library."""
        try:
            self._c: ctypes.CDLL | None = ctypes.CDLL(None, use_errno=True)
        except (OSError, TypeError):  # no POSIX system
            self._c = None

    def _call(self, name: str, *arguments: int) -> int:
        function = getattr(self._c, name, None)
        if function is None:
            raise OSError(f"this system has no {name}")
        result = int(function(*(ctypes.c_ulong(value) for value in arguments)))
        if result < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return result

    def scheduler(self) -> tuple[int, int]:
        """Policy and priority of this thread."""
        if not hasattr(os, "sched_getscheduler"):
            raise OSError("this system has no SCHED_FIFO")
        return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority

    def set_scheduler(self, policy: int, priority: int) -> None:
        """Give this thread a policy."""
        os.sched_setscheduler(0, policy, os.sched_param(priority))

    def affinity(self) -> set[int]:
        """The cores on which this thread may run."""
        if not hasattr(os, "sched_getaffinity"):
            raise OSError("this system does not bind threads to cores")
        return os.sched_getaffinity(0)

    def set_affinity(self, cpus: set[int]) -> None:
        """Keep this thread on these cores."""
        try:
            os.sched_setaffinity(0, cpus)
        except (ValueError, OverflowError) as error:
            raise OSError(str(error)) from None

    def may_lock_memory(self) -> bool:
        """Whether as much may be locked as the process will ever need.

        With a limit that is finite an allocation in the middle of a motion would fail once it is reached; then rather nothing.
        """
        try:
            import resource  # noqa: PLC0415 - Unix only

            if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
                return True
            status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
            return bool(int(status.partition("CapEff:")[2].split()[0], 16) >> CAP_IPC_LOCK & 1)
        except (ImportError, OSError, ValueError, IndexError):
            return False

    def lock_memory(self) -> None:
        """Keep every page that is used from now on; untouched ones are left alone, since libraries map far more than they use."""
        self._call("mlockall", MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)

    def unlock_memory(self) -> None:
        """Undo it."""
        self._call("munlockall")

    def timer_slack(self) -> int:
        """In ns, of this thread."""
        if not sys.platform.startswith("linux"):
            raise OSError("this system has no timer slack to set")
        return self._call("prctl", PR_GET_TIMERSLACK, 0, 0, 0, 0)

    def set_timer_slack(self, slack_ns: int) -> None:
        """Of this thread."""
        self._call("prctl", PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)


def quiet_garbage_collection() -> Callable[[], None]:
    """Collect once, freeze what is there and collect no more; what puts it back."""
    was_enabled, was_frozen = gc.isenabled(), gc.get_freeze_count() > 0
    gc.collect()
    gc.disable()
    gc.freeze()

    def undo() -> None:
        if not was_frozen:
            gc.unfreeze()
        if was_enabled:
            gc.enable()

    return undo


class RealTime:
    """A context in which this thread runs in real time, as far as it is permitted to. Nothing that is refused makes it fail.

    Args:
        settings: What is asked for.
        system: The calls; a test's place to refuse.

    Attributes:
        measures: What was asked for and what became of it, in the order in which it was asked for.
    """

    def __init__(self, settings: Settings, system: System | None = None) -> None:
        """Nothing is asked for yet."""
        self.measures: tuple[Measure, ...] = ()
        self._settings = settings
        self._system = System() if system is None else system
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Self:
        """Ask, the scheduler last: what comes before it may take its time."""
        settings = self._settings
        self._undo.append(quiet_garbage_collection())
        interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._undo.append(lambda: sys.setswitchinterval(interval))
        found = [Measure("garbage collection", True, "off during the run")]
        if settings.lock_memory:
            found.append(self._ask("memory lock", self._lock_memory, "'ulimit -l unlimited' or CAP_IPC_LOCK"))
        found.append(self._ask("timer slack", self._timer_slack, "it needs Linux"))
        if settings.cpus:
            found.append(self._ask("CPU affinity", self._affinity, "see bus.real_time.cpus in the bench file"))
        if settings.priority:
            found.append(self._ask("SCHED_FIFO", self._scheduler, f"'ulimit -r {settings.priority}' or CAP_SYS_NICE"))
        self.measures = tuple(found)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Undo what was granted, in reverse."""
        while self._undo:
            try:
                self._undo.pop()()
            except OSError:
                continue  # nobody takes the smaller right away; and the rest has to be undone all the same

    def _ask(self, name: str, ask: Callable[[], str], remedy: str) -> Measure:
        try:
            return Measure(name, True, ask())
        except OSError as error:
            return Measure(name, False, f"{error.strerror or error}; {remedy}; see docs/realtime.md")

    def _lock_memory(self) -> str:
        if not self._system.may_lock_memory():
            raise OSError("the limit of locked memory is not 'unlimited'")
        self._system.lock_memory()
        self._undo.append(self._system.unlock_memory)
        return "every page that has been used stays in memory"

    def _timer_slack(self) -> str:
        before = self._system.timer_slack()
        self._system.set_timer_slack(TIMER_SLACK_NS)
        self._undo.append(lambda: self._system.set_timer_slack(before))
        return f"{TIMER_SLACK_NS} ns instead of {before} ns"

    def _affinity(self) -> str:
        before = self._system.affinity()
        self._system.set_affinity(set(self._settings.cpus))
        self._undo.append(lambda: self._system.set_affinity(before))
        return "on " + ", ".join(f"CPU {number}" for number in self._settings.cpus)

    def _scheduler(self) -> str:
        policy, priority = self._system.scheduler()
        self._system.set_scheduler(os.SCHED_FIFO, self._settings.priority)
        self._undo.append(lambda: self._system.set_scheduler(policy, priority))
        return f"priority {self._settings.priority}"
