"""Families of drives as data.

`profile` reads the drive profile of a family. Its parts are described in `parameter` (an object with its unit, limits and source)
and `capability` (the drive's loop, filters, encoder and store). `catalogue` lists the objects of a device, from its drive profile
and its EDS, and finds them by name or address.

>>> from drive_profiles.family.catalogue import Catalogue
>>> from drive_profiles.family.profile import Profile
>>> drive = Catalogue(Profile.load("emulated_drive"))
>>> entry = drive.find("0x2100:1")
>>> print(entry)
2100:1 (position_gain_per_s)
>>> entry.decoded(entry.encoded(25.0)), entry.unit
(25.0, '1/s')
"""
