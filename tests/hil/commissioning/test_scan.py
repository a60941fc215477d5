"""The profile of a device that a scan has found: by its identity, or as its user names it."""

import pytest

from drive_profiles.device.device import DeviceIdentity
from drive_profiles.errors import DriveProfileError
from hil.commissioning.scan import FoundNode, profiles_of

SCHUNK = DeviceIdentity(2, 0x00020192, 0x332, 0, 0, 2, "a joint")
"""A device whose product code tells none of the family's products apart."""


def test_a_device_that_may_be_several_products_is_the_one_that_its_user_names():
    assert len(profiles_of(SCHUNK, None)) == 3
    assert FoundNode(SCHUNK, profiles_of(SCHUNK, None)).profile is None
    assert profiles_of(SCHUNK, "schunk_pilz_prbt/prbt") == ("schunk_pilz_prbt/prbt",)
    named = FoundNode(SCHUNK, profiles_of(SCHUNK, "schunk_pilz_prbt")).profile
    assert named is not None
    assert named.name == "schunk_pilz_prbt"


@pytest.mark.parametrize(("name", "said"), [("maxon_epos4", "is for vendor-ID 0x000000FB"), ("unheard_of", "unheard_of")])
def test_a_profile_of_another_vendor_or_of_nobody_is_refused(name, said):
    with pytest.raises(DriveProfileError, match=said):
        profiles_of(SCHUNK, name)
