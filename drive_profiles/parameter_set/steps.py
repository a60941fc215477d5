"""The order in which objects are written."""

from collections.abc import Iterable, Mapping

from drive_profiles.standard.cia301 import CobIdBit
from drive_profiles.standard.object_address import ObjectAddress

Step = tuple[ObjectAddress, bytes]
"""An object, and the bytes to write to it."""

_COMMUNICATION = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_MAPPING_OFFSET = 0x200
_NONE = b"\0"


def pdo_of(address: ObjectAddress) -> int | None:
    """Return the index of an object's PDO communication record, or None."""
    index = address[0]
    for records in _COMMUNICATION:
        if index in records:
            return index
        if index - _MAPPING_OFFSET in records:
            return index - _MAPPING_OFFSET
    return None


def support(addresses: Iterable[ObjectAddress]) -> set[ObjectAddress]:
    """Return further objects to read before these can be written."""
    records = {record for address in addresses if (record := pdo_of(address)) is not None}
    return {needed for record in records for needed in ((record, 1), (record + _MAPPING_OFFSET, 0))}


def mapped(goal: Mapping[ObjectAddress, bytes], held: Mapping[ObjectAddress, bytes]) -> list[ObjectAddress]:
    """Return the mapped objects that the goal lacks, which devices may forget."""
    numbers = {address for address in {**goal, **held} if address[1] == 0 and pdo_of(address) not in {None, address[0]}}
    counts = {address: max([0, *goal.get(address, b""), *held.get(address, b"")]) for address in numbers}
    return [
        (index, k) for (index, _), count in sorted(counts.items()) for k in range(1, min(count, 64) + 1) if (index, k) not in goal
    ]


def steps(goal: Mapping[ObjectAddress, bytes], held: Mapping[ObjectAddress, bytes]) -> list[Step]:
    """Plan the writes that bring a device's values to the goal.

    A PDO is changed as CiA 301, 7.5.2.36 and .38, demands: it is made invalid (bit 31 of its COB-ID), the number of mapped
    objects is set to 0, the objects are mapped, the number is set, and the COB-ID comes last.

    Args:
        goal: Bytes wanted by address, in the order in which the objects are best written.
        held: Bytes that the device holds, by address, for all objects of the goal and of its `support`.
    """
    result = [(address, data) for address, data in goal.items() if pdo_of(address) is None and held[address] != data]
    records = dict.fromkeys(record for address in goal if (record := pdo_of(address)) is not None)
    for record in records:
        result += _pdo_steps(record, {address: data for address, data in goal.items() if pdo_of(address) == record}, held)
    return result


def _pdo_steps(record: int, goal: Mapping[ObjectAddress, bytes], held: Mapping[ObjectAddress, bytes]) -> list[Step]:
    if all(held[address] == data for address, data in goal.items()):
        return []
    cob_id, number = (record, 1), (record + _MAPPING_OFFSET, 0)
    result: list[Step] = []
    valid = int.from_bytes(held[cob_id], "little")
    if not valid & CobIdBit.INVALID:
        result.append((cob_id, (valid | CobIdBit.INVALID).to_bytes(max(4, len(held[cob_id])), "little")))
    mapped = {address: data for address, data in goal.items() if address[0] == number[0]}
    if any(held[address] != data for address, data in mapped.items()):
        count = goal.get(number, held[number])
        if held[number] != _NONE:
            result.append((number, _NONE))
        # all that count are written once more, since a device may forget them with the number; of the others those that differ
        wanted = [address for address in sorted(mapped) if address[1]]
        result += [
            (address, mapped[address])
            for address in wanted
            if address[1] <= int.from_bytes(count, "little") or held[address] != mapped[address]
        ]
        if count != _NONE:
            result.append((number, count))
    result += [
        (address, data) for address, data in goal.items() if address[0] == record and address != cob_id and held[address] != data
    ]
    last = goal.get(cob_id, held[cob_id])
    if (result[-1:] and result[0][0] == cob_id) or last != held[cob_id]:
        result.append((cob_id, last))
    return result
