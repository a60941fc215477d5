"""Ties between the object dictionary and the axis: process data, limits in force, and the set-points of the modes.

Below it stand the dictionary's entries (`drive.dictionary`) and what the drive's family makes of them (`drive.family`); the power
stage and the modes of operation move the motor through these ties alone.
"""
