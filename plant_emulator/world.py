"""The world: drives, accelerometer, axes and one clock.

It is sans IO: frames and time go in, frames come out.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from drive_profiles.standard.cia301 import FunctionCode
from drive_profiles.standard.cia305 import UNCONFIGURED
from hil.can.frame import RECORD, Frame
from plant_emulator.core import CORE
from plant_emulator.drive.drive import Drive
from plant_emulator.image.image import Node, ProcessImage
from plant_emulator.motion.axes import Axes, live, tip_sensor
from plant_emulator.robots.robot import Robot
from plant_emulator.sensor.accelerometer import AccelerometerNode
from plant_emulator.slave.node import Slave

SECOND = 1_000_000_000
FREE_STEP_NS = 1_000_000
"""Time between two looks at the drives in a world that runs by itself, in ns."""

_SYNC = int(FunctionCode.SYNC)
_IDENTIFIER = itemgetter(0)
"""Identifier of a frame."""
_UNKNOWN, _NEVER = -1, (1 << 63) - 1
"""Instead of an instant: one comparison, ``now < wakes_at``, shows that listeners are known and no deadline has passed."""


class PassedCycle(NamedTuple):
    """A cycle that has passed on a bus with bit times.

    Attributes:
        until: Its end, in ns.
        ends: Ends of its frames and of the answers, in ns; empty if a node must act before, at the present time of the world.
        senders: Port of each.
        sent: Frames that drives send now, each with its port.
    """

    until: int
    ends: Sequence[int]
    answers: bytes
    senders: Sequence[int]
    sent: list[tuple[int, Frame]]


class World:
    """All nodes of one bus and the robot behind them.

    Time is in integer nanoseconds of the world's own clock.

    In lock-step every SYNC is worth one period: `receive` returns the answers of that instant, `finish_period` then lets the
    period pass. Without SYNC `advance` lets any time pass.

    Each node has a port, the node-ID that the robot file gives it. Ports tell the frames of different nodes apart and never
    change, whatever node-ID an LSS master gives the node.

    A node whose controller is bus-off neither receives nor sends until it has recovered or been power-cycled.

    Attributes:
        course: The core's record for cycles that need no Python.
        on_power_cycle: Called with the port of a node that gets its supply back.
    """

    def __init__(self, robot: Robot, *, unconfigured: Collection[int] = ()) -> None:
        """Build the nodes; `power_on` starts them.

        Args:
            unconfigured: Ports of nodes that have left the factory without a node-ID, beside those of the robot file: an LSS
                master must give them one.

        Raises:
            ValueError: There is no such node.
        """
        self.robot = robot
        self.now = 0
        self.axes = Axes(robot)
        self.drives = {number: Drive(self.axes, number) for number in self.axes.numbers}
        setting = robot.accelerometer
        self._sensor = tip_sensor(setting, np.random.default_rng(robot.seed))
        self.accelerometer = AccelerometerNode(
            setting.node_id, self.measure, setting.range_m_s2, sdo_max_bytes=setting.sdo_download_bytes
        )
        nodes: list[Node] = [*self.drives.values(), self.accelerometer]
        self._nodes = sorted(nodes, key=lambda node: node.node_id)
        self._ports = {node.node_id: node for node in self._nodes}
        self._drives = [(node.node_id, node) for node in self._nodes if isinstance(node, Drive)]
        for port in {*unconfigured, *robot.unconfigured}:
            self._node(port).slave.lss.stored = UNCONFIGURED
        self.on_power_cycle: Callable[[int], None] = lambda port: None
        self._off: set[int] = set()
        self._slaves = [node.slave for node in self._nodes]
        self._periods = [node.slave.dictionary.cell(0x1006) for node in self._nodes]
        self._control_period_ns = round(1e9 * robot.control_period_s)
        self._mechanics_ns = 0
        self._period_ns = round(1e9 * robot.sync_period_s)
        self._wakes = live(self.axes.motion, "wake")
        self._wakes_at = _UNKNOWN
        self._pending_ns = 0
        self._nodes_on: list[tuple[int, Slave]] = [(port, node.slave) for port, node in self._ports.items()]
        self._listeners: dict[int, list[tuple[int, Slave]]] = {}
        self._watches = False
        self._image = ProcessImage(self.axes, self.accelerometer, self._sensor, self.measure)
        self._is_laid_out = self._is_looked_at = self._can_be_plain = self._is_plain = False
        self._plain_period_ns = 0
        self.course = CORE.new("course")
        self.course.image, self.course.mechanics = self._image.shared, self.axes.shared
        self.course.control_period = self._control_period_ns
        for slave in self._slaves:
            slave.on_routes, slave.on_due = self._forget_listeners, self._forget_due
            slave.dictionary.on_hook = self._forget_layout
        for drive in self.drives.values():
            drive.on_change = self._forget_states

    def _forget_due(self) -> None:
        self._wakes_at = _UNKNOWN

    def _forget_listeners(self) -> None:
        self._listeners.clear()
        self._is_laid_out = False
        self._watches = any(slave.waits_for_changes for slave in self._slaves)

    def _forget_layout(self) -> None:
        self._is_laid_out = False

    def _forget_states(self) -> None:
        self._is_looked_at = False

    def power_on(self) -> list[Frame]:
        """Start all nodes; return their boot-up frames."""
        self._wakes_at = _UNKNOWN
        return by_priority(frame for node in self._nodes for frame in node.power_on(self.now))

    def power_cycle(self, node_id: int) -> list[Frame]:
        """Switch the supply of one node off and on.

        Values that it has not stored are lost. Returns its boot-up frame.

        Args:
            node_id: The one that the node has now, or its port where no node has this node-ID.

        Raises:
            ValueError: There is no such node.
        """
        self._wakes_at = _UNKNOWN
        node = self._node(node_id)
        port = next(port for port, each in self._ports.items() if each is node)
        self._switch(port, is_off=False)
        self.on_power_cycle(port)
        return node.power_on(self.now)

    # -- bus-off ---------------------------------------------------------------------------------------------------------

    def bus_off(self, port: int) -> None:
        """Set a node's controller bus-off.

        1029h and 6007h decide how the node reacts. Calling it again has no effect.

        Raises:
            ValueError: There is no such port.
        """
        node = self._at(port)
        if port in self._off:
            return
        node.advance(self.now)
        self._switch(port, is_off=True)
        node.slave.bus_off()

    def bus_recovered(self, port: int) -> list[tuple[int, Frame]]:
        """Let a node's controller recover from bus-off.

        Returns the node's frames, emergency 8140h first; none if it was not bus-off.

        Raises:
            ValueError: There is no such port.
        """
        node = self._at(port)
        if port not in self._off:
            return []
        node.advance(self.now)  # what it would have said meanwhile is lost
        self._switch(port, is_off=False)
        node.slave.bus_recovered()
        return [(port, frame) for frame in node.slave.take_frames()]

    def bus_off_restart_ns(self, port: int) -> int | None:
        """Return the delay of the automatic restart after bus-off, ns.

        The result is None if the node does not restart its controller by itself.
        """
        node = self._ports.get(port)
        if not isinstance(node, Drive) or node.behaviour.bus_off_restart_ms is None:
            return None
        return round(1e6 * node.behaviour.bus_off_restart_ms)

    def _at(self, port: int) -> Node:
        if port not in self._ports:
            raise ValueError(f"there is no node at port {port}")
        return self._ports[port]

    def _switch(self, port: int, *, is_off: bool) -> None:
        """Cut a node off the bus, or connect it again."""
        (self._off.add if is_off else self._off.discard)(port)
        self._nodes_on = [(each, node.slave) for each, node in self._ports.items() if each not in self._off]
        self._forget_listeners()
        self._forget_due()

    # -- time and frames -------------------------------------------------------------------------------------------------

    def _node(self, node_id: int) -> Node:
        for node in self._nodes:
            if node.node_id == node_id:
                return node
        if node_id in self._ports:
            return self._ports[node_id]
        raise ValueError(f"there is no node {node_id}")

    @property
    def node_ids(self) -> list[int]:
        """Ports of all nodes, in rising order."""
        return list(self._ports)

    @property
    def period_ns(self) -> int:
        """Time that one SYNC is worth, in ns.

        It is the shortest 1006h that a node has been given, else the robot file's period.
        """
        shortest = 0
        for cell in self._periods:
            period_us: Any = cell.value
            if period_us and (not shortest or period_us < shortest):
                shortest = period_us
        return 1000 * shortest or self._period_ns

    def begin_lock_step(self) -> list[Frame]:
        """Advance to the next whole second."""
        return self.free_step(-(-self.now // SECOND) * SECOND)

    def hear(self, frame: Frame) -> list[tuple[int, Frame]]:
        """Return the nodes' answers at this instant, each with its port.

        No period becomes pending.
        """
        can_id, now = frame.can_id, self.now
        if can_id == _SYNC:
            self.accelerometer.sample()
        return [(node_id, answer) for node_id, slave in self._hearers(can_id) for answer in slave.receive(frame, now)]

    def _hearers(self, can_id: int) -> list[tuple[int, Slave]]:
        """Return the nodes that get a frame.

        They are those that listen to its identifier. After a deadline all nodes get it, since the deadline is served first.
        """
        self._is_looked_at = False
        due = self.due
        if due is not None and due <= self.now:
            self._wakes_at = _UNKNOWN
            return self._nodes_on
        found = self._listeners.get(can_id)
        if found is None:
            found = [(node_id, slave) for node_id, slave in self._nodes_on if slave.listens(can_id)]
            if found:  # else whoever sends enough identifiers fills the memory
                self._listeners[can_id] = found
        return found

    def receive(self, frame: Frame) -> list[Frame]:
        """Return the answers of the nodes at this instant.

        After a SYNC one period is pending.
        """
        if self._pending_ns:
            return self.finish_period() + self.receive(frame)
        answers = by_priority(answer for _, answer in self.hear(frame))
        if frame.can_id == _SYNC:
            self._pending_ns = self.period_ns
        return answers

    def exchange(self, message: bytes) -> bytes | None:
        """Process RPDOs and a SYNC at once, if that is all they mean.

        After it one period is pending, as after `receive` of the SYNC, and the answers are the same. Among them are those that
        nodes send late, but within the period.

        Returns:
            Records of the answers. None if the slaves must hear the frames one by one, since a drive does more than follow its
            set-points, a node has a deadline, or a frame is another one; then nothing has changed.
        """
        if self._pending_ns or not self._only_follows() or self._image.delay_ns > self._plain_period_ns:
            return None
        answers = self._image.synchronise(message, self.now)
        if answers is not None:
            self._pending_ns = self._plain_period_ns
        return answers

    def open_course(self) -> bool:
        """Let the core run cycles by itself: prepare `course`.

        It carries a message as long as `exchange` would take it, and no node acts by itself within its period.
        """
        course, image = self.course, self._image
        course.now, course.mechanics_now, course.synced = self.now, self._mechanics_ns, _UNKNOWN
        is_open = not self._pending_ns and self._only_follows() and image.delay_ns <= self._plain_period_ns
        course.is_open = is_open
        if is_open:
            self._sensor.draw()
            due, course.period = self.due, self._plain_period_ns
            self.axes.make_room(1 + self._plain_period_ns // self._control_period_ns)
            course.wakes_at = _NEVER if due is None else due
        return is_open

    def close_course(self) -> list[tuple[int, Frame]]:
        """Take over what the core has done; return the frames that drives send for it, each with its port."""
        course = self.course
        if course.now == self.now:
            return []
        if course.synced != _UNKNOWN:
            self._image.pass_to(course.synced)
        self.now, self._mechanics_ns = course.now, course.mechanics_now
        return [] if course.is_open else self._observed(self._update(), is_due=False)

    def pass_cycle(self, message: bytes, start: int, begin: int, bit_ns: int) -> PassedCycle | None:
        """Let a cycle pass on a bus that nothing else uses, answers included.

        Args:
            message: Records of RPDOs, and of a SYNC behind them.
            start: SOF of the first, in ns.
            begin: Beginning of the cycle, at the end of the one before or later.

        Returns:
            None if the frames must go one by one; then nothing has happened.
        """
        image, course, count = self._image, self.course, len(message) // RECORD.size
        if not self.open_course() or not image.is_in_order or image.delay_ns:
            return None
        ends, until = CORE.integers(count), begin + self._plain_period_ns
        CORE.call.pass_message(course, message, count, start, until, bit_ns, ends)
        if course.now == self.now:
            return None
        if course.synced == _UNKNOWN:
            return PassedCycle(until, (), b"", (), self.close_course())
        answers, answered = image.answered(course.synced), CORE.integers(len(image.ports))
        CORE.call.pass_answers(course, until, bit_ns, answered)
        course.synced = _UNKNOWN  # the slaves know it
        return PassedCycle(until, (*ends, *answered), answers, image.ports, self.close_course())

    def _only_follows(self) -> bool:
        """Return True if the process image can act for all nodes at this instant."""
        if self._watches or ((due := self.due) is not None and due <= self.now):
            return False
        if not (self._is_laid_out and self._is_looked_at):
            self._look()
        return self._is_plain

    def _look(self) -> None:
        """Decide whether the process image or the slaves act at SYNC."""
        if not self._is_laid_out:
            nodes = [node for port, node in self._ports.items() if port not in self._off and node.slave.listens(_SYNC)]
            self._is_laid_out, self._can_be_plain = True, self._image.lay_out(nodes)
        self._is_looked_at, self._is_plain = True, self._can_be_plain and self._image.look()
        self._plain_period_ns = self.period_ns

    def measure(self) -> tuple[float, float, float]:
        """Draw a sample of the accelerometer, in m/s²."""
        return self._sensor.sample(self.axes.sensed_acceleration())

    def finish_period(self) -> list[Frame]:
        """Let the period of the last SYNC pass."""
        pending, self._pending_ns = self._pending_ns, 0
        return self.advance(self.now + pending) if pending else []

    @property
    def due(self) -> int | None:
        """Next instant at which a node acts by itself."""
        wakes_at = self._wakes_at
        if wakes_at == _UNKNOWN:
            wakes_at = _NEVER
            for slave in self._slaves:
                due = slave.due
                if due is not None and due < wakes_at:
                    wakes_at = due
            self._wakes_at = wakes_at
        if wakes_at == _NEVER:
            return None
        return wakes_at if wakes_at > self.now else self.now

    def move(self, until: int) -> list[tuple[int, Frame]]:
        """Let time pass to an instant that is not beyond `due`.

        Returns the frames that the nodes send then, each with its port.

        Raises:
            ValueError: `until` lies before now.
        """
        if until < self.now:
            raise ValueError(f"the world's time is {self.now} ns and does not go back to {until} ns")
        periods = (until - self._mechanics_ns) // self._control_period_ns
        due = self.due
        self.now = until
        is_due = due is not None and due <= until
        if periods <= 0 and not is_due:
            return []  # nothing has moved, and no drive has anything new to look at
        frames: list[tuple[int, Frame]] = []
        if periods > 0:
            self.axes.advance(periods)
            self._mechanics_ns += periods * self._control_period_ns
            frames = self._update()
        return self._observed(frames, is_due=is_due)

    def _observed(self, frames: list[tuple[int, Frame]], *, is_due: bool) -> list[tuple[int, Frame]]:
        """Return frames of drives, with those of nodes that are due, but for nodes that are off the bus."""
        until = self.now
        if is_due or self._watches or self._wakes_at == _UNKNOWN:
            late = [
                (port, node)
                for port, node in self._ports.items()
                if node.slave.waits_for_changes or ((due := node.slave.due) is not None and due <= until)
            ]
            if late:
                self._is_looked_at = False
                # lowest identifier first, as a bus would let them pass
                frames += sorted(
                    ((port, frame) for port, node in late for frame in node.advance(until)), key=lambda sent: sent[1].can_id
                )
            self._wakes_at = _UNKNOWN
        if self._off:
            return [sent for sent in frames if sent[0] not in self._off]
        return frames

    def _update(self) -> list[tuple[int, Frame]]:
        """Update the drives that have something to observe."""
        wakes = self._wakes.tolist()
        if self._is_plain and self._is_looked_at and 1 not in wakes:
            return []  # drives that only follow observe nothing else
        waiting = [(port, drive) for port, drive in self._drives if wakes[drive.row] or drive.needs_update]
        if waiting:
            self._is_looked_at = False
        return [(port, frame) for port, drive in waiting for frame in drive.update(self.now)]

    def advance(self, until: int) -> list[Frame]:
        """Let time pass; return the nodes' frames in order of time.

        Raises:
            ValueError: `until` lies before now.
        """
        frames: list[Frame] = []
        while True:
            due = self.due
            stop = until if due is None or due > until else due
            frames += [frame for _, frame in self.move(stop)]
            if stop >= until:
                return frames

    def free_step(self, until: int) -> list[Frame]:
        """Let time pass in short steps."""
        frames: list[Frame] = []
        while self.now < until:
            frames += self.advance(min(until, self.now + FREE_STEP_NS))
        return frames


def by_priority(frames: Iterable[Frame]) -> list[Frame]:
    """Return frames of one instant in the bus's order of arbitration."""
    return sorted(frames, key=_IDENTIFIER)
