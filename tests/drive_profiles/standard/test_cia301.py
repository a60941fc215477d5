"""The shared facts of CiA 301, held against a stranger's tables (the canopen package) and against themselves."""

import math

import canopen
import canopen.nmt
import pytest
from canopen.objectdictionary import datatypes
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import (
    CobIdBit,
    DataType,
    FunctionCode,
    NmtCommand,
    NmtState,
    SdoAbortCode,
    abort_text,
    decode,
    encode,
    identifier_refusal,
)

INTEGERS = [data_type for data_type in DataType if data_type.is_integer]


def bounds(data_type: DataType) -> tuple[int, int]:
    bits = data_type.size * 8
    if data_type.name.startswith("UNSIGNED"):
        return 0, 2**bits - 1
    return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


@pytest.mark.parametrize("data_type", list(DataType))
def test_data_type_codes_are_those_of_a_stranger(data_type):
    assert getattr(datatypes, data_type.name) == data_type


def test_abort_codes_are_those_of_a_stranger():
    assert set(canopen.SdoAbortedError.CODES) == set(SdoAbortCode)


def test_nmt_commands_and_states_are_those_of_a_stranger():
    assert canopen.nmt.NMT_COMMANDS["OPERATIONAL"] == NmtCommand.START
    assert canopen.nmt.NMT_COMMANDS["STOPPED"] == NmtCommand.STOP
    assert canopen.nmt.NMT_COMMANDS["PRE-OPERATIONAL"] == NmtCommand.ENTER_PRE_OPERATIONAL
    assert canopen.nmt.NMT_COMMANDS["RESET"] == NmtCommand.RESET_NODE
    assert canopen.nmt.NMT_COMMANDS["RESET COMMUNICATION"] == NmtCommand.RESET_COMMUNICATION
    for state in NmtState:
        assert state in canopen.nmt.NMT_STATES


@pytest.mark.parametrize("data_type", INTEGERS)
def test_integers_keep_their_bounds_and_refuse_the_next_value(data_type):
    low, high = bounds(data_type)
    for value in (low, high):
        assert decode(data_type, encode(data_type, value)) == value
    for value in (low - 1, high + 1):
        with pytest.raises(ValueError, match=data_type.name):
            encode(data_type, value)


@given(st.sampled_from(INTEGERS), st.data())
def test_decode_is_the_inverse_of_encode_for_integers(data_type, data):
    value = data.draw(st.integers(*bounds(data_type)))
    encoded = encode(data_type, value)
    assert len(encoded) == data_type.size
    assert decode(data_type, encoded) == value
    assert encoded == value.to_bytes(data_type.size, "little", signed=bounds(data_type)[0] < 0)


@given(st.floats(allow_nan=False))
def test_decode_is_the_inverse_of_encode_for_real64(value):
    assert decode(DataType.REAL64, encode(DataType.REAL64, value)) == value


@given(st.binary(max_size=20))
def test_strings_and_domains_survive_whatever_bytes_they_hold(data):
    for data_type in (DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.DOMAIN):
        assert encode(data_type, decode(data_type, data)) == data


@pytest.mark.parametrize("value", [True, False])
def test_a_boolean_is_one_byte(value):
    assert encode(DataType.BOOLEAN, value) == bytes((value,))
    assert decode(DataType.BOOLEAN, bytes((value,))) is value


@pytest.mark.parametrize(
    ("data_type", "value"),
    [
        (DataType.UNSIGNED8, "1"),
        (DataType.UNSIGNED8, 1.5),
        (DataType.REAL32, 1e39),
        (DataType.VISIBLE_STRING, b"bytes"),
        (DataType.VISIBLE_STRING, "€"),
        (DataType.OCTET_STRING, "text"),
    ],
)
def test_a_value_of_another_type_is_the_callers_mistake(data_type, value):
    with pytest.raises(ValueError, match=data_type.name):
        encode(data_type, value)


@pytest.mark.parametrize("length", [0, 1, 3, 5])
def test_decode_refuses_a_wrong_length(length):
    with pytest.raises(ValueError, match="4 bytes"):
        decode(DataType.UNSIGNED32, bytes(length))


def test_fixed_sizes_and_open_ones():
    assert {t.name: t.size for t in DataType if t.size is None} == {
        "VISIBLE_STRING": None,
        "OCTET_STRING": None,
        "DOMAIN": None,
    }
    assert DataType.REAL32.struct_format == "f"
    assert DataType.DOMAIN.struct_format is None
    assert DataType.REAL64.is_real
    assert not DataType.BOOLEAN.is_integer


def test_every_abort_code_has_words_and_an_unknown_one_too():
    for code in SdoAbortCode:
        assert abort_text(code) == code.text
        assert code.text
    assert abort_text(0xDEADBEEF) == "Unknown abort code DEADBEEFh"


@pytest.mark.parametrize(
    ("can_id", "restricted"),
    [
        (0x000, True), (0x001, True), (0x07F, True), (0x080, False), (0x100, False), (0x101, True), (0x180, True),
        (0x181, False), (0x580, False), (0x581, True), (0x5FF, True), (0x600, False), (0x601, True), (0x67F, True),
        (0x680, False), (0x6DF, False), (0x6E0, True), (0x6FF, True), (0x700, False), (0x701, True), (0x7FF, True),
    ],
)  # fmt: skip
def test_restricted_identifiers_end_where_the_table_says(can_id, restricted):
    assert (identifier_refusal(can_id) is not None) is restricted


def test_the_predefined_connection_set_gives_no_restricted_identifier_to_a_pdo():
    for code in FunctionCode:
        if "PDO" in code.name:
            assert not any(identifier_refusal(code + node_id) for node_id in range(1, 128))


def test_cob_id_bits_are_plain_numbers():
    assert type(0x80000181 & ~CobIdBit.INVALID) is int
    assert 0x80000181 & ~CobIdBit.INVALID == 0x181


def test_real32_is_rounded_to_what_the_wire_holds():
    assert math.isclose(decode(DataType.REAL32, encode(DataType.REAL32, 0.1)), 0.1, rel_tol=1e-7)
