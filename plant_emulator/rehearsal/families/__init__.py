"""Runs of `hil` with each drive family, on emulated drives.

`made` makes the robot and the bench file of a family, moves it, identifies it and cancels its ATE. The resulting table of the
package, `drive_profiles/runs.toml`, is written by ``python -m plant_emulator.rehearsal.families``.
"""
