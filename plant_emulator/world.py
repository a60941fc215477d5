"""The world: drives, accelerometer, axes and one clock. Sans IO: frames and time in, frames out."""

from collections.abc import Iterable

import numpy as np

from drive_profiles.cia301 import FunctionCode
from hil.can.frame import Frame
from plant_emulator.accelerometer import Accelerometer
from plant_emulator.axes import Axes
from plant_emulator.drive import Drive
from plant_emulator.physics.tip import Sensor
from plant_emulator.robot import Robot

SECOND = 1_000_000_000
FREE_STEP_NS = 1_000_000
"""How often a world that runs by itself looks at its drives."""

Node = Drive | Accelerometer


class World:
    """All nodes of one bus and the robot behind them, in integer nanoseconds of their own clock.

    In lock-step every SYNC owes the world one period: `receive` gives the answers of that instant, `settle` then lets the
    period pass. Without SYNC `advance` lets any time pass.

    Attributes:
        now: The world's time in ns.
        axes: The mechanics.
        drives: By axis number.
        accelerometer: The node at the tip.
    """

    def __init__(self, robot: Robot) -> None:
        """Build the nodes; `power_on` starts them."""
        self.robot = robot
        self.now = 0
        self.axes = Axes(robot)
        self.drives = {number: Drive(self.axes, number) for number in self.axes.numbers}
        setting = robot.accelerometer
        self._sensor = Sensor(setting.noise_m_s2, setting.resolution_m_s2, setting.range_m_s2, np.random.default_rng(robot.seed))
        self.accelerometer = Accelerometer(setting.node_id, self._measure, setting.range_m_s2)
        nodes: list[Node] = [*self.drives.values(), self.accelerometer]
        self._nodes = sorted(nodes, key=lambda node: node.node_id)
        self._periods = [node.slave.dictionary.cell(0x1006) for node in self._nodes]
        self._tick_ns = round(1e9 * robot.control_period_s)
        self._mechanics_ns = 0
        self._owed_ns = 0

    def power_on(self) -> list[Frame]:
        """Start all nodes; their boot-up frames."""
        return _by_priority(frame for node in self._nodes for frame in node.power_on(self.now))

    def power_cycle(self, node_id: int) -> list[Frame]:
        """Take the supply of one node away and give it back: what it has not stored is lost; its boot-up frame.

        Raises:
            ValueError: There is no such node.
        """
        for node in self._nodes:
            if node.node_id == node_id:
                return node.power_on(self.now)
        raise ValueError(f"there is no node {node_id}")

    @property
    def period_ns(self) -> int:
        """What one SYNC is worth: the shortest 1006h that a node has been given, else the robot file's period."""
        told = [int(cell.value) for cell in self._periods if cell.value]
        return 1000 * min(told) if told else round(1e9 * self.robot.sync_period_s)

    def begin_lock_step(self) -> list[Frame]:
        """Go on to the next whole second, so that every run finds the clock's phase the same."""
        return self.free_step(-(-self.now // SECOND) * SECOND)

    def receive(self, frame: Frame) -> list[Frame]:
        """What the nodes answer at this instant; a SYNC then owes the world a period."""
        if self._owed_ns:
            return self.settle() + self.receive(frame)
        is_sync = frame.can_id == FunctionCode.SYNC
        if is_sync:
            self.accelerometer.sample()
        answers = [answer for node in self._nodes for answer in node.receive(frame, self.now)]
        if is_sync:
            self._owed_ns = self.period_ns
        return _by_priority(answers) if len(answers) > 1 else answers

    def settle(self) -> list[Frame]:
        """Let the period pass that the last SYNC is worth."""
        owed, self._owed_ns = self._owed_ns, 0
        return self.advance(self.now + owed) if owed else []

    def advance(self, until: int) -> list[Frame]:
        """Let time pass; what the nodes send meanwhile, in order of time.

        Raises:
            ValueError: `until` lies before now.
        """
        if until < self.now:
            raise ValueError(f"the world's time is {self.now} ns and does not go back to {until} ns")
        frames: list[Frame] = []
        while True:
            stop = until
            for node in self._nodes:
                due = node.slave.due
                if due is not None and due < stop:
                    stop = max(due, self.now)
            self._advance_mechanics(stop)
            self.now = stop
            for node in self._nodes:
                frames += node.update()
            late = [node for node in self._nodes if _is_due(node, stop)]
            if late:
                frames += _by_priority(frame for node in late for frame in node.advance(stop))
            if stop >= until:
                return frames

    def free_step(self, until: int) -> list[Frame]:
        """Let time pass in short steps, so that drives see their limits and finished ramps in time."""
        frames: list[Frame] = []
        while self.now < until:
            frames += self.advance(min(until, self.now + FREE_STEP_NS))
        return frames

    def _advance_mechanics(self, until: int) -> None:
        """Run the control periods that begin before `until`."""
        ticks = (until - self._mechanics_ns) // self._tick_ns
        if ticks > 0:
            self.axes.advance(ticks)
            self._mechanics_ns += ticks * self._tick_ns

    def _measure(self) -> tuple[float, float, float]:
        return self._sensor.sample(self.axes.tip_acceleration())


def _is_due(node: Node, now: int) -> bool:
    """Whether a node is to be asked: a timer has run out, or it watches objects that may have changed."""
    due = node.slave.due
    return (due is not None and due <= now) or node.slave.waits_for_changes


def _by_priority(frames: Iterable[Frame]) -> list[Frame]:
    """Frames of one instant in the order in which a bus would let them pass: lowest identifier first."""
    return sorted(frames, key=lambda frame: frame.can_id)
