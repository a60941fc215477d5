"""The core in C: built by `build`, loaded by `library`.

Each header describes the records that Python and C share; numpy's layouts follow from it:

>>> from hil.core.library import CORE
>>> CORE.dtype("cascade_state").names
('motor_angle_rad', 'speed_rad_s', 'error_rad_s', 'integral_nm')
>>> round(CORE.call.lowpass_blend(20.0, 250e-6), 4)
0.0309
"""
