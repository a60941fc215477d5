"""CiA 301 and CiA 402 as data, and the conversion of units.

Nothing here needs a bus, a file or a clock.

>>> from drive_profiles.standard.cia402 import State, control_word_towards, state_of
>>> state_of(0x0237)
<State.OPERATION_ENABLED: 'operation enabled'>
>>> hex(control_word_towards(State.SWITCH_ON_DISABLED))
'0x6'
>>> from drive_profiles.standard.units import Scaling
>>> Scaling(encoder_counts_per_rev=4096, rated_torque_nm=0.5).torque_per_mille(0.1)
200
"""
