"""The procedure that changes a PDO, step by step and with each step's refusal."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.cia301 import SdoAbortCode
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import PdoDefault
from plant_emulator.slave.pdo_setup import Mapped

RPDO, RMAP, TPDO, TMAP = 0x1400, 0x1600, 0x1800, 0x1A00
INVALID = 0x80000000
CONTROL, TARGET, STATUS, POSITION, TORQUE = 0x60400010, 0x607A0020, 0x60410010, 0x60640020, 0x60770010


def disable(bench, communication=TPDO, can_id=0x185):
    assert bench.write_value(communication, 1, can_id | INVALID) is None


def open_mapping(bench, communication=TPDO, mapping=TMAP, can_id=0x185):
    disable(bench, communication, can_id)
    assert bench.write_value(mapping, 0, 0) is None


def configure(bench, entries, communication=TPDO, mapping=TMAP, can_id=0x185):
    """Run the whole procedure (CiA 301, 7.5.2.36); give the first abort code, or None."""
    open_mapping(bench, communication, mapping, can_id)
    for position, entry in enumerate(entries, 1):
        code = bench.write_value(mapping, position, entry)
        if code is not None:
            return code
    return bench.write_value(mapping, 0, len(entries)) or bench.write_value(communication, 1, can_id)


def test_a_mapping_parameter_is_packed_as_the_standard_says():
    assert Mapped(0x6040, 0, 16).value == CONTROL
    assert Mapped.from_value(TARGET) == Mapped(0x607A, 0, 32)


def test_the_whole_procedure_changes_what_is_sent(running):
    running.dictionary.set(0x6064, 0, -2)
    running.dictionary.set(0x6077, 0, 3)
    assert configure(running, [TORQUE, POSITION]) is None
    assert running.sync() == [(0x185, struct.pack("<hi", 3, -2))]


def test_the_mapping_of_a_valid_pdo_cannot_be_changed(bench):
    for subindex, value in ((0, 0), (0, 3), (1, STATUS)):
        assert bench.write_value(TMAP, subindex, value) is SdoAbortCode.UNSUPPORTED_ACCESS


def test_an_entry_cannot_be_changed_while_the_count_is_not_0(bench):
    disable(bench)
    assert bench.write_value(TMAP, 1, POSITION) is SdoAbortCode.UNSUPPORTED_ACCESS
    assert bench.write_value(TMAP, 0, 0) is None
    assert bench.write_value(TMAP, 1, POSITION) is None


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        (0x5FFF0010, SdoAbortCode.NO_OBJECT),
        (0x60410110, SdoAbortCode.NO_OBJECT),
        (0x5FFF0001, SdoAbortCode.NO_OBJECT),
        (0x60600008, SdoAbortCode.NOT_MAPPABLE),  # not mappable at all
        (CONTROL, SdoAbortCode.NOT_MAPPABLE),  # rww: in an RPDO only
        (0x20020010, SdoAbortCode.NOT_MAPPABLE),  # wo
        (0x2001001F, SdoAbortCode.NOT_MAPPABLE),  # a string, and no whole bytes
        (0x6041000F, SdoAbortCode.NOT_MAPPABLE),
        (0x60410000, SdoAbortCode.NOT_MAPPABLE),
        (0x60410008, SdoAbortCode.LENGTH_MISMATCH),
        (0x60410020, SdoAbortCode.LENGTH_MISMATCH),
        (0x00050008, SdoAbortCode.NOT_MAPPABLE),  # a dummy, in a TPDO
    ],
)
def test_what_a_tpdo_cannot_carry_is_refused_and_the_entry_kept(bench, entry, code):
    open_mapping(bench)
    assert bench.write_value(TMAP, 1, entry) is code
    assert bench.read(TMAP, 1) == struct.pack("<I", STATUS)
    assert bench.write_value(TMAP, 0, 3) is None
    assert bench.write_value(TPDO, 1, 0x185) is None


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        (STATUS, SdoAbortCode.NOT_MAPPABLE),  # ro
        (0x20020010, None),  # wo
        (0x20000010, None),  # rw
        (0x00020008, None), (0x00030010, None), (0x00040020, None),
        (0x00050008, None), (0x00060010, None), (0x00070020, None),
        (0x00010001, SdoAbortCode.NO_OBJECT),  # BOOLEAN is no whole byte
        (0x00080020, SdoAbortCode.NO_OBJECT),
        (0x00060001, SdoAbortCode.NOT_MAPPABLE),
        (0x00060008, SdoAbortCode.LENGTH_MISMATCH),
        (0x00060110, SdoAbortCode.NO_OBJECT),
    ],
)  # fmt: skip
def test_what_an_rpdo_can_carry(bench, entry, code):
    open_mapping(bench, RPDO, RMAP, 0x205)
    assert bench.write_value(RMAP, 1, entry) is code


def test_place_holders_take_their_bytes_and_write_nothing(running):
    assert configure(running, [0x00060010, CONTROL, 0x00050008], RPDO, RMAP, 0x205) is None
    running.send(0x205, bytes.fromhex("ffff 3412 ff"))
    running.sync()
    assert running.dictionary.get(0x6040) == 0x1234


def test_more_than_64_bits_are_refused_at_the_count(bench):
    open_mapping(bench)
    for position, entry in enumerate((POSITION, POSITION, 0x10010008), 1):
        assert bench.write_value(TMAP, position, entry) is None
    assert bench.write_value(TMAP, 0, 3) is SdoAbortCode.PDO_LENGTH
    assert bench.read(TMAP, 0) == b"\x00"
    assert bench.write_value(TMAP, 0, 2) is None


@pytest.mark.parametrize("count", [9, 64, 254, 255])
def test_more_than_8_objects_are_refused(bench, count):
    open_mapping(bench)
    assert bench.write_value(TMAP, 0, count) is SdoAbortCode.PDO_LENGTH


def test_a_free_position_cannot_be_counted(bench):
    open_mapping(bench)
    assert bench.write_value(TMAP, 2, 0) is None
    assert bench.write_value(TMAP, 0, 2) is SdoAbortCode.NO_OBJECT
    assert bench.write_value(TMAP, 0, 1) is None


@pytest.mark.parametrize("communication", [RPDO, TPDO])
@pytest.mark.parametrize(
    "cob_id",
    [0x20000185, 0x00000800, 0x10000185, 0x00000000, 0x0000007F, 0x00000101, 0x00000585, 0x00000605, 0x00000705],
)
def test_reserved_bits_and_restricted_identifiers_are_refused(bench, communication, cob_id):
    disable(bench, communication)
    assert bench.write_value(communication, 1, cob_id) is SdoAbortCode.INVALID_VALUE
    assert int.from_bytes(bench.read(communication, 1), "little") & INVALID


@pytest.mark.parametrize("communication", [RPDO, TPDO])
def test_the_identifier_changes_only_while_the_pdo_does_not_exist(bench, communication):
    base = 0x205 if communication == RPDO else 0x185
    assert bench.write_value(communication, 1, 0x190) is SdoAbortCode.INVALID_VALUE
    assert bench.write_value(communication, 1, base) is None
    assert bench.write_value(communication, 1, base | 0x40000000) is None
    assert bench.write_value(communication, 1, 0x190 | INVALID) is None
    assert bench.write_value(communication, 1, 0x190) is None


@pytest.mark.parametrize("communication", [RPDO, TPDO])
@pytest.mark.parametrize("transmission_type", [0, 1, 240, 241, 251, 252, 253, 254, 255])
def test_reserved_and_remote_transmission_types_are_refused(bench, communication, transmission_type):
    code = SdoAbortCode.INVALID_VALUE if 241 <= transmission_type <= 253 else None
    assert bench.write_value(communication, 2, transmission_type) is code


def test_the_inhibit_time_changes_only_while_the_pdo_does_not_exist(bench):
    assert bench.write_value(TPDO, 3, 10) is SdoAbortCode.INVALID_VALUE
    assert bench.write_value(TPDO, 3, 0) is None
    disable(bench)
    assert bench.write_value(TPDO, 3, 10) is None


def test_pdo_3_and_4_do_not_exist_by_default_but_have_their_identifiers(bench):
    for number, cob_id in enumerate((0x185, 0x285, 0x385 | INVALID, 0x485 | INVALID)):
        assert int.from_bytes(bench.read(TPDO + number, 1), "little") == cob_id
        assert int.from_bytes(bench.read(RPDO + number, 1), "little") == cob_id + 0x80


def test_defaults_that_make_no_pdo_are_the_owners_mistake(make_entries):
    for mapped in (((0x6040, 0, 16),), ((0x6041, 0, 8),), ((0x6064, 0, 32),) * 3):
        with pytest.raises(ValueError, match="PDO parameter 1A00h"):
            Slave(5, Dictionary(make_entries(tpdos=[PdoDefault(mapped)])))


@given(st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([STATUS, POSITION, TORQUE, 0x20050040]), max_size=8))
def test_any_mapping_is_refused_or_fits_a_frame(make_bench, entries):
    bench = make_bench(tpdos=[PdoDefault(transmission_type=1)])
    bench.start()
    code = configure(bench, entries)
    frames = bench.sync()
    if code is not None or not entries:
        assert frames == []
    else:
        assert [frame.can_id for frame in frames] == [0x185]
        assert len(frames[0].data) == sum(entry & 0xFF for entry in entries) // 8 <= 8
