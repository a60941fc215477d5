r"""Drives on a bus, read and written through SDO.

An `SdoPort` needs no bus, only an object that sends and receives frames:

>>> from drive_profiles.device.device import Device
>>> from drive_profiles.device.sdo import SdoPort
>>> from drive_profiles.family.catalogue import Catalogue
>>> from drive_profiles.family.profile import Profile
>>> class EnabledDrive:  # it answers every upload with the status word 0237h
...     boots = 0
...     def send(self, can_id, data):
...         self.answer = b"\x4b" + data[1:4] + b"\x37\x02\x00\x00"
...     def receive(self, timeout_s):
...         return self.answer
...     def clear(self):
...         return []
>>> device = Device(SdoPort(2, EnabledDrive()), Catalogue(Profile.load("emulated_drive")))
>>> device.state()
<State.OPERATION_ENABLED: 'operation enabled'>
>>> device.check_quiet()
Traceback (most recent call last):
drive_profiles.errors.NodeError: node 2: it is in state 'operation enabled'; disable it first; nothing is written to it
"""
