"""An SDO client for one node, based on canopen's transfers.

The thread that reads the bus supplies the answers; late answers to earlier requests are discarded.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from typing import Any, Protocol

import canopen
from canopen.sdo.client import SdoClient, WritableStream
from canopen.sdo.exceptions import SdoAbortedError as CanopenAbort
from canopen.sdo.exceptions import SdoCommunicationError

from drive_profiles.errors import NoAnswerError, SdoAbortedError, SharedNodeError
from drive_profiles.standard.cia301 import FunctionCode, SdoAbortCode, abort_text
from drive_profiles.standard.object_address import ObjectAddress

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
_ENTANGLED = frozenset({SdoAbortCode.TOGGLE_BIT, SdoAbortCode.TIMED_OUT, SdoAbortCode.UNKNOWN_COMMAND, SdoAbortCode.GENERAL})
"""Aborts with which a server ends a transfer into which another client has spoken."""
_OBJECT = struct.Struct("<HB")
_SEGMENT = 7
MAX_STRANGERS = 64
"""Number of foreign answers that are passed over while we wait for ours."""
_BARRIER: tuple[ObjectAddress, ...] = ((0x1000, 0), (0x1018, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4))
"""Objects whose answer proves that all older answers have come, since a server answers in order."""


class SdoLine(Protocol):
    """Connection that carries the SDO frames of one node in both directions."""

    def send(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus."""
        ...

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the node's next SDO answer; None after the time-out."""
        ...

    def clear(self) -> list[bytes]:
        """Drop the answers that wait to be received, and return them."""
        ...

    @property
    def boots(self) -> int:
        """Number of boot-up messages of the node since the line was made."""
        ...


class _Sender(canopen.Network):
    """Stand-in for the canopen network that its SDO client sends through."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self.subscribers.clear()  # its LSS master would keep every answer for ever
        self._send = send

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame on the line."""
        self._send(can_id, bytes(data))


class SdoPort(SdoClient):
    """The only SDO client of a node.

    A request is sent once. An answer that names another object than the requested one is late and is dropped. If it confirms a
    *write* of an object that this port has not written, then a request was changed on its way, and the object is added to
    `strays`.

    After a request that was not answered in time its answer may still come, and be taken for that of a later request for the same
    object. So the next transfer waits behind a barrier: another object is read, and once that is answered nothing older can come.

    Attributes:
        refusal: Error raised where the node refuses; a user with errors of its own derives this class and names them.
        silence: Error raised where the node is silent; likewise.
        shared: Error raised instead where requests of another client to the node have been seen.
        node: Node-ID.
        timeout_s: Time that an answer may take, s.
        strays: Objects whose writing the node has confirmed although this port did not write them.
    """

    refusal: type[SdoAbortedError] = SdoAbortedError
    silence: type[NoAnswerError] = NoAnswerError
    shared: type[NoAnswerError] = SharedNodeError

    def __init__(
        self, node: int, line: SdoLine, timeout_s: float = 0.5, requests_of_others: Callable[[], int] = lambda: 0
    ) -> None:
        """Join a line; nothing is sent.

        Args:
            node: Node-ID.
            line: Connection to the node.
            timeout_s: Time that an answer may take, s.
            requests_of_others: Function that returns the number of requests that other clients have sent to the node.
        """
        super().__init__(FunctionCode.SDO_REQUEST + node, FunctionCode.SDO_RESPONSE + node, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self.node = node
        self.timeout_s = timeout_s
        self.strays: set[ObjectAddress] = set()
        self._line = line
        self.network = _Sender(line.send)
        self._object = b""
        self._writes = False
        self._written: set[bytes] = set()
        self._wait_s = timeout_s
        self._behind = False
        self._requests_of_others = requests_of_others

    @property
    def is_shared(self) -> bool:
        """True if another SDO client has been seen talking to the node."""
        return self._requests_of_others() > 0

    @property
    def boots(self) -> int:
        """Number of boot-up messages of the node since the line was made."""
        return self._line.boots

    def forget(self) -> None:
        """Clear the written objects and the `strays` for a new transaction."""
        self.strays.clear()
        self._written.clear()

    # -- what a caller does --------------------------------------------------------------------------------------------

    def read(self, address: ObjectAddress, name: str = "") -> bytes:
        """Upload the bytes of an object.

        Args:
            address: The object.
            name: Name of the object, for messages.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node does not answer, or its answers make no sense.
        """
        self._catch_up()
        return self._read(address, name)

    def _read(self, address: ObjectAddress, name: str = "") -> bytes:
        self._wait_s = self.timeout_s
        try:
            with self.open(*address, buffering=0) as stream:  # type: ignore[no-untyped-call]
                return _bounded(stream)
        except CanopenAbort as error:
            raise self.refusal(self.node, *address, error.code, self._text_of(error.code), name) from error
        except (SdoCommunicationError, struct.error) as error:
            self._behind = True
            raise self._silent(f"the read of {_said(address, name)}", self._wait_s) from error

    def write(
        self, address: ObjectAddress, data: bytes, name: str = "", value: object = None, timeout_s: float | None = None
    ) -> None:
        """Download the bytes of an object, once.

        A write is never repeated blindly.

        Args:
            address: The object.
            data: Its bytes, little-endian.
            name: Name of the object, for messages.
            value: The value as a message shall show it; None: the bytes.
            timeout_s: Time that the answer may take, s; None: the port's. Commands may need longer.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node does not answer; whether it has taken the value is not known.
        """
        self._catch_up()
        self._wait_s = self.timeout_s if timeout_s is None else timeout_s
        shown = data.hex(" ") if value is None else value
        self._written.add(_OBJECT.pack(*address))
        try:
            self._send(address, data)
        except CanopenAbort as error:
            raise self.refusal(self.node, *address, error.code, self._text_of(error.code), name, f"write of {shown}") from error
        except (SdoCommunicationError, struct.error) as error:
            self._behind = True
            raise self._silent(f"the write of {_said(address, name)}", self._wait_s) from error

    def _send(self, address: ObjectAddress, data: bytes) -> None:
        """Download in segments through canopen's stream.

        The stream's empty last segment is suppressed, which it would send even after a failed transfer.
        """
        stream: Any = WritableStream(self, *address, size=len(data))  # type: ignore[no-untyped-call]
        try:
            position = 0
            while position < len(data):
                position += stream.write(data[position : position + _SEGMENT])
            if not data:
                stream.close()
        finally:
            stream._done = True

    def _catch_up(self) -> None:
        """Wait, after a time-out, until no older answer can arrive.

        Raises:
            NoAnswerError: The node answers nothing at all.
        """
        if not self._behind:
            return
        for address in _BARRIER:  # each once: of two answers to one object it would not be known which is the older
            try:
                self._read(address)
            except NoAnswerError:
                continue
            except SdoAbortedError:
                pass  # that is an answer, too
            self._behind = False
            return
        raise self._silent("anything after a time-out", self.timeout_s)

    def _silent(self, what: str, after_s: float) -> NoAnswerError:
        return (self.shared if self.is_shared else self.silence)(self.node, what, after_s)

    def _text_of(self, code: int) -> str:
        """Return the text of an abort code.

        If another client shares the node, codes that entangled transfers cause are marked so.
        """
        text = abort_text(code)
        return f"{text} (another SDO client talks to this node)" if self.is_shared and code in _ENTANGLED else text

    # -- what canopen's client calls -----------------------------------------------------------------------------------

    def request_response(self, sdo_request: Any) -> bytes:
        """Send a request once and wait for its answer.

        Answers that arrived before the request are dropped.
        """
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
        """Return the next answer to our request.

        Raises:
            SdoCommunicationError: No answer came in time.
            SdoAbortedError: The answer is an abort (canopen's error, not ours).
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
        """Note the object of another client's confirmed write.

        An answer to a download that this port has not sent shows it.
        """
        if len(answer) == _LENGTH and answer[0] >> 5 == _DOWNLOAD_ANSWER and answer[1:4] not in self._written:
            index, subindex = _OBJECT.unpack(answer[1:4])
            self.strays.add((index, subindex))


def _said(address: ObjectAddress, name: str) -> str:
    return f"{address[0]:04X}h:{address[1]:X}" + (f" ({name})" if name else "")


def _bounded(stream: Any) -> bytes:
    """Read an upload up to a bound, which protects our memory."""
    data = bytearray()
    while chunk := stream.read(7):
        data += chunk
        if len(data) > MAX_UPLOAD_BYTES:
            raise SdoCommunicationError(f"more than {MAX_UPLOAD_BYTES} bytes")
    return bytes(data)
