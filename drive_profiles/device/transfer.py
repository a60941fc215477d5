"""SDO transfers from the client's side, without a bus or a clock.

A transfer is a generator. It puts the frames to send into `out`, yields, and is sent the next answer of the server; its return
value is the content of the object. It yields True where the next frame is a segment of a block, whose first byte is not a
command. `TransferAbortedError` says that the server refuses, `TransferBrokenError` that an answer makes no sense.

Source: CiA 301, 7.2.4.3.
"""

import struct
from binascii import crc_hqx
from collections.abc import Generator

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.object_address import ObjectAddress

Transfer = Generator[bool, bytes, bytes]

MAX_UPLOAD_BYTES = 65536
"""Longest object that a node may send us, a bound on our memory."""
LENGTH = 8
ABORT = 0x80
_COMMAND = struct.Struct("<BHBI")
_END = struct.Struct("<BH5x")
_THREE = struct.Struct("<BBB5x")
_SPECIFIER, _SPECIFIER_AND_STEP = 0xE0, 0xE3
_LAST_SEGMENT, _NUMBER = 0x80, 0x7F
_EXPEDITED_DATA, _SEGMENT_DATA = 4, 7
MAX_BLOCK_SIZE = 127
SWITCH_BYTES = 4 * _SEGMENT_DATA
"""Length up to which a block upload takes more frames than one in segments: the server may then change to that."""
_MAX_REPETITIONS = 16
"""Number of blocks in a row of which nothing may be accepted, before the transfer is aborted."""


class TransferAbortedError(Exception):
    """The server has aborted the transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"aborted with {code:08X}h")
        self.code = code


class TransferBrokenError(Exception):
    """An answer makes no sense, and the client aborts the transfer."""

    def __init__(self, code: SdoAbortCode) -> None:
        super().__init__(code.text)
        self.code = code


def abort(address: ObjectAddress, code: SdoAbortCode) -> bytes:
    """Return the frame with which a client aborts a transfer."""
    return _COMMAND.pack(ABORT, *address, code)


def upload(out: list[bytes], address: ObjectAddress) -> Transfer:
    """Read an object, expedited or in segments."""
    out.append(_COMMAND.pack(0x40, *address, 0))
    answer = yield False
    return (yield from _uploaded(out, answer))


def _uploaded(out: list[bytes], answer: bytes) -> Transfer:
    # answered 010x nnes: n bytes of d do not contain data, e expedited, s size indicated
    first = _checked(answer, _SPECIFIER, 0x40)
    if first & 0x02:
        size = _EXPEDITED_DATA - (first >> 2 & 0x03) if first & 0x01 else _EXPEDITED_DATA
        return answer[4 : 4 + size]
    data, toggle = bytearray(), 0
    while True:
        out.append(bytes((0x60 | toggle, 0, 0, 0, 0, 0, 0, 0)))
        answer = yield False
        first = _checked(answer, _SPECIFIER, 0x00)  # 000t nnnc
        if first & 0x10 != toggle:
            raise TransferBrokenError(SdoAbortCode.TOGGLE_BIT)
        data += answer[1 : LENGTH - (first >> 1 & 0x07)]
        _check_length(data)
        if first & 0x01:
            return bytes(data)
        toggle ^= 0x10


def download(out: list[bytes], address: ObjectAddress, data: bytes) -> Transfer:
    """Write an object, expedited or in segments."""
    size = len(data)
    if 1 <= size <= _EXPEDITED_DATA:
        out.append(_COMMAND.pack(0x23 | (_EXPEDITED_DATA - size) << 2, *address, int.from_bytes(data, "little")))
        _checked((yield False), _SPECIFIER, 0x60)
        return b""
    out.append(_COMMAND.pack(0x21, *address, size))
    _checked((yield False), _SPECIFIER, 0x60)
    toggle, begin, is_last = 0, 0, False
    while not is_last:
        segment = data[begin : begin + _SEGMENT_DATA]
        begin += _SEGMENT_DATA
        is_last = begin >= size
        out.append(bytes((toggle | (_SEGMENT_DATA - len(segment)) << 1 | is_last,)) + segment.ljust(_SEGMENT_DATA, b"\0"))
        if _checked((yield False), _SPECIFIER, 0x20) & 0x10 != toggle:
            raise TransferBrokenError(SdoAbortCode.TOGGLE_BIT)
        toggle ^= 0x10
    return b""


def block_upload(out: list[bytes], address: ObjectAddress) -> Transfer:
    """Read an object in blocks, or a short one as `upload` does."""
    out.append(_COMMAND.pack(0xA4, *address, MAX_BLOCK_SIZE | SWITCH_BYTES << 8))
    answer = yield False
    if answer[0] & _SPECIFIER == 0x40:
        return (yield from _uploaded(out, answer))
    has_crc = bool(_checked(answer, 0xE1, 0xC0) & 0x04)  # 110x xcs0
    data = bytearray()
    out.append(_THREE.pack(0xA3, 0, 0))
    is_complete, repetitions = False, 0
    while not is_complete:
        accepted, number, first = 0, 0, 0
        while number < MAX_BLOCK_SIZE and not first & _LAST_SEGMENT:
            answer = yield True
            first, number = answer[0], answer[0] & _NUMBER
            if first == ABORT:
                _checked(answer, 0xFF, 0x00)
            if number == accepted + 1:  # of a segment behind a gap, and of all that follow it, the server sends another
                accepted = number
                data += answer[1:]
                _check_length(data)
        is_complete = bool(first & _LAST_SEGMENT) and accepted == number
        repetitions = 0 if accepted else repetitions + 1
        if repetitions > _MAX_REPETITIONS:
            raise TransferBrokenError(SdoAbortCode.INVALID_SEQUENCE_NUMBER)
        out.append(_THREE.pack(0xA2, accepted, MAX_BLOCK_SIZE))
    answer = yield False
    first, crc = _checked(answer, _SPECIFIER_AND_STEP, 0xC1), int.from_bytes(answer[1:3], "little")  # 110n nnx1
    content = bytes(data[: len(data) - (first >> 2 & 0x07)])
    if has_crc and crc != crc_hqx(content, 0):
        raise TransferBrokenError(SdoAbortCode.CRC)
    out.append(_THREE.pack(0xA1, 0, 0))
    return content


def block_download(out: list[bytes], address: ObjectAddress, data: bytes) -> Transfer:
    """Write an object in blocks."""
    out.append(_COMMAND.pack(0xC6, *address, len(data)))
    answer = yield False
    has_crc, block_size = bool(_checked(answer, _SPECIFIER_AND_STEP, 0xA0) & 0x04), answer[4]
    segments = [data[begin : begin + _SEGMENT_DATA] for begin in range(0, len(data), _SEGMENT_DATA)] or [b""]
    done = repetitions = 0
    while done < len(segments):
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            raise TransferBrokenError(SdoAbortCode.INVALID_BLOCK_SIZE)
        block = segments[done : done + block_size]
        for number, segment in enumerate(block, 1):
            is_last = done + number == len(segments)
            out.append(bytes((number | is_last * _LAST_SEGMENT,)) + segment.ljust(_SEGMENT_DATA, b"\0"))
        answer = yield False
        _checked(answer, _SPECIFIER_AND_STEP, 0xA2)
        repetitions = 0 if answer[1] else repetitions + 1
        if answer[1] > len(block) or repetitions > _MAX_REPETITIONS:
            raise TransferBrokenError(SdoAbortCode.INVALID_SEQUENCE_NUMBER)
        done, block_size = done + answer[1], answer[2]
    out.append(_END.pack(0xC1 | (_SEGMENT_DATA - len(segments[-1])) << 2, crc_hqx(data, 0) if has_crc else 0))
    _checked((yield False), _SPECIFIER_AND_STEP, 0xA1)
    return b""


def _checked(answer: bytes, mask: int, wanted: int) -> int:
    """Return the command byte of an answer that is the expected one."""
    first = answer[0]
    if first & mask != wanted:
        if first == ABORT:
            raise TransferAbortedError(int.from_bytes(answer[4:], "little"))
        raise TransferBrokenError(SdoAbortCode.UNKNOWN_COMMAND)
    return first


def _check_length(data: bytearray) -> None:
    if len(data) > MAX_UPLOAD_BYTES:
        raise TransferBrokenError(SdoAbortCode.OUT_OF_MEMORY)
