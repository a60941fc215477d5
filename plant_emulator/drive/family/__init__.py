"""The family of an emulated drive.

It has identity, gains, filters and storing: the parts beyond CiA 402.

    >>> from plant_emulator.drive.family.choice import family_of
    >>> from plant_emulator.robots.robot import load_robot
    >>> family_of(load_robot("reference"), 2).profile
    'emulated_drive'
"""
