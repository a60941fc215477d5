"""Bindings between the object dictionary and the axis.

They cover process data, limits in force, and the set-points of the modes.

They use the dictionary's entries (`drive.dictionary`) and the family's facts (`drive.family`); the power stage and the modes
of operation move the motor through these bindings alone.
"""
