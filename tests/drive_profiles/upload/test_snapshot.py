"""The snapshot of an upload as the set that goes back."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.errors import RefusedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import Profile
from drive_profiles.files.toml import loads
from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.units import Scaling
from drive_profiles.upload.journal import Journal, UploadSnapshot, as_set, read

DRIVE = Catalogue(Profile.load("emulated_drive"))
SCALING = Scaling(131072, 7.1)
IDENTITY = {"device_type": 0x20192, "vendor_id": 0x48494C01, "product_code": 0x402, "revision": 1, "serial_number": 7}
GAIN, LIMIT, ORDER = (0x2100, 1), (0x6072, 0), (0x2110, 2)
OLD = {GAIN: struct.pack("<f", 0.1), LIMIT: b"\xe8\x03", ORDER: b"\x02"}


def snapshot(old, identity=IDENTITY):
    return UploadSnapshot(2, "socketcan:can0", identity, "emulated_drive", old, {}, {GAIN: "position_gain_per_s"})


def bytes_of(parameter_set, catalogue=DRIVE, scaling=SCALING):
    return {write.address: write.data for write in parameter_set.writes(catalogue, scaling)}


def test_what_the_drive_held_is_what_is_written_back():
    wanted = as_set(snapshot(OLD), DRIVE)
    assert bytes_of(wanted) == bytes_of(wanted, scaling=None) == OLD
    assert bytes_of(loads(wanted.dumps(), ParameterSet)) == OLD
    assert {key: (item.value, item.type, item.name) for key, item in wanted.commissioning.items()} == {
        "0x2100:1": (0.1, "REAL32", "position_gain_per_s"),
        "0x6072:0": (1000, "UNSIGNED16", ""),
        "0x2110:2": (2, "UNSIGNED8", ""),
    }


def test_it_goes_back_to_the_very_device_that_it_is_of():
    header = as_set(snapshot(OLD), DRIVE).header
    assert (header.profile, header.vendor_id, header.product_code, header.revision, header.serial_number) == (
        "emulated_drive", 0x48494C01, 0x402, 1, 7,
    )  # fmt: skip
    assert as_set(snapshot(OLD, {}), DRIVE).header.serial_number is None
    assert as_set(snapshot(OLD, {**IDENTITY, "revision": None}), DRIVE).header.revision is None


def test_it_passes_the_journal(tmp_path):
    Journal(tmp_path / "journal", snapshot(OLD)).close()
    assert bytes_of(as_set(read(tmp_path / "journal").snapshot, DRIVE)) == OLD


@given(st.dictionaries(st.tuples(st.integers(0x2000, 0x5FFF), st.integers(0, 0xFE)), st.binary(max_size=9), min_size=1))
def test_objects_of_which_nobody_knows_the_type_go_back_byte_by_byte(old):
    assert bytes_of(as_set(snapshot(old), Catalogue()), Catalogue()) == old


def test_commands_and_what_is_read_only_were_never_written_and_do_not_go_back():
    old = {**OLD, (0x6040, 0): b"\x0f\0", (0x6041, 0): b"\0\0", (0x1018, 1): b"\1\0\0\0"}
    assert bytes_of(as_set(snapshot(old), DRIVE)) == OLD


@pytest.mark.parametrize("old", [{}, {(0x6040, 0): b"\x0f\0"}, {(0x6041, 0): b"\0\0"}])
def test_a_snapshot_without_anything_to_write_back_is_refused(old):
    with pytest.raises(RefusedError, match="holds nothing that can be restored"):
        as_set(snapshot(old), DRIVE)


def test_bytes_that_are_no_value_are_refused_each_with_its_object():
    with pytest.raises(RefusedError) as caught:
        as_set(snapshot({**OLD, GAIN: struct.pack("<f", math.nan), LIMIT: b"\1\2\3\4"}), DRIVE)
    assert caught.value.reasons == (
        "2100:1: the drive's previous value cannot be restored: nan is not a finite number",
        "6072:0: the drive's previous value cannot be restored: UNSIGNED16 takes 2 bytes, not 4",
    )


@given(st.dictionaries(st.sampled_from([entry.address for entry in DRIVE]), st.binary(max_size=8)))
def test_whatever_a_drive_held_it_is_a_set_or_a_refusal(old):
    try:
        wanted = as_set(snapshot(old), DRIVE)
    except RefusedError:
        return
    assert all(item.type in DataType.__members__ for item in wanted.commissioning.values())
