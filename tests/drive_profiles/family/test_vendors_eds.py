"""Profiles that rest on a vendor's EDS, held against that file.

The files are the vendors' and not ours, so they are not here: the test looks for a folder of vendors' files where the environment
variable HIL_EDS_CORPUS says, else beside the repository, and is skipped where there is none.
"""

import os
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable

from drive_profiles.eds import Description, load
from drive_profiles.family.parameter import LIMITS, Parameter
from drive_profiles.family.profile import VENDORS, Profile
from tests.drive_profiles.profiles import DRIVES

FILES = {
    "elmo_gold": ("Elmo_Gold.eds",),
    "harmonic_drive_yukondrive": ("HarmonicDriveAG_YukonDrive-1021_V4.15.EDS",),
    "kollmorgen_rgm": ("Kollmorgen_RGM_V2.eds",),
    "maxon_epos2": ("maxon_EPOS2-50-5.eds",),
    "maxon_epos4": ("maxon_EPOS4-Module-50-5.eds",),
    "nanotec_cl4e": ("Nanotec_CL4-E-1-12.eds",),
    "novanta_eve": ("Ingenia_EVE-XCR-C_1.8.1.eds",),
    "schunk_pilz_prbt": ("Pilz_PRBT_0_1.dcf", "Schunk_0_63.eds"),
    "technosoft_ipos": ("Technosoft_iPOS.D.v1.04.eds",),
    "trinamic_tmcm16xx": ("Trinamic_TMCM-1617.eds",),
    "yiyou_euservo": ("Yiyou_EuServo_V1.4.eds",),
    "zeroerr_erob": ("ZeroErr_eDriver_V1.5.eds",),
}
"""By profile; where there are two, either may be the source of a parameter."""

ACCESS = {"rw": "rw", "rwr": "rw", "rww": "rw", "ro": "ro", "const": "ro", "wo": "wo"}
BY_EDS = {name: [p for p in profile.parameters.values() if p.evidence == "eds"] for name, profile in DRIVES.items()}


def folder() -> Path:
    """A folder of vendors' files."""
    named = os.environ.get("HIL_EDS_CORPUS")
    return Path(named) if named else Path(__file__).resolve().parents[4] / "shared" / "eds"


def described(name: str) -> list[Description]:
    missing = [file for file in FILES[name] if not (folder() / file).is_file()]
    if missing:
        pytest.skip(f"no {', '.join(missing)}: HIL_EDS_CORPUS names no folder of vendors' files that has it")
    return [load(folder() / file) for file in FILES[name]]


def variable(description: Description, parameter: Parameter) -> ODVariable | None:
    found = description.dictionary.get_variable(parameter.index, parameter.subindex)
    return found if isinstance(found, ODVariable) else None


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
    assert {name for name, parameters in BY_EDS.items() if parameters} <= set(FILES)


@pytest.mark.parametrize("name", [name for name in FILES if name in DRIVES])
def test_parameters_are_as_the_vendor_states_them(name):
    descriptions = described(name)
    wrong = []
    for parameter in BY_EDS[name]:
        each = [faults(parameter, variable(description, parameter)) for description in descriptions]
        if all(each):
            wrong.append(f"{parameter.written_address}: {min(each, key=len)}")
    assert BY_EDS[name]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", [name for name in FILES if name in DRIVES])
def test_identity_is_as_the_vendor_states_it(name):
    identity = DRIVES[name].identity
    if identity.evidence != "eds":
        pytest.skip(f"the identity of {name} is by {identity.evidence}")
    descriptions = described(name)
    assert identity.vendor_id in {d.vendor_id for d in descriptions}
    if identity.product_code is not None:
        assert identity.product_code in {d.product_code for d in descriptions}


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
