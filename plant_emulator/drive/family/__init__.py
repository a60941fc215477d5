"""The family of an emulated drive.

It has identity, gains, filters and storing: the parts beyond CiA 402.

`family.base.DriveFamily` is the interface; `family.described` emulates a drive by its drive profile. `family.choice` returns
the family that the robot file names:

    >>> from plant_emulator.drive.family.choice import family_of
    >>> from plant_emulator.robots.robot import load_robot
    >>> family_of(load_robot("reference"), 2).profile
    'emulated_drive'
"""
