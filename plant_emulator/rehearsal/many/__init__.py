"""Rehearsal of many robots.

The package has the executors, the saved rows, the table, the goals, and the page.

>>> from plant_emulator.rehearsal.many.seeds import seeds_of
>>> seeds_of("1-3,7")
(1, 2, 3, 7)
"""
