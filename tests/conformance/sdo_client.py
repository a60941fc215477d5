"""An SDO client of raw frames, so that a device is judged by the standard and not through a library (CiA 301, 7.2.4)."""

import binascii
import struct

TOGGLE, TIMED_OUT, UNKNOWN_COMMAND = 0x0503_0000, 0x0504_0000, 0x0504_0001
BLOCK_SIZE, SEQUENCE, CRC, MEMORY = 0x0504_0002, 0x0504_0003, 0x0504_0004, 0x0504_0005
UNSUPPORTED, WRITE_ONLY, READ_ONLY, NO_OBJECT = 0x0601_0000, 0x0601_0001, 0x0601_0002, 0x0602_0000
NOT_MAPPABLE, PDO_LENGTH, INCOMPATIBLE, INTERNAL = 0x0604_0041, 0x0604_0042, 0x0604_0043, 0x0604_0047
LENGTH, TOO_LONG, TOO_SHORT = 0x0607_0010, 0x0607_0012, 0x0607_0013
NO_SUBINDEX, INVALID, TOO_HIGH, TOO_LOW = 0x0609_0011, 0x0609_0030, 0x0609_0031, 0x0609_0032
GENERAL, NOT_STORED, LOCAL_CONTROL, DEVICE_STATE, NO_DATA = (
    0x0800_0000, 0x0800_0020, 0x0800_0021, 0x0800_0022, 0x0800_0024,
)  # fmt: skip

SEGMENT = 7
MAX_BLOCK = 127


class Abort(int):
    """An abort code; what a transfer gives when the server has refused it."""

    def __repr__(self):
        return f"abort {int(self):08X}h"


def place_bytes(index, subindex):
    """Index and sub-index as every initiate has them."""
    return struct.pack("<HB", index, subindex)


def abort_of(answer):
    """The abort code of an answer, or None."""
    return Abort(int.from_bytes(answer[4:8], "little")) if answer[0] == 0x80 else None


class SdoClient:
    """Transfers to one server, each frame of the server checked for what the standard fixes in it.

    Args:
        port: The bus.
        node_id: Of the server.
        patience_s: How long an answer may take.
    """

    def __init__(self, port, node_id, patience_s):
        self.port, self.node_id, self.patience_s = port, node_id, patience_s
        self.request_id, self.response_id = 0x600 + node_id, 0x580 + node_id

    # -- frames

    def send(self, data):
        """Send a request, padded to its 8 bytes, without waiting."""
        self.port.send(self.request_id, bytes(data).ljust(8, b"\0"))

    def ask(self, data, seconds=None):
        """Send a request; the answer's 8 bytes, or None where none comes."""
        mark = len(self.port.seen)
        self.send(data)
        return self.answer(mark, seconds)

    def answer(self, mark, seconds=None):
        """The next answer after a place in what was seen."""
        heard = self.port.expect(self.response_id, self.patience_s if seconds is None else seconds, mark)
        return None if heard is None else heard.data

    def request(self, data):
        """Send a request that must be answered, by 8 bytes."""
        answer = self.ask(data)
        assert answer is not None, f"no answer within {self.patience_s} s to {bytes(data).hex(' ')}"
        assert len(answer) == 8, f"an SDO of {len(answer)} bytes: {answer.hex(' ')}"
        return answer

    def is_silent(self, seconds=0.1):
        """Tell whether nothing comes from the server for a while."""
        mark = len(self.port.seen)
        return self.port.expect(self.response_id, seconds, mark) is None

    def abort(self, index, subindex, code=GENERAL):
        """End a transfer from this side; nobody answers that."""
        self.send(b"\x80" + place_bytes(index, subindex) + struct.pack("<I", code))

    # -- upload

    def upload(self, index, subindex=0):
        """The bytes of an entry, expedited or in segments as the server likes it, or the abort."""
        place = place_bytes(index, subindex)
        answer = self.request(b"\x40" + place)
        refused = abort_of(answer)
        assert answer[1:4] == place, f"the answer names another object: {answer.hex(' ')}"
        if refused is not None:
            return refused
        first = answer[0]
        assert first & 0xF0 == 0x40, f"no answer to an upload: {answer.hex(' ')}"
        if first & 0x02:
            return answer[4 : 8 - (first >> 2 & 3)] if first & 0x01 else answer[4:8]
        assert not first & 0x0C, "n is 0 where the transfer is not expedited (CiA 301, 7.2.4.3.6)"
        size = struct.unpack("<I", answer[4:])[0] if first & 0x01 else None
        data = self._segments(size)
        if not isinstance(data, Abort):
            assert size is None or size == len(data), f"{size} bytes announced, {len(data)} sent"
        return data

    def _segments(self, size):
        data, toggle = b"", 0
        while True:
            answer = self.request(bytes((0x60 | toggle,)))
            if (refused := abort_of(answer)) is not None:
                return refused
            assert answer[0] & 0xF0 == toggle, f"a segment with another toggle bit or command: {answer.hex(' ')}"
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            toggle ^= 0x10
            if answer[0] & 1:
                return data
            assert size is None or len(data) < size, "more segments than the announced size"

    # -- download

    def download(self, index, subindex, data, *, segmented=False):
        """Write bytes, expedited where there is room; the abort, or None."""
        if 0 < len(data) <= 4 and not segmented:
            answer = self.request(bytes((0x23 | 4 - len(data) << 2,)) + place_bytes(index, subindex) + data)
            return self._downloaded(answer, index, subindex)
        answer = self.request(b"\x21" + place_bytes(index, subindex) + struct.pack("<I", len(data)))
        refused = self._downloaded(answer, index, subindex)
        return refused if refused is not None else self.download_segments(data)

    def download_segments(self, data):
        """The segments of a download that has been initiated."""
        toggle = 0
        while True:
            segment, data = data[:SEGMENT], data[SEGMENT:]
            answer = self.request(bytes((toggle | SEGMENT - len(segment) << 1 | (not data),)) + segment)
            if (refused := abort_of(answer)) is not None:
                return refused
            assert answer == bytes((0x20 | toggle, *bytes(7))), f"no answer to a segment: {answer.hex(' ')}"
            toggle ^= 0x10
            if not data:
                return None

    @staticmethod
    def _downloaded(answer, index, subindex):
        assert answer[1:4] == place_bytes(index, subindex), f"the answer names another object: {answer.hex(' ')}"
        if (refused := abort_of(answer)) is not None:
            return refused
        assert answer[0] == 0x60, f"no answer to a download: {answer.hex(' ')}"
        assert answer[4:] == bytes(4), "bytes 4 to 7 are reserved, 0 (CiA 301, 7.2.4.3.3)"
        return None

    # -- block transfer

    def begin_block_upload(self, index, subindex=0, block=MAX_BLOCK, *, crc=True, switch=0):
        """Initiate; (whether the server knows CRC, size or None), bytes where it switched to another protocol, or the abort."""
        place = place_bytes(index, subindex)
        answer = self.request(bytes((0xA0 | crc << 2,)) + place + bytes((block, switch)))
        if (refused := abort_of(answer)) is not None:
            return refused
        assert answer[1:4] == place, f"the answer names another object: {answer.hex(' ')}"
        assert answer[0] & 0xF9 == 0xC0, f"no answer to a block upload: {answer.hex(' ')}"
        return bool(answer[0] & 4), struct.unpack("<I", answer[4:])[0] if answer[0] & 2 else None

    def receive_block(self, block, mark):
        """The segments of one block: (number, bytes, whether it is the last) of each."""
        segments, place = [], mark
        while len(segments) < block:
            heard = self.port.expect(self.response_id, self.patience_s, place)
            assert heard is not None, f"the block ends after {len(segments)} of {block} segments without the last"
            place = self.port.seen.index(heard, place) + 1
            refused = abort_of(heard.data) if heard.data[0] == 0x80 else None
            assert refused is None, f"aborted inside a block: {refused!r}"
            segments.append((heard.data[0] & 0x7F, heard.data[1:], bool(heard.data[0] & 0x80)))
            if segments[-1][2]:
                break
        return segments

    def block_upload(self, index, subindex=0, block=MAX_BLOCK, lose=frozenset(), end=True):
        """The bytes of an entry by block transfer.

        Args:
            index: Of the entry.
            subindex: Of the entry.
            block: Segments of a block.
            lose: Segments, counted from 0 over the whole transfer, that are taken for lost once.
            end: Whether to confirm the end.
        """
        begun = self.begin_block_upload(index, subindex, block)
        if isinstance(begun, Abort):
            return begun
        has_crc, size = begun
        data, lose, sent = b"", set(lose), 0
        request, final = b"\xa3", False
        while not final:
            mark = len(self.port.seen)
            self.send(request)
            segments = self.receive_block(block, mark)
            assert [number for number, _, _ in segments] == list(range(1, len(segments) + 1)), "sequence numbers rise from 1"
            good = 0
            for _, payload, is_last in segments:
                if sent + good in lose:
                    lose.discard(sent + good)
                    break
                good += 1
                data += payload
                final = is_last
            sent += good
            request = bytes((0xA2, good, block))
        answer = self.request(request)
        assert abort_of(answer) is None, f"{abort_of(answer)!r}"
        assert answer[0] & 0xE3 == 0xC1, f"no end of the block upload: {answer.hex(' ')}"
        data = data[: len(data) - (answer[0] >> 2 & 7)]
        assert size is None or len(data) == size, f"{size} bytes announced, {len(data)} sent"
        if has_crc:
            assert int.from_bytes(answer[1:3], "little") == binascii.crc_hqx(data, 0), "CRC of the data (CiA 301, 7.2.4.3.16)"
        if end:
            self.send(b"\xa1")
        return data

    def block_download(self, index, subindex, data, lose=frozenset(), wrong_crc=False):
        """Write bytes by block transfer; the abort, or None. `lose` as in `block_upload`."""
        place = place_bytes(index, subindex)
        answer = self.request(b"\xc6" + place + struct.pack("<I", len(data)))
        if (refused := abort_of(answer)) is not None:
            return refused
        assert answer[0] & 0xFB == 0xA0, f"no answer to a block download: {answer.hex(' ')}"
        assert answer[1:4] == place, f"the answer names another object: {answer.hex(' ')}"
        has_crc, block = bool(answer[0] & 4), answer[4]
        pieces = [data[i : i + SEGMENT] for i in range(0, len(data), SEGMENT)] or [b""]
        lose, done = set(lose), 0
        while done < len(pieces):
            assert 1 <= block <= MAX_BLOCK, f"a block of {block} segments"
            mark, now = len(self.port.seen), pieces[done : done + block]
            for number, piece in enumerate(now, 1):
                if done + number - 1 in lose:
                    lose.discard(done + number - 1)
                    continue
                last = done + number == len(pieces)
                self.send(bytes((last << 7 | number,)) + piece)
            answer = self.answer(mark)
            assert answer is not None, "a block is not acknowledged"
            if (refused := abort_of(answer)) is not None:
                return refused
            assert answer[0] == 0xA2, f"no answer to a block: {answer.hex(' ')}"
            assert answer[1] <= len(now), f"{answer[1]} segments acknowledged of {len(now)}"
            done, block = done + answer[1], answer[2]
        crc = (binascii.crc_hqx(data, 0) ^ wrong_crc) if has_crc else 0
        answer = self.request(bytes((0xC1 | (SEGMENT - len(pieces[-1])) << 2,)) + struct.pack("<H", crc))
        if (refused := abort_of(answer)) is not None:
            return refused
        assert answer == bytes((0xA1, *bytes(7))), f"no end of the block download: {answer.hex(' ')}"
        return None
