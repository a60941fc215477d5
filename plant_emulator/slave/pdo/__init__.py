"""Process data objects of a node (CiA 301, 7.2.2).

>>> from drive_profiles.standard.cia301 import DataType
>>> from plant_emulator.slave.pdo.setup import BitPacker
>>> BitPacker([(DataType.UNSIGNED8, 8), (None, 4), (DataType.BOOLEAN, 1)]).pack(0x2A, True).hex(" ")
'2a 10'
"""
