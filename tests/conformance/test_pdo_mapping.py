"""How a PDO may be changed, and what refuses it (CiA 301, 7.5.2.35 to 7.5.2.38)."""

import pytest

from tests.conformance.sdo_client import (
    DEVICE_STATE,
    GENERAL,
    INCOMPATIBLE,
    INTERNAL,
    INVALID,
    LENGTH,
    LOCAL_CONTROL,
    NO_OBJECT,
    NO_SUBINDEX,
    NOT_MAPPABLE,
    PDO_LENGTH,
    TOO_HIGH,
    TOO_LOW,
    UNSUPPORTED,
)

RPDO, TPDO = 0x1400, 0x1800
INVALID_BIT, NO_RTR, EXTENDED = 1 << 31, 1 << 30, 1 << 29
RESTRICTED = (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x7FF)
LOCKED = (UNSUPPORTED, DEVICE_STATE, INVALID, INCOMPATIBLE, INTERNAL, GENERAL, LOCAL_CONTROL)
"""What a device may say of a mapping that must not change now: the standard gives no code. First what most stacks say."""
REFUSED = (INVALID, TOO_HIGH, TOO_LOW, INCOMPATIBLE, DEVICE_STATE, UNSUPPORTED)
TOO_MANY = (PDO_LENGTH, INCOMPATIBLE, INVALID, TOO_HIGH)
ABSENT = (NO_OBJECT, NOT_MAPPABLE, NO_SUBINDEX)
ABSENT_SUB = (NO_OBJECT, NO_SUBINDEX, NOT_MAPPABLE)
WRONG_SIZE = (LENGTH, NOT_MAPPABLE, PDO_LENGTH, INCOMPATIBLE, NO_OBJECT)


@pytest.fixture(params=["RPDO", "TPDO"])
def pdo(request, device, needs):
    """A PDO that is off, with an empty mapping."""
    record = RPDO if request.param == "RPDO" else TPDO
    needs((record, 1), (record, 2), (record + 0x200, 0), (record + 0x200, 1))
    if device.entries[record + 0x200, 0].access_type in {"ro", "const"}:
        pytest.skip("the mapping is fixed")
    return Pdo(device, record)


class Pdo:
    """One PDO and what may be mapped into it."""

    def __init__(self, device, record):
        self.device, self.record, self.mapping = device, record, record + 0x200
        self.is_transmit = record == TPDO
        self.cob_id = device.read(record, 1) & ~INVALID_BIT
        self.cob_id |= 0 if self.cob_id & 0x7FF else (0x180 if self.is_transmit else 0x200) + device.node_id
        device.set(record, 1, self.cob_id | INVALID_BIT)
        device.set(self.mapping, 0, 0)

    def mappable(self, bits=None):
        """Mapping parameters of what the EDS says can be mapped."""
        words = {"ro", "const", "rw", "rwr"} if self.is_transmit else {"wo", "rw", "rww"}
        found = []
        for (index, sub), variable in sorted(self.device.entries.items()):
            size = self.device.size(index, sub)
            wanted = bits is None or (size is not None and size * 8 == bits)
            if variable.pdo_mappable and variable.access_type in words and size is not None and wanted:
                length = 1 if variable.data_type == 1 else 8 * size
                found.append(index << 16 | sub << 8 | length)
        return found

    def one(self):
        """Something that can be mapped, at least a place holder."""
        found = self.mappable()
        if found:
            return found[0]
        if self.is_transmit or self.device.device_info.get("dummy0006") != "1":
            pytest.skip("the EDS has nothing that this PDO could carry")
        return 0x0006_0010

    def map(self, *parameters):
        """Map these, without making the PDO valid; the first abort, or None."""
        for number, parameter in enumerate(parameters, 1):
            answer = self.device.write(self.mapping, number, parameter)
            if answer is not None:
                return answer
        return self.device.write(self.mapping, 0, len(parameters))


def test_the_standards_procedure_changes_a_mapping(device, pdo):
    one = pdo.one()
    assert pdo.map(one) is None
    device.set(pdo.record, 1, pdo.cob_id)
    assert device.read(pdo.mapping, 0) == 1
    assert device.read(pdo.mapping, 1) == one
    assert device.read(pdo.record, 1) & 0x7FF == pdo.cob_id & 0x7FF
    assert not device.read(pdo.record, 1) & INVALID_BIT


def test_everything_that_the_eds_calls_mappable_can_be_mapped(device, pdo):
    wrong = []
    for parameter in pdo.mappable():
        device.set(pdo.mapping, 0, 0)
        answer = pdo.map(parameter)
        if answer is not None:
            wrong.append(f"{parameter:08X}h: {answer!r}")
    assert wrong == []


def test_nothing_else_can_be_mapped(device, pdo):
    wrong, can = [], {parameter >> 8 for parameter in pdo.mappable()}
    for index, sub in sorted(device.entries):
        size = device.size(index, sub)
        if size is not None and size <= 8 and index << 8 | sub not in can:
            device.set(pdo.mapping, 0, 0)
            answer = pdo.map(index << 16 | sub << 8 | 8 * size)
            if not device.refused(answer, NOT_MAPPABLE, NO_OBJECT, UNSUPPORTED):
                wrong.append(f"{index:04X}h:{sub:02X}h: {answer!r}")
    assert wrong == []


def test_a_valid_pdo_keeps_its_mapping(device, pdo):
    one = pdo.one()
    assert pdo.map(one) is None
    device.set(pdo.record, 1, pdo.cob_id)
    assert device.refused(device.write(pdo.mapping, 0, 0), *LOCKED)
    assert device.refused(device.write(pdo.mapping, 1, one), *LOCKED)
    assert (device.read(pdo.mapping, 0), device.read(pdo.mapping, 1)) == (1, one)


def test_an_entry_is_not_changed_while_the_mapping_counts(device, pdo):
    one = pdo.one()
    assert pdo.map(one) is None
    assert device.refused(device.write(pdo.mapping, 1, one), *LOCKED)


def test_more_than_64_bits_are_refused(device, pdo):
    wide = pdo.mappable(32) or pdo.mappable(64)
    if not wide:
        wide = [] if pdo.is_transmit else [0x0007_0020]
    if not wide or not device.has(pdo.mapping, 3):
        pytest.skip("the EDS has nothing wide enough")
    assert device.refused(pdo.map(*wide[:1] * 3), *TOO_MANY)
    assert device.read(pdo.mapping, 0) == 0


def test_more_objects_than_there_are_entries_are_refused(device, pdo):
    highest = max(sub for index, sub in device.entries if index == pdo.mapping)
    assert device.refused(device.write(pdo.mapping, 0, highest + 1), *TOO_MANY)
    assert device.refused(device.write(pdo.mapping, highest + 1, 0), NO_SUBINDEX)


def test_an_object_that_is_not_there_is_refused(device, pdo):
    absent = next(index for index in range(0x5FFF, 0x2000, -1) if index not in device.indices)
    assert device.refused(pdo.map(absent << 16 | 8), *ABSENT)
    one = pdo.one()
    if one >> 16 >= 0x1000:
        sub = 1 + max(sub for index, sub in device.entries if index == one >> 16)
        assert device.refused(pdo.map(one & 0xFFFF_00FF | sub << 8), *ABSENT_SUB)


@pytest.mark.parametrize("change", [-8, 8])
def test_a_length_that_is_not_the_objects_is_refused(device, pdo, change):
    one = next((parameter for parameter in pdo.mappable() if 8 < parameter & 0xFF < 64), None)
    if one is None:
        pytest.skip("the EDS has nothing of 16 or 32 bits that this PDO could carry")
    assert device.tolerated(pdo.map(one + change), WRONG_SIZE)


def test_an_empty_entry_does_not_count(device, pdo):
    assert device.write(pdo.mapping, 1, 0) is None
    answer = device.write(pdo.mapping, 0, 1)
    assert device.refused(answer, *ABSENT, PDO_LENGTH, INCOMPATIBLE, INVALID, UNSUPPORTED)


def test_place_holders_are_for_rpdos(device, pdo):
    for index in range(1, 8):
        stated = device.device_info.get(f"dummy{index:04x}") == "1"
        length = {1: 1, 2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}[index]
        device.set(pdo.mapping, 0, 0)
        answer = pdo.map(index << 16 | length)
        if stated and not pdo.is_transmit:
            assert answer is None, f"[DummyUsage] has {index:04X}h: {answer!r}"
        elif answer is None:
            assert not device.is_emulated, f"{index:04X}h is mapped, which [DummyUsage] does not say or a TPDO does not have"


# -- COB-ID ------------------------------------------------------------------------------------------------------------


def test_the_identifier_of_a_valid_pdo_does_not_change(device, pdo):
    assert pdo.map(pdo.one()) is None
    device.set(pdo.record, 1, pdo.cob_id)
    other = pdo.cob_id & ~0x7FF | 0x6A0 + (device.node_id & 0x0F)
    assert device.refused(device.write(pdo.record, 1, other), *REFUSED)
    device.set(pdo.record, 1, pdo.cob_id | INVALID_BIT)
    device.set(pdo.record, 1, other)
    assert device.read(pdo.record, 1) & 0x7FF == other & 0x7FF


@pytest.mark.parametrize("can_id", RESTRICTED)
def test_a_restricted_identifier_is_refused(device, pdo, can_id):
    answer = device.write(pdo.record, 1, pdo.cob_id & ~0x7FF | can_id)
    assert device.refused(answer, *REFUSED), f"{can_id:03X}h: {answer!r}"


@pytest.mark.parametrize("bit", range(11, 29))
def test_bits_beyond_an_11_bit_identifier_are_refused(device, pdo, bit):
    answer = device.write(pdo.record, 1, pdo.cob_id | 1 << bit)
    assert device.refused(answer, *REFUSED)


def test_a_29_bit_identifier_is_taken_or_refused_but_not_cut(device, pdo):
    answer = device.write(pdo.record, 1, pdo.cob_id | EXTENDED | 1 << 20 | INVALID_BIT)
    if answer is None:
        assert device.read(pdo.record, 1) & 0x1FFF_FFFF == pdo.cob_id & 0x7FF | 1 << 20
    else:
        assert device.refused(answer, *REFUSED)


@pytest.mark.parametrize("kind", [*range(241, 252)])
def test_a_reserved_transmission_type_is_refused(device, pdo, kind):
    assert device.refused(device.write(pdo.record, 2, kind), *REFUSED)


@pytest.mark.parametrize("kind", [252, 253])
def test_an_rpdo_is_not_asked_for(device, pdo, kind):
    answer = device.write(pdo.record, 2, kind)
    if pdo.is_transmit:
        assert answer is None or device.refused(answer, *REFUSED)
    else:
        assert device.refused(answer, *REFUSED)


def test_the_inhibit_time_does_not_change_while_the_pdo_is_valid(device, pdo, needs):
    needs((TPDO, 3))
    if not pdo.is_transmit:
        pytest.skip("of TPDOs")
    device.set(TPDO, 3, 100)
    assert pdo.map(pdo.one()) is None
    device.set(TPDO, 1, pdo.cob_id)
    assert device.refused(device.write(TPDO, 3, 200), *REFUSED)
    assert device.read(TPDO, 3) == 100
