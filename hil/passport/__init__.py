"""The passport of gears: what identifications have found of each over months, kept in one file, and alarms on change.

`alarm` is pure statistics, `store` the file (SQLite), `gather` reads model files and results into it, `origin` tells orders that
a motor can make from those of its gear, and `watch` puts them together.

>>> import numpy as np
>>> from hil.passport.alarm import AlarmLimits, watched
>>> worn = watched(np.array([5.0, 5.1, 4.9, 5.0, 5.05, 4.95, 5.0, 6.4]), np.full(8, 0.1), AlarmLimits.of(1e-3, series=6))
>>> worn.first
7
"""
