"""The plant: axes with transmission errors, and their tip.

`axis.h` states the equations of motion, `angle_grid.h` has them in the form that runs, `integration.h` follows them over time,
and `physics.tip` has the tip and the sensor at it:

    >>> import numpy as np
    >>> from plant_emulator.physics.tip import TipSensor
    >>> TipSensor(0.0, 0.5, 19.62, np.random.default_rng(1)).sample((0.7, 0.0, 30.0))  # steps of 0.5 m/s², 2 g at most
    (0.5, 0.0, 19.62)
"""
