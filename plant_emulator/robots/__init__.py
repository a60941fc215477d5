"""Robot and tuning files.

A robot file describes the true plant and its drives, a tuning file the gains and filters for a study.

>>> from plant_emulator.robots.robot import load_robot
>>> robot = load_robot("reference")
>>> sorted(robot.axis), robot.axis[2].reduction_ratio
([2, 3, 5], 120.0)
"""
