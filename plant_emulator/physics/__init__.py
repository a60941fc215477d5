"""The plant: axes with transmission errors, and their tip.

`axis.h` states the equations of motion, `angle_grid.h` has them in the form that runs, `integration.h` follows them over time,
and `physics.tip` gives the acceleration of the tip:

    >>> from plant_emulator.physics.tip import lever_acceleration
    >>> lever_acceleration(0.5, 2.0, 3.0)  # lever in m, speed in rad/s, acceleration in rad/s²; gives X, Y, Z in m/s²
    (-2.0, 0.0, 1.5)
"""
