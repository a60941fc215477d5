"""Fast reader of candump's logs.

Lines such as `(1.5) can0 181#0011` and `(1.5)  can0  181   [2]  00 11`. Lines that are not frames are counted and skipped.

Source: can-utils, `candump -l`, `candump -t a|z|A` and `-x`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from hil.core.library import CORE

CHUNK_BYTES = 1 << 22
"""Bytes that are read at once."""
LEAST_LINE = 7
"""Bytes of the shortest line that can be a frame, its end included: bounds how many frames a chunk may hold."""
LONGEST_LINE = 1 << 16

CONSUMED: int = CORE.call.CONSUMED
READ_LINES: int = CORE.call.READ_LINES
UNREADABLE: int = CORE.call.UNREADABLE
FIRST_UNREADABLE: int = CORE.call.FIRST_UNREADABLE
FLEXIBLE: int = CORE.call.FLEXIBLE
INTERFACE: int = CORE.call.INTERFACE
ELSEWHERE: int = CORE.call.ELSEWHERE
"""Indices of the counters that are carried from chunk to chunk: INTERFACE is the hash of the interface that is read, ELSEWHERE
the number of frames of others."""
COUNTED: int = CORE.call.COUNTED

Chunk = tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint8], NDArray[np.uint64]]


def chunks(path: Path, counters: NDArray[np.int64], progress: Callable[[int], None]) -> Iterator[Chunk]:
    """Yield the frames of a file in chunks.

    Stamps in ns (−1: none), identifiers, lengths and data. The counters are added to; INTERFACE chooses the interface, 0 that of
    the first frame. `progress` gets the bytes read so far.
    """
    most = CHUNK_BYTES // LEAST_LINE + 1
    stamp, can_id = np.empty(most, np.int64), np.empty(most, np.int64)
    length, data = np.empty(most, np.uint8), np.empty(most, np.uint64)
    room = [CORE.pointer(stamp, "int64_t"), CORE.pointer(can_id, "int64_t")]
    room += [CORE.pointer(length, "uint8_t"), CORE.pointer(data, "uint64_t")]
    with path.open("rb") as file:
        for buffer in _pieces(file):
            count = CORE.call.parse_candump(
                CORE.pointer(buffer, "uint8_t"), len(buffer), *room, most, CORE.pointer(counters, "int64_t")
            )
            progress(int(counters[CONSUMED]))
            yield stamp[:count].copy(), can_id[:count].astype(np.uint32), length[:count].copy(), data[:count].copy()


def _pieces(file: BinaryIO) -> Iterator[NDArray[np.uint8]]:
    """Yield chunks of whole lines."""
    rest = b""
    while piece := file.read(CHUNK_BYTES - len(rest)):
        whole = rest + piece
        end = whole.rfind(b"\n") + 1
        if not end:
            if len(whole) < LONGEST_LINE:
                rest = whole
                continue
            end = len(whole)  # no line of a log is as long: it is counted as one that cannot be read
        rest = whole[end:]
        yield np.frombuffer(bytearray(whole[:end]), np.uint8)
    if rest:
        yield np.frombuffer(bytearray(rest + b"\n"), np.uint8)


def hash_of(interface: str) -> int:
    """Return the hash of an interface's name (FNV-1a, 32 bits), never 0."""
    found = 2_166_136_261
    for octet in interface.encode():
        found = (found ^ octet) * 16_777_619 & 0xFFFF_FFFF
    return found | 1 << 32
