"""Real time on Linux, as far as the system permits it."""

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from hil.bench.bench import RealTimeTable

PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 29, 30
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14
SWITCH_INTERVAL_S = 1e-4
"""Time after which another thread hands the interpreter to the loop, instead of Python's 5 ms."""
TIMER_SLACK_NS = 1
"""Time by which the kernel may delay a wake-up to save power; 50 µs by default."""


class Clock:
    """The clock of the cyclic path: the system's monotonic one, which setting the date does not change.

    Args:
        spin_s: Time before a deadline at which the loop stops sleeping and polls. It costs that much of a core per period, and
            saves the time in which a core wakes up.
    """

    def __init__(self, spin_s: float = 0.0) -> None:
        self.spin_s = spin_s

    def now(self) -> float:
        """Time of CLOCK_MONOTONIC in s."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep until the deadline, and poll for the last `spin_s`."""
        while (left := deadline_s - self.spin_s - time.monotonic()) > 0.0:
            time.sleep(left)
        while time.monotonic() < deadline_s:
            pass


@dataclass(frozen=True)
class Measure:
    """One request and its outcome.

    Attributes:
        detail: Present setting; after a refusal the reason and the remedy.
    """

    name: str
    is_granted: bool
    detail: str


class System:
    """Calls to the operating system.

    Each raises OSError if it is not permitted or does not exist.
    """

    def __init__(self) -> None:
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
        """True if the process may lock all memory that it will need.

        With a finite limit, an allocation during a motion could fail; nothing is locked then.
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
        """Lock every page that is used from now on.

        Unused pages are not locked: libraries map far more than they use.
        """
        self._call("mlockall", MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)

    def unlock_memory(self) -> None:
        """Unlock all pages."""
        self._call("munlockall")

    def timer_slack(self) -> int:
        """The timer slack of this thread in ns."""
        if not sys.platform.startswith("linux"):
            raise OSError("this system has no timer slack to set")
        return self._call("prctl", PR_GET_TIMERSLACK, 0, 0, 0, 0)

    def set_timer_slack(self, slack_ns: int) -> None:
        """Set the timer slack of this thread."""
        self._call("prctl", PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)


def no_garbage_collection() -> Callable[[], None]:
    """Switch the garbage collector off; return a function that undoes it.

    Nothing is collected first: a collection takes 0.2 s in a process with many modules, and a lock-step run does not need it.
    """
    was_enabled = gc.isenabled()
    gc.disable()

    def undo() -> None:
        if was_enabled:
            gc.enable()

    return undo


def quiet_garbage_collection() -> Callable[[], None]:
    """Collect once, freeze all objects, switch the collector off.

    Return a function that undoes it.
    """
    was_frozen = gc.get_freeze_count() > 0
    gc.collect()
    enable_again = no_garbage_collection()
    if not was_frozen:  # somebody else's frozen objects cannot be told from ours, and stay
        gc.freeze()

    def undo() -> None:
        if not was_frozen:
            gc.unfreeze()
        enable_again()

    return undo


class RealTime:
    """Context of real time for this thread; a refusal is no error."""

    def __init__(self, settings: RealTimeTable, system: System | None = None) -> None:
        """Prepare the context; nothing is requested yet."""
        self.measures: tuple[Measure, ...] = ()
        self._settings = settings
        self._system = System() if system is None else system
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Self:
        """Make the requests, the scheduler last; the others may take their time."""
        settings = self._settings
        self._undo.append(quiet_garbage_collection())
        interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._undo.append(lambda: sys.setswitchinterval(interval))
        measures = [Measure("garbage collection", True, "off during the run")]
        if settings.lock_memory:
            measures.append(self._ask("memory lock", self._lock_memory, "'ulimit -l unlimited' or CAP_IPC_LOCK"))
        measures.append(self._ask("timer slack", self._timer_slack, "it needs Linux"))
        if settings.cpus:
            measures.append(self._ask("CPU affinity", self._affinity, "see bus.real_time.cpus in the bench file"))
        if settings.priority:
            measures.append(self._ask("SCHED_FIFO", self._scheduler, f"'ulimit -r {settings.priority}' or CAP_SYS_NICE"))
        self.measures = tuple(measures)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Undo the granted requests, in reverse."""
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
