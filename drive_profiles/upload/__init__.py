r"""Uploads of parameter sets to drives: all of them, or none.

Here a dictionary of objects stands for the SDO port of a drive:

>>> import tempfile
>>> from pathlib import Path
>>> from drive_profiles.device.device import Device
>>> from drive_profiles.errors import SdoAbortedError
>>> from drive_profiles.family.catalogue import Catalogue
>>> from drive_profiles.family.profile import Profile
>>> from drive_profiles.parameter_set.parameters import Item, ParameterSet
>>> from drive_profiles.upload import fleet
>>> from drive_profiles.upload.result import UploadOptions
>>> from drive_profiles.upload.upload import Upload
>>> class Port:
...     node, boots, strays = 2, 0, frozenset()
...     objects = {
...         (0x1000, 0): b"\x92\x01\x02\x00", (0x1018, 1): b"\x01LIH", (0x1018, 2): b"\x02\x04\x00\x00",  # its identity
...         (0x6041, 0): b"\x50\x02",  # switch on disabled
...         (0x2100, 1): b"\x00\x00HA",  # position gain 12.5 1/s
...     }
...     def forget(self):
...         pass
...     def read(self, address, name="", in_blocks=False):
...         if address in self.objects:
...             return self.objects[address]
...         raise SdoAbortedError(2, *address, 0x0602_0000, "no such object")
...     def write(self, address, data, name="", value=None, timeout_s=None, in_blocks=False):
...         self.objects[address] = data
>>> drive = Device(Port(), Catalogue(Profile.load("emulated_drive")))
>>> gains = ParameterSet(tuning={"position_gain_per_s": Item(value=25.0, unit="1/s")})
>>> with tempfile.TemporaryDirectory() as folder:
...     upload = Upload(drive, gains, UploadOptions(journals=Path(folder)))
...     fleet.prepare([upload])
...     print([(str(write.entry), before) for write, before in upload.changes])
...     print(fleet.run([upload])[0])
[('2100:1 (position_gain_per_s)', b'\x00\x00HA')]
node 2: done, 1 written and read back
>>> drive.port.objects[0x2100, 1]
b'\x00\x00\xc8A'
"""
