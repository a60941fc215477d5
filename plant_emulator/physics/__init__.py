"""The plant: axes with transmission errors, and their tip.

`axis.h` states the equations of motion, `angle_grid.h` has them in the form that runs, `integration.h` follows them over time,
and `physics.tip` gives the acceleration of the tip:

    >>> import numpy as np
    >>> from plant_emulator.physics.tip import MovedTip
    >>> MovedTip([0.5]).accelerations(np.array([[[0.0, 2.0, 3.0]]])).tolist()  # lever in m; rad, rad/s, rad/s²; X, Y, Z in m/s²
    [[-2.0, 0.0, 1.5]]
"""
