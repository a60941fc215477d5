"""SDO block transfer without the server (CiA 301, 7.2.4.3.9 to 7.2.4.3.15)."""

from binascii import crc_hqx

from drive_profiles.standard.cia301 import SdoAbortCode
from plant_emulator.slave.dictionary import SdoAbort

SEGMENT_DATA = 7
MAX_BLOCK_SIZE = 127

_LAST = 0x80
_SEQUENCE_NUMBER = 0x7F


def crc_of(data: bytes) -> int:
    """Return the checksum of a whole value.

    It is CRC-16-CCITT, polynomial 1021h, start value 0 (CiA 301, 7.2.4.3.16).
    """
    return crc_hqx(data, 0)


def count_segments(length: int) -> int:
    """Return the number of segments of a value."""
    return max(1, -(-length // SEGMENT_DATA))


class BlockDownload:
    """Buffer of a value that a client is sending.

    A value that is too long is refused at the end of a sub-block, when the client waits for an answer: no segment can then
    arrive after the abort and be taken for a request. The sub-block size stays as first granted. The standard lets the
    server change it, but some clients then put the segments in the wrong places.

    Args:
        announced: Length of the value, or None if the client does not state it.
        max_bytes: The longest value; up to one sub-block more is kept until its end, where it is refused.
        max_block_size: At most so many segments are granted at once, 1 to 127.
        has_crc: True if the end brings a checksum.

    Attributes:
        is_complete: True if the last segment of the value is there.
        has_heard: True if a segment of this sub-block has come, be it the right one or not.
    """

    def __init__(self, announced: int | None, max_bytes: int, max_block_size: int, *, has_crc: bool) -> None:
        self._announced = announced
        self._limit = max_bytes if announced is None else announced
        self._has_crc = has_crc
        self._received = bytearray()
        self._accepted = 0
        self._ended_by = b""
        self.is_complete = self.has_heard = False
        self.block_size = min(max_block_size, count_segments(self._limit))

    def __len__(self) -> int:
        return len(self._received)

    def is_repetition(self, segment: bytes) -> bool:
        """Return True if CAN delivered a sub-block's last segment twice.

        Taken for the end of the next sub-block, the segment would be acknowledged once too often. If sub-blocks have one
        segment, two equal ones may both be genuine.
        """
        if self.has_heard or segment != self._ended_by:
            return False
        return self.is_complete or segment[0] & _SEQUENCE_NUMBER > 1

    def receive(self, segment: bytes) -> bool:
        """Process a segment; return True if it ends its sub-block.

        A segment is c, seqno and 7 bytes (7.2.4.3.10). One that does not follow its predecessor is dropped: the
        acknowledgement requests it again.

        Raises:
            SdoAbort: No segment of this sub-block can have that number.
        """
        number = segment[0] & _SEQUENCE_NUMBER
        if not 1 <= number <= self.block_size:
            raise SdoAbort(SdoAbortCode.INVALID_SEQUENCE_NUMBER)
        self.has_heard = True
        is_last = bool(segment[0] & _LAST)
        if number == self._accepted + 1:
            self._received += segment[1:]
            self._accepted = number
            self.is_complete = is_last
        is_end = is_last or number == self.block_size
        if is_end:
            self._ended_by = segment
        return is_end

    def acknowledge(self) -> tuple[int, int]:
        """End a sub-block and return its acknowledgement.

        It is the number of the last segment that came in order, and the size of the next sub-block.

        Raises:
            SdoAbort: All that may come is there, and the client has more.
        """
        accepted, self._accepted, self.has_heard = self._accepted, 0, False
        if len(self._received) >= SEGMENT_DATA * count_segments(self._limit) + self.is_complete:
            raise SdoAbort(SdoAbortCode.OUT_OF_MEMORY if self._announced is None else SdoAbortCode.TOO_LONG)
        return accepted, self.block_size

    def finish(self, unused: int, crc: int) -> bytes:
        """Return the value at the end of the transfer.

        The client has announced the unused bytes of the last segment, and the checksum.

        Raises:
            SdoAbort: Length or checksum differ from those that the client has announced.
        """
        value = bytes(self._received[: len(self._received) - unused])
        if self._announced is not None and len(value) != self._announced:
            raise SdoAbort(SdoAbortCode.TOO_LONG if len(value) > self._announced else SdoAbortCode.TOO_SHORT)
        if len(value) > self._limit:
            raise SdoAbort(SdoAbortCode.OUT_OF_MEMORY)
        if self._has_crc and crc_of(value) != crc:
            raise SdoAbort(SdoAbortCode.CRC)
        return value


class BlockUpload:
    """A value being uploaded, as it was at the transfer's start.

    Raises:
        SdoAbort: There is no such block size.
    """

    def __init__(self, value: bytes, block_size: int, *, has_crc: bool) -> None:
        self._value, self._has_crc = value, has_crc
        self._count = count_segments(len(value))
        self._acknowledged = 0
        self._set_block_size(block_size)

    @property
    def is_complete(self) -> bool:
        """True if the client has every segment."""
        return self._acknowledged == self._count

    def segments(self) -> tuple[bytes, ...]:
        """Return the sub-block after the acknowledged segments.

        A segment is c, seqno and 7 bytes (7.2.4.3.13).
        """
        first = self._acknowledged
        return tuple(self._segment(first, number) for number in range(1, self._in_flight() + 1))

    def acknowledge(self, number: int, block_size: int) -> None:
        """Process the client's acknowledgement.

        Raises:
            SdoAbort: No segment of that number has been sent, or there is no such block size and more is to come.
        """
        if number > self._in_flight():
            raise SdoAbort(SdoAbortCode.INVALID_SEQUENCE_NUMBER)
        self._acknowledged += number
        if not self.is_complete:
            self._set_block_size(block_size)

    def end(self) -> tuple[int, int]:
        """Return the last segment's unused bytes, and the checksum, 0 if unwanted."""
        return self._count * SEGMENT_DATA - len(self._value), crc_of(self._value) if self._has_crc else 0

    def _set_block_size(self, block_size: int) -> None:
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            raise SdoAbort(SdoAbortCode.INVALID_BLOCK_SIZE)
        self._block_size = block_size

    def _in_flight(self) -> int:
        return min(self._block_size, self._count - self._acknowledged)

    def _segment(self, first: int, number: int) -> bytes:
        end = (first + number) * SEGMENT_DATA
        last = _LAST if first + number == self._count else 0
        return bytes((last | number,)) + self._value[end - SEGMENT_DATA : end].ljust(SEGMENT_DATA, b"\0")
