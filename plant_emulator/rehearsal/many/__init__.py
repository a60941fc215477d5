"""Many robots: who walks them, the rows that are kept, the table, the numbers that must be reached, and the page.

>>> from plant_emulator.rehearsal.many.seeds import seeds_of
>>> seeds_of("1-3,7")
(1, 2, 3, 7)
"""
