"""Profiles that rest on a vendor's EDS, held against that file.

The files are the vendors' and not ours, so they are not here: the test looks for a folder of vendors' files where the environment
variable HIL_EDS_CORPUS says, else beside the repository, and is skipped where there is none.
"""

import os
import re
from functools import cache
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable

from drive_profiles.eds import Description, load
from drive_profiles.family.parameter import LIMITS, Fact, Parameter
from drive_profiles.family.profile import VENDORS, Profile
from drive_profiles.standard.object_address import object_address
from tests.drive_profiles.profiles import ALL_DRIVES

FILES = {
    "elmo_gold": ("Elmo_Gold.eds",),
    "harmonic_drive_yukondrive": ("HarmonicDriveAG_YukonDrive-1021_V4.15.EDS",),
    "kollmorgen_rgm": ("Kollmorgen_RGM_V2.eds",),
    "maxon_epos2": ("maxon_EPOS2-50-5.eds",),
    "maxon_epos4": ("maxon_EPOS4-Module-50-5.eds",),
    "maxon_epos4/70-15": ("maxon_EPOS4-70-15.eds",),
    "maxon_epos4/module-24-1.5": ("maxon_EPOS4-Module-24-1.5_fw0x6050.eds",),
    "nanotec_cl4e": ("Nanotec_CL4-E-1-12.eds",),
    "nanotec_cl4e/cl4-e-2-12": ("Nanotec_CL4-E-2-12.eds",),
    "nanotec_cl4e/pd4-e": ("Nanotec_PD4-EB59CD-E-65-2.eds",),
    "novanta_eve": ("Ingenia_EVE-XCR-C_1.8.1.eds",),
    "schunk_pilz_prbt": ("Schunk_0_63.eds",),
    "schunk_pilz_prbt/prbt": ("Pilz_PRBT_0_1.dcf",),
    "schunk_pilz_prbt/prl-120": ("Schunk_PRL120.eds",),
    "technosoft_ipos": ("Technosoft_iPOS.D.v1.04.eds",),
    "technosoft_ipos/isd860": ("Technosoft_ISD860.dcf",),
    "trinamic_tmcm16xx": ("Trinamic_TMCM-1617.eds",),
    "trinamic_tmcm16xx/tmcm-1633": ("Trinamic_TMCM-1633.eds",),
    "trinamic_tmcm16xx/tmcm-1636": ("Trinamic_TMCM-1636_Fw1.12.eds",),
    "trinamic_tmcm16xx/tmcm-1670": ("Trinamic_TMCM-1670.eds",),
    "yiyou_euservo": ("Yiyou_EuServo_V1.4.eds",),
    "zeroerr_erob": ("ZeroErr_eDriver_V1.5.eds",),
}
"""By profile or product; where there are two, either may be the source of a parameter."""

OTHER_MEANING = {
    "trinamic_tmcm16xx/tmcm-1633": {(0x2050, 0), (0x2070, 1)},  # the number of entries; the actual angle
    "trinamic_tmcm16xx/tmcm-1670": {(0x2050, 0)},
}
"""Objects of a product at the address of a parameter that it does not have: another thing by their name in the file."""
ACCESS = {"rw": "rw", "rwr": "rw", "rww": "rw", "ro": "ro", "const": "ro", "wo": "wo"}
BY_EDS = {name: [p for p in profile.parameters.values() if p.evidence == "eds"] for name, profile in ALL_DRIVES.items()}

each_file = pytest.mark.parametrize("name", FILES)


def folder() -> Path:
    """A folder of vendors' files."""
    named = os.environ.get("HIL_EDS_CORPUS")
    return Path(named) if named else Path(__file__).resolve().parents[4] / "shared" / "eds"


read = cache(load)


def described(name: str) -> list[Description]:
    missing = [file for file in FILES[name] if not (folder() / file).is_file()]
    if missing:
        pytest.skip(f"no {', '.join(missing)}: HIL_EDS_CORPUS names no folder of vendors' files that has it")
    return [read(folder() / file) for file in FILES[name]]


def variable(description: Description, parameter: Parameter) -> ODVariable | None:
    return variable_at(description, parameter.index, parameter.subindex)


def variable_at(description: Description, index: int, subindex: int) -> ODVariable | None:
    """The entry that the file itself has: canopen makes up the members of an array that are not there."""
    item = description.dictionary.get(index)
    if isinstance(item, ODVariable):
        return item if subindex == 0 else None
    return None if item is None else item.subindices.get(subindex)


def named(table: Fact | None) -> list[str]:
    """The objects that a table of facts names."""
    values = () if table is None else (getattr(table, name) for name in type(table).model_fields if name not in Fact.model_fields)
    texts = [text for value in values for text in (value if isinstance(value, tuple) else (value,))]
    return [text for text in texts if isinstance(text, str) and re.fullmatch("[0-9A-F]{4}:[0-9A-F]{1,2}", text)]


def limit_faults(parameter: Parameter, entry: ODVariable) -> list[str]:
    """Limits of the file that the profile lacks or exceeds.

    What is only read needs none, and one that follows the encoder or the rated torque cannot be compared.
    """
    if parameter.access == "ro" or isinstance(parameter.scale, str) or parameter.data_type not in LIMITS:
        return []
    faults = []
    for side, stated, limit, bare in (
        (1, parameter.minimum, entry.min, LIMITS[parameter.data_type][0]),
        (-1, parameter.maximum, entry.max, LIMITS[parameter.data_type][1]),
    ):
        if limit is None or limit == bare:
            continue
        expected = limit * parameter.scale
        if stated is None or side * stated < side * expected - 1e-9 * abs(expected):
            faults.append(f"limit {stated}, the file has {expected:g}")
    return faults


def faults(parameter: Parameter, entry: ODVariable | None) -> list[str]:
    """Where a parameter and an entry of the file disagree."""
    if entry is None:
        return ["not in the file"]
    found = []
    if entry.data_type != parameter.type:
        found.append(f"type {parameter.data_type}, the file has {entry.data_type:#x}")
    if ACCESS[entry.access_type] != parameter.access:
        found.append(f"access {parameter.access}, the file has {entry.access_type}")
    if entry.pdo_mappable != parameter.mappable:
        found.append(f"mappable {parameter.mappable}, the file has {entry.pdo_mappable}")
    if parameter.default is not None and (getattr(entry, "relative", False) or entry.default != parameter.default):
        found.append(f"default {parameter.default!r}, the file has {entry.default!r}")
    return found + limit_faults(parameter, entry)


def test_every_profile_that_rests_on_an_eds_names_its_file():
    no_file = {"nanotec_cl4e/cl4-e-2-12-v2213"}  # its identity says so: unverified
    assert {name for name, parameters in BY_EDS.items() if parameters} - no_file <= set(FILES)
    assert not any(ALL_DRIVES[name].identity.is_verified for name in no_file)


@pytest.mark.slow
@each_file
def test_parameters_are_as_the_vendor_states_them(name):
    descriptions = described(name)
    wrong = []
    for parameter in BY_EDS[name]:
        each = [faults(parameter, variable(description, parameter)) for description in descriptions]
        if all(each):
            wrong.append(f"{parameter.written_address}: {min(each, key=len)}")
    assert BY_EDS[name]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
@each_file
def test_limits_are_no_tighter_than_the_products_own(name):
    """Else what the drive holds may not go back; what the first product's file does not decide is no limit of a file."""
    descriptions, first = described(name), ALL_DRIVES[name.partition("/")[0]]
    wrong = []
    for key, parameter in ALL_DRIVES[name].parameters.items():
        entries = [entry for description in descriptions if (entry := variable(description, parameter)) is not None]
        if parameter.evidence != "eds" or isinstance(parameter.scale, str) or not entries or is_deliberate(first, key):
            continue
        for side, stated, limits in (
            (1, parameter.minimum, [entry.min for entry in entries]),
            (-1, parameter.maximum, [entry.max for entry in entries]),
        ):
            known = [limit * parameter.scale for limit in limits if limit is not None]
            if stated is not None and known and side * stated > side * known[0] + 1e-9 * abs(known[0]):
                wrong.append(f"{parameter.written_address} ({key}): limit {stated}, the file has {known}")
    assert not wrong, "\n".join(wrong)


def is_deliberate(first: Profile, key: str) -> bool:
    """True where the first product's own limits are tighter than those of its file: by a document, not by the product."""
    parameter = first.parameters.get(key)
    if parameter is None:
        return False
    entries = [variable(description, parameter) for description in described(first.name)]
    limits = [(entry.min, entry.max) for entry in entries if entry is not None]
    return (parameter.minimum, parameter.maximum) not in [
        tuple(None if limit is None else limit * parameter.scale for limit in pair) for pair in limits
    ]


@each_file
def test_what_a_product_does_not_have_is_not_in_its_file(name):
    family, _, product = name.partition("/")
    absent = next((each.absent for each in ALL_DRIVES[family].products if each.name == product), ())
    first, own = ALL_DRIVES[family].parameters, {p.address: key for key, p in ALL_DRIVES[name].parameters.items()}
    for description in described(name):
        # an object of the same address may be there, and be another parameter of this product
        there = [key for key in absent if variable(description, first[key]) is not None and first[key].address not in own]
        assert not [key for key in there if first[key].address not in OTHER_MEANING.get(name, {})]


@each_file
def test_identity_is_as_the_vendor_states_it(name):
    identity = ALL_DRIVES[name].identity
    if identity.evidence != "eds":
        pytest.skip(f"the identity of {name} is by {identity.evidence}")
    for description in described(name):
        device_type = variable_at(description, 0x1000, 0)
        assert not description.vendor_id or description.vendor_id == identity.vendor_id
        assert (description.product_code or None) == identity.product_code
        assert identity.revision in {None, description.revision}
        assert identity.covers(description.revision)
        if device_type is not None and device_type.default is not None:
            assert device_type.default == identity.device_type
        elif "/" not in name:
            assert identity.device_type is None


MODE_BITS = {"PP": 0, "PV": 2, "TQ": 3, "HM": 5, "IP": 6, "CSP": 7, "CSV": 8, "CST": 9}
"""Bits of 6502h, CiA 402."""


@each_file
def test_modes_are_those_of_6502h(name):
    profile = ALL_DRIVES[name]
    modes, descriptions = profile.modes, described(name)
    stated = [entry.default for d in descriptions if (entry := variable_at(d, 0x6502, 0)) is not None and entry.default]
    if modes.evidence != "eds" or not stated:
        pytest.skip(f"6502h has no value in the file of {name}, or the modes are by {modes.evidence}")
    assert {mode for mode, bit in MODE_BITS.items() if stated[0] >> bit & 1} == set(modes.names)


@each_file
def test_objects_beside_the_parameters_are_in_the_file(name):
    """Torque, encoder, store: what they name is there; what decides the host's part may be mapped where the answer is yes."""
    profile = ALL_DRIVES[name]
    for description in described(name):
        for table in (profile.torque, profile.encoder, profile.load_encoder, profile.store):
            for address in named(table):
                assert variable_at(description, *object_address(address)) is not None, f"{type(table).__name__}: {address}"
        able = profile.capabilities
        for answer, index in (
            (able.host_closed, 0x6071), (able.reference_correction, 0x607A), (able.torque_offset, 0x60B2),
        ):  # fmt: skip
            entry = variable_at(description, index, 0)
            if answer.answer == "yes":
                assert entry is not None, f"{index:04X}h"
                assert entry.pdo_mappable, f"{index:04X}h"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, []),
        ({"index": 0x2FFF}, ["not in the file"]),
        ({"data_type": "INTEGER16"}, ["type INTEGER16, the file has 0x5"]),
        ({"access": "ro"}, ["access ro, the file has rw"]),
        ({"mappable": True}, ["mappable True, the file has False"]),
        ({"default": 7}, ["default 7, the file has"]),
        ({"minimum": 0.0}, ["limit 0.0, the file has 1"]),
        ({"maximum": 9.0}, ["limit 9.0, the file has 8"]),
        ({"maximum": None}, ["limit None, the file has 8"]),
        ({"minimum": 2.0, "maximum": 7.0}, []),
    ],
)
def test_a_disagreement_is_found(change, words):
    """With the project's own file, which is always there: the order of the notch, an UNSIGNED8 of 1 to 8."""
    parameter = Profile.load("emulated_drive").parameter("notch_1.order").model_copy(update=change)
    found = faults(parameter, variable(load(VENDORS / "emulated_drive.eds"), parameter))
    assert len(found) == len(words)
    assert all(expected in text for expected, text in zip(words, found, strict=True))
