"""Runs of `hil` with each drive family, on emulated drives.

`rig` makes the robot and the bench file of a family; `made` moves it, identifies it and cancels its ATE. The resulting table
of the package, `drive_profiles/runs.toml`, is written by ``python -m plant_emulator.rehearsal.families``.
"""
