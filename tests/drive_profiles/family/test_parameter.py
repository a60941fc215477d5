"""One value of a profile: to bytes and back, within its limits or not at all."""

import math
import struct
from decimal import Decimal

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from drive_profiles.errors import DriveProfileError, OutOfRangeError
from drive_profiles.family.parameter import BYTES, LIMITS, Fact, Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.object_address import address_text, object_address
from drive_profiles.standard.units import Scaling
from tests.drive_profiles.profiles import PROFILES

SCALING = Scaling(131072, 7.1)
FACTS = {
    "index": 0x2147,
    "subindex": 1,
    "class": "tuning",
    "description": "A value.",
    "source": "a test",
    "evidence": "definition",
}
BOUNDED = [
    (name, key)
    for name, profile in PROFILES.items()
    for key, p in profile.parameters.items()
    if (p.minimum, p.maximum) != (None, None)
]


def parameter(data_type, **facts):
    return Parameter.model_validate({**FACTS, "data_type": data_type, **facts})


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFF))
def test_an_address_is_read_as_it_is_written(index, subindex):
    assert object_address(address_text((index, subindex))) == (index, subindex)


def test_an_address_without_a_subindex_is_that_of_subindex_0():
    assert object_address("6072") == object_address("6072:0") == (0x6072, 0)
    assert parameter("REAL32").written_address == "2147:1"
    assert parameter("REAL32").address == (0x2147, 1)


@pytest.mark.parametrize(("data_type", "limits"), LIMITS.items())
def test_both_ends_of_an_integer_type_cross_the_bus_exactly_and_the_next_numbers_are_refused(data_type, limits):
    entry = parameter(data_type)
    for value in limits:
        data = entry.encoded(value)
        assert data == value.to_bytes(DataType[data_type].size, "little", signed=limits[0] < 0)
        assert entry.decoded(data) == value
        assert type(entry.decoded(data)) is int
    for value in (limits[0] - 1, limits[1] + 1):
        with pytest.raises(OutOfRangeError, match=f"2147:1 {value}: is outside the range of {data_type}"):
            entry.encoded(value)


@given(st.sampled_from(sorted(LIMITS)), st.data())
def test_every_integer_comes_back_from_the_wire(data_type, data):
    value = data.draw(st.integers(*LIMITS[data_type]))
    assert parameter(data_type).decoded(parameter(data_type).encoded(value)) == value


def significant_digits(value: float) -> int:
    return len(Decimal(repr(value)).normalize().as_tuple().digits)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
@example(999999986991104.0)
def test_a_real32_is_shown_with_the_fewest_decimals_that_give_the_same_bits(value):
    entry, data = parameter("REAL32"), struct.pack("<f", value)
    shown = entry.decoded(data)
    assert entry.encoded(shown) == data
    assert significant_digits(shown) <= significant_digits(value)
    assert entry.decoded(struct.pack("<f", 0.1)) == 0.1


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_real64_comes_back_from_the_wire(value):
    entry = parameter("REAL64")
    assert struct.pack("<d", entry.decoded(entry.encoded(value))) == struct.pack("<d", value)


@given(
    st.sampled_from(["INTEGER8", "UNSIGNED16", "INTEGER32", "UNSIGNED32"]),
    st.one_of(st.floats(1e-6, 1e6), st.sampled_from(["counts", "per mille"])),
    st.data(),
)
def test_what_an_object_holds_comes_back_through_any_scale(data_type, scale, data):
    entry = parameter(data_type, scale=scale, unit="rad")
    raw = data.draw(st.integers(*LIMITS[data_type]))
    assert entry.raw(entry.value(raw, SCALING), SCALING) == raw


@given(st.floats(1e-3, 1e3), st.floats(-(2.0**100), 2.0**100, width=32))
def test_a_scaled_real32_comes_back_with_the_same_bits(scale, held):
    entry, data = parameter("REAL32", scale=scale), struct.pack("<f", held)
    if math.isclose(held, 0, abs_tol=1e-30):
        return  # what is near the smallest single loses bits in any conversion
    assert entry.encoded(entry.decoded(data)) == data


@given(st.integers(1, 254), st.floats(1e-6, 1e6))
def test_a_limit_that_is_a_whole_number_of_steps_is_accepted_when_it_is_read_back(steps, scale):
    for limit in (steps * scale, float(f"{steps * scale:.15g}")):
        entry = parameter("UNSIGNED8", scale=scale, minimum=limit, maximum=limit)
        assert entry.raw(entry.value(entry.raw(limit))) == steps
        for outside in (entry.value(steps - 1), entry.value(steps + 1)):
            with pytest.raises(OutOfRangeError):
                entry.raw(outside)


def test_a_limit_between_two_steps_is_not_moved_to_the_next():
    entry = parameter("UNSIGNED8", scale=0.1, unit="s", maximum=0.26)
    assert entry.raw(0.2) == 2
    with pytest.raises(OutOfRangeError, match=r"2147:1 0\.3 s: must be at most 0\.26"):
        entry.raw(0.3)


@pytest.mark.parametrize(("name", "key"), BOUNDED)
def test_every_limit_of_every_profile_can_be_written_read_back_and_written_again(name, key):
    entry = Profile.load(name).parameter(key)
    for limit in (entry.minimum, entry.maximum):
        if limit is not None and not (isinstance(entry.scale, str)):
            data = entry.encoded(limit)
            assert entry.encoded(entry.decoded(data)) == data


@pytest.mark.parametrize("data_type", [*LIMITS, "REAL32", "REAL64"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400, -(10**400)])
def test_what_no_number_type_holds_is_refused(data_type, value):
    for scale in (1.0, 0.1):
        with pytest.raises(OutOfRangeError):
            parameter(data_type, scale=scale).encoded(value)


def test_a_value_that_overflows_by_its_scale_is_refused():
    for data_type in ("REAL32", "REAL64", "UNSIGNED64"):
        with pytest.raises(OutOfRangeError):
            parameter(data_type, scale=1e-9).encoded(1e300)


@pytest.mark.parametrize(
    ("data_type", "text", "data"),
    [
        ("VISIBLE_STRING", "", b""),
        ("VISIBLE_STRING", 'a "b" \\ \n\0\x7fä', b'a "b" \\ \n\0\x7f\xe4'),
        ("OCTET_STRING", "00 ff 7F", b"\x00\xff\x7f"),
        ("DOMAIN", "", b""),
    ],
)
def test_strings_and_bytes_cross_the_bus_as_they_are(data_type, text, data):
    entry = parameter(data_type)
    assert entry.is_bytes
    assert entry.encoded(text) == data
    assert entry.encoded(entry.decoded(data)) == data
    with pytest.raises(DriveProfileError, match="holds bytes, not a number"):
        entry.raw(1.0)


@pytest.mark.parametrize(
    ("data_type", "value", "words"),
    [
        ("VISIBLE_STRING", "5 €", "'5 €' is not a value of VISIBLE_STRING"),
        ("VISIBLE_STRING", 5, "5 is not a value of VISIBLE_STRING"),
        ("OCTET_STRING", "0g", "non-hexadecimal"),
        ("DOMAIN", 1.5, "1.5 is not a value of DOMAIN"),
        ("REAL32", "1.5", "'1.5' is not a value of REAL32"),
        ("UNSIGNED8", "1", "'1' is not a value of UNSIGNED8"),
        ("BOOLEAN", 2, "is outside the range of BOOLEAN"),
    ],
)
def test_a_value_of_another_type_is_refused_with_the_object(data_type, value, words):
    with pytest.raises(DriveProfileError, match=words) as caught:
        parameter(data_type).encoded(value)
    assert "2147:1" in str(caught.value)


@pytest.mark.parametrize("data_type", [name for name in DataType.__members__ if name not in BYTES])
@given(st.binary(max_size=9))
def test_bytes_of_another_length_are_no_value(data_type, data):
    if len(data) != DataType[data_type].size:
        with pytest.raises(ValueError, match=f"{data_type} takes"):
            parameter(data_type).decoded(data)


def test_a_scale_of_the_drive_needs_the_drive():
    for scale in ("counts", "per mille"):
        entry = parameter("INTEGER32", scale=scale, unit="rad")
        for convert in (lambda entry=entry: entry.encoded(1.0), lambda entry=entry: entry.decoded(b"\0\0\0\0")):
            with pytest.raises(DriveProfileError, match=f"2147:1 counts in {scale}: the drive's scaling is needed"):
                convert()


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"data_type": "DOMAIN", "unit": "s"}, "a DOMAIN has no unit, no scale and no limits"),
        ({"data_type": "VISIBLE_STRING", "minimum": 0.0}, "a VISIBLE_STRING has no unit, no scale and no limits"),
        ({"data_type": "OCTET_STRING", "scale": 2.0}, "a OCTET_STRING has no unit, no scale and no limits"),
        ({"data_type": "REAL32", "minimum": 2.0, "maximum": 1.0}, "minimum 2 is above maximum 1"),
        ({"data_type": "UNSIGNED8", "default": 256}, "default 256"),
        ({"data_type": "UNSIGNED8", "default": "one"}, "default 'one'"),
        ({"data_type": "OCTET_STRING", "default": "0g"}, "default '0g'"),
        ({"data_type": "OCTET_STRING", "default": 1}, "expected bytes as hexadecimal text"),
        ({"data_type": "UNSIGNED8", "index": 0x0FFF}, "greater than or equal to 4096"),
        ({"data_type": "UNSIGNED8", "subindex": 0xFF}, "less than or equal to 254"),
        ({"data_type": "UNSIGNED8", "scale": 0.0}, "greater than 0"),
        ({"data_type": "REAL32", "minimum": math.nan}, "finite number"),
    ],
)
def test_facts_that_contradict_each_other_are_no_parameter(facts, words):
    with pytest.raises(ValidationError, match=words):
        Parameter.model_validate({**FACTS, **facts})


@pytest.mark.parametrize(
    ("data_type", "default", "data"),
    [
        ("UNSIGNED16", None, None),
        ("UNSIGNED16", 258, b"\x02\x01"),
        ("UNSIGNED64", 2**64 - 1, b"\xff" * 8),
        ("REAL32", 1, b"\x00\x00\x80\x3f"),
        ("REAL64", 0.5, struct.pack("<d", 0.5)),
        ("VISIBLE_STRING", "ab", b"ab"),
        ("DOMAIN", "01 02", b"\x01\x02"),
    ],
)
def test_the_factory_value_is_what_is_on_the_wire(data_type, default, data):
    assert parameter(data_type, default=default, **({"scale": 0.1} if data_type == "UNSIGNED16" else {})).default_bytes() == data


def test_a_step_is_said_in_words():
    assert parameter("UNSIGNED16", scale=0.001, unit="s").step == "0.001 s"
    assert parameter("UNSIGNED16").step == "1"
    assert parameter("INTEGER32", scale="counts", unit="rad").step == "1 count"
    assert parameter("INTEGER16", scale="per mille", unit="N·m").step == "1 ‰ of 6076h"
    assert parameter("REAL32", unit="Hz").step == parameter("DOMAIN").step == ""


def test_what_is_known_by_a_guess_only_is_not_verified():
    assert Fact(source="a manual", evidence="documentation").is_verified
    assert not Fact(source="a forum", evidence="unverified").is_verified
    with pytest.raises(ValidationError):
        Fact(source="", evidence="measured")
