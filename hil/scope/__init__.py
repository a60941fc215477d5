"""The live page of a bus: signals, triggers and spectra.

It has the last seconds of all signals, and a server. Pure but for `sources`, `server`, `asking` and `process`; time is an
argument everywhere.

>>> import numpy as np
>>> from hil.can.listening import FRAME_RECORD
>>> from hil.scope.decoder import SignalDecoder
>>> frames = np.array([(1_000_000 * k, 0x80, 0, 0) for k in range(6)], FRAME_RECORD)
>>> rows = SignalDecoder(bench=None, descriptions={}, bitrate=1_000_000).feed(frames)
>>> [signal.name for signal in rows.signals], rows.time_s.tolist()
(['bus load', 'misses', 'SYNC interval'], [0.0, 0.001, 0.002, 0.003, 0.004])
"""
