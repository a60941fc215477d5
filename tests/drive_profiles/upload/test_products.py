"""Every product with all objects of its own EDS: pulled, changed, uploaded, stored and put back, on an emulated drive."""

import pytest

from drive_profiles.device.target import device_at
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.standard.object_address import object_address
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from tests.drive_profiles.device.test_target import NAMED
from tests.drive_profiles.family.test_vendors_eds import FILES, described, folder
from tests.drive_profiles.profiles import PRODUCTS
from tests.drive_profiles.world_bus import WorldSdoBus, robot_with

WITH_A_FILE = [label for label in PRODUCTS if label in FILES]
NODE = 2


def upload(device, parameter_set, tmp_path, **options):
    made = Upload(device, parameter_set, UploadOptions(journals=tmp_path / "journals", allow_unverified=True, **options))
    fleet.prepare([made])
    return fleet.run([made])[0]


@pytest.mark.slow
@pytest.mark.parametrize("label", WITH_A_FILE)
def test_a_product_goes_round_with_its_own_file(label, tmp_path):
    described(label)  # skips where the file is not at hand
    path = folder() / FILES[label][0]
    bus = WorldSdoBus(robot_with(axis2={"profile": label, "eds": str(path)}))
    device = device_at(bus, NODE, label if label in NAMED else None, path)
    profile = Profile.load(label)
    assert device.profile == profile
    pulled = device.pull()
    # the engine's own objects are the emulator's, and the file may keep objects out of a scan
    engine = [line for line in pulled.header.not_read if line[:1] == "1" or "ObjFlags" in line]
    assert pulled.header.not_read == tuple(engine)
    held = {key for _, key, _ in pulled.items()}
    for key, parameter in profile.parameters.items():
        spelt = f"{parameter.written_address} ({key})"
        if parameter.access == "rw" and not is_command(parameter.address) and not any(spelt in line for line in engine):
            assert held & {key, f"0x{parameter.written_address}"}, spelt
    assert {e.address for e in device.catalogue} >= {p.address for p in profile.parameters.values()}
    assert upload(device, pulled, tmp_path).written == 0
    tuned = {key: _moved(item, profile.parameters.get(key)) for key, item in pulled.tuning.items()}
    moved = pulled.model_copy(update={"tuning": tuned})
    outcome = upload(device, moved, tmp_path)
    assert (outcome.kind, outcome.written) == ("done", len(pulled.differences(moved)))
    assert device.pull().differences(moved) == []
    assert upload(device, pulled, tmp_path, store=profile.store.object is not None).kind == "done"
    assert device.pull().differences(pulled) == []


def _moved(item, parameter):
    """A value of the profile one step away, towards zero; what only the file knows stays as it is."""
    if parameter is None or (isinstance(item.value, float) and not parameter.type.is_real) or item.value == 0:
        return item
    return item.model_copy(update={"value": item.value + 0.5 if parameter.type.is_real else item.value - 1})


@pytest.mark.parametrize("label", [label for label in WITH_A_FILE if PRODUCTS[label].store.object is not None])
def test_the_store_commands_of_a_product_are_in_its_own_file(label):
    (description,) = described(label)
    for command in (PRODUCTS[label].store.object, PRODUCTS[label].store.restore):
        index, subindex = object_address(command)
        assert subindex in description.dictionary[index].subindices
