"""The master's side of CANopen on one channel."""

import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drive_profiles.device.sdo import ForeignRequests, SdoPort
from drive_profiles.standard.cia301 import DataType, FunctionCode, NmtCommand, decode, encode
from drive_profiles.standard.error_codes import emergency_text
from hil.can.channel import Channel, MessageChannel
from hil.can.errors_frame import decode as decode_error
from hil.can.frame import CAN_ERR_FLAG, Frame
from hil.errors import NoAnswerError, ReadBackError, SdoAbortedError, SharedNodeError
from hil.master.realtime import Clock
from hil.recording import BusLog, LoggedFrame, LoggedMessage

SYNC = Frame(FunctionCode.SYNC, b"")
MAX_EVENTS = 256
_EMERGENCY = struct.Struct("<HB5s")


@dataclass(frozen=True)
class Emergency:
    """An EMCY message: a node's error, or its end (code 0)."""

    node: int
    code: int
    register: int
    vendor: bytes
    own: Mapping[int, str] = field(default_factory=dict)
    """The maker's codes in words."""

    def __str__(self) -> str:
        return f"node {self.node} reports {emergency_text(self.code, self.register, self.own)}"


class _Line:
    """SDO frames of one node, read from the channel in the caller's thread."""

    def __init__(self, network: "Network") -> None:
        self._network = network
        self.answers: deque[bytes] = deque(maxlen=MAX_EVENTS)
        self.requests = ForeignRequests()
        self.unasked = 0
        self.boots = 0  # the network itself watches for them

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame and log it."""
        self.requests.note_own(data)
        self._network.send(Frame(can_id, data))

    def receive(self, timeout_s: float) -> bytes | None:
        """The next answer, or None when none came in time."""
        return self.answers.popleft() if self._network.pump_until(lambda: bool(self.answers), timeout_s) else None

    def clear(self) -> list[bytes]:
        """Return the answers that were not read, and forget them."""
        old = list(self.answers)
        self.unasked += len(old)
        self.answers.clear()
        return old


class _Port(SdoPort):
    """The package's SDO client with the bench's errors."""

    refusal = SdoAbortedError
    silence = NoAnswerError
    shared = SharedNodeError


class Network:
    """One bus from the master's side.

    Time on a lock-step bus is counted in SYNCs; on any other it is the monotonic clock, from the start of the network.

    Attributes:
        messages: The same, if it can take a cycle in one message each way; else None.
        emergencies: Emergencies of the nodes that were not handled yet; a bounded queue.
        fault_texts: For each node, its maker's own error codes in words.
        heartbeats: Time and NMT state of the last heartbeat of each node.
        bus_errors: Errors on the bus that the controller reported, in words, with their number; the first `MAX_EVENTS` kinds.
        foreign_sync: True if the SYNC of another node has been seen.
        boots: Nodes whose boot-up message has come since it was last cleared.
        period_s: Time that one SYNC adds on a lock-step bus.
        lock_step_s: The bench's time on such a bus.
    """

    def __init__(self, channel: Channel, log: BusLog, timeout_s: float, period_s: float, clock: Clock | None = None) -> None:
        self.channel = channel
        self.messages = channel if isinstance(channel, MessageChannel) else None
        self.log, self.timeout_s, self.period_s = log, timeout_s, period_s
        self.emergencies: deque[Emergency] = deque(maxlen=MAX_EVENTS)
        self.fault_texts: dict[int, Mapping[int, str]] = {}
        self.heartbeats: dict[int, tuple[float, int]] = {}
        self.boots: set[int] = set()
        self.bus_errors: Counter[str] = Counter()
        self.foreign_sync = False
        self._lines: dict[int, _Line] = {}
        self._ports: dict[int, _Port] = {}
        self.lock_step_s = 0.0
        self._clock = clock or Clock()
        self._start = self._clock.now()

    def now(self) -> float:
        """The bench's time in s."""
        return self.lock_step_s if self.channel.is_lock_step else self._clock.now() - self._start

    def send(self, frame: Frame) -> None:
        """Send a frame and log it."""
        self.channel.send(frame)
        if self.log.is_on:
            self.log.add(LoggedFrame(self.now(), frame[0], frame[1], False))

    def sync(self) -> None:
        """Send SYNC; on a lock-step bus time advances by one period."""
        self.send(SYNC)
        self.lock_step_s += self.period_s

    def sync_with(self, frames: list[Frame]) -> None:
        """Send frames and SYNC after them, together if possible."""
        together = [*frames, SYNC]
        self.channel.send_all(together)
        if self.log.is_on:
            now = self.now()
            for can_id, data in together:
                self.log.add(LoggedFrame(now, can_id, data, False))
        self.lock_step_s += self.period_s

    def log_message(self, message: bytes | bytearray, *, is_received: bool) -> None:
        """Log the records of one message of a cycle."""
        if self.log.is_on:
            self.log.add(LoggedMessage(self.lock_step_s, bytes(message), is_received))

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Receive the next frame and those in one message with it."""
        frames = self.channel.receive_all(timeout_s)
        if self.log.is_on:
            now = self.now()
            for can_id, data in frames:
                self.log.add(LoggedFrame(now, can_id, data, True))
        return frames

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, logged; None when none came in time."""
        frame = self.channel.receive(timeout_s)
        if frame is not None and self.log.is_on:
            self.log.add(LoggedFrame(self.now(), frame[0], frame[1], True))
        return frame

    def dispatch(self, frame: Frame) -> None:
        """Dispatch a frame that is not cyclic; no bytes raise an error."""
        can_id, data = frame
        if can_id & CAN_ERR_FLAG:
            event = decode_error(frame)
            if event is not None and (event.words in self.bus_errors or len(self.bus_errors) < MAX_EVENTS):
                self.bus_errors[event.words] += 1
            return
        function, node = can_id & 0x780, can_id & 0x7F
        if can_id > 0x7FF:  # extended, or a remote request
            return
        if function == FunctionCode.SDO_RESPONSE and node in self._lines:
            self._lines[node].answers.append(data)
        elif function == FunctionCode.SDO_REQUEST and node in self._lines:
            self._lines[node].requests.note_received(data)
        elif function == FunctionCode.HEARTBEAT and len(data) == 1:
            self.heartbeats[node] = (self.now(), data[0] & 0x7F)
            if data[0] == 0:
                self.boots.add(node)
        elif can_id == FunctionCode.SYNC:
            self.foreign_sync = True
        elif function == FunctionCode.EMERGENCY and node:
            code, register, vendor = _EMERGENCY.unpack(data.ljust(_EMERGENCY.size, b"\0")[: _EMERGENCY.size])
            self.emergencies.append(Emergency(node, code, register, vendor, self.fault_texts.get(node, {})))

    def answers_twice(self, node: int) -> bool:
        """True if too many answers suggest that two nodes share a node-ID."""
        line = self._lines.get(node)
        return line is not None and line.unasked + len(line.answers) > 0

    def pump_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Read and dispatch frames until `done` holds or none can come.

        None can come once time is over, and on a bus that does not wait. Return the last value of `done`.
        """
        deadline = self._clock.now() + timeout_s
        while not done():
            left = deadline - self._clock.now()
            if left <= 0.0:
                return False
            frame = self.receive(left)
            if frame is not None:
                self.dispatch(frame)
            elif not self.channel.waits:
                return False
        return True

    def nmt(self, command: NmtCommand, node: int) -> None:
        """Send an NMT command to one node."""
        self.send(Frame(FunctionCode.NMT, bytes((command, node))))

    # -- SDO -----------------------------------------------------------------------------------------------------------

    def _port(self, node: int) -> _Port:
        if node not in self._ports:
            line = self._lines[node] = _Line(self)
            self._ports[node] = _Port(node, line, self.timeout_s, lambda: line.requests.count)
        return self._ports[node]

    def read_raw(self, node: int, index: int, subindex: int = 0, name: str = "") -> bytes:
        """Upload an object as bytes.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node is silent.
        """
        return self._port(node).read((index, subindex), name)

    def write_raw(self, node: int, index: int, subindex: int, data: bytes, name: str = "", value: object = None) -> None:
        """Download an object, once: a write is never repeated blindly.

        Args:
            value: New value for messages, instead of the bytes.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node is silent.
        """
        self._port(node).write((index, subindex), data, name, value)

    def read(self, node: int, index: int, subindex: int, kind: DataType, name: str = "") -> Any:
        """Read an object's value.

        Bytes of another length than the type's count as no answer.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node is silent, or its answer has another length.
        """
        data = self.read_raw(node, index, subindex, name)
        size = kind.size
        if size is not None and len(data) != size:
            raise NoAnswerError(
                node, f"{index:04X}h:{subindex:02X}h of {size} bytes (received: {len(data)} bytes)", self.timeout_s
            )
        return decode(kind, data)

    def write(self, node: int, index: int, subindex: int, kind: DataType, value: Any, name: str = "") -> None:
        """Write an object and read it back, raw bytes compared.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node is silent.
            ReadBackError: The object holds another value afterwards.
        """
        data = encode(kind, value)
        self.write_raw(node, index, subindex, data, name, value)
        held = self.read_raw(node, index, subindex, name)
        if held != data:
            raise ReadBackError(node, index, subindex, data, held)
