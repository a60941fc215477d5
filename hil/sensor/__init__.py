r"""Accelerometers on a serial port.

`accelerometer` reads the port in a thread of its own and gives the measurement at a SYNC. `framing` finds samples in the bytes,
`clock` dates them, and `table` is their description in a bench file.

>>> from hil.sensor.framing import Fields, LineFraming
>>> fields = Fields(names=("x", "y", "z"), scale_m_s2=(0.01, 0.01, 0.01), range_m_s2=40.0)
>>> decoder = LineFraming(fields).decoder()
>>> decoder.feed(b"half a line\n12,-5,981\n3,")
[Sample(acceleration_m_s2=(0.12, -0.05, 9.81), counter=None)]
"""
