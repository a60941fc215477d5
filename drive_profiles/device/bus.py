"""A CAN bus for the parameter tool, opened through python-can."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

import can

from drive_profiles.address import LOCAL, PYTHON_CAN_LOCAL, parse_address, without_errno
from drive_profiles.device.sdo import ForeignRequests, SdoPort
from drive_profiles.errors import BusError
from drive_profiles.standard.cia301 import BROADCAST, MAX_NODE_ID, FunctionCode, NmtCommand
from drive_profiles.standard.cia305 import LSS_RESPONSE

_INTERFACES = {LOCAL: PYTHON_CAN_LOCAL}
"""Interfaces that python-can knows by another name than ours."""
_FILTERS = [
    {"can_id": FunctionCode.SDO_RESPONSE, "can_mask": 0x780, "extended": False},
    {"can_id": FunctionCode.SDO_REQUEST, "can_mask": 0x780, "extended": False},  # those of other clients
    {"can_id": FunctionCode.HEARTBEAT, "can_mask": 0x780, "extended": False},
    {"can_id": LSS_RESPONSE, "can_mask": 0x7FF, "extended": False},
]
_FUNCTION = 0x780
_POLL_S = 0.05
_BACKLOG = 256
_SCAN_BURST = 8
"""Number of requests that a scan sends together: the queue of a small adapter holds so many."""


class _Line:
    """The SDO frames of one node on a shared bus."""

    def __init__(self, bus: "SdoBus", node: int) -> None:
        self._bus = bus
        self.answers: queue.Queue[bytes] = queue.Queue(_BACKLOG)
        self.boots = 0
        self.nmt_state: int | None = None
        self.requests = ForeignRequests()
        self.port = SdoPort(node, self, bus.timeout_s, lambda: self.requests.count)

    def send(self, can_id: int, data: bytes) -> None:
        self.requests.note_own(data)
        self._bus.send(can_id, data)

    def receive(self, timeout_s: float) -> bytes | None:
        """Wait for the next answer; raise `BusError` if the bus is lost."""
        self._bus.check()
        try:
            return self.answers.get(timeout=timeout_s)
        except queue.Empty:
            self._bus.check()
            return None

    def clear(self) -> list[bytes]:
        old: list[bytes] = []
        with contextlib.suppress(queue.Empty):
            while True:
                old.append(self.answers.get_nowait())
        return old


class SdoBus:
    """A CAN bus that several threads may share.

    Attributes:
        on_lss: Called in the reading thread with the data of each answer of an LSS slave.
    """

    def __init__(self, address: str, timeout_s: float = 0.5) -> None:
        """Open the bus, whose nodes may take `timeout_s` to answer.

        Raises:
            AddressError: `address` is not a bus address.
            BusError: There is no such bus.
        """
        parsed = parse_address(address)
        self.address = str(parsed)
        self.timeout_s = timeout_s
        settings: dict[str, Any] = {} if parsed.bitrate is None else {"bitrate": parsed.bitrate}
        try:
            self._bus = can.Bus(
                interface=_INTERFACES.get(parsed.interface, parsed.interface),
                channel=parsed.channel,
                can_filters=_FILTERS,
                **settings,
            )
        except (can.CanError, OSError, ValueError, ImportError, TypeError) as error:
            said = without_errno(str(error))
            is_named = f"{parsed.interface}:{parsed.channel}" in said
            raise BusError(said if is_named else f"no bus at {self.address}: {said}") from error
        self._lines: dict[int, _Line] = {}
        self.on_lss: Callable[[bytes], None] = lambda data: None
        self._lost: Exception | None = None
        self._closing = threading.Event()
        self._sending = threading.Lock()
        self._reader = threading.Thread(target=self._read, name=f"bus {self.address}", daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bus; closing it again does nothing."""
        if not self._closing.is_set():
            self._closing.set()
            self._reader.join(2 * _POLL_S + 1.0)
            with contextlib.suppress(can.CanError, OSError):  # of a bus that is lost there is nothing left to close
                self._bus.shutdown()

    def port(self, node: int) -> SdoPort:
        """Return a node's one SDO client; `ValueError` outside 1 to 127."""
        return self._line(node).port

    def _line(self, node: int) -> _Line:
        if not 1 <= node <= MAX_NODE_ID:
            raise ValueError(f"node-ID {node}: expected 1 to {MAX_NODE_ID}")
        if node not in self._lines:
            self._lines[node] = _Line(self, node)
        return self._lines[node]

    def nmt(self, command: NmtCommand, node: int) -> None:
        """Send an NMT command to one node (0: to all)."""
        self.send(FunctionCode.NMT, bytes((command, BROADCAST if node == 0 else node)))

    def boots(self, node: int) -> int:
        """Return the number of boot-up messages since the node's port was made."""
        return self._line(node).boots

    def nmt_state(self, node: int) -> int | None:
        """Return the NMT state of a node's last heartbeat, or None."""
        return self._line(node).nmt_state

    def send(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus.

        Raises:
            BusError: The frame cannot be sent.
        """
        self.check()
        try:
            with self._sending:
                self._bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data), timeout=self.timeout_s)
        except (can.CanError, OSError) as error:
            raise BusError(f"bus {self.address} cannot send a frame: {error}") from error

    def check(self) -> None:
        """Raise `BusError` if the bus was lost."""
        if self._lost is not None:
            raise BusError(f"bus {self.address} lost: {self._lost}")

    def answering(self, nodes: Sequence[int]) -> list[int]:
        """Return the nodes that answer a read of 1000h, in rising order."""
        for node in nodes:
            self._line(node).clear()
        for count, node in enumerate(nodes, 1):
            self._lines[node].send(FunctionCode.SDO_REQUEST + node, b"\x40\x00\x10\x00\x00\x00\x00\x00")
            if count % _SCAN_BURST == 0:
                time.sleep(0.002)
        deadline = time.monotonic() + self.timeout_s
        while time.monotonic() < deadline:
            time.sleep(min(0.02, self.timeout_s))
            self.check()
        return [node for node in nodes if self._lines[node].clear()]

    def _read(self) -> None:
        """Pass each received frame to its node's port until the bus closes."""
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_POLL_S)
            except Exception as error:  # noqa: BLE001 - adapters raise what they like, and silence would look like a dead node
                self._lost = error
                for line in list(self._lines.values()):
                    with contextlib.suppress(queue.Full):
                        line.answers.put_nowait(b"")  # wakes whoever waits
                return
            if message is None or message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd:
                continue
            node, function = message.arbitration_id & 0x7F, message.arbitration_id & _FUNCTION
            if function == FunctionCode.SDO_RESPONSE and node in self._lines:
                with contextlib.suppress(queue.Full):  # a babbling node loses its own answers
                    self._lines[node].answers.put_nowait(bytes(message.data))
            elif message.arbitration_id == LSS_RESPONSE:
                self.on_lss(bytes(message.data))
            elif function == FunctionCode.SDO_REQUEST and node in self._lines:
                self._lines[node].requests.note_received(bytes(message.data))
            elif function == FunctionCode.HEARTBEAT and len(message.data) == 1 and node in self._lines:
                self._lines[node].nmt_state = message.data[0] & 0x7F
                self._lines[node].boots += message.data[0] == 0
