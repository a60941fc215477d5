"""Bindings between the object dictionary and the axis.

They use the dictionary's entries (`drive.dictionary`) and the family's facts (`drive.family`); the power stage and the modes
of operation move the motor through these bindings alone.
"""
