r"""Parameter sets: values with names and units that an upload writes.

>>> from drive_profiles.family.catalogue import Catalogue
>>> from drive_profiles.family.profile import Profile
>>> from drive_profiles.parameter_set.parameters import Item, ParameterSet
>>> gains = ParameterSet(tuning={"position_gain_per_s": Item(value=25.0, unit="1/s")})
>>> [(str(write.entry), write.data) for write in gains.writes(Catalogue(Profile.load("emulated_drive")))]
[('2100:1 (position_gain_per_s)', b'\x00\x00\xc8A')]
"""
