"""The master's side of CANopen on one channel: SDO, NMT, SYNC, heartbeats and emergencies, in one thread."""

import logging
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError as CanopenAbort
from canopen.sdo.exceptions import SdoCommunicationError

from drive_profiles.cia301 import DataType, FunctionCode, NmtCommand, decode, encode
from hil.can.channel import Channel
from hil.can.frame import Frame
from hil.errors import NoAnswerError, ReadBackError, SdoAbortedError
from hil.recording import BusLog, LoggedFrame

SYNC = Frame(FunctionCode.SYNC, b"")
MAX_EVENTS = 256
MAX_UPLOAD_BYTES = 65536
_INITIATE_REQUESTS = (1, 2)
"""Command specifiers of an initiate download and upload: these name their object (CiA 301, 7.2.4.3)."""
_NAMED_ANSWERS = (2, 3, 4)
"""Command specifiers of answers that name their object: initiate upload, initiate download, abort."""
_EMERGENCY = struct.Struct("<HB5s")

# The package's client reports each of its own aborts as an error to the root logger; here they are exceptions, told once.
logging.getLogger("canopen").addHandler(logging.NullHandler())
logging.getLogger("canopen").propagate = False


@dataclass(frozen=True)
class Emergency:
    """An EMCY message: the node says that something is wrong, or (code 0) right again."""

    node: int
    code: int
    register: int
    vendor: bytes

    def __str__(self) -> str:
        """In words."""
        return f"node {self.node} reports emergency {self.code:04X}h (error register {self.register:02X}h)"


class _PumpedSdoClient(SdoClient):
    """canopen's SDO client, fed by the caller's own thread: while it waits for an answer, it reads the channel."""

    def __init__(self, network: "Network", node: int) -> None:
        super().__init__(FunctionCode.SDO_REQUEST + node, FunctionCode.SDO_RESPONSE + node, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self.network = network.canopen
        self._pump = network.pump_until
        self._timeout_s = network.timeout_s
        self._answers: deque[bytes] = deque(maxlen=MAX_EVENTS)
        self._object = b""

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Keep an answer of the right length; others are no SDO."""
        if len(data) == 8:
            self._answers.append(bytes(data))

    def request_response(self, sdo_request: bytes) -> bytes:
        """Send a request once and wait for its answer. What is left from before belongs to nobody."""
        self._answers.clear()
        if sdo_request[0] >> 5 in _INITIATE_REQUESTS:
            self._object = bytes(sdo_request[1:4])
        self.send_request(sdo_request)  # type: ignore[no-untyped-call]
        try:
            return self.read_response()
        except SdoCommunicationError:
            self.abort(0x0504_0000)  # type: ignore[no-untyped-call]
            raise

    def read_response(self) -> bytes:
        """The next answer.

        Raises:
            SdoCommunicationError: None came in time.
            SdoAbortedError: It is an abort.
        """
        while True:
            if not self._pump(lambda: bool(self._answers), self._timeout_s):
                raise SdoCommunicationError("no SDO response")
            answer = self._answers.popleft()
            if answer[0] >> 5 not in _NAMED_ANSWERS or answer[1:4] == self._object:
                break  # a late answer to an earlier request names another object, and is nobody's
        if answer[0] == 0x80:
            raise CanopenAbort(int.from_bytes(answer[4:], "little"))
        return answer


def _bounded(stream: Any) -> bytes:
    """What an upload gives, up to a bound: a node must not make us hold what it likes."""
    data = bytearray()
    while chunk := stream.read(7):
        data += chunk
        if len(data) > MAX_UPLOAD_BYTES:
            raise SdoCommunicationError(f"more than {MAX_UPLOAD_BYTES} bytes")
    return bytes(data)


class _Tee(canopen.Network):
    """canopen's network on our channel: it sends through it and is shown every frame that is not cyclic."""

    def __init__(self, send: Callable[[Frame], None]) -> None:
        super().__init__()
        self._send_frame = send

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send by the channel."""
        self._send_frame(Frame(can_id, bytes(data)))


class Network:
    """One bus from the master's side.

    Time on a lock-step bus is counted in SYNCs; on any other it is the monotonic clock, from the start of the network.

    Attributes:
        channel: The bus.
        canopen: canopen's network; it gets every frame that is not cyclic.
        emergencies: What nodes have reported and nobody has taken yet, bounded.
        heartbeats: Time and NMT state of the last heartbeat of each node.
        foreign_sync: Whether somebody else's SYNC has been seen.
        boots: Nodes whose boot-up message has come since it was last cleared.
        period_s: What one SYNC is worth on a lock-step bus.
    """

    def __init__(self, channel: Channel, log: BusLog, timeout_s: float, period_s: float) -> None:
        """Join the bus; nothing is sent."""
        self.channel = channel
        self.log = log
        self.timeout_s = timeout_s
        self.period_s = period_s
        self.canopen = _Tee(self.send)
        self.canopen.subscribers.clear()  # its LSS master would keep every answer for ever
        self.emergencies: deque[Emergency] = deque(maxlen=MAX_EVENTS)
        self.heartbeats: dict[int, tuple[float, int]] = {}
        self.boots: set[int] = set()
        self.foreign_sync = False
        self._clients: dict[int, _PumpedSdoClient] = {}
        self._lock_step_s = 0.0
        self._start = time.monotonic()

    def now(self) -> float:
        """The bench's time in s."""
        return self._lock_step_s if self.channel.is_lock_step else time.monotonic() - self._start

    def send(self, frame: Frame) -> None:
        """Send a frame and log it."""
        self.channel.send(frame)
        if self.log.is_on:
            self.log.add(LoggedFrame(self.now(), frame[0], frame[1], False))

    def sync(self) -> None:
        """Send SYNC; on a lock-step bus the world moves on by one period."""
        self.send(SYNC)
        self._lock_step_s += self.period_s

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, logged; None when none came in time."""
        frame = self.channel.receive(timeout_s)
        if frame is not None and self.log.is_on:
            self.log.add(LoggedFrame(self.now(), frame[0], frame[1], True))
        return frame

    def dispatch(self, frame: Frame) -> None:
        """Give a frame that is not cyclic to whom it concerns; no bytes make this raise."""
        can_id, data = frame
        function, node = can_id & 0x780, can_id & 0x7F
        if function == FunctionCode.HEARTBEAT and can_id <= 0x7FF and len(data) == 1:
            self.heartbeats[node] = (self.now(), data[0] & 0x7F)
            if data[0] == 0:
                self.boots.add(node)
        elif can_id == FunctionCode.SYNC:
            self.foreign_sync = True
        elif function == FunctionCode.EMERGENCY and node and can_id <= 0x7FF:
            code, register, vendor = _EMERGENCY.unpack(data.ljust(_EMERGENCY.size, b"\0")[: _EMERGENCY.size])
            self.emergencies.append(Emergency(node, code, register, vendor))
        self.canopen.notify(can_id, bytearray(data), self.now())

    def pump_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Read and dispatch frames until something holds, or the time (of the wall clock) is up; whether it holds."""
        deadline = time.monotonic() + timeout_s
        while not done():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return False
            frame = self.receive(left)
            if frame is not None:
                self.dispatch(frame)
        return True

    def nmt(self, command: NmtCommand, node: int) -> None:
        """Send an NMT command to one node."""
        self.send(Frame(FunctionCode.NMT, bytes((command, node))))

    # -- SDO -----------------------------------------------------------------------------------------------------------

    def _client(self, node: int) -> _PumpedSdoClient:
        if node not in self._clients:
            client = self._clients[node] = _PumpedSdoClient(self, node)
            self.canopen.subscribe(client.tx_cobid, client.on_response)
        return self._clients[node]

    def read_raw(self, node: int, index: int, subindex: int = 0, name: str = "") -> bytes:
        """Upload an object.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: It is silent.
        """
        try:
            with self._client(node).open(index, subindex, buffering=0) as stream:  # type: ignore[no-untyped-call]
                return _bounded(stream)
        except CanopenAbort as error:
            raise SdoAbortedError(node, index, subindex, error.code, name) from error
        except (SdoCommunicationError, struct.error) as error:
            raise NoAnswerError(node, f"the read of object {index:04X}h:{subindex:02X}h", self.timeout_s) from error

    def write_raw(self, node: int, index: int, subindex: int, data: bytes, name: str = "", value: object = None) -> None:
        """Download an object, once: a write is never repeated blindly.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: It is silent.
        """
        shown = value if value is not None else data.hex(" ")
        try:
            self._client(node).download(index, subindex, data)
        except CanopenAbort as error:
            raise SdoAbortedError(node, index, subindex, error.code, name, shown) from error
        except (SdoCommunicationError, struct.error) as error:
            raise NoAnswerError(node, f"the write of object {index:04X}h:{subindex:02X}h", self.timeout_s) from error

    def read(self, node: int, index: int, subindex: int, kind: DataType, name: str = "") -> Any:
        """An object's value; see `read_raw`. Bytes of another length than the type's count as no answer."""
        data = self.read_raw(node, index, subindex, name)
        size = kind.size
        if size is not None and len(data) != size:
            raise NoAnswerError(node, f"{index:04X}h:{subindex:02X}h with {size} bytes, {len(data)} came", self.timeout_s)
        return decode(kind, data)

    def write(self, node: int, index: int, subindex: int, kind: DataType, value: Any, name: str = "") -> None:
        """Write an object and read it back, raw bytes compared.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: It is silent.
            ReadBackError: It holds something else.
        """
        data = encode(kind, value)
        self.write_raw(node, index, subindex, data, name, value)
        held = self.read_raw(node, index, subindex, name)
        if held != data:
            raise ReadBackError(node, index, subindex, data, held)
