"""Entries that check themselves, and the dictionary's answers to reads and writes."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import DataType, SdoAbortCode
from plant_emulator.slave.dictionary import Access, Dictionary, Entry, ResetKind, SdoAbort

U8, U16, U32, I16 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.INTEGER16
REAL32, TEXT = DataType.REAL32, DataType.VISIBLE_STRING
RW, RO, WO = Access.RW, Access.RO, Access.WO


@pytest.fixture
def dictionary():
    return Dictionary(
        [
            Entry(0x1017, 0, "Heartbeat", U16, RW, 100),
            Entry(0x2000, 0, "Limited", I16, RW, 10, low=-100, high=100),
            Entry(0x2001, 0, "Label", TEXT, RW, "label"),
            Entry(0x2002, 0, "Key", U16, WO, 0),
            Entry(0x2003, 1, "Gain", REAL32, RW, 1.5, record_name="Tuning"),
            Entry(0x2003, 4, "Time", U32, RW, 4, record_name="Tuning"),
            Entry(0x2005, 0, "Relative", U32, RW, 0x180, node_relative=True),
            Entry(0x6041, 0, "Status", U16, RO, 0x1234),
            Entry(0x6042, 0, "Fixed", U16, Access.CONST, 7),
        ],
        node_id=5,
    )


def code_of(call, *arguments):
    with pytest.raises(SdoAbort) as caught:
        call(*arguments)
    return caught.value.code


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"default": 256}, "not a value of UNSIGNED8"),
        ({"default": "1"}, "not a value of UNSIGNED8"),
        ({"default": 9, "high": 8}, "too high"),
        ({"default": 1, "low": 2}, "too low"),
        ({"low": 3, "high": 2}, "above high limit"),
        ({"high": 256}, "not a value of UNSIGNED8"),
        ({"index": 0}, "out of range"),
        ({"index": 0x10000}, "out of range"),
        ({"subindex": 0xFF}, "out of range"),
        ({"name": ""}, "name"),
        ({"name": "a;b"}, "name"),
        ({"name": "a\nb"}, "name"),
        ({"name": " a"}, "name"),
        ({"record_name": "x;"}, "name"),
        ({"data_type": TEXT, "default": "x", "mappable": True}, "cannot be mapped"),
        ({"data_type": TEXT, "default": "x", "low": 1}, "has no limits"),
        ({"data_type": DataType.BOOLEAN, "default": False, "high": 1}, "has no limits"),
        ({"data_type": REAL32, "default": math.nan}, "Invalid value"),
        ({"data_type": REAL32, "default": 1e39}, "not a value of REAL32"),
        ({"data_type": TEXT, "default": "x", "node_relative": True}, "node-ID added"),
        ({"default": 200, "node_relative": True}, "not a value of UNSIGNED8"),
    ],
)
def test_an_entry_that_contradicts_itself_cannot_be_built(changes, words):
    arguments = {"index": 0x2000, "subindex": 0, "name": "x", "data_type": U8, "access": RW, "default": 3} | changes
    with pytest.raises(ValueError, match=words):
        Entry(**arguments)


@pytest.mark.parametrize(
    ("access", "in_rpdo", "in_tpdo"),
    [
        (Access.RO, False, True), (Access.WO, True, False), (Access.RW, True, True),
        (Access.CONST, False, True), (Access.RWW, True, False), (Access.RWR, False, True),
    ],
)  # fmt: skip
def test_access_decides_the_direction_in_which_an_entry_is_mapped(access, in_rpdo, in_tpdo):
    entry = Entry(0x2000, 0, "x", U8, access, 0, mappable=True)
    assert (entry.is_rpdo_mappable, entry.is_tpdo_mappable) == (in_rpdo, in_tpdo)
    closed = Entry(0x2000, 0, "x", U8, access, 0)
    assert (closed.is_rpdo_mappable, closed.is_tpdo_mappable) == (False, False)


def test_the_limit_of_a_real32_may_be_written_although_it_is_not_a_binary_fraction():
    dictionary = Dictionary([Entry(0x2000, 0, "x", REAL32, RW, 0.1, low=0.1, high=0.7)])
    for limit in (0.1, 0.7):
        dictionary.write(0x2000, 0, struct.pack("<f", limit))
        dictionary.set(0x2000, 0, limit)


def test_an_entry_given_twice_is_refused():
    entry = Entry(0x2000, 0, "x", U8, RW, 0)
    with pytest.raises(ValueError, match=r"2000h:00h 'x': .* twice"):
        Dictionary([entry, entry])


def test_the_highest_subindex_is_provided_and_read_only(dictionary):
    assert dictionary.read(0x2003, 0) == b"\x04"
    assert code_of(dictionary.write, 0x2003, 0, b"\x05") is SdoAbortCode.READ_ONLY


def test_a_given_subindex_0_is_kept():
    own = Entry(0x1600, 0, "Count", U8, RW, 0)
    dictionary = Dictionary([Entry(0x1600, 1, "Mapped", U32, RW, 0), own])
    assert dictionary.cell(0x1600, 0).entry is own


def test_entries_come_in_the_order_of_their_places(dictionary):
    addresses = [(entry.index, entry.subindex) for entry in dictionary]
    assert addresses == sorted(addresses)
    assert len(dictionary) == len(addresses) == 10
    assert (0x2003, 0) in dictionary
    assert (0x2003, 2) not in dictionary


@pytest.mark.parametrize(
    ("address", "code"),
    [
        ((0x2FFF, 0), SdoAbortCode.NO_OBJECT),
        ((0x2FFF, 1), SdoAbortCode.NO_OBJECT),
        ((0x2000, 1), SdoAbortCode.NO_SUBINDEX),
        ((0x2003, 2), SdoAbortCode.NO_SUBINDEX),
        ((0x2002, 0), SdoAbortCode.WRITE_ONLY),
    ],
)
def test_reads_are_refused_with_the_standards_code(dictionary, address, code):
    assert code_of(dictionary.read, *address) is code


@pytest.mark.parametrize(
    ("address", "data", "code"),
    [
        ((0x2FFF, 0), b"\0", SdoAbortCode.NO_OBJECT),
        ((0x2000, 1), b"\0", SdoAbortCode.NO_SUBINDEX),
        ((0x6041, 0), b"\0\0", SdoAbortCode.READ_ONLY),
        ((0x6042, 0), b"\0\0", SdoAbortCode.READ_ONLY),
        ((0x2000, 0), b"\0\0\0", SdoAbortCode.TOO_LONG),
        ((0x2000, 0), b"\0", SdoAbortCode.TOO_SHORT),
        ((0x2000, 0), b"", SdoAbortCode.TOO_SHORT),
        ((0x2000, 0), struct.pack("<h", 101), SdoAbortCode.VALUE_TOO_HIGH),
        ((0x2000, 0), struct.pack("<h", -101), SdoAbortCode.VALUE_TOO_LOW),
        ((0x2003, 1), struct.pack("<f", math.nan), SdoAbortCode.INVALID_VALUE),
        ((0x2003, 1), struct.pack("<f", math.inf), SdoAbortCode.INVALID_VALUE),
        ((0x2003, 1), struct.pack("<f", -math.inf), SdoAbortCode.INVALID_VALUE),
    ],
)
def test_writes_are_refused_with_the_standards_code_and_change_nothing(dictionary, address, data, code):
    before = [dictionary.get(entry.index, entry.subindex) for entry in dictionary]
    assert code_of(dictionary.write, *address, data) is code
    assert [dictionary.get(entry.index, entry.subindex) for entry in dictionary] == before


@given(st.integers(-100, 100))
def test_what_is_written_is_read_back(value):
    dictionary = Dictionary([Entry(0x2000, 0, "Limited", I16, RW, 10, low=-100, high=100)])
    dictionary.write(0x2000, 0, struct.pack("<h", value))
    assert dictionary.get(0x2000) == value
    assert dictionary.read(0x2000, 0) == struct.pack("<h", value)


def test_the_owner_is_not_bound_by_access(dictionary):
    dictionary.set(0x6041, 0, 0x4321)
    assert dictionary.read(0x6041, 0) == b"\x21\x43"
    assert dictionary.get(0x2002) == 0


def test_the_owner_is_bound_by_places_types_and_limits(dictionary):
    with pytest.raises(KeyError, match="2FFFh:00h"):
        dictionary.get(0x2FFF)
    with pytest.raises(KeyError, match="2000h:01h"):
        dictionary.set(0x2000, 1, 0)
    with pytest.raises(ValueError, match="UNSIGNED16"):
        dictionary.set(0x6041, 0, 70000)
    with pytest.raises(ValueError, match="too high"):
        dictionary.set(0x2000, 0, 101)
    with pytest.raises(TypeError, match="not a whole number"):
        dictionary.get_int(0x2001)
    assert dictionary.get_int(0x6041) == 0x1234


def test_a_read_hook_gives_the_live_value(dictionary):
    values = iter((1, 2))
    dictionary.on_read(0x6041, 0, lambda: next(values))
    assert dictionary.read(0x6041, 0) == b"\x01\x00"
    assert dictionary.get(0x6041) == 2


def test_a_read_hook_whose_value_is_not_of_the_type_is_an_error_that_says_so(dictionary):
    dictionary.on_read(0x6041, 0, lambda: 70_000)
    with pytest.raises(ValueError, match="70000 is not a value of UNSIGNED16"):
        dictionary.read(0x6041, 0)


def test_a_write_hook_sees_the_value_before_it_is_stored(dictionary):
    seen = []
    dictionary.on_write(0x2000, 0, lambda value: seen.append((value, dictionary.get(0x2000))))
    dictionary.write(0x2000, 0, struct.pack("<h", 42))
    assert seen == [(42, 10)]
    assert dictionary.get(0x2000) == 42


def test_a_write_hook_refuses_and_nothing_changes(dictionary):
    dictionary.on_write(0x2000, 0, lambda value: SdoAbortCode.LOCAL_CONTROL)
    assert code_of(dictionary.write, 0x2000, 0, struct.pack("<h", 42)) is SdoAbortCode.LOCAL_CONTROL
    assert dictionary.get(0x2000) == 10


def test_an_object_takes_one_write_hook_and_a_second_is_an_error_that_names_it(dictionary):
    seen = []
    dictionary.on_write(0x2000, 0, seen.append)
    with pytest.raises(ValueError, match=r"2000h:00h '.*' has a write hook already; .*wrap_write"):
        dictionary.on_write(0x2000, 0, lambda value: SdoAbortCode.LOCAL_CONTROL)
    dictionary.write(0x2000, 0, b"\1\0\0\0"[: len(dictionary.read(0x2000, 0))])
    assert len(seen) == 1


def test_a_write_hook_is_wrapped_where_that_is_asked_for(dictionary):
    seen = []
    dictionary.wrap_write(0x2000, 0, lambda inner: lambda value: seen.append(inner))
    dictionary.wrap_write(0x2000, 0, lambda inner: lambda value: seen.append("outer") or inner(value))
    dictionary.write(0x2000, 0, b"\1\0\0\0"[: len(dictionary.read(0x2000, 0))])
    assert seen == ["outer", None]


def test_a_write_hook_is_not_asked_about_what_the_limits_refuse(dictionary):
    dictionary.on_write(0x2000, 0, lambda value: pytest.fail("asked"))
    assert code_of(dictionary.write, 0x2000, 0, struct.pack("<h", 101)) is SdoAbortCode.VALUE_TOO_HIGH


def test_a_communication_reset_restores_1000h_to_1fffh_only(dictionary):
    for address in ((0x1017, 0), (0x2000, 0), (0x6041, 0)):
        dictionary.set(*address, 5)
    dictionary.reset(ResetKind.COMMUNICATION)
    assert [dictionary.get(index) for index in (0x1017, 0x2000, 0x6041)] == [100, 5, 5]
    dictionary.reset(ResetKind.NODE)
    assert [dictionary.get(index) for index in (0x1017, 0x2000, 0x6041)] == [100, 10, 0x1234]


def test_a_node_relative_default_follows_the_node_id(dictionary):
    assert dictionary.get(0x2005) == 0x185
    dictionary.node_id = 7
    dictionary.reset(ResetKind.NODE)
    assert dictionary.get(0x2005) == 0x187


def test_an_abort_carries_the_standards_words():
    assert str(SdoAbort(SdoAbortCode.NO_OBJECT)) == "06020000h Object does not exist in the object dictionary"


# -- what a reset puts back --------------------------------------------------------------------------------------------


def numbered(default=0x85 - 5, **more):
    return Entry(0x1014, 0, "COB-ID", DataType.UNSIGNED32, Access.RW, default, node_relative=True, **more)


@pytest.mark.parametrize(
    ("kept", "then"),
    [(0x85, 0x89), (0x8000_0085, 0x8000_0089), (0x190, 0x190), (0x89, 0x89)],
)
def test_a_kept_cob_id_follows_the_node_id_where_it_is_the_nodes_own(kept, then):
    dictionary = Dictionary([numbered(), Entry(0x2000, 0, "Other", DataType.UNSIGNED32, Access.RW, 0)], node_id=5)
    dictionary.stored = {(0x1014, 0): kept, (0x2000, 0): 5}
    dictionary.renumber(9)
    dictionary.reset(ResetKind.NODE)
    assert (dictionary.node_id, dictionary.get(0x1014), dictionary.get(0x2000)) == (9, then, 5)


def test_a_value_that_its_owner_refuses_gives_way_to_the_default():
    dictionary = Dictionary([Entry(0x2000, 0, "Even", DataType.UNSIGNED8, Access.RW, 2)])
    given = []

    def even(value):
        given.append(value)
        return SdoAbortCode.INVALID_VALUE if value % 2 else None

    dictionary.load(0x2000)  # whom nobody owns, nobody refuses
    dictionary.on_write(0x2000, 0, even)
    for kept, value in ((4, 4), (5, 2)):
        dictionary.stored = {(0x2000, 0): kept}
        dictionary.reset(ResetKind.NODE)
        dictionary.load(0x2000)
        assert dictionary.get(0x2000) == value
    assert given == [4, 5, 2]


def test_the_owner_hears_of_what_an_sdo_changes_and_of_nothing_else():
    dictionary = Dictionary([Entry(0x2000, 0, "Value", DataType.UNSIGNED8, Access.RW, 2, high=9)])
    changed = []
    dictionary.on_change = lambda entry: changed.append(entry.index)
    dictionary.write(0x2000, 0, b"\x03")
    dictionary.write(0x2000, 0, b"\x03")
    dictionary.set(0x2000, 0, 4)
    dictionary.cell(0x2000).assign(5)
    with pytest.raises(SdoAbort):
        dictionary.write(0x2000, 0, b"\x0a")
    assert changed == [0x2000]
