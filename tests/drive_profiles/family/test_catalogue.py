"""What is known of a device's objects, by profile and by EDS: how they are found, and between which limits they are written."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.errors import AmbiguousNameError, DriveProfileError, OutOfRangeError, RefusedError, UnknownObjectError
from drive_profiles.family.catalogue import MAX_CANDIDATES, Catalogue, CatalogueEntry, address_from
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.object_address import address_text
from drive_profiles.standard.units import Scaling

SCALING = Scaling(1000, 2.0)
FACTS = {"class": "limits", "description": "A value.", "source": "a test", "evidence": "definition"}


def variable(section, name, data_type, access="rw", **more):
    lines = [
        f"[{section}]",
        f"ParameterName={name}",
        "ObjectType=0x7",
        f"DataType=0x{int(data_type):04X}",
        f"AccessType={access}",
    ]
    return "\n".join([*lines, "PDOMapping=0", *(f"{key}={value}" for key, value in more.items())])


def record(section, name, *members):
    return "\n".join([f"[{section}]", f"ParameterName={name}", "ObjectType=0x9", f"SubNumber={len(members)}", *members])


def description(*sections):
    """A small EDS; what it lacks of the formal tables costs warnings, not objects."""
    return eds.loads("\n".join([variable("1000", "Device type", DataType.UNSIGNED32, "ro"), *sections, ""]).encode())


GRIPPER = description(
    variable("1017", "Producer heartbeat time", DataType.UNSIGNED16),
    record(
        "2000",
        "Grip",
        variable("2000sub0", "Number of entries", DataType.UNSIGNED8, "const"),
        variable("2000sub1", "Force", DataType.UNSIGNED16, LowLimit=10, HighLimit=100),
        variable("2000sub2", "Stroke", DataType.REAL32, LowLimit=0.1, HighLimit=0.9),
        variable("2000sub3", "Grip trim", DataType.INTEGER8),
    ),
    variable("2001", "Force", DataType.INTEGER32, "wo"),
    variable("2002", "Label", DataType.VISIBLE_STRING),
    variable("2003", "Label", DataType.OCTET_STRING),
    variable("2004", "Sealed", DataType.BOOLEAN, "ro"),
)
PROFILE = Profile.model_validate(
    {
        "name": "gripper",
        "title": "A gripper",
        "kind": "accelerometer",
        "identity": {"vendor_id": 1, "source": "a test", "evidence": "definition"},
        "sync": {"source": "a test", "evidence": "definition"},
        "store": {"note": "It keeps nothing.", "source": "a test", "evidence": "definition"},
        "parameters": {
            "force_limit_nm": {
                **FACTS, "index": 0x2000, "subindex": 1, "data_type": "UNSIGNED16", "unit": "N·m", "scale": 0.1, "maximum": 20.0,
            },
            "stroke_m": {**FACTS, "index": 0x2000, "subindex": 2, "data_type": "REAL64", "unit": "m"},
            "reach_rad": {**FACTS, "index": 0x2010, "subindex": 0, "data_type": "INTEGER32", "unit": "rad", "scale": "counts"},
            "guess": {**FACTS, "index": 0x2011, "subindex": 0, "data_type": "UNSIGNED8", "evidence": "unverified"},
        },
    }
)  # fmt: skip
BOTH = Catalogue(PROFILE, GRIPPER)


# Addresses


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("0x2147:1", (0x2147, 1)),
        ("2147:1", (0x2147, 1)),
        ("2147sub1", (0x2147, 1)),
        ("2147SUB1", (0x2147, 1)),
        ("2147h:1", (0x2147, 1)),
        ("2147h:01h", (0x2147, 1)),
        ("0x2147:0x1A", (0x2147, 0x1A)),
        ("0X60ff", (0x60FF, 0)),
        ("6072", (0x6072, 0)),
        ("2147.1", (0x2147, 1)),
        ("  2147 : fe\n", (0x2147, 0xFE)),
        ("1018 sub 4", (0x1018, 4)),
        ("2110sub10", (0x2110, 0x10)),
    ],
)
def test_an_address_may_be_spelled_as_manuals_and_eds_files_spell_it(text, address):
    assert address_from(text) == address


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0x",
        "214",
        "0x214",
        "21470",
        "2147:",
        "2147:ff",
        "2147:100",
        "2147 1",
        "2147-1",
        ":1",
        "2147:1:1",
        "214g",
        "-2147",
        "٢١٤٧",
    ],
)
def test_what_is_no_address_is_none(text):
    assert address_from(text) is None


@given(st.text(max_size=20))
def test_no_text_makes_the_reading_of_an_address_raise(text):
    address = address_from(text)
    assert address is None or (0 <= address[0] <= 0xFFFF and 0 <= address[1] <= 0xFE)


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFE))
def test_an_address_as_it_is_shown_is_found_again(index, subindex):
    text = address_text((index, subindex))
    assert address_from(text) == address_from(f"0x{text}") == (index, subindex)
    assert BOTH.find(text, whole=True).address == (index, subindex)


# Names


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("force_limit_nm", (0x2000, 1)),  # the profile's name
        ("Grip.Force", (0x2000, 1)),  # the EDS's name of the same object
        ("grip.force", (0x2000, 1)),
        ("  FORCE ", (0x2001, 0)),  # whole before part
        ("Grip trim", (0x2000, 3)),  # the record's name is not said twice
        ("PRODUCER heartbeat time", (0x1017, 0)),
        ("status_word", (0x6041, 0)),  # the standard's
    ],
)
def test_a_whole_name_is_found_in_either_case_by_profile_eds_or_standard(text, address):
    assert BOTH.find(text).address == BOTH.find(text, whole=True).address == address


@pytest.mark.parametrize(
    ("text", "address"), [("reach", (0x2010, 0)), ("ch_RA", (0x2010, 0)), ("heartb", (0x1017, 0)), ("stroke", (0x2000, 2))]
)
def test_a_part_of_a_name_will_do_for_a_user_but_not_in_a_file(text, address):
    assert BOTH.find(text).address == address
    with pytest.raises(UnknownObjectError, match=f"no object '{text}'"):
        BOTH.find(text, whole=True)


def test_an_object_with_two_names_is_one_object():
    catalogue = Catalogue(PROFILE, description(record("2000", "Force", variable("2000sub1", "Force limit", DataType.UNSIGNED16))))
    assert catalogue.find("limit").address == (0x2000, 1)
    assert catalogue.find("force limit", whole=True) is catalogue.find("force_limit_nm", whole=True)


def test_the_device_comes_before_the_standard_when_a_part_is_looked_for():
    assert BOTH.find("heartbeat").address == (0x1017, 0)  # not 1016h, which the standard has besides
    with pytest.raises(AmbiguousNameError) as caught:
        Catalogue().find("heartbeat")
    assert caught.value.candidates == ("1016:1 (consumer_heartbeat_time_1)", "1017:0 (producer_heartbeat_time)")


def test_a_name_of_several_objects_lists_them_with_their_addresses():
    for text in ("label", "Label"):
        with pytest.raises(AmbiguousNameError) as caught:
            BOTH.find(text, whole=True)
        assert caught.value.candidates == ("2002:0 (Label)", "2003:0 (Label)")
        assert "'label' may be any of 2002:0 (Label), 2003:0 (Label)" in str(caught.value).replace("'Label'", "'label'")
        assert caught.value.exit_code == 2
    with pytest.raises(AmbiguousNameError) as caught:
        BOTH.find("grip")
    assert caught.value.candidates == (
        "2000:0 (Grip.Number of entries)",
        "2000:1 (force_limit_nm)",
        "2000:2 (stroke_m)",
        "2000:3 (Grip trim)",
    )


def test_a_list_of_candidates_ends_where_nobody_would_read_on():
    many = Catalogue(None, description(*(variable(f"{0x3000 + n:04X}", f"Point {n}", DataType.UNSIGNED8) for n in range(30))))
    with pytest.raises(AmbiguousNameError) as caught:
        many.find("point")
    assert len(caught.value.candidates) == MAX_CANDIDATES + 1
    assert caught.value.candidates[0] == "3000:0 (Point 0)"
    assert caught.value.candidates[-1] == f"{30 - MAX_CANDIDATES} more"


@pytest.mark.parametrize(("text", "close"), [("force_limit_mm", "force_limit_nm"), ("stats_word", "status_word")])
def test_an_unknown_name_has_near_ones(text, close):
    with pytest.raises(UnknownObjectError, match=f"no object '{text}'; did you mean .*{close}") as caught:
        BOTH.find(text)
    assert close in caught.value.close
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("text", ["", "   ", "zzzzzzzz"])
def test_a_text_that_is_near_to_nothing_says_how_an_object_is_written(text):
    with pytest.raises(UnknownObjectError, match="write it as 0x2147:1"):
        BOTH.find(text)


def test_an_object_that_nobody_knows_is_known_by_its_address_alone():
    entry = Catalogue().find("0x5000:3")
    assert (entry.address, entry.name, entry.data_type, str(entry)) == ((0x5000, 3), "", None, "5000:3")
    assert entry.decoded(b"\x01\xff") == "01 ff"
    with pytest.raises(RefusedError, match="5000:3: its data type is not known; give an EDS, or the type"):
        entry.encoded(1)


# What is known


def test_the_profile_names_what_the_eds_has_too_and_the_rest_keeps_the_name_of_the_eds():
    assert [str(entry) for entry in BOTH] == [
        "1000:0 (Device type)",
        "1017:0 (Producer heartbeat time)",
        "2000:0 (Grip.Number of entries)",
        "2000:1 (force_limit_nm)",
        "2000:2 (stroke_m)",
        "2000:3 (Grip trim)",
        "2001:0 (Force)",
        "2002:0 (Label)",
        "2003:0 (Label)",
        "2004:0 (Sealed)",
        "2010:0 (reach_rad)",
        "2011:0 (guess)",
    ]
    assert len(BOTH) == 12
    assert BOTH.names == [entry.name for entry in BOTH]


def test_the_standards_objects_are_known_but_not_counted_as_the_devices():
    assert len(Catalogue()) == 0
    assert list(Catalogue()) == []
    assert Catalogue().get((0x1017, 0)) == CatalogueEntry((0x1017, 0), "producer_heartbeat_time", DataType.UNSIGNED16)
    assert BOTH.get((0x1017, 0)).name == "Producer heartbeat time"
    assert BOTH.get((0x5000, 0)) is None


def test_access_class_and_evidence_are_those_of_who_knows_best():
    by_name = {entry.name: entry for entry in BOTH}
    assert not by_name["Sealed"].is_writable
    assert by_name["Sealed"].is_readable
    assert not BOTH.get((0x2001, 0)).is_readable
    assert not by_name["Grip.Number of entries"].is_writable  # const
    assert by_name["Producer heartbeat time"].parameter_class == "communication"
    assert by_name["Grip trim"].parameter_class == "tuning"
    assert by_name["force_limit_nm"].parameter_class == "limits"
    assert [entry.name for entry in BOTH if not entry.is_verified] == ["guess"]
    assert [entry.name for entry in BOTH if entry.needs_scaling] == ["reach_rad"]
    assert (by_name["force_limit_nm"].unit, by_name["Grip trim"].unit) == ("N·m", "")


# Values


def test_a_value_is_within_the_limits_of_the_profile_and_of_the_eds():
    entry = BOTH.find("force_limit_nm")  # the EDS: 10 to 100 on the wire, 1 to 10 N·m; the profile: at most 20 N·m
    assert entry.encoded(1.0) == b"\x0a\x00"
    assert entry.encoded(10.0) == b"\x64\x00"
    for value, raw in ((10.1, 101), (0.9, 9), (20.0, 200)):
        with pytest.raises(
            OutOfRangeError, match=rf"\(force_limit_nm\) {value} N·m: {raw} on the wire is outside 10 to 100, the limits of"
        ):
            entry.encoded(value)
    with pytest.raises(OutOfRangeError, match=r"2000:1 20\.1 N·m: must be at most 20"):
        entry.encoded(20.1)
    assert Catalogue(PROFILE).find("force_limit_nm").encoded(20.0) == b"\xc8\x00"  # without the EDS
    assert Catalogue(None, GRIPPER).find("Grip.Force").encoded(100) == b"\x64\x00"  # without the profile: as on the wire
    with pytest.raises(OutOfRangeError, match="101 on the wire is outside 10 to 100"):
        Catalogue(None, GRIPPER).find("Grip.Force").encoded(101)


def test_limits_of_an_eds_that_says_another_type_are_not_this_objects():
    assert BOTH.find("stroke_m").encoded(5.0) == struct.pack("<d", 5.0)
    assert (BOTH.find("stroke_m").low, BOTH.find("stroke_m").high) == (None, None)


def test_a_real32_may_be_at_its_limits_as_the_drive_rounds_them():
    entry = Catalogue(None, GRIPPER).find("Grip.Stroke")
    for limit in (0.1, 0.9):
        held = struct.pack("<f", limit)
        assert entry.encoded(limit) == entry.encoded(struct.unpack("<f", held)[0]) == held
        assert entry.decoded(held) == limit
    for outside in (0.0999, 0.9001):
        with pytest.raises(OutOfRangeError, match="the limits of the EDS"):
            entry.encoded(outside)


def test_a_scale_of_the_drive_is_asked_for():
    entry = BOTH.find("reach_rad")
    assert entry.encoded(2 * math.pi, SCALING) == (1000).to_bytes(4, "little")
    assert entry.decoded((1000).to_bytes(4, "little"), SCALING) == pytest.approx(2 * math.pi)
    with pytest.raises(DriveProfileError, match="the drive's scaling is needed"):
        entry.encoded(1.0)


def raw(kind):
    return CatalogueEntry((0x2000, 0), "value", kind)


@pytest.mark.parametrize(
    ("kind", "value", "data"),
    [
        (DataType.BOOLEAN, 1, b"\1"),
        (DataType.BOOLEAN, 0.0, b"\0"),
        (DataType.UNSIGNED8, 255.0, b"\xff"),
        (DataType.INTEGER16, -2, b"\xfe\xff"),
        (DataType.UNSIGNED64, 2**64 - 1, b"\xff" * 8),
        (DataType.INTEGER64, -(2**63), b"\0" * 7 + b"\x80"),
        (DataType.REAL32, 1, b"\0\0\x80\x3f"),
        (DataType.REAL64, 0.1, struct.pack("<d", 0.1)),
        (DataType.VISIBLE_STRING, "\0ÿ", b"\0\xff"),
        (DataType.OCTET_STRING, "0a FF", b"\x0a\xff"),
        (DataType.DOMAIN, "", b""),
    ],
)
def test_a_value_without_a_unit_is_as_on_the_wire(kind, value, data):
    assert raw(kind).encoded(value) == data
    assert raw(kind).encoded(raw(kind).decoded(data)) == data


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        (DataType.BOOLEAN, 2, "is outside the range of BOOLEAN"),
        (DataType.BOOLEAN, -1, "is outside the range of BOOLEAN"),
        (DataType.BOOLEAN, 0.5, "is not a whole number"),
        (DataType.UNSIGNED8, 256, "is outside the range of UNSIGNED8"),
        (DataType.UNSIGNED8, -1, "is outside the range of UNSIGNED8"),
        (DataType.UNSIGNED8, 1.5, "is not a whole number; UNSIGNED8 holds only whole numbers"),
        (DataType.UNSIGNED64, 2**64, "is outside the range of UNSIGNED64"),
        (DataType.UNSIGNED8, 10**400, "is outside the range of UNSIGNED8"),
        (DataType.REAL32, 1e39, "is outside the range of REAL32"),
        (DataType.REAL64, 10**400, "is outside the range of REAL64"),
        (DataType.REAL64, math.inf, "is outside the range of REAL64"),
        (DataType.REAL32, math.nan, "is outside the range of REAL32"),
        (DataType.INTEGER8, math.nan, "is not a whole number"),
        (DataType.UNSIGNED8, "1", "'1' is not a value of UNSIGNED8; expected a number"),
        (DataType.VISIBLE_STRING, 1, "1 is not a value of VISIBLE_STRING; expected a text"),
        (DataType.VISIBLE_STRING, "€", "outside ISO 8859-1"),
        (DataType.DOMAIN, 1, "1 is not a value of DOMAIN; expected hexadecimal text"),
        (DataType.OCTET_STRING, "0g", "'0g' is not hexadecimal text"),
    ],
)
def test_a_value_that_the_type_does_not_hold_is_refused_never_bent(kind, value, words):
    with pytest.raises(DriveProfileError, match=words) as caught:
        raw(kind).encoded(value)
    assert "2000:0 (value)" in str(caught.value)


values = st.one_of(st.integers(), st.floats(), st.text(max_size=8), st.sampled_from([10**400, 2**64, "ff"]))


@given(st.sampled_from([None, *DataType]), values)
def test_no_value_makes_an_object_raise_anything_but_a_refusal(kind, value):
    try:
        data = raw(kind).encoded(value)
    except DriveProfileError:
        return
    assert raw(kind).encoded(raw(kind).decoded(data)) == data


@given(st.sampled_from(list(DataType)), st.binary(max_size=9))
def test_what_a_device_sends_is_shown_so_that_it_gives_the_same_bytes(kind, data):
    if kind.size is not None:
        data = data[: kind.size].ljust(kind.size, b"\0")
    shown = raw(kind).decoded(data)
    if isinstance(shown, float) and not math.isfinite(shown):
        return
    assert raw(kind).encoded(shown) == (data if kind is not DataType.BOOLEAN else bytes([data != b"\0"]))
