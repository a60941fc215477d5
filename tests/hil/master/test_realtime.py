"""Real time as far as it is granted: asked for once, said when refused, undone in any case."""

import gc
import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.bench.bench import RealTimeTable
from hil.master import realtime
from hil.master.realtime import Clock, RealTime, System, no_garbage_collection, quiet_garbage_collection


class FakeSystem(System):
    """A system that grants or refuses by name, and keeps what was asked of it."""

    def __init__(self, *refused: str, may_lock: bool = True) -> None:
        self.refused, self.may_lock = set(refused), may_lock
        self.calls: list[tuple[object, ...]] = []

    def _ask(self, *call: object) -> None:
        if call[0] in self.refused:
            raise PermissionError(1, "Operation not permitted")
        self.calls.append(call)

    def scheduler(self) -> tuple[int, int]:
        return 0, 0

    def set_scheduler(self, policy: int, priority: int) -> None:
        self._ask("scheduler", policy, priority)

    def affinity(self) -> set[int]:
        return {0, 1}

    def set_affinity(self, cpus: set[int]) -> None:
        self._ask("affinity", tuple(sorted(cpus)))

    def may_lock_memory(self) -> bool:
        return self.may_lock

    def lock_memory(self) -> None:
        self._ask("lock")

    def unlock_memory(self) -> None:
        self._ask("unlock")

    def timer_slack(self) -> int:
        return 50_000

    def set_timer_slack(self, slack_ns: int) -> None:
        self._ask("slack", slack_ns)


ALL = RealTimeTable(priority=70, cpus=(1,))


def test_everything_is_asked_for_and_undone_in_reverse() -> None:
    system = FakeSystem()
    with RealTime(ALL, system) as real_time:
        granted = [("lock",), ("slack", 1), ("affinity", (1,)), ("scheduler", os.SCHED_FIFO, 70)]
        assert system.calls == granted
        assert all(measure.is_granted for measure in real_time.measures)
    assert system.calls[4:] == [("scheduler", 0, 0), ("affinity", (0, 1)), ("slack", 50_000), ("unlock",)]


def test_what_is_refused_is_said_with_its_remedy_and_not_undone() -> None:
    system = FakeSystem("scheduler", "affinity", may_lock=False)
    with RealTime(ALL, system) as real_time:
        refused = {measure.name: measure.detail for measure in real_time.measures if not measure.is_granted}
    assert set(refused) == {"memory lock", "CPU affinity", "SCHED_FIFO"}
    assert "ulimit -l unlimited" in refused["memory lock"]
    assert "ulimit -r 70" in refused["SCHED_FIFO"]
    assert "CAP_SYS_NICE" in refused["SCHED_FIFO"]
    assert system.calls == [("slack", 1), ("slack", 50_000)]


def test_what_is_not_wanted_is_not_asked_for() -> None:
    system = FakeSystem()
    with RealTime(RealTimeTable(priority=0, cpus=(), lock_memory=False), system) as real_time:
        assert [measure.name for measure in real_time.measures] == ["garbage collection", "timer slack"]


def test_all_is_undone_after_an_error_and_when_undoing_fails() -> None:
    system = FakeSystem()

    def fail() -> None:
        with RealTime(ALL, system):
            system.refused = {"affinity"}
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert [call[0] for call in system.calls[4:]] == ["scheduler", "slack", "unlock"]
    assert gc.isenabled()


def test_the_garbage_collector_and_the_interpreter_are_as_before() -> None:
    interval, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    with RealTime(ALL, FakeSystem()):
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert sys.getswitchinterval() < interval
    assert gc.isenabled()
    assert gc.get_freeze_count() == frozen
    assert sys.getswitchinterval() == interval


def test_in_lock_step_nothing_is_collected_before_a_run() -> None:
    collections = sum(each["collections"] for each in gc.get_stats())
    undo = no_garbage_collection()
    assert not gc.isenabled()
    undo()
    assert gc.isenabled()
    assert sum(each["collections"] for each in gc.get_stats()) == collections


@pytest.mark.parametrize("switch", [quiet_garbage_collection, no_garbage_collection])
def test_a_collector_that_was_off_stays_off(switch: Callable[[], Callable[[], None]]) -> None:
    gc.disable()
    try:
        switch()()
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_the_real_system_is_left_as_it_was_whatever_it_grants() -> None:
    """In a thread of its own, since scheduler, slack and affinity are a thread's."""
    seen: list[object] = []

    def state(system: System) -> list[object]:
        found: list[object] = []
        for ask in (system.scheduler, system.affinity, system.timer_slack):
            try:
                found.append(ask())
            except OSError as error:
                found.append(type(error))
        return found

    def work() -> None:
        system = System()
        before = state(system)
        with RealTime(RealTimeTable(priority=1, cpus=(0,))) as real_time:
            seen.append({measure.name for measure in real_time.measures})
            for measure in real_time.measures:
                if measure.is_granted and measure.name == "SCHED_FIFO":
                    assert system.scheduler() == (os.SCHED_FIFO, 1)
        seen.append(state(system) == before)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [{"garbage collection", "memory lock", "timer slack", "CPU affinity", "SCHED_FIFO"}, True]


def test_a_core_that_does_not_exist_is_refused_not_fatal() -> None:
    with RealTime(RealTimeTable(priority=0, cpus=(4000,), lock_memory=False)) as real_time:
        assert [m.name for m in real_time.measures if not m.is_granted] == ["CPU affinity"]


@pytest.mark.parametrize("spin_s", [0.0, 0.002])
def test_the_clock_never_comes_back_too_early(spin_s: float) -> None:
    clock = Clock(spin_s)
    for wait_s in (0.0, 0.0005, 0.004, -1.0):
        deadline = clock.now() + wait_s
        clock.sleep_until(deadline)
        assert clock.now() >= deadline


def test_the_master_has_one_clock() -> None:
    """All else in the room takes the time from the `Clock` that it is given."""
    room = Path(realtime.__file__).parent
    imports = {
        path.name for path in room.glob("*.py") if re.search(r"^\s*(import|from) time\b", path.read_text("utf-8"), re.MULTILINE)
    }
    assert imports == {"realtime.py"}
