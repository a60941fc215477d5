"""Entries of the drive's object dictionary.

They are CiA 402's, the emulator's own objects, units, and the table of limits.

>>> from plant_emulator.drive.dictionary.manufacturer_objects import drive_entries
>>> [entry.name for entry in drive_entries() if entry.index == 0x6041]
['Status word']
"""
