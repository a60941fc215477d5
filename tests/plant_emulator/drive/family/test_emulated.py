"""Every emulated node says that it is one, in whatever maker's name it speaks."""

from pathlib import Path

import pytest

import drive_profiles
from drive_profiles.family.profile import Profile
from drive_profiles.standard.emulation import HARDWARE_VERSION, HARDWARE_VERSION_OBJECT, is_emulated
from plant_emulator.drive.family.choice import family_of
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

NAMES = sorted(path.stem for path in (Path(drive_profiles.__file__).parent / "vendors").glob("*.toml"))
DRIVES = [name for name in NAMES if Profile.load(name).kind == "drive" and Profile.load(name).loop is not None]
ROBOT = load_robot("reference")


@pytest.mark.parametrize("name", DRIVES)
def test_a_vendors_identity_is_kept_and_the_hardware_version_is_none(name: str) -> None:
    axes = {2: ROBOT.axis[2].model_copy(update={"profile": name}), 3: ROBOT.axis[3], 5: ROBOT.axis[5]}
    family = family_of(ROBOT.model_copy(update={"axis": axes}), 2)
    assert family.dictionary.get(0x1018, 1) == Profile.load(name).identity.vendor_id
    assert family.dictionary.get(*HARDWARE_VERSION_OBJECT) == HARDWARE_VERSION


def test_the_accelerometer_says_it_too() -> None:
    assert World(ROBOT).accelerometer.slave.dictionary.get(*HARDWARE_VERSION_OBJECT) == HARDWARE_VERSION


@pytest.mark.parametrize("version", [b"", b"1", b"rev C", b"emulated", HARDWARE_VERSION.encode()[:-1]])
def test_no_other_version_is_taken_for_emulated(version: bytes) -> None:
    assert not is_emulated(version)
    assert is_emulated(HARDWARE_VERSION.encode() + b"\0\0")
