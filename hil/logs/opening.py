"""Opening of logs in all known formats.

The reader of this package takes candump's logs, python-can takes BLF, ASC, TRC and MF4. A damaged log is read as far as possible,
and missing parts are counted. Only a file without any frame is refused.
"""

import itertools
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drive_profiles.files.reading import kind_of
from drive_profiles.python_can import with_mf4
from hil.can.frame import MAX_DATA_LENGTH
from hil.errors import LogError
from hil.logs import candump
from hil.logs.log import Damage, Log, LogBuilder

if TYPE_CHECKING:
    import can

MOST_FRAMES = 200_000_000
"""About seven hours of three axes at 1 kHz."""
FOREIGN = {".blf": b"LOGG", ".asc": b"", ".trc": b"", ".mf4": b"MDF     "}
"""Formats that python-can reads, with what such a file begins with where that says it."""
BATCH = 100_000


def open_log(path: Path, progress: Callable[[int], None] = lambda size: None, interface: str | None = None) -> Log:
    """Read a log.

    The suffix tells the format, an unknown one candump's. `progress` gets the bytes read so far; without an interface that of the
    first frame is read.

    Raises:
        LogError: The file cannot be read, or holds no frame.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        if not path.exists():
            raise LogError(path, "no such file")
        raise LogError(path, f"is {kind_of(path.stat().st_mode)}; expected a log of a bus, such as its bus.log")
    counters = np.zeros(candump.COUNTED, np.int64)
    ended: list[str] = []
    if suffix in FOREIGN:
        with path.open("rb") as file:
            if not file.read(len(FOREIGN[suffix])) == FOREIGN[suffix]:
                raise LogError(
                    path, f"is not {suffix[1:].upper()} data: a {suffix} file begins with {FOREIGN[suffix].decode().strip()}"
                )
        pieces = _foreign(path, counters, ended, interface)
    else:
        counters[candump.INTERFACE] = 0 if interface is None else candump.hash_of(interface)
        pieces = candump.chunks(path, counters, progress)
    builder, unstamped = LogBuilder(path), 0
    for stamp, can_id, length, data in pieces:
        unstamped += int(np.count_nonzero(stamp < 0))
        builder.add(stamp, can_id, length, data)
        if builder.frames > MOST_FRAMES:
            raise LogError(path, f"more than {MOST_FRAMES} frames; split the log")
    if not builder.frames and counters[candump.ELSEWHERE]:
        raise LogError(path, f"no frame of interface {interface}, but {counters[candump.ELSEWHERE]} of others")
    if not builder.frames:
        reason = ended[0] if ended else f"none of its {counters[candump.READ_LINES]} lines is a line of candump"
        raise LogError(path, f"no frame in it: {reason}")
    if unstamped:
        raise LogError(path, f"{unstamped} of {builder.frames} frames have no time stamp; record with candump -ta")
    damage = Damage(
        unreadable=int(counters[candump.UNREADABLE]),
        first_unreadable=int(counters[candump.FIRST_UNREADABLE]),
        flexible=int(counters[candump.FLEXIBLE]),
        elsewhere=int(counters[candump.ELSEWHERE]),
        backwards=builder.backwards,
        first_backwards=builder.first_backwards,
        furthest_back_ns=builder.furthest_back_ns,
        ended=ended[0] if ended else "",
    )
    return builder.log(damage)


def _foreign(
    path: Path, counters: NDArray[np.int64], ended: list[str], interface: str | None
) -> Iterator[candump.Chunk]:  # fmt: skip
    """Yield frames that python-can reads, in batches."""
    from hil.can.adapter import identifier_of  # noqa: PLC0415 - python-can is slow to load

    messages, channel = _messages(path, ended), interface
    while batch := list(itertools.islice(messages, BATCH)):
        kept = [message for message in batch if not message.is_fd and len(message.data) <= MAX_DATA_LENGTH]
        counters[candump.FLEXIBLE] += len(batch) - len(kept)
        if channel is None and kept:
            channel = str(kept[0].channel)
        own = [message for message in kept if str(message.channel) == channel]
        counters[candump.ELSEWHERE] += len(kept) - len(own)
        kept = own
        counters[candump.READ_LINES] += len(batch)
        yield (
            np.array([round(message.timestamp * 1e9) for message in kept], np.int64),
            np.array([identifier_of(message) for message in kept], np.uint32),
            np.array([len(message.data) for message in kept], np.uint8),
            np.array([int.from_bytes(message.data, "little") for message in kept], np.uint64),
        )


def _messages(path: Path, ended: list[str]) -> Iterator["can.Message"]:
    import can  # noqa: PLC0415 - slow to load
    from can.io.blf import BLFParseError  # noqa: PLC0415

    if path.suffix.lower() == ".mf4":
        with_mf4()
    known = (
        OSError,
        EOFError,
        ValueError,
        IndexError,
        KeyError,
        TypeError,
        struct.error,
        zlib.error,
        can.CanError,
        BLFParseError,
    )
    try:
        with can.LogReader(str(path)) as reader:
            yield from reader
    except (ImportError, NotImplementedError) as error:  # the latter is python-can's word for an absent asammdf
        raise LogError(path, f"{error}; pip install 'hil-bench[mf4]'") from error
    except known as error:
        ended.append(f"{type(error).__name__}: {error}")
