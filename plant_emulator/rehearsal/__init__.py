"""The rehearsal: the documented path walked on drawn robots; like `plant_emulator.pytest_plugin` it sees world and master.

>>> from plant_emulator.rehearsal.record import COLUMNS, PathRecord
>>> row = PathRecord(name="robot", seed=1, axis=2).row()
>>> tuple(row) == COLUMNS
True
"""
