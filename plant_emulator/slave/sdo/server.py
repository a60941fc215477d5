"""The SDO server (CiA 301, 7.2.4)."""

import struct
from collections.abc import Callable
from enum import Enum

from drive_profiles.standard.cia301 import SdoAbortCode
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Cell, Dictionary, Postponed, SdoAbort
from plant_emulator.slave.sdo.block import MAX_BLOCK_SIZE, SEGMENT_DATA, BlockDownload, BlockUpload

_LENGTH = 8
_HEADER = struct.Struct("<BHB")
_SIZED = struct.Struct("<BHBI")
_ACKNOWLEDGEMENT = struct.Struct("<BBB5x")
_END = struct.Struct("<BH5x")
_EXPEDITED_DATA = 4
_ABORT = 0x80

DEFAULT_BLOCK_SIZE = 31
"""Segments at once of a block download: the most whose first bytes no request to begin a transfer has."""

_NO_DOWNLOAD, _NO_UPLOAD = BlockDownload(None, 0, 1, has_crc=False), BlockUpload(b"", 1, has_crc=False)

Answers = tuple[bytes, ...]


class SdoService(Enum):
    """Request of a client: the command specifier, bits 7 to 5.

    A block transfer has its sub-command in the lower bits.
    """

    DOWNLOAD_SEGMENT = 0, 0
    INITIATE_DOWNLOAD = 1, 0
    INITIATE_UPLOAD = 2, 0
    UPLOAD_SEGMENT = 3, 0
    ABORT = 4, 0
    INITIATE_BLOCK_UPLOAD = 5, 0
    END_BLOCK_UPLOAD = 5, 1
    ACKNOWLEDGE_BLOCK = 5, 2
    START_BLOCK_UPLOAD = 5, 3
    INITIATE_BLOCK_DOWNLOAD = 6, 0
    END_BLOCK_DOWNLOAD = 6, 1
    RESERVED = 7, 0


_ABORTED = SdoService.ABORT
_SUB_COMMAND_BITS = {5: 0x03, 6: 0x01}
_SERVICES = tuple(SdoService((first >> 5, first & _SUB_COMMAND_BITS.get(first >> 5, 0))) for first in range(256))

INITIATES = frozenset({
    *(SdoService.INITIATE_DOWNLOAD, SdoService.INITIATE_UPLOAD),
    *(SdoService.INITIATE_BLOCK_DOWNLOAD, SdoService.INITIATE_BLOCK_UPLOAD),
})  # fmt: skip
"""The services that begin a transfer, and name its object."""


def is_read(data: bytes) -> bool:
    """Return True if a request begins an upload, expedited or segmented."""
    return _SERVICES[data[0]] is SdoService.INITIATE_UPLOAD if data else False


class SdoState(Enum):
    """State of the server: the transfer that is under way."""

    IDLE = "idle"
    DOWNLOADING = "downloading segments"
    UPLOADING = "uploading segments"
    BLOCK_DOWNLOADING = "taking the segments of a sub-block"
    BLOCK_DOWNLOAD_ENDING = "has all segments, waits for the end of the block download"
    BLOCK_UPLOAD_READY = "waits for the client to start the block upload"
    BLOCK_UPLOADING = "has sent a sub-block, waits for its acknowledgement"
    BLOCK_UPLOAD_ENDING = "has sent all, waits for the client to end the block upload"
    WAITING = "waiting for the owner, who needs time for what was written"


_IDLE, _WAITING, _BLOCK_DOWNLOADING = SdoState.IDLE, SdoState.WAITING, SdoState.BLOCK_DOWNLOADING
"""Looked up once: a look-up on the class takes a tenth of a microsecond."""


class SdoServer:
    """SDO server for one client: frames in, frames out.

    Every request gets one answer, but for these:

    - A frame that is not 8 bytes long is not an SDO and is ignored (CiA 301, 7.2.4.3).
    - An abort of the client ends the transfer in silence (7.2.4.3.17).
    - A segment of a block download is not answered; the last of its sub-block is, with the acknowledgement (7.2.4.3.10).
      A sub-block whose last segment is lost is acknowledged after `silence_ns`, as far as it came. Where no segment of it
      came at all it is not: the client may still wait for the previous acknowledgement, and would take this one for it. Nor
      is a last segment that the bus delivers twice.
    - The start of a block upload, and an acknowledgement after which there is more, are answered with a sub-block: 1 to 127
      segments (7.2.4.3.13).
    - The client's end of a block upload ends the transfer in silence (7.2.4.3.15).
    - While the owner delays a value (`Postponed`), the server drops all requests; it answers when the owner has finished.

    A request that begins a transfer forgets the one before it, in any state. In the middle of a sub-block its first byte
    distinguishes it from a segment only where that is higher than the sequence numbers granted; hence the block size of 31, below
    all of those bytes. A checksum is offered where the client asks for one.

    Args:
        max_bytes: The longest value that a client may download, hence all the memory it can make the server keep.
        timeout_ns: An unfinished transfer is given up after so long a silence.
        block_size: Segments that the server takes at once, 1 to 127.
        silence_ns: A client that falls silent in the middle of a sub-block has its segments acknowledged after this time.

    Attributes:
        due: Time at which `advance` must be called, or None.

    Raises:
        ValueError: There is no such block size.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        response_id: int = 0,
        *,
        max_bytes: int = 1024,
        timeout_ns: int = 5_000_000_000,
        block_size: int = DEFAULT_BLOCK_SIZE,
        silence_ns: int = 250_000_000,
    ) -> None:
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            raise ValueError(f"block size {block_size}: expected 1 to {MAX_BLOCK_SIZE}")
        self.response_id, self._dictionary, self._max_bytes = response_id, dictionary, max_bytes
        self._timeout_ns, self._block_size = timeout_ns, block_size
        self._silence_ns = min(silence_ns, timeout_ns)
        self.reset()

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes of a client's value in the buffer.

        It is at most `max_bytes`, and six more in a block download.
        """
        return len(self._received) + len(self._block_download)

    def reset(self) -> None:
        """Drop an unfinished transfer without informing the client."""
        self.state = SdoState.IDLE
        self.due: int | None = None
        self._index = self._subindex = 0
        self._toggle = 0
        self._announced: int | None = None
        self._received = bytearray()
        self._uploaded, self._sent_bytes = b"", 0
        self._block_download, self._block_upload = _NO_DOWNLOAD, _NO_UPLOAD
        self._job: Postponed | None = None
        self._late_answers: Answers = ()

    def receive(self, data: bytes, now: int) -> list[Frame]:
        """Return the answers to a request."""
        state, block = self.state, self._block_download
        if len(data) != _LENGTH or state is _WAITING or (block is not _NO_DOWNLOAD and block.is_repetition(data)):
            return []
        first = data[0]
        if state is _BLOCK_DOWNLOADING and self._is_segment(_SERVICES[first], data):
            handler: Handler | None = SdoServer._block_segment
        elif _SERVICES[first] is _ABORTED:
            self.reset()
            return []
        else:
            handler = _HANDLERS[state][first]
        try:
            if handler is None:
                raise self._unknown(_SERVICES[first], data)
            answers = handler(self, data)
        except SdoAbort as abort:
            return [self._abort(abort.code)]
        if self._job is not None:
            self.state, self.due, self._late_answers = _WAITING, now + self._job.duration_ns, answers
            return self.advance(now)
        if self.state is _IDLE:
            self.due = None
        else:
            self.due = now + (self._silence_ns if self._block_download.has_heard else self._timeout_ns)
        return [Frame(self.response_id, answer) for answer in answers]

    def advance(self, now: int) -> list[Frame]:
        """Return the frames that are due.

        They are an answer that the owner has finished, an acknowledgement, or the abort of a silent client's transfer.
        """
        if self.due is None or now < self.due:
            return []
        if self._job is not None:
            answers, code = self._late_answers, self._job.finish()
            if code is not None:
                return [self._abort(code)]
            self.reset()
        elif self._block_download.has_heard:
            answers = self._acknowledge_block()
            self.due = now + self._timeout_ns
        else:
            return [self._abort(SdoAbortCode.TIMED_OUT)]
        return [Frame(self.response_id, answer) for answer in answers]

    def _abort(self, code: int) -> Frame:
        frame = Frame(self.response_id, _SIZED.pack(_ABORT, self._index, self._subindex, code))
        self.reset()
        return frame

    def _unknown(self, service: SdoService, data: bytes) -> SdoAbort:
        # A command of the future has its object where each that begins a transfer has it; let the abort name it too.
        if self.state is SdoState.IDLE and service is SdoService.RESERVED:
            _, self._index, self._subindex = _HEADER.unpack_from(data)
        return SdoAbort(SdoAbortCode.UNKNOWN_COMMAND)

    def _begin(self, data: bytes) -> int:
        # A new transfer in any state forgets the old one: an abandoned one must not reach into it.
        if self.state is not _IDLE:
            self.reset()
        first, self._index, self._subindex = _HEADER.unpack_from(data)
        return int(first)

    def _announce(self, cell: Cell, size: int) -> None:
        self._announced = size
        code = cell.length_refusal(size)
        if code is None and size > self._max_bytes:
            code = SdoAbortCode.OUT_OF_MEMORY
        if code is not None:
            raise SdoAbort(code)

    def _write(self, data: bytes) -> None:
        """End the transfer; its answer has been made before."""
        try:
            self._dictionary.write(self._index, self._subindex, data)
        except Postponed as job:
            self._job = job
        else:
            self.reset()

    # Expedited and segmented

    def _initiate_download(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.3: 001x nnes; n bytes of d do not contain data, e expedited, s size indicated.
        first = self._begin(data)
        answer = _SIZED.pack(0x60, self._index, self._subindex, 0)
        cell = self._dictionary.find_writable(self._index, self._subindex)
        if first & 0x02:
            unused = first >> 2 & 0x03
            size = _EXPEDITED_DATA - unused if first & 0x01 else cell.entry.data_type.size or _EXPEDITED_DATA
            self._write(data[4 : 4 + min(size, _EXPEDITED_DATA)])
            return (answer,)
        if first & 0x01:
            self._announce(cell, int.from_bytes(data[4:], "little"))
        self.state = SdoState.DOWNLOADING
        return (answer,)

    def _download_segment(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.4: 000t nnnc; t toggle, n bytes do not contain data, c the last one.
        first = data[0]
        self._check_toggle(first)
        self._received += data[1 : 1 + SEGMENT_DATA - (first >> 1 & 0x07)]
        limit = self._max_bytes if self._announced is None else self._announced
        if len(self._received) > limit:
            raise SdoAbort(SdoAbortCode.OUT_OF_MEMORY if self._announced is None else SdoAbortCode.TOO_LONG)
        answer = bytes((0x20 | self._toggle << 4, *bytes(7)))
        if first & 0x01:
            if len(self._received) < limit and self._announced is not None:
                raise SdoAbort(SdoAbortCode.TOO_SHORT)
            self._write(bytes(self._received))
        else:
            self._toggle ^= 1
        return (answer,)

    def _initiate_upload(self, data: bytes) -> Answers:
        self._begin(data)
        return self._upload(self._dictionary.read(self._index, self._subindex))

    def _upload(self, value: bytes) -> Answers:
        # CiA 301, 7.2.4.3.6: expedited up to four bytes, else with the size; an empty value has no expedited form.
        if 0 < len(value) <= _EXPEDITED_DATA:
            first = 0x43 | (_EXPEDITED_DATA - len(value)) << 2
            return (_HEADER.pack(first, self._index, self._subindex) + value.ljust(_EXPEDITED_DATA, b"\0"),)
        self._uploaded, self._sent_bytes = value, 0
        self.state = SdoState.UPLOADING
        return (_SIZED.pack(0x41, self._index, self._subindex, len(value)),)

    def _upload_segment(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.7: answered 000t nnnc.
        self._check_toggle(data[0])
        segment = self._uploaded[self._sent_bytes : self._sent_bytes + SEGMENT_DATA]
        self._sent_bytes += len(segment)
        first = self._toggle << 4 | (SEGMENT_DATA - len(segment)) << 1
        if self._sent_bytes < len(self._uploaded):
            self._toggle ^= 1
        else:
            first |= 0x01
            self.reset()
        return (bytes((first,)) + segment.ljust(SEGMENT_DATA, b"\0"),)

    def _check_toggle(self, first: int) -> None:
        if first >> 4 & 0x01 != self._toggle:
            raise SdoAbort(SdoAbortCode.TOGGLE_BIT)

    # Block

    def _initiate_block_download(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.9: 110x xcs0; c the client has checksums, s size indicated. Answered 101x xc00 and the block size.
        first = self._begin(data)
        cell = self._dictionary.find_writable(self._index, self._subindex)
        if first & 0x02:
            self._announce(cell, int.from_bytes(data[4:], "little"))
        has_crc = bool(first & 0x04)
        self._block_download = BlockDownload(self._announced, self._max_bytes, self._block_size, has_crc=has_crc)
        self.state = SdoState.BLOCK_DOWNLOADING
        return (_SIZED.pack(0xA0 | has_crc << 2, self._index, self._subindex, self._block_download.block_size),)

    def _is_segment(self, service: SdoService, data: bytes) -> bool:
        # Number 0 with c set is the abort. A number that was not granted is more likely a client that begins anew.
        if data[0] == _ABORT:
            return False
        if service not in INITIATES or data[0] & 0x7F <= self._block_download.block_size:
            return True
        _, index, subindex = _HEADER.unpack_from(data)
        return (index, subindex) not in self._dictionary

    def _block_segment(self, data: bytes) -> Answers:
        return self._acknowledge_block() if self._block_download.receive(data) else ()

    def _acknowledge_block(self) -> Answers:
        # CiA 301, 7.2.4.3.10: 101x xx10, the last segment in order, the next block size.
        accepted, block_size = self._block_download.acknowledge()
        if self._block_download.is_complete:
            self.state = SdoState.BLOCK_DOWNLOAD_ENDING
        return (_ACKNOWLEDGEMENT.pack(0xA2, accepted, block_size),)

    def _end_block_download(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.11: 110n nnx1 and the checksum; n bytes of the last segment do not contain data.
        first, crc = _END.unpack(data)
        self._write(self._block_download.finish(first >> 2 & 0x07, crc))
        return (_ACKNOWLEDGEMENT.pack(0xA1, 0, 0),)

    def _initiate_block_upload(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.12: 101x xc00, block size, protocol switch threshold. Answered 110x xcs0 and the size.
        first = self._begin(data)
        value = self._dictionary.read(self._index, self._subindex)
        has_crc = bool(first & 0x04)
        upload = BlockUpload(value, data[4], has_crc=has_crc)
        if 0 < len(value) <= data[5]:
            return self._upload(value)
        self._block_upload = upload
        self.state = SdoState.BLOCK_UPLOAD_READY
        return (_SIZED.pack(0xC2 | has_crc << 2, self._index, self._subindex, len(value)),)

    def _start_block_upload(self, _data: bytes) -> Answers:
        self.state = SdoState.BLOCK_UPLOADING
        return self._block_upload.segments()

    def _acknowledge_upload(self, data: bytes) -> Answers:
        # CiA 301, 7.2.4.3.13: the last segment in order, the next block size. At the end answered 110n nnx1 and the checksum.
        _, number, block_size = _ACKNOWLEDGEMENT.unpack(data)
        self._block_upload.acknowledge(number, block_size)
        if not self._block_upload.is_complete:
            return self._block_upload.segments()
        self.state = SdoState.BLOCK_UPLOAD_ENDING
        unused, crc = self._block_upload.end()
        return (_END.pack(0xC1 | unused << 2, crc),)

    def _end_block_upload(self, _data: bytes) -> Answers:
        self.reset()
        return ()


Handler = Callable[[SdoServer, bytes], Answers]

_TABLE: dict[tuple[SdoState, SdoService], Handler] = {
    **{(state, SdoService.INITIATE_DOWNLOAD): SdoServer._initiate_download for state in SdoState},
    **{(state, SdoService.INITIATE_UPLOAD): SdoServer._initiate_upload for state in SdoState},
    **{(state, SdoService.INITIATE_BLOCK_DOWNLOAD): SdoServer._initiate_block_download for state in SdoState},
    **{(state, SdoService.INITIATE_BLOCK_UPLOAD): SdoServer._initiate_block_upload for state in SdoState},
    (SdoState.DOWNLOADING, SdoService.DOWNLOAD_SEGMENT): SdoServer._download_segment,
    (SdoState.UPLOADING, SdoService.UPLOAD_SEGMENT): SdoServer._upload_segment,
    (SdoState.BLOCK_DOWNLOAD_ENDING, SdoService.END_BLOCK_DOWNLOAD): SdoServer._end_block_download,
    (SdoState.BLOCK_UPLOAD_READY, SdoService.START_BLOCK_UPLOAD): SdoServer._start_block_upload,
    (SdoState.BLOCK_UPLOADING, SdoService.ACKNOWLEDGE_BLOCK): SdoServer._acknowledge_upload,
    (SdoState.BLOCK_UPLOAD_ENDING, SdoService.END_BLOCK_UPLOAD): SdoServer._end_block_upload,
}
"""Handlers by state and service; a service that is not listed is answered with 0504 0001h."""
_HANDLERS = {state: tuple(_TABLE.get((state, service)) for service in _SERVICES) for state in SdoState}
"""The same by state and first byte."""
