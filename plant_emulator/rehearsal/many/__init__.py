"""Rehearsal of many robots.

>>> from plant_emulator.rehearsal.many.seeds import seeds_of
>>> seeds_of("1-3,7")
(1, 2, 3, 7)
"""
