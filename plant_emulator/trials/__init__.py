"""Many trials on the processes of this machine or of a Dask scheduler.

A rehearsal's trial walks the documented path on one robot; a robustness study's judges some plants:

    >>> from plant_emulator.trials.executors import LocalProcesses
    >>> LocalProcesses(2).name
    '2 processes of this machine'
"""
