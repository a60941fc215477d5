"""Faults that a test injects into its bench."""

from collections.abc import Callable

import pytest

from drive_profiles.standard.cia301 import FunctionCode, NmtCommand
from hil.can.frame import Frame
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.motion.record import HOME_SWITCH, NEGATIVE_SWITCH, POSITIVE_SWITCH, PROBE_1, PROBE_2
from plant_emulator.pytest_plugin.interference import Interference
from plant_emulator.pytest_plugin.target import Target
from plant_emulator.world import SECOND

INPUTS = {
    "negative_limit": NEGATIVE_SWITCH,
    "positive_limit": POSITIVE_SWITCH,
    "home": HOME_SWITCH,
    "probe_1": PROBE_1,
    "probe_2": PROBE_2,
}


class FaultInjection:
    """Faults between the master and its bus.

    Times count from the call, in the time of the bench, which is virtual on the emulated robot.

    On a real bench frames can be lost, other participants can send, and the master can lose the bus. A fault that could send
    a real robot a wrong set-point, or that is impossible there, skips the test with the reason.
    """

    def __init__(self, target: Target) -> None:
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
    ) -> BusFaults:  # fmt: skip
        """Lose frames in both directions.

        Args:
            can_id: Identifier of the frames; None: all frames.
            after_s: Time from now until it begins.
            for_s: Duration; None: to the end of the test.
            every: n, so that every n-th such frame is lost.
            count: Largest number of frames; None: no limit.
            probability: Chance that such an n-th frame is lost.

        Returns:
            The fault at work; its `hits` counts the lost frames.
        """
        return self._apply(Fault(kind="drop", can_id=can_id, every=every, count=count, probability=probability), after_s, for_s)

    def delay(
        self, can_id: int, delay_s: float, *, after_s: float = 0.0, for_s: float | None = None, every: int = 1,
        count: int | None = None,
    ) -> BusFaults:  # fmt: skip
        """Delay frames by so much; the others as of `lose`. The `hits` of the result count them."""
        self._needs_emulation("delayed set-points would reach a real robot")
        return self._apply(
            Fault(kind="delay", can_id=can_id, delay_ns=round(SECOND * delay_s), every=every, count=count), after_s, for_s
        )

    def duplicate(
        self, can_id: int, copies: int = 1, *, after_s: float = 0.0, for_s: float | None = None, every: int = 1,
        count: int | None = None,
    ) -> BusFaults:  # fmt: skip
        """Send so many copies of frames; the others as of `lose`. The `hits` of the result count the frames."""
        self._needs_emulation("doubled frames would reach a real robot")
        return self._apply(Fault(kind="duplicate", can_id=can_id, copies=copies, every=every, count=count), after_s, for_s)

    def corrupt(
        self, can_id: int, bits: tuple[int, ...] = (), *, noticed: bool = False, after_s: float = 0.0,
        for_s: float | None = None, every: int = 1, count: int | None = None,
    ) -> BusFaults:  # fmt: skip
        """Invert bits of the payload of frames; the others as of `lose`.

        Args:
            bits: Bits to invert, 0 is the lowest of the first byte; one by chance unless they are given.
            noticed: The CRC shows it, so that the frame is sent again; needs bit times (`--hil-bitrate`).
        """
        self._needs_emulation("wrong set-points would reach a real robot")
        if noticed and self._interference.wire is None:
            pytest.skip("noticed=True needs bit times; give --hil-bitrate 1M")
        bits = () if noticed else bits
        return self._apply(Fault(kind="corrupt", can_id=can_id, bits=bits, crc=noticed, every=every, count=count), after_s, for_s)

    # -- nodes and bus -------------------------------------------------------------------------------------------------

    def stop_heartbeat(self, node_id: int, *, after_s: float = 0.0, for_s: float | None = None) -> BusFaults:
        """Lose the heartbeats of a node or of the master.

        The master's node-ID is `bench.bus.master_node_id`.
        """
        return self.lose(FunctionCode.HEARTBEAT + node_id, after_s=after_s, for_s=for_s)

    def lose_bus(self, *, after_s: float = 0.0) -> None:
        """Disconnect the master from the bus.

        The bus is back when the drive is disabled at the end of the test.
        """
        interference = self._interference
        if after_s:
            interference.at(interference.now_ns() + round(SECOND * after_s), interference.pull)
        else:
            interference.pull()

    def reset_node(self, node_id: int, *, after_s: float = 0.0) -> None:
        """Switch the supply of a node off and on.

        Values that it has not stored are lost.
        """
        self._needs_emulation("a test cannot switch a real node off; nmt() resets one by a message")
        self._between(after_s, None, lambda: self._interference.power_cycle(node_id))

    def bus_off(self, node_id: int, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """Put a node's controller bus-off.

        The node neither receives nor sends, and reacts as its 1029h and 6007h demand.

        Raises:
            ValueError: The robot has no such node.
        """
        self._needs_emulation("a test cannot put a real controller bus-off")
        robot = self._target.robot
        if robot is not None and node_id not in robot.world.node_ids:
            raise ValueError(f"the robot has no node {node_id}; it has {', '.join(map(str, robot.world.node_ids))}")
        switch = self._interference.switch_bus_off
        self._between(after_s, for_s, lambda: switch(node_id, True), lambda: switch(node_id, False))

    def nmt(self, command: NmtCommand, node_id: int = 0, *, after_s: float = 0.0) -> None:
        """Send an NMT command as another participant; node 0 means all."""
        self.send(Frame(FunctionCode.NMT, bytes((command, node_id))), after_s=after_s)

    def emergency(self, node_id: int, code: int, *, register: int = 1, after_s: float = 0.0) -> None:
        """Send an emergency in the name of a node.

        Code 0 withdraws it; `register` is that of 1001h. The master receives it as well.
        """
        data = code.to_bytes(2, "little") + bytes((register, 0, 0, 0, 0, 0))
        frame = Frame(FunctionCode.EMERGENCY + node_id, data)
        if self._target.robot is None:
            self._needs_emulation("a master does not receive the emergencies that it sends")
        self.send(frame, after_s=after_s)

    def send(self, frame: Frame, *, after_s: float = 0.0) -> None:
        """Send a frame as another participant."""
        self._between(after_s, None, lambda: self._interference.put(frame))

    # -- contacts of a drive --------------------------------------------------------------------------------------------

    def safe_torque_off(self, axis: int, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """Activate safe torque off of an axis' drive.

        Under torque that is a fault, and the brake closes at once.

        Raises:
            ValueError: The robot has no such axis.
        """
        inputs = self._inputs(axis)
        self._between(after_s, for_s, lambda: inputs.set_sto(True), lambda: inputs.set_sto(False))

    def hold_input(self, axis: int, name: str, *, after_s: float = 0.0, for_s: float | None = None) -> None:
        """Force an input of `INPUTS` of an axis' drive to be active.

        Raises:
            ValueError: The robot has no such axis, or there is no such input.
        """
        inputs = self._inputs(axis)
        if name not in INPUTS:
            raise ValueError(f"unknown input {name}; expected one of {', '.join(INPUTS)}")
        bit = INPUTS[name]
        self._between(after_s, for_s, lambda: inputs.force(bit), lambda: inputs.force(bit, active=False))

    def _inputs(self, axis: int) -> DigitalInputs:
        self._needs_emulation("a test cannot reach a real drive's contacts")
        drives = {} if self._target.robot is None else self._target.robot.drives
        if axis not in drives:
            raise ValueError(f"the robot has no axis {axis}; it has {', '.join(map(str, sorted(drives)))}")
        return drives[axis].inputs

    # -- how -----------------------------------------------------------------------------------------------------------

    def _between(
        self, after_s: float, for_s: float | None, begin: Callable[[], None], end: Callable[[], None] | None = None
    ) -> None:
        begin_ns = self._interference.now_ns() + round(SECOND * after_s)
        end_ns = None if for_s is None else begin_ns + round(SECOND * for_s)
        self._interference.between(begin_ns, end_ns, begin, end)
        if not after_s and self._target.robot is not None:
            self._interference.run_due()

    def _apply(self, fault: Fault, after_s: float, for_s: float | None) -> BusFaults:
        begin_s = self._interference.now_ns() / SECOND + after_s
        end_s = None if for_s is None else begin_s + for_s
        timed = fault.model_copy(update={"from_s": begin_s, "to_s": end_s})
        if fault.kind == "corrupt" and fault.crc and self._interference.wire is not None:
            return self._interference.wire.add(timed)
        return self._interference.frames.add(timed)

    def _needs_emulation(self, reason: str) -> None:
        if self._target.robot is None:
            pytest.skip(f"{reason}; this runs on the emulated robot only")
