"""Many trials on the processes of this machine or of a Dask scheduler.

A rehearsal's trial walks the documented path on one robot; a robustness study's judges some plants.
"""
