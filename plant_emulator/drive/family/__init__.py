"""The family of an emulated drive.

>>> from plant_emulator.drive.family.choice import family_of
>>> from plant_emulator.robots.robot import load_robot
>>> family_of(load_robot("reference"), 2).profile
'emulated_drive'
"""
