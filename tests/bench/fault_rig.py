"""A line motion in one process in which something goes wrong at a known cycle, and what the drives and the master did then."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from drive_profiles.standard.cia402 import State
from hil.bench.bench import Bench, load_bench
from hil.can.frame import Frame
from hil.errors import SafetyStopError
from hil.experiments.motions import line_motion
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.faults import BusEvent, BusFaults, Fault
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.instant import FIRST_CLIENT
from plant_emulator.bus.medium import medium_for
from plant_emulator.motion.record import BRAKED
from plant_emulator.rehearsal.families.made import bench_of, robot_of
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World
from tests.hil.master.virtual_time import VirtualClock

T_S = 0.002
RATE = 1_000_000
MASTER = FIRST_CLIENT
PHASES = ("enable", "settle", "acceleration", "constant", "deceleration", "return")
NODES = (2, 3, 5)
OPERATE, QUICK_STOP = 0x0F, 0x02
_DWELL_S, _RAMP_S, _DURATION_S = 0.05, 0.2, 0.8
_MOVING = {0x6041, 0x6064, 0x606C, 0x6077, 0x60F4, 0x2130, 0x6040, 0x607A, 0x6071, 0x7130, 0x1001, 0x1003, 0x603F}
_MOVING |= {0x60C1, 0x2062, 0x6062, 0x6063, 0x6069, 0x606B, 0x6074, 0x6078, 0x60FA, 0x60FC}
"""Objects that are measured, commanded, or tell of faults: nobody puts them back."""


@cache
def reference_robot(family: str | None = None) -> Robot:
    """The robot of every rig that has none of its own; all its drives are of the family that is named."""
    robot = load_robot("reference")
    return robot if family is None else robot_of(robot, load_bench("reference"), dict.fromkeys(NODES, family))


def sync_s(family: str | None) -> float:
    """SYNC period of a rig."""
    return T_S if family is None else bench(family).bus.sync_period_s


@cache
def bench(family: str | None = None) -> Bench:
    """The reference bench with a tenth of a metre of line in 0.8 s."""
    whole = load_bench("reference")
    line = whole.line_motion
    assert line is not None
    short = {"end_m": line.end_m.model_copy(update={"x": 0.60}), "duration_s": _DURATION_S, "ramp_s": _RAMP_S}
    line = line.model_copy(update={**short, "dwell_s": _DWELL_S, "tail_s": 0.05})
    bus = whole.bus.model_copy(update={"sync_period_s": T_S, "answer_timeout_s": 0.25})
    made = whole.model_copy(update={"line_motion": line, "settle_s": 0.1, "bus": bus})
    return made if family is None else bench_of(reference_robot(family), made, dict.fromkeys(NODES, family))


@dataclass
class Tape:
    """What was to be seen at each SYNC, just before the nodes heard it.

    Attributes:
        now_ns: The world's time, by number of the SYNC; SYNCs count from 1.
        states: Of the drives of `NODES`.
        torque_nm: Of the same.
        words: Control words sent: number of the SYNC that follows, node, word.
        heard: The frame of each identifier heard last, by number of the SYNC before it.
        left: Which drive's state machine left operation enabled, and when.
        moving: The shares of the motion that the session has told, each with the SYNCs so far.
    """

    now_ns: list[int] = field(default_factory=lambda: [0])
    states: list[tuple[State, ...]] = field(default_factory=lambda: [()])
    torque_nm: list[tuple[float, ...]] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])
    words: list[tuple[int, int, int]] = field(default_factory=list)
    heard: dict[int, dict[int, bytes]] = field(default_factory=dict)
    left: list[tuple[int, int]] = field(default_factory=list)
    moving: list[tuple[float, int]] = field(default_factory=list)


@dataclass
class Outcome:
    """What came of a run.

    Attributes:
        at: The cycle at which the fault began.
        before: What all objects held.
    """

    session: Session
    channel: InProcessChannel
    tape: Tape
    at: int
    before: dict[int, dict[tuple[int, int], object]]
    result: RunResult | None = None
    error: Exception | None = None

    @property
    def stopped(self) -> SafetyStopError | None:
        return None if self.result is None else self.result.stopped

    @property
    def stop_word_at(self) -> int | None:
        """The cycle whose RPDOs first take a drive out of operation, from the fault on."""
        return next((number for number, _, word in self.tape.words if number >= self.at and word in (QUICK_STOP, 0x00)), None)

    def left_operation_at_ns(self, node: int) -> int | None:
        """When a drive left operation, from the fault on."""
        return next((at_ns for who, at_ns in self.tape.left if who == node and at_ns >= self.tape.now_ns[self.at]), None)


def everything(world: World) -> dict[int, dict[tuple[int, int], object]]:
    """All objects of all nodes that a run has to put back."""
    nodes = {drive.node_id: drive.slave.dictionary for drive in world.drives.values()}
    nodes[world.accelerometer.node_id] = world.accelerometer.slave.dictionary
    return {
        node: {(e.index, e.subindex): held.get(e.index, e.subindex) for e in held if e.index not in _MOVING}
        for node, held in nodes.items()
    }


class Rig:
    """One run with one fault.

    Attributes:
        at: The cycle at which it begins: the number of that cycle's SYNC.
        channel: The bus.
        tape: What is seen.
    """

    def __init__(
        self,
        *,
        bitrate: int | None = None,
        faults: BusFaults | None = None,
        at: int = 0,
        act: "Callable[[Rig, int], None]" = lambda rig, number: None,
        robot: Robot | None = None,
        clock: Any = None,
        family: str | None = None,
    ) -> None:
        self.family, self.sync_s = family, sync_s(family)
        self.world = World(robot or reference_robot(family))
        self.channel = InProcessChannel(self.world, medium_for(self.world, bitrate, faults=faults))
        self.tape, self.at, self._act = Tape(), at, act
        self.bench = bench(family)
        virtual = VirtualClock()
        self.session = Session(self.bench, self.channel, BusLog(None), self._progress, clock or virtual)
        self.channel.on_sync = self._on_sync
        self.channel.heard = self._heard
        for node in NODES:
            self._watch(node)
        send, receive = self.channel.send, self.channel.receive

        def received(timeout_s: float) -> Frame | None:
            frame = receive(timeout_s)
            if frame is None:  # nothing more arrives before the master sends again
                virtual.sleep_until(virtual.now() + timeout_s)
            return frame

        def watched(frame: Frame) -> None:
            if 0x200 < frame.can_id <= 0x27F:
                word = int.from_bytes(frame.data[:2], "little")
                self.tape.words.append((self.channel.syncs + 1, frame.can_id - 0x200, word))
            send(frame)

        self.channel.send, self.channel.receive = watched, received  # type: ignore[method-assign]

    def _watch(self, node: int) -> None:
        def entered(before: State, after: State) -> None:
            if before is State.OPERATION_ENABLED:
                self.tape.left.append((node, self.world.now))

        self.world.drives[node].on_state = entered

    def run(self) -> Outcome:
        """Bring up, run the line without the notch, and leave."""
        outcome = Outcome(self.session, self.channel, self.tape, self.at, everything(self.world))
        with self.session:
            try:
                self.session.bring_up()
                outcome.result = self.session.run(line_motion(self.bench, self.sync_s), "none", "drive")
            except Exception as error:  # noqa: BLE001 - the test says which it expects
                outcome.error = error
        return outcome

    def pass_time(self, duration_s: float) -> None:
        """Let time pass by itself, in steps, without the master."""
        end = self.world.now + round(1e9 * duration_s)
        while self.world.now < end:
            heard = self.channel.medium.free(min(end, self.world.now + 2_000_000))
            self.channel._deliver(heard)
            self._look()

    def disturb(self, kind: str, port: int, frame: Frame | None = None) -> None:
        """Let something happen to a port of the wire now; scheduled beforehand it would keep the set-up waiting."""
        wire = self.channel.medium.wire  # type: ignore[attr-defined]
        wire.schedule(BusEvent(self.world.now, kind, port, None, frame))

    def _on_sync(self, number: int) -> None:
        self._look()
        self._act(self, number)

    def _look(self) -> None:
        drives = [self.world.drives[number] for number in NODES]
        self.tape.now_ns.append(self.world.now)
        self.tape.states.append(tuple(drive.state for drive in drives))
        motion = self.world.axes.motion
        self.tape.torque_nm.append(tuple(float(motion[self.world.axes.row(number)]["torque_nm"]) for number in NODES))

    def _heard(self, frame: Frame, end_ns: int) -> None:
        self.tape.heard.setdefault(self.channel.syncs, {})[frame.can_id] = frame.data

    def _progress(self, share: float) -> None:
        self.tape.moving.append((share, self.channel.syncs))


@cache
def undisturbed(bitrate: int | None, family: str | None = None) -> Outcome:
    """The same run without a fault."""
    outcome = Rig(bitrate=bitrate, family=family).run()
    assert outcome.stopped is None
    assert outcome.error is None
    return outcome


def cycle_of(phase: str, bitrate: int | None, family: str | None = None) -> int:
    """The cycle in the middle of a phase; equal runs have equal cycles."""
    tape, cycle_s = undisturbed(bitrate, family).tape, sync_s(family)
    first = next(n for n, states in enumerate(tape.states) if states and State.OPERATION_ENABLED in states)
    begin, end = tape.moving[0][1], tape.moving[-1][1]
    halfway = {
        "enable": first - 2,
        "settle": (first + begin) // 2,
        "acceleration": begin + round((_DWELL_S + 0.5 * _RAMP_S) / cycle_s),
        "constant": begin + round((_DWELL_S + 0.5 * _DURATION_S) / cycle_s),
        "deceleration": begin + round((_DWELL_S + _DURATION_S - 0.5 * _RAMP_S) / cycle_s),
        "return": end + round(0.5 / cycle_s),
    }
    return halfway[phase]


def fastest_rps(at: int, bitrate: int | None) -> float:
    """The highest speed of a motor around a cycle of the undisturbed run, from what was on the bus."""
    tape = undisturbed(bitrate).tape
    speeds = [0.0]
    for node in NODES:
        before, after = (tape.heard[n][0x180 + node] for n in (at - 3, at + 3))
        counts = int.from_bytes(after[2:6], "little", signed=True) - int.from_bytes(before[2:6], "little", signed=True)
        speeds.append(abs(counts) / 131072 / (6 * T_S))
    return max(speeds)


def window(bitrate: int | None, at: int, cycles: int | None, family: str | None = None) -> dict[str, float]:
    """From and to of a fault of the wire that hits so many whole cycles; None: all that follow."""
    cycle_s = sync_s(family)
    begin = 1e-9 * undisturbed(bitrate, family).tape.now_ns[at] - 0.1 * cycle_s
    return {"from_s": begin} if cycles is None else {"from_s": begin, "to_s": begin + cycles * cycle_s}


def on_the_wire(at: int, cycles: int | None, *faults: dict[str, Any], seed: int = 1, family: str | None = None) -> BusFaults:
    """Faults of the wire at 1 Mbit/s in the cycles from `at` on."""
    return BusFaults([Fault(**{**window(RATE, at, cycles, family), **fault}) for fault in faults], seed)


def check_the_end(rig: Rig, outcome: Outcome) -> None:
    """What holds whatever has happened: no torque, nobody enabled again, nothing unrestored that is not named."""
    session, world, tape = outcome.session, rig.world, outcome.tape
    disabled = {node: rig.world.drives[node].state is not State.OPERATION_ENABLED for node in NODES}
    if outcome.stopped is None or outcome.stopped.all_disabled:
        assert all(disabled.values()), "the session said that all are"
    named = " ".join(session.not_restored)
    for node, is_disabled in disabled.items():
        assert is_disabled or f"node {node}" in named or "the bus" in named
    held = everything(world)
    for node, objects in outcome.before.items():
        assert held[node] == objects or f"node {node}" in named or "the bus" in named, f"node {node} is not as it was"
    sent = len(outcome.channel.sent)
    rig.pass_time(1.0)
    assert np.all(world.axes.motion["mode"] == BRAKED)
    assert not np.any(world.axes.motion["torque_nm"])
    assert len(outcome.channel.sent) == sent, "nothing is sent again"
    for column, node in enumerate(NODES):
        enabled = [states[column] is State.OPERATION_ENABLED for states in tape.states if states]
        assert int(np.sum(np.diff(np.array(enabled, dtype=int)) == 1)) <= 1, f"node {node} was enabled again"
        words = [word for _, sender, word in tape.words if sender == node]
        last = max((i for i, word in enumerate(words) if word & OPERATE == OPERATE), default=-1)
        first_stop = next((i for i, word in enumerate(words) if word == QUICK_STOP), len(words))
        assert last < first_stop, f"node {node} was commanded to operate after a quick stop"


def fresh_rows(outcome: Outcome, begin: int) -> tuple[int, int]:
    """Rows recorded in cycles from `begin` on, and how many of them hold what was on the bus in their cycle."""
    assert outcome.result is not None
    recording, tape = outcome.result.recording, outcome.tape
    first = tape.moving[0][1]
    rows = range(max(0, begin - first), len(recording.time_s))
    good = 0
    for row in rows:
        heard = tape.heard.get(first + row, {})
        tip = np.frombuffer(heard.get(0x190, b"\0" * 6), "<i2") * 1e-3
        shown = [recording.columns[f"tip_{axis}_m_s2"][row] for axis in "xyz"]
        counts = [int.from_bytes(heard.get(0x180 + node, b"")[2:6], "little", signed=True) for node in NODES]
        angles = [recording.axis(node, "position_rad")[row] for node in NODES]
        is_fresh = np.allclose(tip, shown, atol=1e-6) and np.allclose(np.array(counts) * 2.0 * np.pi / 131072, angles, atol=1e-6)
        good += bool(is_fresh)
    return len(rows), good
