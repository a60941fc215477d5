"""The control period of all axes, `advance` of `period.h`.

`motion.axes.Axes` holds the arrays. Here axis 2 opens its brake and gets a set-point 100 counts ahead, which the demand
reaches after one interpolation period of 8 control periods:

    >>> from plant_emulator.motion.axes import Axes
    >>> from plant_emulator.motion.record import POSITION
    >>> from plant_emulator.robots.robot import load_robot
    >>> axes = Axes(load_robot("reference"))
    >>> row = axes.row(2)
    >>> start = axes.open_brake(row, POSITION, periods_per_set_point=8)
    >>> axes.set_point(row, start + 100)
    >>> axes.advance(8)
    >>> motion = axes.motion[row]
    >>> round(motion["demand_rad"] * motion["counts_per_rad"]) - start
    100
"""
