"""The procedure that changes a PDO, step by step and with each step's refusal."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import DataType, SdoAbortCode
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import PdoDefault
from plant_emulator.slave.pdo.setup import PdoObject

RPDO, RMAP, TPDO, TMAP = 0x1400, 0x1600, 0x1800, 0x1A00
INVALID = 0x80000000
CONTROL, TARGET, STATUS, POSITION, TORQUE = 0x60400010, 0x607A0020, 0x60410010, 0x60640020, 0x60770010
FLAG = 0x20060001


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
    assert PdoObject(0x6040, 0, 16).value == CONTROL
    assert PdoObject.from_value(TARGET) == PdoObject(0x607A, 0, 32)


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
        (0x60410008, SdoAbortCode.NOT_MAPPABLE),
        (0x60410020, SdoAbortCode.NOT_MAPPABLE),
        (0x20060008, SdoAbortCode.NOT_MAPPABLE),  # a BOOLEAN takes one bit
        (0x20060001, None),
        (0x00050008, SdoAbortCode.NOT_MAPPABLE),  # a dummy, in a TPDO
    ],
)
def test_what_a_tpdo_cannot_carry_is_refused_and_the_entry_kept(bench, entry, code):
    open_mapping(bench)
    assert bench.write_value(TMAP, 1, entry) is code
    assert bench.read(TMAP, 1) == struct.pack("<I", STATUS if code else entry)
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
        (0x00010001, None),
        (0x00010008, SdoAbortCode.NOT_MAPPABLE),  # a BOOLEAN takes one bit
        (0x20060001, None),
        (0x00080020, SdoAbortCode.NO_OBJECT),
        (0x00060001, SdoAbortCode.NOT_MAPPABLE),
        (0x00060008, SdoAbortCode.NOT_MAPPABLE),
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


@pytest.mark.parametrize(("communication", "last_reserved"), [(RPDO, 253), (TPDO, 251)])
def test_reserved_transmission_types_are_refused_and_those_of_remote_requests_in_an_rpdo(bench, communication, last_reserved):
    for transmission_type in range(256):
        code = SdoAbortCode.INVALID_VALUE if 241 <= transmission_type <= last_reserved else None
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


@given(st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([STATUS, POSITION, TORQUE, 0x20050040, FLAG]), max_size=8))
def test_any_mapping_is_refused_or_fits_a_frame(make_bench, entries):
    bench = make_bench(tpdos=[PdoDefault(transmission_type=1)])
    bench.start()
    code = configure(bench, entries)
    frames = bench.sync()
    if code is not None or not entries:
        assert frames == []
    else:
        assert [frame.can_id for frame in frames] == [0x185]
        assert len(frames[0].data) == -(-sum(entry & 0xFF for entry in entries) // 8) <= 8


# Bits


def flags(count):
    """So many BOOLEANs."""
    return [Entry(0x2010, sub, f"Flag {sub}", DataType.BOOLEAN, Access.RW, False, mappable=True) for sub in range(1, count + 1)]


def test_booleans_take_one_bit_each_and_the_first_lies_lowest(make_bench, make_entries):
    mapped = tuple((0x2010, sub, 1) for sub in range(1, 6))
    bench = make_bench(entries=[*make_entries(tpdos=[PdoDefault(mapped, 1)], rpdos=[PdoDefault(mapped)]), *flags(5)])
    bench.start()
    bench.send(0x205, b"\xf2")
    assert [bench.dictionary.get(0x2010, sub) for sub in range(1, 6)] == [False, True, False, False, True]
    assert bench.sync() == [(0x185, b"\x12")]
    assert [frame.data[:2] for frame in bench.send(0x205, b"")] == [b"\x10\x82"]  # five bits take a byte


def test_what_follows_a_bit_needs_not_begin_with_a_byte(running):
    running.dictionary.set(0x6041, 0, 0x8001)
    running.dictionary.set(0x2006, 0, True)
    running.dictionary.set(0x6077, 0, -1)
    assert configure(running, [STATUS, FLAG, TORQUE]) is None
    assert running.sync() == [(0x185, bytes.fromhex("0180 ffff 01"))]


def test_place_holders_may_be_bits(running):
    assert configure(running, [0x00010001, CONTROL, 0x00010001, FLAG], RPDO, RMAP, 0x205) is None
    running.send(0x205, (1 << 18 | 1 << 17 | 0x1234 << 1 | 1).to_bytes(3, "little"))
    running.sync()
    assert running.dictionary.get(0x6040) == 0x1234
    assert running.dictionary.get(0x2006) is True


def test_a_bit_more_than_64_is_refused(bench):
    open_mapping(bench)
    for position, entry in enumerate((POSITION, POSITION, FLAG), 1):
        assert bench.write_value(TMAP, position, entry) is None
    assert bench.write_value(TMAP, 0, 3) is SdoAbortCode.PDO_LENGTH


def test_there_is_no_ninth_position(bench):
    open_mapping(bench)
    assert bench.write(TMAP, 9, bytes(4)) is SdoAbortCode.NO_SUBINDEX


def test_wide_numbers_can_be_mapped(make_bench, make_entries):
    wide = [
        Entry(0x2011, 0, "Energy", DataType.REAL64, Access.RO, 0.5, mappable=True),
        Entry(0x2012, 0, "Time", DataType.INTEGER64, Access.RO, -2, mappable=True),
    ]
    tpdos = [PdoDefault(((0x2011, 0, 64),), 1), PdoDefault(((0x2012, 0, 64),), 1)]
    bench = make_bench(entries=[*make_entries(tpdos=tpdos), *wide])
    bench.start()
    assert bench.sync() == [(0x185, struct.pack("<d", 0.5)), (0x285, struct.pack("<q", -2))]


def test_a_bit_of_the_wrong_type_is_the_owners_mistake_and_named(running):
    assert configure(running, [FLAG, POSITION]) is None
    running.dictionary.on_read(0x6064, 0, lambda: 2**31)
    with pytest.raises(ValueError, match="Flag, Position"):
        running.sync()


# From the memory


@pytest.mark.parametrize(
    ("address", "value", "shown"),
    [
        ((TPDO, 1), 0x20000185, 0x185 | INVALID),  # a reserved bit
        ((TPDO, 1), 0x605, 0x185 | INVALID),  # a restricted identifier
        ((TPDO, 2), 245, 1),
        ((TPDO, 6), 241, 0),
        ((TMAP, 0), 9, 0),
        ((TMAP, 1), CONTROL, 0),  # not mappable in this direction
        ((TMAP, 2), 0x60640010, 0),
    ],
)
def test_what_could_not_have_been_written_is_not_taken_from_the_memory_and_the_pdo_does_not_exist(bench, address, value, shown):
    bench.dictionary.stored = {address: value}
    bench.slave.power_on(bench.now)
    assert bench.dictionary.get(*address) == shown
    assert bench.dictionary.get_int(TPDO, 1) == 0x185 | INVALID
    assert bench.start() == []
    assert bench.sync() == []
    assert configure(bench, [TORQUE]) is None
    assert bench.sync() == [(0x185, bytes(2))]


def test_what_could_have_been_written_is_taken_from_the_memory(bench):
    bench.dictionary.stored = {(TPDO, 1): 0x40000190, (TMAP, 0): 1, (TMAP, 1): TORQUE, (TPDO, 3): 7}
    bench.slave.power_on(bench.now)
    bench.start()
    assert bench.sync() == [(0x190, bytes(2))]


# Anything in any order

ENTRIES = [CONTROL, TARGET, STATUS, POSITION, TORQUE, FLAG, 0x20050040, 0x00010001, 0x00050008, 0x00070020, 0, 0x5FFF0010]
PLACE_HOLDERS = [0x00010001, 0x00020008, 0x00060010, 0x00070020]
writes = st.one_of(
    st.tuples(st.sampled_from([RPDO, TPDO]), st.just(1), st.sampled_from([0x185, 0x205, 0x80000185, 0xC0000205, 0x20000185, 0])),
    st.tuples(st.sampled_from([RPDO, TPDO]), st.just(2), st.sampled_from([0, 1, 2, 241, 252, 253, 254, 255])),
    st.tuples(st.sampled_from([RPDO, TPDO]), st.sampled_from([3, 5]), st.integers(0, 3)),
    st.tuples(st.just(TPDO), st.just(6), st.integers(0, 3)),
    st.tuples(st.sampled_from([RMAP, TMAP]), st.just(0), st.integers(0, 9)),
    st.tuples(st.sampled_from([RMAP, TMAP]), st.integers(1, 8), st.sampled_from(ENTRIES)),
    st.tuples(st.just(0x1019), st.just(0), st.integers(0, 3)),
    st.tuples(st.just(0x1007), st.just(0), st.sampled_from([0, 500])),
)
frames = st.tuples(st.sampled_from([0x80, 0x185, 0x205, 0x185 | 1 << 30]), st.binary(max_size=8))
procedures = st.tuples(
    st.lists(st.sampled_from(ENTRIES), max_size=4),
    st.sampled_from([(TPDO, TMAP, 0x185), (RPDO, RMAP, 0x205)]),
    st.none(),
    st.none(),
)


@pytest.mark.ci
@settings(max_examples=100)
@given(st.lists(writes | frames | procedures | st.integers(1, 3), max_size=40))
def test_any_writes_and_frames_in_any_order_make_no_exception_and_no_long_frame(make_bench, synchronous, steps):
    bench = make_bench(**synchronous)
    bench.start()
    for step in steps:
        sent = []
        if isinstance(step, int):
            sent = [frame for _, frame in bench.wait(step)]
        elif len(step) == 2:
            sent = bench.send(*step)
        elif len(step) == 4:
            configure(bench, step[0], *step[1])
        elif (step[0], step[1]) in bench.dictionary:
            bench.write_value(*step)
        assert all(len(frame.data) <= 8 for frame in sent)
        assert bench.slave.due is None or bench.slave.due >= bench.now


@settings(max_examples=60)
@given(st.lists(st.sampled_from(PLACE_HOLDERS), min_size=1, max_size=8), st.binary(min_size=8, max_size=8))
def test_place_holders_write_nothing_whatever_comes(make_bench, synchronous, dummies, data):
    bench = make_bench(**synchronous)
    bench.start()
    code = configure(bench, dummies, RPDO, RMAP, 0x205)
    addresses = [(entry.index, entry.subindex) for entry in bench.dictionary if entry.index >= 0x2000]
    before = [bench.dictionary.get(*address) for address in addresses]
    bits = sum(entry & 0xFF for entry in dummies)
    assert code is (None if bits <= 64 else SdoAbortCode.PDO_LENGTH)
    bench.send(0x205, data[: -(-bits // 8)])
    bench.sync()
    assert [bench.dictionary.get(*address) for address in addresses] == before


@pytest.mark.ci
@settings(max_examples=60)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 255)), min_size=1, max_size=8), st.data())
def test_what_one_node_sends_another_one_takes_bit_by_bit(make_bench, make_entries, objects, data):
    # As text: the first object rightmost, as the standard draws a byte.
    entries, mapped, text = [], [], ""
    for sub, (is_flag, value) in enumerate(objects, 1):
        kind, bits = (DataType.BOOLEAN, 1) if is_flag else (DataType.UNSIGNED8, 8)
        held = bool(value & 1) if is_flag else value
        entries.append(Entry(0x2010, sub, f"Object {sub}", kind, Access.RW, held, mappable=True))
        mapped.append((0x2010, sub, bits))
        text = f"{int(held):0{bits}b}" + text
    sender = make_bench(entries=[*make_entries(tpdos=[PdoDefault(tuple(mapped), 1)]), *entries])
    sender.start()
    ((_, frame),) = sender.sync()
    assert frame == int(text, 2).to_bytes(-(-len(text) // 8), "little")

    taker = make_bench(entries=[*make_entries(rpdos=[PdoDefault(tuple(mapped))]), *entries])
    taker.start()
    other = data.draw(st.integers(0, 2 ** len(text) - 1))
    for number in (other, int(text, 2)):
        taker.send(0x205, number.to_bytes(len(frame), "little"))
        end = len(text)
        for sub, (_, _, bits) in enumerate(mapped, 1):
            wanted = f"{number:0{len(text)}b}"[end - bits : end]
            assert int(taker.dictionary.get(0x2010, sub)) == int(wanted, 2)
            end -= bits
