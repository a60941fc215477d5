"""The passport of gears: errors over months, and alarms on change.

>>> import numpy as np
>>> from hil.passport.alarm import AlarmLimits, watched
>>> worn = watched(np.array([5.0, 5.1, 4.9, 5.0, 5.05, 4.95, 5.0, 6.4]), np.full(8, 0.1), AlarmLimits.of(1e-3, series=6))
>>> worn.first
7
"""
