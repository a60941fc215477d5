"""The modes of operation of CiA 402.

>>> from plant_emulator.drive.modes.homing import Homing
>>> from plant_emulator.motion.record import HOME_SWITCH
>>> Homing(19, HOME_SWITCH, counts_per_rev=4096.0, travel_counts=1e6).start(counts=0.0, inputs=0)
Move(direction=1, is_fast=True, is_hard=False)
"""
