"""The rehearsal: the documented path on drawn robots.

Like `plant_emulator.pytest_plugin`, this package may import both world and master.

>>> from plant_emulator.rehearsal.record import COLUMNS, PathRecord
>>> row = PathRecord(name="robot", seed=1, axis=2).row()
>>> tuple(row) == COLUMNS
True
"""
