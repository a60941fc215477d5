"""The SDO client of one node: it sends the frames of a transfer, and finds the answers that belong to it.

The thread that reads the bus supplies the answers; late answers to earlier requests are discarded.
"""

import collections
import struct
from collections.abc import Callable
from typing import Protocol

from drive_profiles.device import transfer
from drive_profiles.device.transfer import ABORT, LENGTH, Transfer, TransferAbortedError, TransferBrokenError
from drive_profiles.errors import NoAnswerError, SdoAbortedError, SharedNodeError
from drive_profiles.standard.cia301 import FunctionCode, SdoAbortCode, abort_text
from drive_profiles.standard.object_address import ObjectAddress

_NAMED_ANSWERS = (2, 3, 4)
"""Command specifiers of answers that name their object: initiate upload, initiate download, abort (CiA 301, 7.2.4.3.3)."""
_DOWNLOAD_ANSWER = 3
_ENTANGLED = frozenset({SdoAbortCode.TOGGLE_BIT, SdoAbortCode.TIMED_OUT, SdoAbortCode.UNKNOWN_COMMAND, SdoAbortCode.GENERAL})
"""Aborts with which a server ends a transfer into which another client has spoken."""
_OBJECT = struct.Struct("<HB")
_ECHOES = 64
"""Number of own requests that are remembered, by which an adapter's echo is known."""
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


class ForeignRequests:
    """Counter of the SDO requests that other clients send to a node.

    Some adapters return what they have sent: a request that is equal to one of our latest is not counted.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sent: collections.deque[bytes] = collections.deque(maxlen=_ECHOES)

    def note_own(self, data: bytes) -> None:
        """Remember a request of our own."""
        self._sent.append(bytes(data))

    def note_received(self, data: bytes) -> None:
        """Count a request that came from the bus."""
        self.count += data not in self._sent


class SdoPort:
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
        strays: Objects whose writing the node has confirmed although this port did not write them.
    """

    refusal: type[SdoAbortedError] = SdoAbortedError
    silence: type[NoAnswerError] = NoAnswerError
    shared: type[NoAnswerError] = SharedNodeError

    def __init__(
        self, node: int, line: SdoLine, timeout_s: float = 0.5, requests_of_others: Callable[[], int] = lambda: 0
    ) -> None:
        """Join a line; `requests_of_others` counts other clients' requests to the node."""
        self.node = node
        self.timeout_s = timeout_s
        self.strays: set[ObjectAddress] = set()
        self._line = line
        self._request_id = FunctionCode.SDO_REQUEST + node
        self._written: set[bytes] = set()
        self._behind = False
        self._has_blocks: bool | None = None
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

    def read(self, address: ObjectAddress, name: str = "", *, in_blocks: bool = False) -> bytes:
        """Upload the bytes of an object, in blocks where it is long.

        A node that has refused blocks is not asked for them again.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node does not answer, or its answers make no sense.
        """
        self._catch_up()
        if not in_blocks or self._has_blocks is False:
            return self._read(address, name)
        try:
            content = self._read(address, name, transfer.block_upload)
        except (SdoAbortedError, NoAnswerError):
            if self._has_blocks:
                raise
            self._catch_up()
            content = self._read(address, name)  # a node without blocks may refuse one by any code, or be silent
            self._has_blocks = False
            return content
        self._has_blocks = True
        return content

    def _read(
        self, address: ObjectAddress, name: str = "", by: Callable[[list[bytes], ObjectAddress], Transfer] = transfer.upload
    ) -> bytes:
        out: list[bytes] = []
        return self._transfer(out, by(out, address), address, name, "read", self.timeout_s)

    def write(
        self,
        address: ObjectAddress,
        data: bytes,
        name: str = "",
        value: object = None,
        timeout_s: float | None = None,
        *,
        in_blocks: bool = False,
    ) -> None:
        """Download the bytes of an object, once: it is never repeated blindly.

        A message shows `value`, by default the bytes. Commands may need a longer time than the port's. `in_blocks` asks for a
        block transfer, where a read in blocks has succeeded.

        Raises:
            SdoAbortedError: The node refuses.
            NoAnswerError: The node does not answer; whether it has taken the value is not known.
        """
        self._catch_up()
        wait_s = self.timeout_s if timeout_s is None else timeout_s
        action = f"write of {data.hex(' ') if value is None else value}"
        self._written.add(_OBJECT.pack(*address))
        out: list[bytes] = []
        if in_blocks and self._has_blocks:
            try:
                self._transfer(out, transfer.block_download(out, address, data), address, name, action, wait_s, writes=True)
            except SdoAbortedError as error:
                if error.code != SdoAbortCode.UNKNOWN_COMMAND or self.is_shared:
                    raise
                out.clear()  # the node takes no blocks; after an abort it has written nothing
            else:
                return
        self._transfer(out, transfer.download(out, address, data), address, name, action, wait_s, writes=True)

    def _transfer(
        self,
        out: list[bytes],
        running: Transfer,
        address: ObjectAddress,
        name: str,
        action: str,
        wait_s: float,
        *,
        writes: bool = False,
    ) -> bytes:
        """Send the frames of a transfer and feed it the answers."""
        line, request_id, own = self._line, self._request_id, _OBJECT.pack(*address)
        code = SdoAbortCode.TIMED_OUT
        try:
            is_segment = next(running)
            while True:
                if out:  # what came before this request does not answer it
                    for late in line.clear():
                        self._look_at(late)
                    for frame in out:
                        line.send(request_id, frame)
                    out.clear()
                answer = self._answer(own, wait_s, writes=writes, is_segment=is_segment)
                if answer is None:
                    break
                is_segment = running.send(answer)
        except StopIteration as end:
            for frame in out:  # the last, which is not answered
                line.send(request_id, frame)
            return bytes(end.value)
        except TransferAbortedError as error:
            others = " (another SDO client talks to this node)" if self.is_shared and error.code in _ENTANGLED else ""
            raise self.refusal(self.node, *address, error.code, abort_text(error.code) + others, name, action) from error
        except TransferBrokenError as error:
            code = error.code
        line.send(request_id, transfer.abort(address, code))
        self._behind = True
        said = f"{address[0]:04X}h:{address[1]:X}" + (f" ({name})" if name else "")
        raise self._silent(f"the {'write' if writes else 'read'} of {said}", wait_s)

    def _answer(self, own: bytes, wait_s: float, *, writes: bool, is_segment: bool) -> bytes | None:
        """Return the next answer to our request; None if none comes in time, or others' only."""
        for _ in range(MAX_STRANGERS):
            answer = self._line.receive(wait_s)
            if answer is None:
                return None
            if len(answer) != LENGTH:
                continue  # no SDO
            if is_segment and answer[0] != ABORT:
                return answer
            specifier = answer[0] >> 5
            if specifier in _NAMED_ANSWERS and answer[1:4] != own:
                self._look_at(answer)
                continue
            if specifier == _DOWNLOAD_ANSWER and not writes:  # a read was taken for a write
                self.strays.add(_OBJECT.unpack(answer[1:4]))
            return answer
        return None

    def _catch_up(self) -> None:
        """Wait, after a time-out, until no older answer can arrive."""
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

    def _look_at(self, answer: bytes) -> None:
        """Note the object of another client's confirmed write."""
        if len(answer) == LENGTH and answer[0] >> 5 == _DOWNLOAD_ANSWER and answer[1:4] not in self._written:
            index, subindex = _OBJECT.unpack(answer[1:4])
            self.strays.add((index, subindex))
