"""The EDS against the object dictionary of the device, entry by entry (CiA 306-1; CiA 301, 7.2.4.3.17 and 7.4)."""

import itertools

from drive_profiles.standard.cia301 import DataType, encode
from tests.conformance.device import default_bytes
from tests.conformance.sdo_client import (
    DEVICE_STATE,
    INVALID,
    LENGTH,
    NO_DATA,
    NO_OBJECT,
    NO_SUBINDEX,
    READ_ONLY,
    TOO_HIGH,
    TOO_LONG,
    TOO_LOW,
    TOO_SHORT,
    UNSUPPORTED,
    WRITE_ONLY,
    Abort,
)

HISTORY = 0x1003
COUNTS = {HISTORY, *range(0x1600, 0x1800), *range(0x1A00, 0x1C00)}
"""Objects whose sub-index 0 is not the highest sub-index but how many of them count."""
OF_ONE_DEVICE = {(0x1018, 4), (0x1020, 1), (0x1020, 2)}
"""What an EDS, being of a kind of device, cannot state."""
MANDATORY = ((0x1000, 0), (0x1001, 0), (0x1018, 0), (0x1018, 1))


def shown(index, subindex, what):
    return f"{index:04X}h:{subindex:02X}h {what}"


def places(device):
    return sorted(device.entries.items())


def test_the_mandatory_objects_are_there(device):
    assert [place for place in MANDATORY if not device.has(*place)] == []
    assert any(device.has(index) for index in (0x1017, 0x100C)), "error control: heartbeat or guarding (CiA 301, 7.2.8)"


def test_every_readable_entry_can_be_read_with_the_length_of_its_type(device):
    wrong = []
    for place, variable in places(device):
        if not variable.readable:
            continue
        data, size = device.sdo.upload(*place), device.size(*place)
        is_past = place[0] == HISTORY and place[1] > 0
        if isinstance(data, Abort):
            if not (is_past and data in {NO_DATA, NO_SUBINDEX}):
                wrong.append(shown(*place, data))
        elif size is not None and len(data) != size:
            wrong.append(shown(*place, f"has {len(data)} bytes, its type {size}"))
    assert wrong == []


def test_what_is_write_only_cannot_be_read(device):
    wrong = []
    for place, variable in places(device):
        if not variable.readable:
            answer = device.sdo.upload(*place)
            if not device.refused(answer, WRITE_ONLY, UNSUPPORTED):
                wrong.append(shown(*place, answer))
    assert wrong == []


def test_every_entry_that_keeps_its_value_holds_the_default_of_the_eds_after_a_reset(device, permit):
    permit("factory")
    device.reset()
    wrong = []
    for place, variable in places(device):
        if not variable.readable or place in OF_ONE_DEVICE or place[0] == HISTORY:
            continue
        lives = variable.access_type == "ro" and (variable.pdo_mappable or place[0] >= 0x2000)
        default = default_bytes(variable, device.node_id)
        if default is None or lives:
            continue
        data = device.sdo.upload(*place)
        if data != default:
            wrong.append(shown(*place, f"holds {data.hex(' ')}, the EDS says {default.hex(' ')}"))
    assert wrong == []


def test_sub_index_0_is_the_highest_sub_index(device):
    wrong = []
    highest = {index: max(sub for i, sub in device.entries if i == index) for index in device.indices}
    for index, last in highest.items():
        variable = device.entries.get((index, 0))
        if last > 0 and index not in COUNTS and variable is not None and variable.access_type in {"ro", "const"}:
            held = device.read(index, 0)
            if held != last:
                wrong.append(shown(index, 0, f"is {held}, the EDS lists up to {last:02X}h"))
    assert wrong == []


def test_what_is_read_only_cannot_be_written(device):
    wrong = []
    for place, variable in places(device):
        if not variable.writable:
            answer = device.sdo.download(*place, bytes(device.size(*place) or 1))
            if not device.refused(answer, READ_ONLY, UNSUPPORTED):
                wrong.append(shown(*place, answer))
    assert wrong == []


def test_a_value_of_the_wrong_length_is_refused(device):
    wrong = []
    device.is_touched = True
    for (index, subindex), variable in places(device):
        size = device.size(index, subindex)
        if not variable.writable or size is None or device.is_untouchable(index):
            continue
        answer = device.sdo.download(index, subindex, bytes(size + 1))
        if not device.refused(answer, TOO_LONG, LENGTH):
            wrong.append(shown(index, subindex, f"takes {size + 1} bytes: {answer}"))
        if size > 1:
            answer = device.sdo.download(index, subindex, bytes(size - 1))
            if not device.refused(answer, TOO_SHORT, LENGTH):
                wrong.append(shown(index, subindex, f"takes {size - 1} bytes: {answer}"))
    assert wrong == []


def test_a_value_beyond_a_limit_is_refused_and_changes_nothing(device):
    wrong, checked = [], 0
    device.is_touched = True
    for (index, subindex), variable in places(device):
        if not variable.writable or device.is_untouchable(index) or device.size(index, subindex) is None:
            continue
        kind = DataType(variable.data_type)
        for limit, step, exact in ((variable.max, 1, TOO_HIGH), (variable.min, -1, TOO_LOW)):
            if limit is None or kind.is_real or variable.relative:
                continue
            try:
                beyond = encode(kind, int(limit) + step)
            except ValueError:
                continue  # the type ends there
            before = device.sdo.upload(index, subindex) if variable.readable else None
            answer = device.sdo.download(index, subindex, beyond)
            checked += 1
            if not device.refused(answer, exact, INVALID, DEVICE_STATE, UNSUPPORTED):
                wrong.append(shown(index, subindex, f"takes {int(limit) + step}: {answer}"))
            if before is not None and device.sdo.upload(index, subindex) != before:
                device.sdo.download(index, subindex, before)
                wrong.append(shown(index, subindex, f"has changed with the refused {int(limit) + step}"))
    assert wrong == []
    assert checked or not device.is_emulated


def test_the_neighbours_of_every_object_are_not_there(device):
    wrong = []
    for index in sorted(device.indices):
        subs = [sub for i, sub in device.entries if i == index]
        near = [(index, max(subs) + 1, NO_SUBINDEX)]
        near += [(i, 0, NO_OBJECT) for i in (index - 1, index + 1) if i not in device.indices and i <= 0xFFFF]
        for i, sub, code in near:
            for verb, answer in (("read", device.sdo.upload(i, sub)), ("written", device.sdo.download(i, sub, b"\0"))):
                # of a sub-index of a plain variable the standard leaves open which of the two is said
                if not device.refused(answer, code, *({NO_OBJECT, NO_SUBINDEX} - {code} if sub else ())):
                    wrong.append(shown(i, sub, f"{verb}: {answer}"))
    assert wrong == []


def test_what_the_eds_does_not_list_is_not_there(device):
    ranges = itertools.chain(range(0x1000, 0x2000), range(0x2000, 0x3000, 16), range(0x6000, 0x6800), (0x9FFF, 0xFFFF))
    wrong = []
    for index in ranges:
        if index not in device.indices:
            answer = device.sdo.upload(index)
            if not device.refused(answer, NO_OBJECT):
                wrong.append(shown(index, 0, answer))
    assert wrong == []


def test_the_identity_is_that_of_the_device_info(device):
    stated = {sub: device.device_info.get(key) for sub, key in ((1, "vendornumber"), (2, "productnumber"), (3, "revisionnumber"))}
    for sub, text in stated.items():
        if text and device.has(0x1018, sub):
            assert device.read(0x1018, sub) == int(text, 0), f"1018h:{sub:02X}h"


def test_the_device_info_counts_the_pdos(device):
    for key, first in (("nrofrxpdo", 0x1400), ("nroftxpdo", 0x1800)):
        count = sum(first <= index < first + 0x200 for index in device.indices)
        assert int(device.device_info[key], 0) == count, key


def test_pdo_mapping_is_claimed_of_entries_that_can_be_mapped_only(device):
    wrong = [place for place, v in places(device) if v.pdo_mappable and device.size(*place) is None]
    assert wrong == []
