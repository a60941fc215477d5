"""Parameter sets: the file, what its lines mean in bytes, and every reason against them at once."""

import math
import re
import struct

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drive_profiles import eds
from drive_profiles.errors import DriveProfileError, FileError, OutOfRangeError, RefusedError
from drive_profiles.family.catalogue import Catalogue, CatalogueEntry
from drive_profiles.family.profile import Profile
from drive_profiles.files import toml as files
from drive_profiles.parameter_set import parameters
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.parameter_set.formats import from_concise, to_concise
from drive_profiles.parameter_set.parameters import (
    CLASSES,
    Header,
    Item,
    ParameterSet,
    Write,
    from_values,
    item_of,
)
from drive_profiles.standard.cia301 import DataType, decode, encode
from drive_profiles.standard.units import Scaling

SCALING = Scaling(131072, 7.1)
DRIVE = Catalogue(Profile.load("emulated_drive"))
FACTS = {"class": "tuning", "description": "A value.", "source": "a test", "evidence": "definition"}
TYPES = tuple(kind for kind in DataType)
PROFILE = Profile.model_validate(
    {
        "name": "every_type",
        "title": "A device with an object of every type",
        "kind": "accelerometer",
        "identity": {"vendor_id": 1, "source": "a test", "evidence": "definition"},
        "sync": {"source": "a test", "evidence": "definition"},
        "store": {"note": "It keeps nothing.", "source": "a test", "evidence": "definition"},
        "parameters": {
            **{
                f"a_{kind.name.lower()}": {**FACTS, "index": 0x2000, "subindex": number, "data_type": kind.name}
                for number, kind in enumerate(TYPES)
            },
            "angle_rad": {**FACTS, "index": 0x2001, "subindex": 0, "data_type": "INTEGER32", "scale": "counts", "unit": "rad"},
            "torque_nm": {**FACTS, "index": 0x2001, "subindex": 1, "data_type": "INTEGER16", "scale": "per mille", "unit": "N·m"},
            "time_s": {**FACTS, "index": 0x2001, "subindex": 2, "data_type": "UNSIGNED16", "scale": 0.001, "unit": "s"},
            "first": {**FACTS, "index": 0x2002, "subindex": 0, "data_type": "UNSIGNED8", "order": -1},
            "last": {**FACTS, "index": 0x1F00, "subindex": 0, "data_type": "UNSIGNED8", "order": 9},
            "held": {**FACTS, "index": 0x2003, "subindex": 0, "data_type": "UNSIGNED8", "access": "ro"},
            "key": {**FACTS, "index": 0x2004, "subindex": 0, "data_type": "UNSIGNED8", "access": "wo"},
            "level": {**FACTS, "index": 0x2005, "subindex": 0, "data_type": "UNSIGNED8", "minimum": 2, "maximum": 5},
            "offset_rad": {
                **FACTS, "class": "commissioning", "index": 0x2006, "subindex": 0, "data_type": "REAL32", "unit": "rad",
            },
        },
    }
)  # fmt: skip
DEVICE = Catalogue(PROFILE)


def lines(**tables):
    """A set from `key: (value, unit)` or `key: (value, unit, type)` by class."""
    return ParameterSet(
        **{
            name: {key: Item(value=line[0], unit=line[1], type=line[2] if len(line) > 2 else None) for key, line in table.items()}
            for name, table in tables.items()
        }
    )


def read(text):
    return files.loads(text, ParameterSet)


def again(parameter_set):
    return read(parameter_set.dumps())


def reasons(parameter_set, catalogue=DEVICE, scaling=SCALING):
    with pytest.raises(RefusedError) as caught:
        parameter_set.writes(catalogue, scaling)
    return caught.value.reasons


def held_by(kind):
    """Bytes of a type that a device may hold, NaN and infinity aside."""
    if kind.size is None:
        return st.binary(max_size=12)
    if kind is DataType.BOOLEAN:
        return st.sampled_from([b"\0", b"\1"])
    if kind.is_real:
        return st.floats(width=8 * kind.size, allow_nan=False, allow_infinity=False).map(lambda value: encode(kind, value))
    return st.binary(min_size=kind.size, max_size=kind.size)


places = st.sampled_from([entry.address for entry in DEVICE if entry.is_writable and entry.is_readable and entry.name != "level"])


@st.composite
def devices(draw):
    """What a device holds: by place, bytes of the type of the object there."""
    chosen = draw(st.lists(places, unique=True, min_size=1))
    return {place: draw(held_by(DEVICE.get(place).data_type)) for place in chosen}


def pulled(held, *, is_raw=False):
    tables = {name: {} for name in CLASSES}
    for place, data in held.items():
        entry = DEVICE.get(place)
        shown = CatalogueEntry(place, entry.name, entry.data_type) if is_raw else entry
        key, item = item_of(shown, data, SCALING)
        tables[entry.parameter_class][key] = item
    return ParameterSet(**tables)


# The file


@given(devices(), st.booleans())
def test_what_a_device_holds_comes_back_from_the_file_bit_by_bit(held, is_raw):
    loaded = again(pulled(held, is_raw=is_raw))
    assert {write.address: write.data for write in loaded.writes(DEVICE, SCALING)} == held
    assert not loaded.is_edited


@given(devices(), st.booleans())
def test_a_file_that_is_written_again_is_the_same_text(held, is_raw):
    text = pulled(held, is_raw=is_raw).dumps()
    assert read(text).dumps() == text


@pytest.mark.slow
@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("is_raw", [False, True])
@given(st.data())
@settings(max_examples=40)
def test_every_type_passes_the_file(kind, is_raw, data):
    held = {(0x2000, TYPES.index(kind)): data.draw(held_by(kind))}
    assert {write.address: write.data for write in again(pulled(held, is_raw=is_raw)).writes(DEVICE, SCALING)} == held


@pytest.mark.parametrize("is_raw", [False, True])
def test_a_real32_stands_in_the_file_as_a_human_would_write_it(is_raw):
    place = (0x2000, TYPES.index(DataType.REAL32))
    for text in ("0.1", "25.0", "0.196", "1e-05", "3.4028235e+38", "1e-45", "-0.0"):
        assert f"value = {text}," in pulled({place: struct.pack("<f", float(text))}, is_raw=is_raw).dumps().replace(" }", ",")


@pytest.mark.parametrize(("kind", "value"), [
    (DataType.UNSIGNED64, 2**64 - 1), (DataType.INTEGER64, -(2**63)), (DataType.INTEGER64, 2**53 + 1),
])  # fmt: skip
def test_64_bits_do_not_pass_through_a_float(kind, value):
    key = f"a_{kind.name.lower()}"
    (write,) = again(lines(tuning={key: (value, "")})).writes(DEVICE)
    assert write.data == value.to_bytes(8, "little", signed=value < 0)


@pytest.mark.parametrize(
    "text", ['"', "\\", "\\u0041", "'''", '"""', "\n", "\r\n", "\t", "\0", "\x1f", "\x7f", "\x85", "\xa0", "ÿ", "#", " ]["]
)
def test_odd_characters_pass_the_file_in_values_names_keys_and_the_header(text):
    odd = ParameterSet(
        header=Header(title=text, firmware=text, not_read=(text, text)),
        tuning={"a_visible_string": Item(value=text, name=text), text: Item(value=1, unit=text)},
    )
    assert again(odd).model_copy(update={"header": odd.header}) == odd
    assert again(odd).header.model_copy(update={"hash": ""}) == odd.header


@given(st.text(st.characters(exclude_categories=["Cs"])), st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_passes_the_file(key, value):
    odd = ParameterSet(header=Header(title=value), limits={key: Item(value=value, name=value)})
    loaded = again(odd)
    # TOML knows one line end, and the reader takes the Windows one for it; JSON's escapes keep what is inside a string
    assert loaded.limits == odd.limits
    assert loaded.header.title == value


def test_the_header_passes_the_file_with_its_numbers_in_hexadecimal():
    header = Header(
        profile="emulated_drive", title="Axis 2", vendor_id=0x48494C01, product_code=0, revision=0xFFFFFFFF,
        serial_number=12, firmware="1.2", date="2025-11-21", not_read=("2000:1 refused",),
    )  # fmt: skip
    text = ParameterSet(header=header).dumps()
    assert "vendor_id = 0x48494C01\n" in text
    assert "revision = 0xFFFFFFFF\n" in text
    assert "serial_number = 12\n" in text
    assert read(text).header.model_copy(update={"hash": ""}) == header


def test_a_set_is_edited_when_its_values_are_not_those_of_its_hash():
    text = lines(tuning={"position_gain_per_s": (25.0, "1/s")}, limits={"torque_limit_nm": (7.1, "N·m")}).dumps()
    assert re.search(r'^hash = "sha256:[0-9a-f]{64}"$', text, re.MULTILINE)
    assert not read(text).is_edited
    assert not read(text.replace("[header]", '[header]\ntitle = "Axis 2"')).is_edited  # the header is not a value
    assert not read(text.replace("\n\n", "\n\n\n# a remark\n").replace("\n", "\r\n")).is_edited
    for old, new in (("25.0", "25.1"), ("position_gain", "velocity_gain"), ("1/s", "Hz"), ("[limits]", "[commissioning]")):
        assert read(text.replace(old, new)).is_edited, old
    assert not read(re.sub(r"hash = .*", "", text)).is_edited  # written by hand: nothing to compare with


def test_the_digest_does_not_depend_on_the_order_of_the_lines():
    one = lines(tuning={"a": (1, ""), "b": (2, "")})
    other = lines(tuning={"b": (2, ""), "a": (1, "")})
    assert one.digest() == other.digest() != lines(tuning={"a": (2, ""), "b": (1, "")}).digest()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[tuning]\na = { value = 1, type = "FLOAT" }', r":2: tuning\.a\.type: .*'FLOAT' is not a data type"),
        ("[tuning]\na = { value = true }", r":2: tuning\.a\.value"),
        ("[tuning]\na = { value = nan }", r":2: tuning\.a\.value"),
        ("[tuning]\na = { value = [1] }", r":2: tuning\.a\.value"),
        ("[tuning]\na = { unit = 's' }", r":2: tuning\.a\.value: is missing"),
        ("[tuning]\na = 1", r":2: tuning\.a"),
        ("[gains]\na = { value = 1 }", r":1: gains: unknown key"),
        ("[header]\nformat = 2", r":2: header\.format: found 2"),
        ("[tuning]\na = { value = 1 }\na = { value = 2 }", r":3"),
    ],
)
def test_a_file_that_is_no_set_is_refused_with_the_line(text, words):
    with pytest.raises(FileError, match=words):
        read(text)


def test_a_set_is_loaded_from_and_saved_to_a_file(tmp_path):
    parameter_set = lines(tuning={"level": (3, "")})
    path = tmp_path / "sets" / "axis 2.toml"
    parameter_set.save(path)
    assert path.read_text(encoding="utf-8") == parameter_set.dumps()
    assert ParameterSet.load(path).tuning == parameter_set.tuning
    with pytest.raises(RefusedError, match="already exists"):
        lines().save(path)
    assert ParameterSet.load(path).tuning == parameter_set.tuning
    lines().save(path, force=True)
    assert ParameterSet.load(path).tuning == {}


def test_what_is_written_can_be_read_up_to_the_bound_and_is_refused_beyond_it(tmp_path, monkeypatch):
    held = lines(tuning={f"0x2000:{n}": (n, "") for n in range(9)})
    length = len(held.dumps().encode())
    monkeypatch.setattr(parameters, "MAX_BYTES", length)
    held.save(tmp_path / "a.toml")
    assert ParameterSet.load(tmp_path / "a.toml").tuning == held.tuning
    monkeypatch.setattr(parameters, "MAX_BYTES", length - 1)
    for refused in (held.dumps, lambda: held.save(tmp_path / "b.toml")):
        with pytest.raises(RefusedError, match=rf"would be a file of {length} bytes; expected at most .* \(--classes\)"):
            refused()
    assert not (tmp_path / "b.toml").exists()
    with pytest.raises(FileError, match="is larger than"):
        ParameterSet.load(tmp_path / "a.toml")


# What the lines mean


def test_names_and_addresses_mean_the_objects_of_the_catalogue():
    parameter_set = lines(
        tuning={"position_gain_per_s": (25.0, "1/s"), "0x2101:1": (0.5, "N·m·s/rad"), "2101sub3": (300, "Hz")},
        limits={"TORQUE_limit_nm": (7.1, "N·m")},
    )
    assert {write.address: write.data for write in parameter_set.writes(DRIVE, SCALING)} == {
        (0x2100, 1): struct.pack("<f", 25.0),
        (0x2101, 1): struct.pack("<f", 0.5),
        (0x2101, 3): struct.pack("<f", 300.0),
        (0x6072, 0): b"\xe8\x03",
    }


def test_a_line_with_a_type_is_as_on_the_wire_also_where_nobody_knows_the_object():
    parameter_set = lines(tuning={"0x5000:1": (7, "", "UNSIGNED16"), "0x6072": (1000, "", "UNSIGNED16")})
    writes = parameter_set.writes(DRIVE)  # no scaling is asked for
    assert [(write.address, write.data) for write in writes] == [((0x5000, 1), b"\x07\x00"), ((0x6072, 0), b"\xe8\x03")]
    assert [write.data for write in parameter_set.writes(Catalogue())] == [b"\x07\x00", b"\xe8\x03"]


def test_objects_are_written_in_the_order_of_the_profile_and_else_of_the_file():
    parameter_set = lines(tuning={"last": (1, ""), "level": (3, ""), "a_unsigned8": (1, ""), "first": (1, "")})
    assert [write.entry.name for write in parameter_set.writes(DEVICE)] == ["first", "level", "a_unsigned8", "last"]


def test_classes_that_are_not_wanted_are_left_out_whatever_is_wrong_in_them():
    parameter_set = lines(
        tuning={"level": (3, "")}, commissioning={"offset_rad": (0.5, "rad")}, communication={"nonsense": (1, "")}
    )
    writes = parameter_set.writes(DEVICE, classes={"tuning", "commissioning"})
    assert [(write.entry.name, write.parameter_class) for write in writes] == [
        ("level", "tuning"),
        ("offset_rad", "commissioning"),
    ]
    assert [write.entry.name for write in parameter_set.writes(DEVICE, classes=("tuning",))] == ["level"]
    assert parameter_set.writes(DEVICE, classes=()) == []


WRONG = [
    ("tuning", "position_gain", (25.0, "1/s"), "no object 'position_gain'"),
    ("tuning", "a_real32x", (25.0, "", "REAL32"), "a line with a type needs the address of its object, such as 0x2147:1"),
    ("tuning", "0x5000:1", (1, ""), "its data type is not known; give an EDS, or the type"),
    ("tuning", "time_s", (1.0, "ms"), "has the unit ms; expected s"),
    ("tuning", "angle_rad", (1.0, ""), "has no unit; expected rad"),
    ("tuning", "a_real32", (1.0, "s"), "has the unit s; expected no unit"),
    ("limits", "level", (6, ""), "2005:0 6: is outside 2 to 5"),
    ("limits", "0x2005:0", (1, "", "UNSIGNED8"), "2005:0 1: is outside 2 to 5"),
    ("tuning", "a_unsigned8", (256, ""), "is outside the range of UNSIGNED8"),
    ("tuning", "a_integer8", (-129, ""), "is outside the range of INTEGER8"),
    ("tuning", "a_boolean", (2, ""), "is outside the range of BOOLEAN"),
    ("tuning", "0x5000:2", (2, "", "BOOLEAN"), "is outside the range of BOOLEAN"),
    ("tuning", "0x5000:3", (1e39, "", "REAL32"), "is outside the range of REAL32"),
    ("tuning", "a_real64", (10**400, ""), "is outside"),
    ("tuning", "0x5000:4", (10**400, "", "REAL64"), "is outside the range of REAL64"),
    ("tuning", "0x5000:5", ("5 €", "", "VISIBLE_STRING"), "outside ISO 8859-1"),
    ("tuning", "0x5000:6", (1.5, "", "UNSIGNED8"), "is not a whole number"),
    ("tuning", "a_visible_string", (1, ""), "1 is not a value of VISIBLE_STRING"),
    ("tuning", "a_domain", ("0g", ""), "non-hexadecimal"),
    ("tuning", "a_unsigned16", ("1", ""), "'1' is not a value of UNSIGNED16"),
    ("tuning", "0x2000:5", (1, "", "UNSIGNED64"), "the set says UNSIGNED64"),
    ("tuning", "held", (1, ""), "2003:0 (held) is read only"),
    ("tuning", "key", (1, ""), "2004:0 (key) is write-only, so it cannot be read back"),
    ("communication", "vendor_id", (1, ""), "1018:1 (vendor_id) is read only"),
    ("tuning", "0x6040:0", (15, "", "UNSIGNED16"), "6040:0 (control_word) is a command; a parameter set cannot contain commands"),
    ("tuning", "target_position", (0, ""), "607A:0 (target_position) is a command"),
    ("communication", "0x1010:1", (0x65766173, "", "UNSIGNED32"), "1010:1 is a command"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "key", "line", "words"), WRONG)
def test_a_line_that_cannot_be_written_is_refused_with_its_key_and_the_reason(table, key, line, words):
    (reason,) = reasons(lines(**{table: {key: line}, "communication" if table == "limits" else "limits": {"first": (1, "")}}))
    assert reason.startswith(f"{key}: ")
    assert words in reason


def test_every_line_that_cannot_be_written_is_named_at_once():
    tables = {name: {key: line for table, key, line, _ in WRONG if table == name} for name in CLASSES}
    found = reasons(lines(**tables))
    expected = [(key, words) for name in CLASSES for table, key, _, words in WRONG if table == name]
    assert len(found) == len(expected)
    for reason, (key, words) in zip(found, expected, strict=True):
        assert reason.startswith(f"{key}: ")
        assert words in reason


def test_an_object_that_is_in_the_set_twice_is_refused_however_it_is_spelled():
    twice = lines(tuning={"level": (3, ""), "0x2005:0": (3, ""), "first": (1, "")}, limits={"LEVEL": (4, "")})
    assert reasons(twice) == ("0x2005:0: 2005:0 (level) is in the set twice", "LEVEL: 2005:0 (level) is in the set twice")


def test_a_name_of_two_objects_is_refused_with_both():
    text = "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\n"
    for index in ("2000", "2001"):
        text += f"[{index}]\nParameterName=Gain\nObjectType=7\nDataType=7\nAccessType=rw\n"
    (reason,) = reasons(lines(tuning={"gain": (1, "")}), Catalogue(None, eds.loads(text.encode())))
    assert reason == "gain: 'gain' may be any of 2000:0 (Gain), 2001:0 (Gain); give its address instead of a name"


def test_a_scale_of_the_drive_is_asked_for_by_the_lines_that_need_it():
    parameter_set = lines(tuning={"angle_rad": (1.0, "rad"), "torque_nm": (1.0, "N·m"), "time_s": (1.0, "s")})
    assert [reason.split(":")[0] for reason in reasons(parameter_set, DEVICE, None)] == ["angle_rad", "torque_nm"]
    assert len(parameter_set.writes(DEVICE, SCALING)) == 3


@given(st.sampled_from([entry.name for entry in DEVICE]), st.integers() | st.floats(allow_nan=False, allow_infinity=False))
@example("offset_rad", 8758764033)
def test_a_number_is_written_as_it_is_to_half_a_step_or_refused_never_clamped(name, value):
    entry = DEVICE.find(name)
    try:
        (write,) = lines(tuning={name: (value, entry.unit)}).writes(DEVICE, SCALING)
    except RefusedError as error:
        refused = error.reasons
    else:
        refused = ()
    assert all(reason.startswith(f"{name}: ") for reason in refused)
    if refused:
        return
    held = entry.decoded(write.data, SCALING)
    step = entry.parameter.value_per_step(SCALING)
    # half a step to the REAL32, and half a step from there to its shortest decimal
    half = max(abs(value) * 1.2e-7, 3e-45) if entry.data_type.is_real else step / 2 * (1 + 1e-6)
    assert held == value or abs(held - value) <= half


@given(st.lists(st.tuples(
    st.sampled_from(CLASSES),
    st.one_of(st.text(max_size=8), st.sampled_from([*(entry.name for entry in DEVICE), "0x2005", "6040", "5000:1"])),
    st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text(max_size=6)),
    st.sampled_from(["", "s", "rad", "N·m"]),
    st.one_of(st.none(), st.sampled_from(list(DataType.__members__))),
), max_size=8))  # fmt: skip
@settings(suppress_health_check=[HealthCheck.too_slow])
def test_no_set_raises_anything_but_a_refusal(drawn):
    tables = {name: {} for name in CLASSES}
    for name, key, value, unit, kind in drawn:
        tables[name][key] = Item(value=value, unit=unit, type=kind)
    try:
        writes = ParameterSet(**tables).writes(DEVICE, SCALING)
    except RefusedError as error:
        refused = error.reasons
    else:
        assert len({write.address for write in writes}) == len(writes) == sum(map(len, tables.values()))
        refused = ()
    assert all(any(reason.startswith(f"{key}: ") for table in tables.values() for key in table) for reason in refused)


@pytest.mark.parametrize(
    ("index", "does"),
    [(0x6040, True), (0x6840, True), (0x9840, True), (0x7060, True), (0x607A, True), (0x687A, True), (0x1010, True),
     (0x1F51, True), (0x6041, False), (0x6065, False), (0x6865, False), (0xA040, False), (0x2040, False), (0x1017, False)],
)  # fmt: skip
def test_what_commands_a_drive_is_told_from_what_sets_it_up_on_every_axis(index, does):
    assert is_command((index, 0)) == does


def test_the_set_point_of_a_makers_own_mode_is_a_command():
    profile = Profile.load("maxon_epos2")
    assert is_command((0x2062, 0), profile)
    assert not is_command((0x2062, 0))
    assert "command" in reasons(lines(communication={"position_mode_target": (0, "")}), Catalogue(profile))[0]


def test_every_command_that_the_emulated_drive_has_is_refused():
    commands = [entry for entry in DRIVE if is_command(entry.address)]
    for entry in commands:
        assert "command" in reasons(lines(tuning={entry.name: (0, entry.unit)}), DRIVE)[0]


# Differences


def test_differences_are_in_the_order_of_the_left_set_and_name_what_only_one_has():
    left = lines(tuning={"b": (1, "s"), "a": (2.0, "s")}, limits={"same": (3, "")})
    right = lines(tuning={"a": (3.0, "s"), "new": ("x", "")}, limits={"same": (3, "")})
    assert left.differences(right) == [("b", 1, None, "s"), ("a", 2.0, 3.0, "s"), ("new", None, "x", "")]
    assert [tuple(difference)[1:3] for difference in right.differences(left)] == [(3.0, 2.0), ("x", None), (None, 1)]
    assert left.differences(left) == []


def test_another_unit_or_type_is_a_difference_another_name_or_class_is_not():
    one = lines(tuning={"a": (1, "s"), "b": (1, "", "UNSIGNED8"), "c": (1, "")})
    assert [each.key for each in one.differences(lines(tuning={"a": (1, "ms"), "b": (1, "", "INTEGER8"), "c": (1, "")}))] == [
        "a",
        "b",
    ]
    assert (
        one.differences(ParameterSet(limits={key: item.model_copy(update={"name": "n"}) for key, item in one.tuning.items()}))
        == []
    )


@given(devices(), devices())
def test_two_sets_without_a_difference_write_the_same(one, other):
    differences = pulled(one).differences(pulled(other))
    differing = {place for place in one.keys() | other.keys() if one.get(place) != other.get(place)}
    zeros = {
        p for p in differing if DEVICE.get(p).data_type.is_real and p in one and p in other and decode_is_zero(p, one, other)
    }
    assert {DEVICE.find(each.key, whole=True).address for each in differences} == differing - zeros  # -0.0 equals 0.0


def decode_is_zero(place, *devices_):
    return all(decode(DEVICE.get(place).data_type, device[place]) == 0 for device in devices_)


# A DCF's values


def test_the_values_of_a_dcf_are_the_set_that_writes_them():
    values = {
        (0x1000, 0): 0x20192, (0x1010, 1): 1, (0x1017, 0): 100, (0x2000, 0): True, (0x2001, 0): 1000, (0x2001, 2): 250,
        (0x2003, 0): 1, (0x2006, 0): 0.1, (0x5000, 0): 5, (0x6040, 0): 6, (0x2000, 8): "text", (0x2000, 9): b"\x01\xff",
    }  # fmt: skip
    parameter_set = from_values(DEVICE, values, lambda entry: SCALING)
    assert [(name, key, item.value, item.unit) for name, key, item in parameter_set.items()] == [
        ("tuning", "0x1017:0", 100, ""),
        ("tuning", "a_boolean", 1, ""),
        ("tuning", f"a_{TYPES[8].name.lower()}", "text", ""),
        ("tuning", f"a_{TYPES[9].name.lower()}", "01 ff", ""),
        ("tuning", "angle_rad", pytest.approx(1000 / SCALING.counts_per_rad), "rad"),
        ("tuning", "time_s", 0.25, "s"),
        ("commissioning", "offset_rad", 0.1, "rad"),
    ]
    assert parameter_set.header.not_read == (
        "1000:0 is read only",
        "1010:1 is in no object of the file",
        "2003:0 is read only",
        "5000:0 is in no object of the file",
        "6040:0 is a command",
    )
    written = {write.address: write.data for write in again(parameter_set).writes(DEVICE, SCALING)}
    left_out = {(0x1000, 0), (0x1010, 1), (0x2003, 0), (0x5000, 0), (0x6040, 0)}
    assert written == {place: encode(DEVICE.get(place).data_type, values[place]) for place in values.keys() - left_out}


def test_without_the_drive_a_dcf_gives_raw_lines_where_the_drive_decides_the_scale():
    parameter_set = from_values(DEVICE, {(0x2001, 0): 1000, (0x2001, 2): 250})
    assert {key: (item.value, item.unit, item.type) for _, key, item in parameter_set.items()} == {
        "0x2001:0": (1000, "", "INTEGER32"),
        "time_s": (0.25, "s", None),
    }
    assert [write.data for write in parameter_set.writes(DEVICE)] == [b"\xe8\x03\0\0", b"\xfa\0"]


@pytest.mark.parametrize("value", [256, -1, "text", b"\1", 1.5])
def test_a_value_of_a_dcf_that_its_object_does_not_hold_is_listed(value):
    parameter_set = from_values(DEVICE, {(0x2005, 0): value})
    assert list(parameter_set.items()) == []
    (reason,) = parameter_set.header.not_read
    assert reason.startswith("2005:0 (level): ")


def test_what_is_no_finite_number_has_no_line():
    for value in (math.nan, math.inf, -math.inf):
        for kind in (DataType.REAL32, DataType.REAL64):
            for entry in (CatalogueEntry((0x2000, 0), "x", kind), DEVICE.find(f"a_{kind.name}")):
                with pytest.raises(ValueError, match="is not a finite number"):
                    item_of(entry, encode(kind, value), None)
    (reason,) = from_values(DEVICE, {(0x2006, 0): math.nan}).header.not_read
    assert reason == "2006:0 (offset_rad): nan is not a finite number"


# Concise DCF


@given(devices())
def test_a_concise_dcf_holds_what_was_put_into_it(held):
    writes = pulled(held).writes(DEVICE, SCALING)
    assert from_concise(to_concise(writes)) == held
    assert to_concise(writes)[:4] == len(held).to_bytes(4, "little")


def test_a_concise_dcf_is_laid_out_as_the_standard_says():
    write = Write(CatalogueEntry((0x1017, 0), "", DataType.UNSIGNED16), b"\xe8\x03", 1000, "communication")
    assert to_concise([write]) == bytes.fromhex("01000000 1710 00 02000000 e803")
    assert to_concise([]) == b"\0\0\0\0"
    assert from_concise(b"\0\0\0\0") == {}


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("", "begins with a count of 4 bytes, but the file has only 0 bytes"),
        ("010000", "begins with a count of 4 bytes, but the file has only 3 bytes"),
        ("01000000", "entry 1 of 1 of the concise DCF is cut off at byte 4"),
        ("ffffffff 1710 00 00000000", "entry 2 of 4294967295 of the concise DCF is cut off at byte 11"),
        ("01000000 1710 00 02000000 e8", "entry 1, 1017:0, states 2 bytes, but only 1 are left"),
        ("01000000 1710 00 ffffffff e803", "states 4294967295 bytes, but only 2 are left"),
        ("01000000 1710 00 02000000 e803 00", "1 bytes follow the last of 1 entries of the concise DCF"),
        ("00000000 00", "1 bytes follow the last of 0 entries"),
    ],
)
def test_a_concise_dcf_that_does_not_add_up_is_refused(data, words):
    with pytest.raises(RefusedError, match=words):
        from_concise(bytes.fromhex(data))


entries = st.builds(
    lambda index, subindex, length, data: struct.pack("<HBI", index, subindex, length if length < 9 else len(data)) + data,
    st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.integers(0, 12), st.binary(max_size=8),
)  # fmt: skip


@given(st.one_of(
    st.binary(max_size=64),
    st.builds(lambda count, parts: struct.pack("<I", count) + b"".join(parts), st.integers(0, 5), st.lists(entries, max_size=5)),
))  # fmt: skip
def test_no_bytes_make_the_reading_of_a_concise_dcf_raise_anything_but_a_refusal(data):
    try:
        found = from_concise(data)
    except RefusedError:
        return
    assert sum(7 + len(value) for value in found.values()) <= len(data) - 4


@pytest.mark.ci
@given(devices(), st.integers(0))
def test_a_concise_dcf_that_is_cut_anywhere_is_refused(held, at):
    data = to_concise(pulled(held).writes(DEVICE, SCALING))
    with pytest.raises(RefusedError):
        from_concise(data[: at % len(data)])


def test_a_refusal_is_an_error_of_the_package():
    assert issubclass(RefusedError, DriveProfileError)
    assert issubclass(OutOfRangeError, DriveProfileError)
