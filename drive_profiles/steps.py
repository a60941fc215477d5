"""In which order objects are written: PDOs by the standard's procedure, everything else as the set has it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from drive_profiles.cia301 import CobIdBit
from drive_profiles.parameter import Place

Step = tuple[Place, bytes]
"""An object, and the bytes to write to it."""

_COMMUNICATION = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_MAPPING_OFFSET = 0x200
_NONE = b"\0"


def pdo_of(place: Place) -> int | None:
    """Index of the communication record of the PDO that an object belongs to; None where it belongs to none."""
    index = place[0]
    for records in _COMMUNICATION:
        if index in records:
            return index
        if index - _MAPPING_OFFSET in records:
            return index - _MAPPING_OFFSET
    return None


def support(places: Iterable[Place]) -> set[Place]:
    """What must be known beside these objects in order to write them: COB-ID and number of mapped objects of their PDOs."""
    records = {record for place in places if (record := pdo_of(place)) is not None}
    return {needed for record in records for needed in ((record, 1), (record + _MAPPING_OFFSET, 0))}


def mapped(goal: Mapping[Place, bytes], held: Mapping[Place, bytes]) -> list[Place]:
    """Mapped objects that count before or after, but are not in the goal: a device may forget them with their number."""
    numbers = {place for place in {**goal, **held} if place[1] == 0 and pdo_of(place) not in {None, place[0]}}
    counts = {place: max([0, *goal.get(place, b""), *held.get(place, b"")]) for place in numbers}
    return [
        (index, k) for (index, _), count in sorted(counts.items()) for k in range(1, min(count, 64) + 1) if (index, k) not in goal
    ]


def steps(goal: Mapping[Place, bytes], held: Mapping[Place, bytes]) -> list[Step]:
    """The writes that turn what a device holds into the goal; none where it is there already.

    A PDO is changed as CiA 301, 7.5.2.36 and .38, demands: it is made invalid (bit 31 of its COB-ID), the number of mapped
    objects is set to 0, the objects are mapped, the number is set, and the COB-ID comes last.

    Args:
        goal: In the order in which the objects are best written.
        held: What the device holds; of everything in the goal, and of the `support` of it.
    """
    result = [(place, data) for place, data in goal.items() if pdo_of(place) is None and held[place] != data]
    records = dict.fromkeys(record for place in goal if (record := pdo_of(place)) is not None)
    for record in records:
        result += _pdo_steps(record, {place: data for place, data in goal.items() if pdo_of(place) == record}, held)
    return result


def _pdo_steps(record: int, goal: Mapping[Place, bytes], held: Mapping[Place, bytes]) -> list[Step]:
    if all(held[place] == data for place, data in goal.items()):
        return []
    cob_id, number = (record, 1), (record + _MAPPING_OFFSET, 0)
    result: list[Step] = []
    valid = int.from_bytes(held[cob_id], "little")
    if not valid & CobIdBit.INVALID:
        result.append((cob_id, (valid | CobIdBit.INVALID).to_bytes(max(4, len(held[cob_id])), "little")))
    mapped = {place: data for place, data in goal.items() if place[0] == number[0]}
    if any(held[place] != data for place, data in mapped.items()):
        count = goal.get(number, held[number])
        if held[number] != _NONE:
            result.append((number, _NONE))
        # all that count are written once more, since a device may forget them with the number; of the others those that differ
        wanted = [place for place in sorted(mapped) if place[1]]
        result += [
            (place, mapped[place])
            for place in wanted
            if place[1] <= int.from_bytes(count, "little") or held[place] != mapped[place]
        ]
        if count != _NONE:
            result.append((number, count))
    result += [(place, data) for place, data in goal.items() if place[0] == record and place != cob_id and held[place] != data]
    last = goal.get(cob_id, held[cob_id])
    if (result[-1:] and result[0][0] == cob_id) or last != held[cob_id]:
        result.append((cob_id, last))
    return result
