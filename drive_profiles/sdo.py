"""An SDO client for one node: canopen's transfers, fed by whoever reads the bus, and never fooled by an old answer."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from typing import Any, Protocol

import canopen
from canopen.sdo.client import SdoClient, WritableStream
from canopen.sdo.exceptions import SdoAbortedError as CanopenAbort
from canopen.sdo.exceptions import SdoCommunicationError

from drive_profiles.cia301 import FunctionCode, SdoAbortCode
from drive_profiles.errors import NoAnswerError, SdoAbortedError
from drive_profiles.parameter import Place

# The package's client reports each of its own aborts as an error to the root logger; here they are exceptions, told once.
logging.getLogger("canopen").addHandler(logging.NullHandler())
logging.getLogger("canopen").propagate = False

MAX_UPLOAD_BYTES = 65536
_LENGTH = 8
_INITIATE_REQUESTS = (1, 2)
"""Command specifiers of an initiate download and upload: these name their object (CiA 301, 7.2.4.3)."""
_NAMED_ANSWERS = (2, 3, 4)
"""Command specifiers of answers that name their object: initiate upload, initiate download, abort."""
_DOWNLOAD_ANSWER = 3
_DOWNLOAD_REQUEST = 1
_ABORT = 0x80
_OBJECT = struct.Struct("<HB")
_SEGMENT = 7
MAX_STRANGERS = 64
"""Answers to others that are passed over while one of ours is waited for."""
_BARRIER: tuple[Place, ...] = ((0x1000, 0), (0x1018, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4))
"""Objects that may be read to learn that all older answers have come: a server answers in order."""


class Line(Protocol):
    """The SDO frames of one node: what is sent to it, and what comes back."""

    def send(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus."""
        ...

    def receive(self, timeout_s: float) -> bytes | None:
        """The node's next SDO answer, or None when none came in time."""
        ...

    def clear(self) -> list[bytes]:
        """Forget what has come and was not received, and give it."""
        ...

    @property
    def boots(self) -> int:
        """How often the node has been heard to start (its boot-up message) since the line was made."""
        ...


class _Sender(canopen.Network):
    """What canopen's client wants of a network: a way out."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self.subscribers.clear()  # its LSS master would keep every answer for ever
        self._send = send

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send by the line."""
        self._send(can_id, bytes(data))


class SdoPort(SdoClient):
    """The one SDO client of a node.

    A request is sent once. An answer that names another object than the one asked for is a late one, and nobody's; if it confirms
    a *write* of an object that this port has not written, then a request was changed on its way, and the object is noted in
    `strays`.

    After a request that was not answered in time its answer may still come, and be taken for that of a later request for the same
    object. So the next transfer waits behind a barrier: another object is read, and once that is answered nothing older can come.

    Attributes:
        node: Its id.
        timeout_s: How long an answer may take.
        strays: Objects that the node says were written, although this port has not asked for it.
    """

    def __init__(self, node: int, line: Line, timeout_s: float = 0.5) -> None:
        """Join a line; nothing is sent."""
        super().__init__(FunctionCode.SDO_REQUEST + node, FunctionCode.SDO_RESPONSE + node, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self.node = node
        self.timeout_s = timeout_s
        self.strays: set[Place] = set()
        self._line = line
        self.network = _Sender(line.send)
        self._object = b""
        self._writes = False
        self._written: set[bytes] = set()
        self._wait_s = timeout_s
        self._behind = False

    @property
    def boots(self) -> int:
        """How often the node has been heard to start."""
        return self._line.boots

    def forget(self) -> None:
        """A new piece of work begins: what was written before, and what was astray, is no longer of interest."""
        self.strays.clear()
        self._written.clear()

    # -- what a caller does --------------------------------------------------------------------------------------------

    def read(self, place: Place, name: str = "") -> bytes:
        """Upload an object: its bytes.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: It is silent, or its answers make no sense.
        """
        self._catch_up()
        return self._read(place, name)

    def _read(self, place: Place, name: str = "") -> bytes:
        self._wait_s = self.timeout_s
        try:
            with self.open(*place, buffering=0) as stream:  # type: ignore[no-untyped-call]
                return _bounded(stream)
        except CanopenAbort as error:
            raise SdoAbortedError(self.node, *place, error.code, name) from error
        except (SdoCommunicationError, struct.error) as error:
            self._behind = True
            raise NoAnswerError(self.node, f"the read of {_said(place, name)}", self._wait_s) from error

    def write(self, place: Place, data: bytes, name: str = "", value: object = None, timeout_s: float | None = None) -> None:
        """Download an object, once: a write is never repeated blindly.

        Args:
            place: The object.
            data: Its bytes.
            name: For messages.
            value: For messages, instead of the bytes.
            timeout_s: Instead of the port's, for commands that take their time.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: It is silent; whether it has taken the value is not known.
        """
        self._catch_up()
        self._wait_s = self.timeout_s if timeout_s is None else timeout_s
        shown = data.hex(" ") if value is None else value
        self._written.add(_OBJECT.pack(*place))
        try:
            self._send(place, data)
        except CanopenAbort as error:
            raise SdoAbortedError(self.node, *place, error.code, name, f"write of {shown}") from error
        except (SdoCommunicationError, struct.error) as error:
            self._behind = True
            raise NoAnswerError(self.node, f"the write of {_said(place, name)}", self._wait_s) from error

    def _send(self, place: Place, data: bytes) -> None:
        """Download in canopen's segments, without the empty last one that its stream adds, even to a transfer that has failed."""
        stream: Any = WritableStream(self, *place, size=len(data))  # type: ignore[no-untyped-call]
        try:
            position = 0
            while position < len(data):
                position += stream.write(data[position : position + _SEGMENT])
            if not data:
                stream.close()
        finally:
            stream._done = True

    def _catch_up(self) -> None:
        """After a time-out: wait until no older answer can come any more.

        Raises:
            NoAnswerError: The node does not answer anything.
        """
        if not self._behind:
            return
        for place in _BARRIER:  # each once: of two answers to one object it would not be known which is the older
            try:
                self._read(place)
            except NoAnswerError:
                continue
            except SdoAbortedError:
                pass  # that is an answer, too
            self._behind = False
            return
        raise NoAnswerError(self.node, "anything after a time-out", self.timeout_s)

    # -- what canopen's client calls -----------------------------------------------------------------------------------

    def request_response(self, sdo_request: Any) -> bytes:
        """Send a request once and wait for its answer. What is left from before belongs to nobody."""
        for answer in self._line.clear():
            self._look_at(answer)
        if sdo_request[0] >> 5 in _INITIATE_REQUESTS:
            self._object = bytes(sdo_request[1:4])
            self._writes = sdo_request[0] >> 5 == _DOWNLOAD_REQUEST
        self.send_request(sdo_request)  # type: ignore[no-untyped-call]
        try:
            return self.read_response()
        except SdoCommunicationError:
            self.abort(SdoAbortCode.TIMED_OUT)  # type: ignore[no-untyped-call]
            raise

    def read_response(self) -> bytes:
        """The next answer that is ours.

        Raises:
            SdoCommunicationError: None came in time.
            SdoAbortedError: It is an abort (canopen's error, not ours).
        """
        for _ in range(MAX_STRANGERS):
            answer = self._line.receive(self._wait_s)
            if answer is None:
                raise SdoCommunicationError("no SDO response")
            if len(answer) != _LENGTH:
                continue  # no SDO
            if answer[0] >> 5 in _NAMED_ANSWERS and answer[1:4] != self._object:
                self._look_at(answer)
                continue
            if answer[0] >> 5 == _DOWNLOAD_ANSWER and not self._writes:  # a read was taken for a write
                self.strays.add(_OBJECT.unpack(answer[1:4]))
            if answer[0] == _ABORT:
                raise CanopenAbort(int.from_bytes(answer[4:], "little"))
            return answer
        raise SdoCommunicationError("others' answers only")

    def _look_at(self, answer: bytes) -> None:
        """Note a confirmed write that nobody has asked for."""
        if len(answer) == _LENGTH and answer[0] >> 5 == _DOWNLOAD_ANSWER and answer[1:4] not in self._written:
            index, subindex = _OBJECT.unpack(answer[1:4])
            self.strays.add((index, subindex))


def _said(place: Place, name: str) -> str:
    return f"{place[0]:04X}h:{place[1]:X}" + (f" ({name})" if name else "")


def _bounded(stream: Any) -> bytes:
    """What an upload gives, up to a bound: a node must not make us hold what it likes."""
    data = bytearray()
    while chunk := stream.read(7):
        data += chunk
        if len(data) > MAX_UPLOAD_BYTES:
            raise SdoCommunicationError(f"more than {MAX_UPLOAD_BYTES} bytes")
    return bytes(data)
