"""A bus to a whole emulated robot in this process, in the robot's own time: one SDO line per node, for several threads."""

import threading
from collections import deque

from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import NmtCommand
from hil.can.frame import Frame
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

TIMEOUT_S = 0.5


def robot_with(**axes: dict[str, object]) -> Robot:
    """The reference robot with other drives: `robot_with(axis2={"profile": "kollmorgen_akd"})`."""
    robot = load_robot("reference")
    changed = {int(name[4:]): robot.axis[int(name[4:])].model_copy(update=update) for name, update in axes.items()}
    return robot.model_copy(update={"axis": {**robot.axis, **changed}})


class WorldBus:
    """A world behind SDO lines; time passes when somebody waits."""

    def __init__(self, robot: Robot) -> None:
        self.world = World(robot)
        self._lock = threading.RLock()
        self._answers: dict[int, deque[bytes]] = {}
        self.frames = 0
        self.boots: dict[int, int] = {}
        self._sort(self.world.power_on())

    def device(self, node: int, profile: str) -> Device:
        return Device(SdoPort(node, self.line(node), TIMEOUT_S), Catalogue(Profile.load(profile)), self.nmt)

    def line(self, node: int) -> "Line":
        """The SDO channel of a node."""
        self._answers[node] = deque()
        return Line(self, node)

    def nmt(self, command: NmtCommand, node: int) -> None:
        self.put(0, bytes((command, node)))

    def put(self, can_id: int, data: bytes) -> None:
        with self._lock:
            self.frames += 1
            self._sort(self.world.receive(Frame(can_id, data)))

    def wait(self, seconds: float) -> None:
        with self._lock:
            self._sort(self.world.free_step(self.world.now + round(1e9 * seconds)))

    def get(self, node: int, timeout_s: float) -> bytes | None:
        with self._lock:
            if not self._answers[node]:
                self.wait(timeout_s)
            return self._answers[node].popleft() if self._answers[node] else None

    def clear(self, node: int) -> list[bytes]:
        with self._lock:
            old = list(self._answers[node])
            self._answers[node].clear()
            return old

    def _sort(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.frames += 1
            if frame.can_id & 0x780 == 0x700 and frame.data == b"\0":
                self.boots[frame.can_id & 0x7F] = self.boots.get(frame.can_id & 0x7F, 0) + 1
            node = frame.can_id - 0x580
            if node in self._answers:
                self._answers[node].append(frame.data)


class WorldSdoBus(WorldBus):
    """As much of an `SdoBus` as the choice of a device needs."""

    def port(self, node: int) -> SdoPort:
        return SdoPort(node, self.line(node), TIMEOUT_S)


class Line:
    def __init__(self, bus: WorldBus, node: int) -> None:
        self._bus, self._node = bus, node

    def send(self, can_id: int, data: bytes) -> None:
        self._bus.put(can_id, data)

    def receive(self, timeout_s: float) -> bytes | None:
        return self._bus.get(self._node, timeout_s)

    def clear(self) -> list[bytes]:
        return self._bus.clear(self._node)

    @property
    def boots(self) -> int:
        return self._bus.boots.get(self._node, 0)
