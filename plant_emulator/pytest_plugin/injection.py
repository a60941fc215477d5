"""What can go wrong on a bench, for a test to make it happen, at once or after a time of the bench."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from drive_profiles.cia301 import FunctionCode, NmtCommand
from hil.can.frame import Frame
from plant_emulator.bus.faults import Fault, Faults
from plant_emulator.inputs import DigitalInputs
from plant_emulator.motion_data import HOME_SWITCH, NEGATIVE_SWITCH, POSITIVE_SWITCH, PROBE_1, PROBE_2
from plant_emulator.pytest_plugin.interference import Interference
from plant_emulator.pytest_plugin.target import Target

SECOND = 1_000_000_000
INPUTS = {
    "negative_limit": NEGATIVE_SWITCH,
    "positive_limit": POSITIVE_SWITCH,
    "home": HOME_SWITCH,
    "probe_1": PROBE_1,
    "probe_2": PROBE_2,
}


class FaultInjection:
    """Faults between the master and its bus. Times count from the call, in the time of the bench: virtual on the emulated robot.

    On a real bench frames can be lost, strangers can speak, and the bus can be lost to the master. What could send a real robot
    a wrong set-point, and what nobody can do there, skips the test with the reason.
    """

    def __init__(self, target: Target) -> None:
        """Nothing goes wrong yet."""
        self._target = target
        target.channel()

    @property
    def _interference(self) -> Interference:
        self._target.interference.is_used = True
        return self._target.interference

    # -- frames --------------------------------------------------------------------------------------------------------

    def lose(
        self, can_id: int | None = None, *, after_s: float = 0.0, for_s: float | None = None, every: int = 1,
        count: int | None = None, probability: float = 1.0,
    ) -> Faults:  # fmt: skip
        """Frames do not arrive, in either direction; None: no frame does. What comes back tells its `hits`."""
        return self._befall(Fault("drop", can_id, every=every, count=count, probability=probability), after_s, for_s)

    def delay(
        self, can_id: int, delay_s: float, *, after_s: float = 0.0, for_s: float | None = None, every: int = 1,
        count: int | None = None,
    ) -> Faults:  # fmt: skip
        """Frames arrive later by so much."""
        self._needs_emulation("delayed set-points would reach a real robot")
        return self._befall(Fault("delay", can_id, delay_ns=round(SECOND * delay_s), every=every, count=count), after_s, for_s)

    def duplicate(
        self, can_id: int, copies: int = 1, *, after_s: float = 0.0, for_s: float | None = None, every: int = 1,
        count: int | None = None,
    ) -> Faults:  # fmt: skip
        """Frames arrive more than once."""
        self._needs_emulation("doubled frames would reach a real robot")
        return self._befall(Fault("duplicate", can_id, copies=copies, every=every, count=count), after_s, for_s)

    def corrupt(
        self, can_id: int, bits: tuple[int, ...] = (), *, noticed: bool = False, after_s: float = 0.0,
        for_s: float | None = None, every: int = 1, count: int | None = None,
    ) -> Faults:  # fmt: skip
        """Bits of the payload are inverted.

        Args:
            can_id: Of which frames.
            bits: Which ones, 0 is the lowest of the first byte; one by chance unless they are given.
            noticed: The CRC shows it, so that the frame is sent again; needs bit times (`--bitrate`).
            after_s: When it begins.
            for_s: How long it lasts; None: to the end.
            every: Only every n-th frame.
            count: How many at most.
        """
        self._needs_emulation("wrong set-points would reach a real robot")
        if noticed and self._interference.wire is None:
            pytest.skip("a CRC that is noticed needs bit times: --bitrate 1M")
        return self._befall(Fault("corrupt", can_id, bits=bits, crc=noticed, every=every, count=count), after_s, for_s)

    # -- nodes and bus -------------------------------------------------------------------------------------------------

    def stop_heartbeat(self, node_id: int, *, after_s: float = 0.0, for_s: float | None = None) -> Faults:
        """The heartbeat of a node, or of the master (`bench.bus.master_node_id`), is not heard any more."""
        return self.lose(FunctionCode.HEARTBEAT + node_id, after_s=after_s, for_s=for_s)

    def lose_bus(self, *, after_s: float = 0.0) -> None:
        """The master's plug is pulled; it is back when the drive is to be disabled in the end."""
        interference = self._interference
        if after_s:
            interference.at(interference.now_ns() + round(SECOND * after_s), interference.pull)
        else:
            interference.pull()

    def reset_node(self, node_id: int, *, after_s: float = 0.0) -> None:
        """A node loses its supply and gets it back: what it has not stored is gone."""
        self._needs_emulation("nobody here can switch a real node off; nmt() resets one by a message")
        interference = self._interference
        interference.at(interference.now_ns() + round(SECOND * after_s), lambda: interference.power_cycle(node_id))
        self._at_once(after_s)

    def bus_off(self, node_id: int, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """A node's controller goes bus-off: the node neither hears nor is heard, and reacts as its 1029h and 6007h say.

        Raises:
            ValueError: The robot has no such node.
        """
        self._needs_emulation("nobody here can put a real controller bus-off")
        robot = self._target.robot
        if robot is not None and node_id not in robot.world.node_ids:
            raise ValueError(f"the robot has no node {node_id}; it has {', '.join(map(str, robot.world.node_ids))}")
        switch = self._interference.switch_bus_off
        self._between(after_s, for_s, lambda: switch(node_id, True), lambda: switch(node_id, False))

    def nmt(self, command: NmtCommand, node_id: int = 0, *, after_s: float = 0.0) -> None:
        """A stranger sends an NMT command; node 0 means all."""
        self.send(Frame(FunctionCode.NMT, bytes((command, node_id))), after_s=after_s)

    def emergency(self, node_id: int, code: int, *, register: int = 1, after_s: float = 0.0) -> None:
        """A node reports an emergency, or somebody in its name; code 0 withdraws it. The master hears it as well."""
        data = code.to_bytes(2, "little") + bytes((register, 0, 0, 0, 0, 0))
        frame = Frame(FunctionCode.EMERGENCY + node_id, data)
        if self._target.robot is None:
            self._needs_emulation("a master does not hear the emergencies that it sends itself")
        self.send(frame, after_s=after_s)

    def send(self, frame: Frame, *, after_s: float = 0.0) -> None:
        """A stranger sends a frame."""
        interference = self._interference
        interference.at(interference.now_ns() + round(SECOND * after_s), lambda: interference.put(frame))
        self._at_once(after_s)

    # -- contacts of a drive --------------------------------------------------------------------------------------------

    def safe_torque_off(self, axis: int, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """The safe torque off input of an axis' drive opens: under torque that is a fault, and the brake closes at once.

        Raises:
            ValueError: The robot has no such axis.
        """
        inputs = self._inputs(axis)
        self._between(after_s, for_s, lambda: inputs.set_sto(True), lambda: inputs.set_sto(False))

    def hold_input(self, axis: int, name: str, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """An input of an axis' drive is active, wherever the axis stands.

        Args:
            axis: Its number.
            name: negative_limit, positive_limit, home, probe_1 or probe_2.
            after_s: When it begins.
            for_s: How long it lasts; None: to the end.

        Raises:
            ValueError: The robot has no such axis, or there is no such input.
        """
        inputs = self._inputs(axis)
        if name not in INPUTS:
            raise ValueError(f"there is no input {name}; there are {', '.join(INPUTS)}")
        bit = INPUTS[name]
        self._between(after_s, for_s, lambda: inputs.force(bit), lambda: inputs.force(bit, active=False))

    def _inputs(self, axis: int) -> DigitalInputs:
        self._needs_emulation("nobody here can reach a real drive's contacts")
        drives = {} if self._target.robot is None else self._target.robot.drives
        if axis not in drives:
            raise ValueError(f"the robot has no axis {axis}; it has {', '.join(map(str, sorted(drives)))}")
        return drives[axis].inputs

    # -- how -----------------------------------------------------------------------------------------------------------

    def _between(self, after_s: float, for_s: float | None, begin: Callable[[], None], end: Callable[[], None]) -> None:
        begin_ns = self._interference.now_ns() + round(SECOND * after_s)
        end_ns = None if for_s is None else begin_ns + round(SECOND * for_s)
        self._interference.between(begin_ns, end_ns, begin, end)
        self._at_once(after_s)

    def _at_once(self, after_s: float) -> None:
        if not after_s and self._target.robot is not None:
            self._interference.run_due()

    def _befall(self, fault: Fault, after_s: float, for_s: float | None) -> Faults:
        begin_s = self._interference.now_ns() / SECOND + after_s
        end_s = None if for_s is None else begin_s + for_s
        timed = replace(fault, from_s=begin_s, to_s=end_s)
        if fault.kind == "corrupt" and fault.crc and self._interference.wire is not None:
            return self._interference.wire.add(timed)
        return self._interference.frames.add(timed)

    def _needs_emulation(self, reason: str) -> None:
        if self._target.robot is None:
            pytest.skip(f"{reason}; this runs on the emulated robot only")
