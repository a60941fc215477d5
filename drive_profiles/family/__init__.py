"""Families of drives as data.

>>> from drive_profiles.family.catalogue import Catalogue
>>> from drive_profiles.family.profile import Profile
>>> drive = Catalogue(Profile.load("emulated_drive"))
>>> entry = drive.find("0x2100:1")
>>> print(entry)
2100:1 (position_gain_per_s)
>>> entry.decoded(entry.encoded(25.0)), entry.unit
(25.0, '1/s')
"""
