"""The choice of a device's profile: by its identity, by a name, and what is said where nothing fits."""

import pytest

from drive_profiles.device.device import DeviceIdentity
from drive_profiles.device.target import catalogue_of, device_at, matching
from drive_profiles.errors import NodeError
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from tests.drive_profiles.profiles import PRODUCTS, PROFILES
from tests.drive_profiles.world_bus import WorldSdoBus, robot_with

CODED = [label for label, product in PRODUCTS.items() if product.identity.product_code is not None]
NAMED = [label for label in PRODUCTS if label not in CODED]


class Bus(WorldSdoBus):
    """A bus with another drive at node 2."""

    def __init__(self, profile: str) -> None:
        super().__init__(robot_with(axis2={"profile": profile}))

    def set(self, index: int, subindex: int, value: int) -> None:
        self.world.drives[2].slave.dictionary.cell(index, subindex).value = value


def upload(device, parameter_set, tmp_path, **options):
    made = Upload(device, parameter_set, UploadOptions(journals=tmp_path / "journals", **options))
    fleet.prepare([made])
    return fleet.run([made])[0]


def identity(label: str, **changes: int | None) -> DeviceIdentity:
    known = {**PROFILES, **PRODUCTS}[label].identity
    stated = {"device_type": known.device_type, "vendor_id": known.vendor_id, "product_code": known.product_code}
    return DeviceIdentity(2, **(stated | {"revision": known.typical_revision, "serial_number": 2} | changes))


@pytest.mark.parametrize("label", CODED)
def test_a_scan_names_the_product(label):
    assert matching(identity(label)) == [label]


@pytest.mark.parametrize("label", NAMED)
def test_of_products_without_a_code_each_may_be_meant(label):
    found = matching(identity(label))
    assert label in found
    assert found == [member.label for member in PROFILES[label.partition("/")[0]].members]


@pytest.mark.slow
@pytest.mark.parametrize("label", CODED)
@pytest.mark.parametrize("named", ["", "family", "product"])
def test_a_device_is_taken_for_its_product_whichever_way_the_profile_is_given(label, named):
    bus = Bus(label)
    device = device_at(bus, 2, {"": None, "family": label.partition("/")[0], "product": label}[named])
    assert device.profile == PRODUCTS[label]
    assert device.pull(("tuning",)).header.profile == label


@pytest.mark.parametrize("label", NAMED)
def test_a_product_that_nothing_tells_apart_has_to_be_named(label):
    bus = Bus(label)
    with pytest.raises(NodeError, match=rf"may be any of .*{label}.*choose with --profile"):
        device_at(bus, 2)
    assert device_at(bus, 2, label).profile == PRODUCTS[label]


@pytest.mark.parametrize("label", PRODUCTS)
def test_what_was_pulled_goes_back_by_the_profile_that_its_header_names(label, tmp_path):
    """Limits, type and device type are those of the product, so a set of it is no wrong one."""
    bus = Bus(label)
    pulled = device_at(bus, 2, label if label in NAMED else None).pull()
    assert not pulled.header.not_read
    again = device_at(bus, 2, pulled.header.profile)
    facts = (again.profile.identity, *again.profile.parameters.values())
    guessed = label in NAMED or not all(fact.is_verified for fact in facts)
    assert upload(again, pulled, tmp_path, allow_unverified=guessed).written == 0


def test_a_product_that_no_profile_names_is_refused_with_what_to_do():
    bus = Bus("maxon_epos4/70-15")
    bus.set(0x1018, 2, 0x6999_0000)
    with pytest.raises(NodeError) as error:
        device_at(bus, 2)
    text = str(error.value)
    assert "no profile fits this device (vendor 0x000000FB, product 0x69990000, revision 0x01700000)" in text
    assert "maxon_epos4 names 0x61500000 (module-50-5) or 0x60500000 (module-24-1.5) or 0x64500000 (70-15)" in text
    assert "--eds" in text


def test_a_product_that_the_named_profile_does_not_name_is_read_and_not_written(tmp_path):
    bus = Bus("maxon_epos4/70-15")
    bus.set(0x1018, 2, 0x6999_0000)
    device = device_at(bus, 2, "maxon_epos4")
    assert device.profile == PROFILES["maxon_epos4"]
    wanted = ParameterSet(tuning={"velocity_lowpass": Item(value=500)})
    with pytest.raises(
        NodeError, match=r"product \(1018h:2\) is 0x69990000, profile maxon_epos4 says .*\[\[product\]\] in a copy"
    ):
        upload(device, wanted, tmp_path, allow_unverified=True)


def test_a_set_of_one_product_is_refused_on_another(tmp_path):
    bus = Bus("trinamic_tmcm16xx/tmcm-1670")
    device = device_at(bus, 2, "trinamic_tmcm16xx/tmcm-1633")
    wanted = ParameterSet(tuning={"position_gain": Item(value=5)})
    with pytest.raises(NodeError, match=r"is 0x686, profile trinamic_tmcm16xx/tmcm-1633 says 0x661"):
        upload(device, wanted, tmp_path, allow_unverified=True)


def test_the_device_type_is_that_of_the_product(tmp_path):
    bus = Bus("trinamic_tmcm16xx/tmcm-1636")
    wanted = ParameterSet(tuning={"position_gain": Item(value=5)})
    assert upload(device_at(bus, 2), wanted, tmp_path).kind == "done"
    bus.set(0x1000, 0, 0x0046_0192)  # the first product's
    with pytest.raises(NodeError, match=r"device type \(1000h\) is 0x460192, profile trinamic_tmcm16xx/tmcm-1636 says 0x420192"):
        upload(device_at(bus, 2), wanted, tmp_path)


@pytest.mark.parametrize(("code", "largest"), [(0x6150_0000, 5000), (0x6050_0000, 1500), (0x6450_0000, 15000)])
def test_a_file_is_turned_into_bytes_by_the_limits_of_the_product_that_it_is_of(code, largest):
    entry = catalogue_of("maxon_epos4", None, product_code=code).find("nominal_current")
    assert entry.encoded(largest) == largest.to_bytes(4, "little")
    with pytest.raises(ValueError, match=f"must be at most {largest}$"):
        entry.encoded(largest + 1)
