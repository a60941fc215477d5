"""What the master watches beside the cycle, on a network whose time the test owns."""

from collections import Counter, deque
from types import SimpleNamespace

import pytest

from hil.bench.bench import load_bench
from hil.can.frame import Frame
from hil.master.network import Emergency
from hil.master.supervision import Supervisor

BUS = load_bench("reference").bus.model_copy(update={"heartbeat_s": 0.1, "master_node_id": 127})
HEARTBEAT = Frame(0x77F, b"\x05")


class Wire:
    """What a supervisor needs of a network."""

    def __init__(self) -> None:
        self.time_s = 10.0
        self.sent: list[Frame] = []
        self.emergencies: deque[Emergency] = deque()
        self.boots: set[int] = set()
        self.heartbeats: dict[int, tuple[float, int]] = {}
        self.bus_errors: Counter[str] = Counter()

    def now(self) -> float:
        return self.time_s

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)


class Exchange:
    """Counts its cycles, and keeps what it has been shown."""

    def __init__(self) -> None:
        self.cycles = 0
        self.seen: list[Frame] = []
        self.stretch = SimpleNamespace(until_s=0.0)

    def exchange(self) -> None:
        self.cycles += 1

    def saw(self, frame: Frame) -> None:
        self.seen.append(frame)


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def supervisor(wire: Wire) -> Supervisor:
    made = Supervisor(wire, BUS)  # type: ignore[arg-type]
    made.begin([2, 3])
    return made


def test_the_master_s_heartbeat_leaves_with_the_cycles_when_it_is_due_and_stops_with_them(
    wire: Wire, supervisor: Supervisor
) -> None:
    exchange = Exchange()
    supervisor.send_heartbeat()
    for _ in range(100):
        wire.time_s += 0.01
        supervisor.cycle(exchange)  # type: ignore[arg-type]
    assert exchange.cycles == 100
    assert wire.sent == [HEARTBEAT] * 11
    assert exchange.seen == [HEARTBEAT] * 10
    wire.time_s += 5.0
    assert len(wire.sent) == 11


def test_nothing_is_wrong_at_first(supervisor: Supervisor) -> None:
    assert supervisor.fault() is None


def test_without_nodes_no_heartbeat_is_missed(wire: Wire, supervisor: Supervisor) -> None:
    supervisor.begin(())
    for _ in range(10):
        assert supervisor.fault() is None
        wire.time_s += BUS.heartbeat_s


def test_what_nodes_reported_before_does_not_count(wire: Wire, supervisor: Supervisor) -> None:
    wire.emergencies.append(Emergency(2, 0x8611, 0x21, b""))
    wire.boots.add(3)
    supervisor.begin([2, 3])
    assert supervisor.fault() is None


def test_an_emergency_of_any_node_is_a_reason_and_the_end_of_one_is_none(wire: Wire, supervisor: Supervisor) -> None:
    wire.emergencies.append(Emergency(9, 0, 0, b""))
    assert supervisor.fault() is None
    wire.emergencies.append(Emergency(9, 0x8611, 0x21, b""))
    assert supervisor.fault() == "node 9 reports emergency 8611h (following error; error register 21h)"


def test_a_node_that_starts_anew_is_a_reason_where_it_takes_part(wire: Wire, supervisor: Supervisor) -> None:
    wire.boots.add(9)
    assert supervisor.fault() is None
    wire.boots.add(3)
    assert supervisor.fault() == "node 3 has been reset"


@pytest.mark.parametrize("silent", [2, 3])
def test_a_node_that_is_silent_for_three_periods_is_a_reason(wire: Wire, supervisor: Supervisor, silent: int) -> None:
    for _ in range(35):
        wire.time_s += 0.01
        wire.heartbeats[5 - silent] = (wire.time_s, 5)
        fault = supervisor.fault()
        assert (fault is None) == (wire.time_s <= 10.3 + 1e-9)
    assert fault is not None
    assert fault.startswith(f"node {silent} has lost its heartbeat")


def test_ctrl_c_is_the_last_of_all_reasons(wire: Wire, supervisor: Supervisor) -> None:
    supervisor.interrupted_by = "SIGINT"
    assert supervisor.fault() == "SIGINT"
    assert supervisor.fault() == "SIGINT", "and stays one"
    wire.boots.add(2)
    assert supervisor.fault() == "node 2 has been reset"
