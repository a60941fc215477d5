r"""Export of recordings and bus logs to other programs.

>>> import numpy as np
>>> from hil.export.series import Series
>>> from hil.export.tables import in_words
>>> list(in_words(Series("run", np.array([0.0, 0.001]), {"axis2_torque_nm": np.array([0.5, np.nan])})))
['{"time_s":0.0,"axis2_torque_nm":0.5}', '{"time_s":0.001,"axis2_torque_nm":null}']
"""
