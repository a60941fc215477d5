r"""Drives as data, and the tool that changes their parameters.

`family` describes families of drives: identity, capabilities, and the object of each parameter. `standard` holds the data of CiA
301 and CiA 402 with the conversion of units, and `eds` reads any maker's device description. `parameter_set` and `realisation`
turn values and designs into bytes. `device` and `upload` write them to drives on a bus, all or none. `cli` is the command line.

>>> from drive_profiles.family.profile import Profile
>>> drive = Profile.load("emulated_drive")
>>> gain = drive.parameter("position_gain_per_s")
>>> gain.written_address, gain.unit, gain.encoded(25.0)
('2100:1', '1/s', b'\x00\x00\xc8A')
"""
