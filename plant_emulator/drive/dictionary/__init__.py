"""Entries of the drive's object dictionary.

>>> from plant_emulator.drive.dictionary.manufacturer_objects import drive_entries
>>> [entry.name for entry in drive_entries() if entry.index == 0x6041]
['Status word']
"""
