"""What `hil run` does with each drive family, found by doing it on emulated drives.

`rig` makes the robot and the bench file of a family, and `made` moves it, identifies it and cancels its transmission error. The
package's table of it, `drive_profiles/runs.toml`, is written by ``python -m plant_emulator.rehearsal.families``.
"""
