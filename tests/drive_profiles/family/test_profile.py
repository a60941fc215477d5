"""The profiles of the package, and what a profile file may not say."""

import json
import math
import tomllib
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drive_profiles.errors import (
    DriveProfileError,
    FileError,
    OutOfRangeError,
    ProfileNotFoundError,
    UnknownParameterError,
)
from drive_profiles.family.parameter import Evidence, Parameter
from drive_profiles.family.profile import VENDORS, Identity, Profile, available
from drive_profiles.standard.cia402 import Mode, Object
from drive_profiles.standard.units import Scaling, real32

SCALING = Scaling(131072, 7.1)
DRIVE = Profile.load("emulated_drive")
TUNING = {"position_gain_per_s": 25.0, "velocity_gain_nm_s_rad": 0.196, "velocity_integral_gain_nm_rad": 3.92}


@pytest.mark.parametrize("name", available())
def test_every_profile_of_the_package_is_valid_and_called_like_its_file(name):
    profile = Profile.load(name)
    assert profile.name == name
    assert Profile.load(VENDORS / f"{name}.toml") == profile
    assert available() == sorted(available())


def test_the_emulated_devices_are_there_under_a_vendor_number_that_nobody_has():
    emulated = [name for name in available() if name.startswith("emulated_")]
    assert emulated == ["emulated_accelerometer", "emulated_drive"]
    for name in available():
        identity = Profile.load(name).identity
        assert (identity.vendor_id == 0x48494C01) == (name in emulated)
        assert name not in emulated or (identity.revision == 1 and identity.is_verified)
    assert DRIVE.identity.product_code == 0x402
    assert DRIVE.identity.device_type & 0xFFFF == 402
    assert DRIVE.loop.period_s == 250e-6
    assert set(DRIVE.supported_modes) >= {Mode.CSP, Mode.CST}
    accelerometer = Profile.load("emulated_accelerometer")
    assert accelerometer.identity.product_code == 0x404
    assert accelerometer.identity.device_type & 0xFFFF == 404
    assert accelerometer.capabilities is None
    assert accelerometer.supported_modes == ()


@pytest.mark.parametrize(
    ("name", "address", "data_type", "parameter_class"),
    [
        ("position_gain_per_s", "2100:1", "REAL32", "tuning"),
        ("velocity_gain_nm_s_rad", "2101:1", "REAL32", "tuning"),
        ("velocity_integral_gain_nm_rad", "2101:2", "REAL32", "tuning"),
        ("lowpass_hz", "2101:3", "REAL32", "tuning"),
        ("notch_1.mode", "2110:1", "UNSIGNED8", "tuning"),
        ("notch_1.order", "2110:2", "UNSIGNED8", "tuning"),
        ("notch_1.start_rps", "2110:3", "REAL32", "tuning"),
        ("notch_2.ramp_rps", "2111:A", "REAL32", "tuning"),
        ("notch_1.active", "2112:1", "UNSIGNED8", "tuning"),
        ("notch_2.zeta_rd", "2113:3", "REAL32", "tuning"),
        ("torque_limit_nm", "6072:0", "UNSIGNED16", "limits"),
        ("speed_limit_rad_s", "6080:0", "UNSIGNED32", "limits"),
        ("position_limit_min_rad", "607D:1", "INTEGER32", "limits"),
        ("position_limit_max_rad", "607D:2", "INTEGER32", "limits"),
        ("following_error_window_rad", "6065:0", "UNSIGNED32", "limits"),
        ("following_error_timeout_s", "6066:0", "UNSIGNED16", "limits"),
        ("quick_stop_deceleration_rad_s2", "6085:0", "UNSIGNED32", "limits"),
        ("control_period_s", "2120:0", "UNSIGNED32", "commissioning"),
    ],
)
def test_objects_of_the_emulated_drive(name, address, data_type, parameter_class):
    parameter = DRIVE.parameter(name)
    assert (parameter.written_address, parameter.data_type, parameter.parameter_class) == (address, data_type, parameter_class)


def test_every_name_of_a_control_or_notch_table_is_a_parameter():
    control = {"position_gain_per_s", "velocity_gain_nm_s_rad", "velocity_integral_gain_nm_rad", "lowpass_hz"}
    notch = {"order", "start_rps", "end_rps", "offset_hz", "zeta_rn", "zeta_rdth"}
    for name in control | {f"notch_{n}.{key}" for n in (1, 2) for key in notch}:
        assert (DRIVE.parameter(name).access, DRIVE.parameter(name).parameter_class) == ("rw", "tuning")


def test_indices_in_the_profile_area_are_known_to_cia402():
    known = {int(entry) for entry in Object}
    assert all(p.index in known for p in DRIVE.parameters.values() if p.index >= 0x6000)


def test_values_on_the_wire():
    raw = {
        "torque_limit_nm": (7.1, 1000),
        "speed_limit_rad_s": (314.159265, 3000),
        "position_limit_min_rad": (-2 * 3.141592653589793, -131072),
        "following_error_timeout_s": (0.05, 50),
        "notch_1.order": (2, 2),
        "lowpass_hz": (300.0, 300.0),
        "control_period_s": (250e-6, 250_000),
        "position_gain_per_s": (0.1, real32(0.1)),
    }
    for name, (value, expected) in raw.items():
        wire = DRIVE.parameter(name).raw(value, SCALING)
        assert wire == expected
        assert isinstance(wire, type(expected))
        assert DRIVE.parameter(name).value(wire, SCALING) == pytest.approx(value, rel=1e-6)


@given(st.sampled_from(sorted(DRIVE.parameters)), st.integers(0, 2))
def test_what_the_wire_holds_comes_back(name, wire):
    parameter = DRIVE.parameter(name)
    value = parameter.value(wire, SCALING)
    low = 0.0 if parameter.minimum is None else parameter.minimum
    high = math.inf if parameter.maximum is None else parameter.maximum
    if low <= value <= high:
        assert parameter.raw(value, SCALING) == pytest.approx(wire, rel=1e-7)


@pytest.mark.parametrize("name", [name for name, p in DRIVE.parameters.items() if p.data_type == "REAL32"])
def test_both_ends_of_a_range_can_be_written_and_read_back(name):
    parameter = DRIVE.parameter(name)
    for limit in (parameter.minimum, parameter.maximum):
        if limit is not None:
            wire = parameter.raw(limit)
            assert parameter.raw(parameter.value(wire)) == wire == real32(limit)


def test_values_that_do_not_fit_are_refused():
    with pytest.raises(OutOfRangeError, match="2110:2 9: is outside 1 to 8"):
        DRIVE.parameter("notch_1.order").raw(9)
    with pytest.raises(OutOfRangeError, match="outside 0 to 65535"):
        DRIVE.parameter("torque_limit_nm").raw(1000.0, SCALING)
    with pytest.raises(OutOfRangeError):
        DRIVE.parameter("lowpass_hz").raw(float("nan"))
    with pytest.raises(OutOfRangeError):
        DRIVE.parameter("lowpass_hz").raw(1e39)
    with pytest.raises(DriveProfileError, match="6072:0 counts in per mille: the drive's scaling is needed"):
        DRIVE.parameter("torque_limit_nm").raw(1.0)


def test_an_unknown_parameter_has_near_names():
    with pytest.raises(UnknownParameterError, match=r"no parameter 'notch_1\.start_rsp', did you mean notch_1\.start_rps"):
        DRIVE.parameter("notch_1.start_rsp")


def test_names_come_from_the_package_and_nowhere_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine").write_text("not a profile")
    Path("mine.toml").write_text((VENDORS / "emulated_drive.toml").read_text())
    with pytest.raises(ProfileNotFoundError, match=f"no drive profile 'mine'; available: {', '.join(available())}"):
        Profile.load("mine")
    assert Profile.load("mine.toml") == DRIVE
    assert Profile.load(Path("mine.toml")) == DRIVE
    with pytest.raises(FileError, match="mine"):
        Profile.load(Path("mine"))
    with pytest.raises(FileError):
        Profile.load("../emulated_drive")


def good():
    return (VENDORS / "emulated_drive.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("vendor_id = 0x4849_4C01", "vendor_id = 0", r":\d+: identity\.vendor_id: found 0; expected at least 1"),
        ("subindex = 2,", "subindex = 1,", r"velocity_gain_nm_s_rad and velocity_integral_gain_nm_rad are both in"),
        ('unit = "Hz"', 'unit = "1/s"', "lowpass_hz ends in a unit, Hz, but states unit = '1/s'"),
        ('structure = "P-PI"', 'structure = "PPI"', "loop.structure: found 'PPI'; expected one of 'P-PI'"),
        ('parameter = "lowpass_hz"', 'parameter = "low_pass_hz"', "name parameters that are not there: low_pass_hz"),
        ('mode = "notch_1.mode"', 'mode = "notch_3.mode"', r"loop or notch name parameters that are not there: notch_3\.mode"),
        ('object = "1010:1"\nwait_s = 2.0', "", "a drive without a store command needs a note with what to do instead"),
        ('object = "1010:1"', 'object = "0x1010"', r"store\.object: found '0x1010'"),
        ("max_period_s = 20e-3", "max_period_s = 20e-6", r"sync: min_period_s 0\.00025 is above max_period_s 2e-05"),
        ("min_period_s = 250e-6", "min_period_ms = 0.5", r"wrong unit: 'min_period_ms'; expected min_period_s \(s\)"),
        ('data_type = "REAL32"', 'data_type = "FLOAT"', "found 'FLOAT'; expected one of 'BOOLEAN'"),
        ('class = "tuning"', 'class = "tuned"', "found 'tuned'; expected one of 'tuning'"),
        ('evidence = "definition"', "", r"evidence: is missing; expected one of 'definition'"),
        ('evidence = "definition"', 'evidence = "hearsay"', "evidence: found 'hearsay'; expected one of 'definition'"),
        ('names = ["PP", "PV", "TQ", "HM", "IP", "CSP", "CSV", "CST"]', 'names = ["CSX"]', r"modes\.names\[0\]: found 'CSX'"),
    ],
)
def test_a_profile_that_contradicts_itself_is_refused_with_the_line(tmp_path, old, new, words):
    path = tmp_path / "drive.toml"
    assert old in good()
    path.write_text(good().replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FileError, match=words):
        Profile.load(path)


@pytest.mark.parametrize("table", ["modes", "capabilities", "loop", "torque", "encoder"])
def test_a_drive_states_all_that_the_master_needs_of_a_drive(table):
    document = tomllib.loads(good())
    del document[table]
    with pytest.raises(ValidationError, match="a drive profile needs modes, capabilities, loop, torque and encoder"):
        Profile.model_validate_json(json.dumps(document))


def test_a_drive_without_a_filter_does_not_hold_the_notch():
    document = tomllib.loads(good())
    del document["notch"]
    with pytest.raises(ValidationError, match="notch_inside says yes, but there is no notch table"):
        Profile.model_validate_json(json.dumps(document))
    document["capabilities"]["notch_inside"]["answer"] = "no"
    assert Profile.model_validate_json(json.dumps(document)).notch is None


@pytest.mark.parametrize("evidence", get_args(Evidence))
def test_only_a_guess_is_unverified(evidence):
    assert Identity(vendor_id=1, source="a manual", evidence=evidence).is_verified == (evidence != "unverified")


@pytest.mark.parametrize("name", available())
def test_every_fact_has_a_source_and_a_reason(name):
    profile = Profile.load(name)
    tables = (profile.identity, profile.modes, profile.sync, profile.loop, profile.notch, profile.torque, profile.encoder)
    for fact in (*tables, profile.store, *profile.aborts, *profile.parameters.values()):
        assert fact is None or (fact.source.strip() and fact.evidence in get_args(Evidence))
    for capability in dict(profile.capabilities or ()).values():
        assert capability.reason.endswith(".")


def test_steps_are_said_in_words():
    steps = {name: DRIVE.parameter(name).step for name in ("torque_limit_nm", "following_error_timeout_s", "lowpass_hz")}
    assert steps == {"torque_limit_nm": "1 ‰ of 6076h", "following_error_timeout_s": "0.001 s", "lowpass_hz": ""}
    assert isinstance(DRIVE.parameter("lowpass_hz"), Parameter)
