"""The concise DCF, which holds the bytes of many objects.

A master holds one for each node in 1F22h.

Source: CiA 302-3, 1F22h.
"""

from __future__ import annotations

import struct
from collections.abc import Collection

from drive_profiles.errors import RefusedError
from drive_profiles.parameter_set.parameters import Write
from drive_profiles.parameter_set.steps import pdo_of, steps, support
from drive_profiles.standard.object_address import ObjectAddress


def to_concise(writes: Collection[Write]) -> bytes:
    """Write a concise DCF, the value of 1F22h.

    It holds a count, then index, sub-index, length and bytes of each object (CiA 302-3, 1F22h).

    It is sent entry by entry, so PDOs whose COB-ID is in the set are made invalid first and valid last.
    """
    goal = {write.address: write.data for write in writes}
    # as if the device held something else everywhere, and every PDO were valid
    held = {address: data + b"\0" for address, data in goal.items()}
    held |= {address: b"\1" for address in goal if address[1] == 0 and pdo_of(address) is not None}
    held |= {
        address: data[:3] + bytes((data[3] & 0x7F,)) for address, data in goal.items() if _is_cob_id(address) and len(data) == 4
    }
    whole = {address for address in goal if support([address]) <= set(goal)}
    order = steps({address: goal[address] for address in goal if address in whole}, held)
    order += [(address, data) for address, data in goal.items() if address not in whole]
    entries = [struct.pack("<HBI", *address, len(data)) + data for address, data in order]
    return struct.pack("<I", len(entries)) + b"".join(entries)


def from_concise(data: bytes) -> dict[ObjectAddress, bytes]:
    """Read a concise DCF into the bytes of each object.

    If it writes an object several times, the last bytes count.

    Raises:
        RefusedError: The data are too short, or go on after the end.
    """
    if len(data) < 4:
        raise RefusedError(f"a concise DCF begins with a count of 4 bytes, but the file has only {len(data)} bytes")
    count, position = struct.unpack_from("<I", data)[0], 4
    contents: dict[ObjectAddress, bytes] = {}
    for number in range(1, count + 1):
        if position + 7 > len(data):
            raise RefusedError(f"entry {number} of {count} of the concise DCF is cut off at byte {len(data)}")
        index, subindex, length = struct.unpack_from("<HBI", data, position)
        position += 7
        if position + length > len(data):
            raise RefusedError(
                f"entry {number}, {index:04X}:{subindex:X}, states {length} bytes, but only {len(data) - position} are left"
            )
        contents[index, subindex] = data[position : position + length]
        position += length
    if position != len(data):
        raise RefusedError(f"{len(data) - position} bytes follow the last of {count} entries of the concise DCF; expected none")
    return contents


def _is_cob_id(address: ObjectAddress) -> bool:
    return address[1] == 1 and pdo_of(address) == address[0]
