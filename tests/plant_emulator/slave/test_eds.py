"""The EDS of a dictionary, read by the canopen package and by configparser."""

from configparser import RawConfigParser

import canopen
import pytest

from drive_profiles import eds
from drive_profiles.standard.cia301 import DataType
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.eds import DeviceInfo, write_eds

INFO = DeviceInfo("device.eds", "The vendor", "The product", "ORDER-1", "A test device")


@pytest.fixture
def text(bench):
    return write_eds(bench.dictionary, INFO)


@pytest.fixture
def imported(text, tmp_path):
    path = tmp_path / "device.eds"
    path.write_text(text)
    return canopen.import_od(str(path), node_id=5)


def test_a_stranger_finds_every_entry_with_its_type_access_default_and_mapping(bench, imported):
    bench.dictionary.node_id = 5
    for entry in bench.dictionary:
        found = imported.get_variable(entry.index, entry.subindex)
        assert found is not None, str(entry)
        assert found.name == entry.name
        assert found.data_type == entry.data_type
        assert found.access_type == entry.access.value
        assert found.pdo_mappable == entry.mappable
        if not entry.data_type.is_real:
            assert found.default == entry.default_for(5)
        assert found.relative == entry.node_relative


@pytest.mark.ci
def test_a_stranger_finds_no_entry_that_is_not_there(bench, imported):
    addresses = {(entry.index, entry.subindex) for entry in bench.dictionary}
    found = set()
    for index, thing in imported.items():
        if index > 7:  # below: dummies
            subindices = [0] if isinstance(thing, canopen.objectdictionary.ODVariable) else list(thing)
            found |= {(index, subindex) for subindex in subindices}
    assert found == addresses


def test_a_stranger_finds_the_limits_of_whole_numbers(bench, imported):
    for entry in bench.dictionary:
        if entry.data_type.is_integer:
            found = imported.get_variable(entry.index, entry.subindex)
            assert (found.min, found.max) == (entry.low, entry.high)


def test_defaults_of_real_numbers_are_in_the_comments_only_and_in_decimals(text):
    parser = RawConfigParser()
    parser.read_string(text)
    section = parser["2003sub1"]
    assert {"DefaultValue", "LowLimit", "HighLimit"}.isdisjoint(section)
    assert "DefaultValue" not in parser["2003sub2"]
    comments = dict(parser["Comments"])
    assert comments.pop("lines") == str(len(comments))
    assert list(comments.values())[1:] == ["2003sub1 Gain: 1.5, at least 0.1, at most 1000", "2003sub2 Time: 0.25"]


@pytest.mark.parametrize("value", [0.1, 1.5, -2.0, 1e-30, 300.0, 0.0])
@pytest.mark.parametrize("data_type", [DataType.REAL32, DataType.REAL64])
def test_no_reader_takes_a_real_number_for_another(tmp_path, data_type, value):
    entry = Entry(0x2000, 0, "x", data_type, Access.RW, value)
    path = tmp_path / "x.eds"
    path.write_text(write_eds(Dictionary([entry]), INFO))
    ours = eds.load(path)
    assert ours.dictionary[0x2000].default is None
    assert [warning for warning in ours.warnings if "2000" in str(warning)] == []
    assert canopen.import_od(str(path))[0x2000].default is None


@pytest.mark.parametrize(
    ("low", "high", "stated"), [(0.0, 5.0, {"LowLimit": "0"}), (-1.0, 0.0, {"HighLimit": "0"}), (None, None, {})]
)
def test_a_limit_of_a_real_number_is_stated_where_every_reader_takes_it_for_the_same(low, high, stated):
    parser = RawConfigParser()
    parser.optionxform = str
    parser.read_string(write_eds(Dictionary([Entry(0x2000, 0, "x", DataType.REAL32, Access.RW, 0.0, low, high)]), INFO))
    assert {key: text for key, text in parser["2000"].items() if "Limit" in key} == stated


def test_the_device_info_says_what_the_device_can(text):
    parser = RawConfigParser()
    parser.read_string(text)
    device = parser["DeviceInfo"]
    assert (device["LSS_Supported"], device["Granularity"], device["SimpleBootUpSlave"]) == ("1", "1", "1")
    assert [rate for rate in (10, 20, 50, 125, 250, 500, 800, 1000) if device[f"BaudRate_{rate}"] != "1"] == []
    assert (device["CompactPDO"], device["GroupMessaging"], device["DynamicChannelsSupported"]) == ("0", "0", "0")
    assert parser["DummyUsage"]["Dummy0001"] == "1"


def test_records_and_arrays_keep_their_names_and_kinds(imported):
    assert isinstance(imported[0x1018], canopen.objectdictionary.ODRecord)
    assert isinstance(imported[0x1003], canopen.objectdictionary.ODArray)
    assert imported[0x1018].name == "Identity object"
    assert imported[0x2003].name == "Tuning"


def test_the_device_is_described(imported):
    device = imported.device_information
    assert (device.vendor_name, device.product_name, device.order_code) == ("The vendor", "The product", "ORDER-1")
    assert device.vendor_number == 0x1234
    assert (device.nr_of_RXPDO, device.nr_of_TXPDO) == (4, 4)
    assert 1_000_000 in device.allowed_baudrates


def test_object_lists_count_what_they_list(text, bench):
    parser = RawConfigParser()
    parser.read_string(text)
    listed = []
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        values = dict(parser[name])
        assert int(values.pop("supportedobjects")) == len(values)
        listed += [int(value, 16) for value in values.values()]
    assert sorted(listed) == sorted({entry.index for entry in bench.dictionary})


def test_equal_dictionaries_give_equal_text(bench, text, make_bench, synchronous):
    assert write_eds(make_bench(**synchronous).dictionary, INFO) == text


def test_values_at_the_moment_do_not_matter(bench, text):
    bench.write_value(0x2000, 0, 77)
    assert write_eds(bench.dictionary, INFO) == text


@pytest.mark.parametrize("value", ["two\nlines", " led by a space", "a ;comment"])
def test_what_an_ini_file_cannot_carry_is_refused(value):
    entry = Entry(0x2000, 0, "Label", DataType.VISIBLE_STRING, Access.RW, value)
    with pytest.raises(ValueError, match="does not fit"):
        write_eds(Dictionary([entry]), INFO)


@pytest.mark.parametrize(
    ("data_type", "value"),
    [
        (DataType.INTEGER8, -128),
        (DataType.INTEGER64, -(2**63)),
        (DataType.UNSIGNED64, 2**64 - 1),
        (DataType.OCTET_STRING, b"\x00\xff"),
        (DataType.BOOLEAN, True),
        (DataType.VISIBLE_STRING, "a name"),
    ],
)
def test_extreme_defaults_survive(tmp_path, data_type, value):
    entry = Entry(0x2000, 0, "x", data_type, Access.RW, value)
    path = tmp_path / "x.eds"
    path.write_text(write_eds(Dictionary([entry]), INFO))
    found = canopen.import_od(str(path))[0x2000].default
    assert found == entry.default
