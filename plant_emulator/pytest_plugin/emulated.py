"""The emulated robot in the test's own process, in virtual time."""

from functools import partial
from types import MappingProxyType

from drive_profiles.address import LOCAL, Address
from drive_profiles.standard.cia301 import FunctionCode
from hil.can.frame import Frame
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.instant import FIRST_CLIENT, HeardFrame, Instant
from plant_emulator.bus.medium import Medium
from plant_emulator.bus.timed import TimedBus
from plant_emulator.bus.wire import EmulatedWire
from plant_emulator.drive.drive import Drive
from plant_emulator.motion.record import BRAKED
from plant_emulator.pytest_plugin.interference import Interference, LiveFaults
from plant_emulator.robots.robot import Robot
from plant_emulator.world import SECOND, World


class EmulatedChannel(InProcessChannel):
    """The bus in one process, with faults between bus and master."""

    def __init__(self, world: World, medium: Medium, bitrate: int | None, interference: Interference) -> None:
        """Join the bus; the nodes are powered on."""
        super().__init__(world, medium)
        self.address = Address(LOCAL, "in-process", bitrate)
        self.interference = interference
        interference.join(lambda: world.now, self.inject, self)
        self.heard = interference.trace.hear
        for frame in self._queue:
            self.heard(frame, world.now)

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus, subject to the faults.

        A SYNC advances the world by its period even if the frame is lost.
        """
        if frame.can_id == FunctionCode.SYNC:
            self.interference.run_due()
        passages = self.interference.frames.apply(frame, FIRST_CLIENT, self.world.now)
        if not passages and frame.can_id == FunctionCode.SYNC:
            self.advance(self.world.period_ns)
        for passage in passages:
            if not passage.delay_ns:
                super().send(passage.frame)
            elif frame.can_id == FunctionCode.SYNC:
                self.advance(passage.delay_ns)
                super().send(passage.frame)
            else:
                self.interference.at(self.world.now + passage.delay_ns, partial(super().send, passage.frame))

    def advance(self, duration_ns: int) -> None:
        """Let time pass without a SYNC.

        Actions that are due meanwhile happen at their instants.
        """
        until = self.world.now + duration_ns
        while True:
            due = self.interference.due_ns
            stop = until if due is None else max(self.world.now, min(until, due))
            self._deliver(self.medium.free(stop))
            self.interference.run_due()
            if stop >= until:
                return

    def _deliver(self, heard: list[HeardFrame]) -> None:
        for frame, port, end_ns in heard:
            self.heard(frame, end_ns)
            if port == FIRST_CLIENT or not self.passes(frame):
                continue
            for passage in self.interference.frames.apply(frame, port, end_ns):
                if passage.delay_ns:
                    self.interference.at(end_ns + passage.delay_ns, partial(self._queue.append, passage.frame))
                else:
                    self._queue.append(passage.frame)


class EmulatedRobot:
    """The world behind the bench, which tests inspect and advance."""

    def __init__(self, model: Robot, bitrate: int | None, interference: Interference) -> None:
        """Build the robot and switch it on."""
        self.model = model
        self.world = World(model)
        interference.wire = None if bitrate is None else LiveFaults()
        medium: Medium = Instant(self.world)
        self._wire: EmulatedWire | None = None
        if bitrate is not None:
            self._wire = EmulatedWire(bitrate, faults=interference.wire, now_ns=self.world.now)
            medium = TimedBus(self.world, self._wire)
        interference.power_cycle = lambda node_id: self.channel._deliver(
            [HeardFrame(frame, node_id, self.world.now) for frame in self.world.power_cycle(node_id)]
        )
        interference.switch_bus_off = self._switch_bus_off
        self.channel = EmulatedChannel(self.world, medium, bitrate, interference)
        self.drives: MappingProxyType[int, Drive] = MappingProxyType(self.world.drives)

    @property
    def now_s(self) -> float:
        """The robot's own time."""
        return self.world.now / SECOND

    def advance(self, duration_s: float) -> None:
        """Let time pass without the master: no SYNC, no heartbeat.

        Raises:
            ValueError: Time does not go back.
        """
        if not duration_s >= 0.0:
            raise ValueError(f"time cannot advance by {duration_s} s; expected 0 or more")
        self.channel.advance(round(SECOND * duration_s))

    def is_braked(self, axis: int) -> bool:
        """Return True if the brake of an axis is closed."""
        return bool(self.world.axes.motion["mode"][self.world.axes.row(axis)] == BRAKED)

    def position_rev(self, axis: int) -> float:
        """Return the position of an axis' motor, as its encoder counts."""
        axes = self.world.axes
        return float(axes.counts(axes.row(axis))) / self.model.axis[axis].encoder_counts_per_rev

    def _switch_bus_off(self, node_id: int, is_off: bool) -> None:
        """Put a node's controller bus-off, or restart it.

        On a wire the controller informs its node; without a wire the node changes at once.
        """
        if self._wire is not None:
            (self._wire.switch_off if is_off else self._wire.restart)(node_id)
        elif is_off:
            self.world.bus_off(node_id)
        else:
            self.channel._deliver([HeardFrame(frame, port, self.world.now) for port, frame in self.world.bus_recovered(node_id)])
