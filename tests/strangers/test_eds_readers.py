"""Every EDS that we write, read as the programs of others read it: gocanopen, npm canopen, the canopen package.

dcf-tools, which Lely uses, is in tests/conformance. gocanopen's rule is written down here from its documents and its sources
(pkg/od, parser_v1.go, parser_v2.go, encoding.go, of 2025): Go's strconv decides what is a number, and one default that is none
refuses the whole file.
"""

import math
import os
import re
from configparser import RawConfigParser
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable

import drive_profiles
from drive_profiles import eds
from drive_profiles.eds.export import as_text
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from plant_emulator.data_sheets import data_sheets, data_sheets_of
from plant_emulator.robots.robot import load_robot, with_drives

VENDORS = Path(drive_profiles.__file__).parent / "vendors"
QUIRKS = Path(__file__).parents[1] / "drive_profiles" / "eds" / "quirks"
CORPUS = Path(os.environ.get("HIL_EDS_CORPUS", Path(__file__).parents[3] / "shared" / "eds"))
"""Makers' files, where they are: see tests/drive_profiles/eds/test_corpus.py."""
NODE = 5
REAL32, UNSIGNED32 = 8, 7
NAMES = sorted(path.stem for path in VENDORS.glob("*.toml") if Profile.load(path.stem).identity.device_type != 0x20194)


def texts():
    """Name and text of each: the committed ones, those that are generated, and those of robots with every vendor's drive."""
    yield from ((path.name, path.read_text(encoding="ascii")) for path in sorted(VENDORS.glob("*.eds")))
    yield from ((f"generated {name}", text) for name, text in data_sheets().items())
    robot = load_robot("reference")
    for name in NAMES:
        yield name, data_sheets_of(with_drives(robot, {2: name}))["axis2.eds"]


TEXTS = dict(texts())


# -- gocanopen ---------------------------------------------------------------------------------------------------------

_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_HEXADECIMAL = re.compile(r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)[pP][+-]?\d+")
_BITS = {1: 8, 2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32, 0x15: 64, 0x1B: 64}
_SIGNED = {2, 3, 4, 0x15}
_REALS, _TEXTS = {8, 0x11}, {9, 0xA, 0xF}


def parse_float(text):
    """Go's strconv.ParseFloat: decimal, or hexadecimal with an exponent of two; no bit pattern is a number to it."""
    if _DECIMAL.fullmatch(text):
        return float(text)
    if _HEXADECIMAL.fullmatch(text):
        return float.fromhex(text)
    raise ValueError(f"strconv.ParseFloat: parsing {text!r}: invalid syntax")


def parse_int(text, data_type):
    """Go's strconv.ParseInt and ParseUint with base 0 and the bits of the type."""
    bits, signed = _BITS[data_type], data_type in _SIGNED
    if not signed and text[:1] in {"+", "-"}:
        raise ValueError(f"strconv.ParseUint: parsing {text!r}: invalid syntax")
    value = int(text, 0)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    if not low <= value <= high:
        raise ValueError(f"strconv: parsing {text!r}: value out of range")
    return value


def gocanopen(text, *, version):
    """Defaults by section as one of gocanopen's parsers reads them; ValueError where it refuses the file."""
    parser = RawConfigParser()
    parser.optionxform = str
    parser.read_string(text)
    found = {}
    for name in parser.sections():
        section = parser[name]
        if not re.fullmatch(r"[0-9A-Fa-f]{4}(sub[0-9A-Fa-f]+)?", name) or section.get("ObjectType", "0x7") in {"0x8", "0x9"}:
            continue
        data_type = int(section["DataType"], 0)
        if version == 1 and "DefaultValue" not in section:
            found[name] = None  # the first parser leaves it out, the second takes it for an empty one
            continue
        value = re.sub(r"\+?\$NODEID\+?", "", section.get("DefaultValue", "")) or "0"
        if data_type in _REALS:
            found[name] = parse_float(value)
        elif data_type in _BITS:
            found[name] = parse_int(value, data_type)
        elif data_type not in _TEXTS:
            raise ValueError(f"[{name}] data type {data_type:#x}: type mismatch")
    return found


@pytest.mark.parametrize(("text", "value"), [("300", 300.0), ("1.5", 1.5), (".5e-3", 5e-4), ("-0", 0.0), ("0x1p-2", 0.25)])
def test_the_rule_of_go_takes_decimals(text, value):
    assert parse_float(text) == value


@pytest.mark.parametrize("text", ["0x43960000", "0x0", "", "1,5", "300 Hz", "3_0"])
def test_the_rule_of_go_takes_no_bit_pattern(text):
    with pytest.raises(ValueError, match="invalid syntax"):
        parse_float(text)


def test_a_bit_pattern_as_a_default_would_refuse_the_whole_file():
    text = TEXTS["emulated_drive.eds"].replace("DataType=0x0008\n", "DataType=0x0008\nDefaultValue=0x43960000\n", 1)
    for version in (1, 2):
        with pytest.raises(ValueError, match="0x43960000"):
            gocanopen(text, version=version)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("name", TEXTS)
def test_gocanopen_takes_every_file_of_ours(name, version):
    found = gocanopen(TEXTS[name], version=version)
    assert len(found) > 100


# -- the others --------------------------------------------------------------------------------------------------------


def entries(od):
    for thing in od.values():
        yield from [thing] if isinstance(thing, ODVariable) else thing.values()


@pytest.mark.parametrize("name", TEXTS)
def test_the_canopen_package_reads_no_other_number(tmp_path, name):
    (tmp_path / "x.eds").write_text(TEXTS[name], encoding="latin-1")
    od = canopen.import_od(str(tmp_path / "x.eds"), node_id=NODE)
    reals = [entry for entry in entries(od) if entry.data_type == REAL32]
    assert [entry.default for entry in reals] == [None] * len(reals)
    assert reals or name not in {"emulated_drive.eds", "schunk_pilz_prbt"}


@pytest.mark.ci
def test_npm_canopen_reads_no_other_number(master, tmp_path):
    paths = []
    for name, text in TEXTS.items():
        paths.append(tmp_path / f"{name}.eds".replace(" ", "_"))
        paths[-1].write_text(text, encoding="latin-1")
    found = master("eds", paths=[str(path) for path in paths])
    assert {each["path"] for each in found} == {str(path) for path in paths}
    reals = [each for each in found if each["type"] == REAL32]
    assert len(reals) > 50
    assert {each["stated"] for each in reals} == {None}
    assert any(each["stated"] for each in found if each["type"] == UNSIGNED32)


# -- files of others, as `drive-profiles eds convert` writes them ------------------------------------------------------


def has_reals(path):
    return re.search(rb"(?i)^\s*DataType\s*=\s*0x0*(8|11)\s*$", path.read_bytes().replace(b"\r", b""), re.MULTILINE) is not None


def converted():
    makers = [path for path in sorted(CORPUS.glob("*")) if path.suffix.lower() in {".eds", ".dcf"}]
    return [path for path in (*sorted(VENDORS.glob("*.eds")), *sorted(QUIRKS.glob("*.*")), *makers) if has_reals(path)]


@pytest.mark.slow
@pytest.mark.parametrize("path", converted(), ids=lambda path: path.name)
@pytest.mark.parametrize("kind", ["eds", "dcf"])
def test_a_real_number_that_a_converted_file_states_is_a_decimal(path, kind):
    """As its maker meant it: gocanopen and the canopen package read the same number, and no tool refuses the file for it."""
    description = eds.load(path, node_id=NODE)
    parser = RawConfigParser()
    parser.optionxform = str
    parser.read_string(as_text(description, kind))
    for name in parser.sections():
        section = parser[name]
        if "DataType" in section and int(section["DataType"], 0) in {DataType.REAL32, DataType.REAL64}:
            index, _, sub = name.partition("sub")
            variable = description.dictionary.get_variable(int(index, 16), int(sub or "0", 16))
            if "DefaultValue" in section:
                assert math.isclose(parse_float(section["DefaultValue"]), variable.default)
            if "ParameterValue" in section:
                assert math.isclose(parse_float(section["ParameterValue"]), variable.value)
