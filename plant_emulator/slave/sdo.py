"""The SDO server: expedited and segmented transfers, as a table of states and commands (CiA 301, 7.2.4)."""

import struct
from collections.abc import Callable
from enum import Enum, IntEnum

from drive_profiles.cia301 import FunctionCode, SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary, Postponed, SdoAbort

_LENGTH = 8
_HEADER = struct.Struct("<BHB")
_SIZED = struct.Struct("<BHBI")
_EXPEDITED_DATA = 4
_SEGMENT_DATA = 7


class Command(IntEnum):
    """Client command specifiers, the upper three bits of the first byte (CiA 301, 7.2.4.3)."""

    DOWNLOAD_SEGMENT = 0
    INITIATE_DOWNLOAD = 1
    INITIATE_UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4
    BLOCK_UPLOAD = 5
    BLOCK_DOWNLOAD = 6
    RESERVED = 7


class State(Enum):
    """What the server is in the middle of. Block transfer will add its own states here and their rows in the table."""

    IDLE = "idle"
    DOWNLOADING = "downloading segments"
    UPLOADING = "uploading segments"
    WAITING = "waiting for the owner, who needs time for what was written"


class SdoServer:
    """Answers one client: frames in, frames out.

    A frame that is not 8 bytes long is not an SDO and is ignored (CiA 301, 7.2.4.3); an abort of the client ends the
    transfer in silence; every other request gets one answer. While the owner takes its time over a value (`Postponed`) the
    server is deaf: what comes meanwhile is lost, and the answer comes when the owner has finished.

    Args:
        dictionary: What is read and written.
        node_id: Of this server.
        max_bytes: The longest value that a client may download, hence all the memory it can make the server keep.
        timeout_ns: An unfinished transfer is given up after so long a silence.
    """

    def __init__(self, dictionary: Dictionary, node_id: int, *, max_bytes: int = 1024, timeout_ns: int = 5_000_000_000) -> None:
        self._dictionary = dictionary
        self._response_id = FunctionCode.SDO_RESPONSE + node_id
        self._max_bytes = max_bytes
        self._timeout_ns = timeout_ns
        self.reset()

    def reset(self) -> None:
        """Forget an unfinished transfer, without a word to the client."""
        self.state = State.IDLE
        self.due: int | None = None
        self._index = self._subindex = 0
        self._toggle = 0
        self._announced: int | None = None
        self._received = bytearray()
        self._remaining = b""
        self._job: Postponed | None = None
        self._late_answer = b""

    def receive(self, data: bytes, now: int) -> list[Frame]:
        """Give the answer to a request."""
        if len(data) != _LENGTH or self.state is State.WAITING:
            return []
        command = Command(data[0] >> 5)
        if command is Command.ABORT:
            self.reset()
            return []
        handler = _TABLE.get((self.state, command))
        try:
            if handler is None:
                self._address_unknown(command, data)
                raise SdoAbort(SdoAbortCode.UNKNOWN_COMMAND)
            answer = handler(self, data)
        except SdoAbort as abort:
            return [self._abort(abort.code)]
        if self._job is not None:
            self.state, self.due, self._late_answer = State.WAITING, now + self._job.duration_ns, answer
            return self.advance(now)
        self.due = None if self.state is State.IDLE else now + self._timeout_ns
        return [Frame(self._response_id, answer)]

    def advance(self, now: int) -> list[Frame]:
        """Give the answer that the owner has finished, or abort the transfer whose client has been silent for too long."""
        if self.due is None or now < self.due:
            return []
        if self._job is None:
            return [self._abort(SdoAbortCode.TIMED_OUT)]
        answer, code = self._late_answer, self._job.finish()
        if code is not None:
            return [self._abort(code)]
        self.reset()
        return [Frame(self._response_id, answer)]

    def _abort(self, code: int) -> Frame:
        frame = Frame(self._response_id, _SIZED.pack(Command.ABORT << 5, self._index, self._subindex, code))
        self.reset()
        return frame

    def _address_unknown(self, command: Command, data: bytes) -> None:
        # A block request that starts a transfer (its sub-command is 0) names its object; let the abort name it too.
        if self.state is State.IDLE and command in {Command.BLOCK_UPLOAD, Command.BLOCK_DOWNLOAD} and not data[0] & 0x03:
            _, self._index, self._subindex = _HEADER.unpack_from(data)

    def _begin(self, data: bytes) -> int:
        # A new transfer in any state forgets the old one: an abandoned one must not reach into it.
        self.reset()
        first, self._index, self._subindex = _HEADER.unpack_from(data)
        return int(first)

    def _write(self, data: bytes) -> None:
        try:
            self._dictionary.write(self._index, self._subindex, data)
        except Postponed as job:
            self._job = job

    def _initiate_download(self, data: bytes) -> bytes:
        # CiA 301, 7.2.4.3.3: 001x nnes; n bytes of d do not contain data, e expedited, s size indicated.
        first = self._begin(data)
        cell = self._dictionary.find_writable(self._index, self._subindex)
        if first & 0x02:
            unused = first >> 2 & 0x03
            size = _EXPEDITED_DATA - unused if first & 0x01 else cell.entry.data_type.size or _EXPEDITED_DATA
            self._write(data[4 : 4 + min(size, _EXPEDITED_DATA)])
            return self._download_answer()
        if first & 0x01:
            self._announced = int.from_bytes(data[4:], "little")
            code = cell.length_refusal(self._announced)
            if code is None and self._announced > self._max_bytes:
                code = SdoAbortCode.OUT_OF_MEMORY
            if code is not None:
                raise SdoAbort(code)
        self.state = State.DOWNLOADING
        return self._download_answer()

    def _download_answer(self) -> bytes:
        return _SIZED.pack(0x60, self._index, self._subindex, 0)

    def _download_segment(self, data: bytes) -> bytes:
        # CiA 301, 7.2.4.3.4: 000t nnnc; t toggle, n bytes do not contain data, c the last one.
        first = data[0]
        self._check_toggle(first)
        self._received += data[1 : 1 + _SEGMENT_DATA - (first >> 1 & 0x07)]
        limit = self._max_bytes if self._announced is None else self._announced
        if len(self._received) > limit:
            raise SdoAbort(SdoAbortCode.OUT_OF_MEMORY if self._announced is None else SdoAbortCode.TOO_LONG)
        answer = bytes((0x20 | self._toggle << 4, *bytes(7)))
        if first & 0x01:
            if len(self._received) < limit and self._announced is not None:
                raise SdoAbort(SdoAbortCode.TOO_SHORT)
            self._write(bytes(self._received))
            if self._job is None:
                self.reset()
        else:
            self._toggle ^= 1
        return answer

    def _initiate_upload(self, data: bytes) -> bytes:
        # CiA 301, 7.2.4.3.6: expedited up to four bytes, else with the size; an empty value has no expedited form.
        self._begin(data)
        value = self._dictionary.read(self._index, self._subindex)
        if 0 < len(value) <= _EXPEDITED_DATA:
            first = 0x43 | (_EXPEDITED_DATA - len(value)) << 2
            return _HEADER.pack(first, self._index, self._subindex) + value.ljust(_EXPEDITED_DATA, b"\0")
        self._remaining = value
        self.state = State.UPLOADING
        return _SIZED.pack(0x41, self._index, self._subindex, len(value))

    def _upload_segment(self, data: bytes) -> bytes:
        # CiA 301, 7.2.4.3.7: answered 000t nnnc.
        self._check_toggle(data[0])
        segment, self._remaining = self._remaining[:_SEGMENT_DATA], self._remaining[_SEGMENT_DATA:]
        first = self._toggle << 4 | (_SEGMENT_DATA - len(segment)) << 1
        if self._remaining:
            self._toggle ^= 1
        else:
            first |= 0x01
            self.reset()
        return bytes((first,)) + segment.ljust(_SEGMENT_DATA, b"\0")

    def _check_toggle(self, first: int) -> None:
        if first >> 4 & 0x01 != self._toggle:
            raise SdoAbort(SdoAbortCode.TOGGLE_BIT)


_TABLE: dict[tuple[State, Command], Callable[[SdoServer, bytes], bytes]] = {
    **{(state, Command.INITIATE_DOWNLOAD): SdoServer._initiate_download for state in State},
    **{(state, Command.INITIATE_UPLOAD): SdoServer._initiate_upload for state in State},
    (State.DOWNLOADING, Command.DOWNLOAD_SEGMENT): SdoServer._download_segment,
    (State.UPLOADING, Command.UPLOAD_SEGMENT): SdoServer._upload_segment,
}
"""What each state does with each command; what is not here is answered with 0504 0001h."""
