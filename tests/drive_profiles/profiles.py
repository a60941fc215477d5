"""The package's profiles by name, read once for all tests; nobody changes them."""

from drive_profiles.family.profile import Profile, available

PROFILES = {name: Profile.load(name) for name in available()}
DRIVES = {name: profile for name, profile in PROFILES.items() if profile.kind == "drive"}
PRODUCTS = {member.label: member for profile in PROFILES.values() for member in profile.members[1:]}
"""The further products of the families that have several, by ``family/product``."""
ALL_DRIVES = {**DRIVES, **PRODUCTS}
