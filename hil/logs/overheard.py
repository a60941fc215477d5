"""SDO transfers that a listener overhears.

Writing, reading, refusals, and requests without answer. Expedited and segmented transfers of the default channel; of a block
transfer only its existence.

Source: CiA 301, 7.2.4.3.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from drive_profiles.standard.cia301 import FunctionCode
from drive_profiles.standard.object_address import ObjectAddress
from hil.logs.log import Log

PATIENCE_NS = 1_000_000_000
"""A server that has not answered after that does not."""
LONGEST = 4096
"""Bytes of a transfer that are kept: what is longer is a program or a file, no parameter."""
BLOCK_UPLOADED, BLOCK_UPLOADING_ENDS, BLOCK_MASK = 0xA1, 0xC1, 0xE3
"""Last answers of a server in a block download and in a block upload, and the bits that tell the second."""
_SEGMENT_DOWN, _DOWN, _UP, _SEGMENT_UP, _ABORT, _BLOCK_UP, _BLOCK_DOWN = range(7)
_DONE_SEGMENT_UP, _DONE_SEGMENT_DOWN, _DONE_UP, _DONE_DOWN = range(4)


@dataclass(frozen=True)
class OverheardValue:
    """One transfer that succeeded."""

    stamp_ns: int
    node: int
    address: ObjectAddress
    data: bytes
    is_write: bool


@dataclass(frozen=True)
class AbortedTransfer:
    """One transfer that was aborted."""

    stamp_ns: int
    node: int
    address: ObjectAddress
    code: int
    by_server: bool


@dataclass(frozen=True)
class UnansweredRequest:
    """A request without an answer."""

    stamp_ns: int
    node: int
    address: ObjectAddress


@dataclass(frozen=True)
class OverlappingRequest:
    """A request during a recent open one on the same channel."""

    stamp_ns: int
    node: int


Event = OverheardValue | AbortedTransfer | UnansweredRequest | OverlappingRequest


@dataclass
class _Transfer:
    stamp_ns: int
    address: ObjectAddress
    is_write: bool
    data: bytearray = field(default_factory=bytearray)
    is_segmented: bool = False
    is_last: bool = False
    is_block: bool = False


def overheard(log: Log) -> list[Event]:
    """SDO transfers of a log, in the order of their ends."""
    bases = ((FunctionCode.SDO_REQUEST, True), (FunctionCode.SDO_RESPONSE, False))
    frames = sorted(
        (int(stream.position[row]), int(stream.stamp_ns[row]), stream.can_id - base, stream.bytes_of(row), is_request)
        for base, is_request in bases
        for stream in log.near(base)
        for row in range(len(stream))
    )
    open_transfers: dict[int, _Transfer] = {}
    events: list[Event] = []
    for _, stamp_ns, node, data, is_request in frames:
        if len(data) != 8:
            continue
        if is_request:
            events += _request(open_transfers, stamp_ns, node, data)
        else:
            events += _answer(open_transfers, stamp_ns, node, data)
    for node, transfer in open_transfers.items():
        if log.duration_ns - transfer.stamp_ns > PATIENCE_NS and not transfer.is_block:
            events.append(UnansweredRequest(transfer.stamp_ns, node, transfer.address))
    return events


def _request(transfers: dict[int, _Transfer], stamp_ns: int, node: int, data: bytes) -> Iterator[Event]:
    command, address = data[0] >> 5, (int.from_bytes(data[1:3], "little"), data[3])
    transfer = transfers.get(node)
    if transfer is not None and transfer.is_block:
        if command in {_DOWN, _UP, _ABORT} and stamp_ns - transfer.stamp_ns > PATIENCE_NS:
            transfers.pop(node)
        return
    if command == _ABORT:
        if transfers.pop(node, None) is not None:
            yield AbortedTransfer(stamp_ns, node, address, int.from_bytes(data[4:], "little"), by_server=False)
        return
    if command in {_DOWN, _UP, _BLOCK_UP, _BLOCK_DOWN}:
        if transfer is not None:
            if stamp_ns - transfer.stamp_ns < PATIENCE_NS // 20:
                yield OverlappingRequest(stamp_ns, node)
            else:
                yield UnansweredRequest(transfer.stamp_ns, node, transfer.address)
        fresh = _Transfer(stamp_ns, address, is_write=command in {_DOWN, _BLOCK_DOWN})
        fresh.is_block = command in {_BLOCK_UP, _BLOCK_DOWN}
        if command == _DOWN and data[0] & 2:
            fresh.data += data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)]
        fresh.is_segmented = command == _DOWN and not data[0] & 2
        transfers[node] = fresh
    elif transfer is not None and command == _SEGMENT_DOWN and transfer.is_write and len(transfer.data) < LONGEST:
        transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        transfer.is_last = bool(data[0] & 1)


def _answer(transfers: dict[int, _Transfer], stamp_ns: int, node: int, data: bytes) -> Iterator[Event]:
    command, address = data[0] >> 5, (int.from_bytes(data[1:3], "little"), data[3])
    transfer = transfers.get(node)
    if transfer is None:
        return
    if command == _ABORT and data[0] == 0x80:
        transfers.pop(node)
        yield AbortedTransfer(stamp_ns, node, address, int.from_bytes(data[4:], "little"), by_server=True)
    elif transfer.is_block:
        if data[0] == BLOCK_UPLOADED or data[0] & BLOCK_MASK == BLOCK_UPLOADING_ENDS:
            transfers.pop(node)
    elif transfer.is_write:
        is_whole = command == _DONE_DOWN and address == transfer.address and not transfer.is_segmented
        if is_whole or (command == _DONE_SEGMENT_DOWN and transfer.is_last):
            transfers.pop(node)
            yield OverheardValue(stamp_ns, node, transfer.address, bytes(transfer.data), is_write=True)
    elif command == _DONE_UP and address == transfer.address:
        if data[0] & 2:
            transfers.pop(node)
            yield OverheardValue(stamp_ns, node, address, data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)], is_write=False)
        else:
            transfer.is_segmented = True
    elif command == _DONE_SEGMENT_UP and transfer.is_segmented:
        if len(transfer.data) < LONGEST:
            transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        if data[0] & 1:
            transfers.pop(node)
            yield OverheardValue(stamp_ns, node, transfer.address, bytes(transfer.data), is_write=False)
