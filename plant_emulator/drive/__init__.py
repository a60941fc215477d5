"""The emulated CiA 402 drive.

It has an object dictionary, a state machine, modes of operation and a power stage, and is bound to one axis.

`drive.drive.Drive` puts the parts together. `drive.state_machine` is the pure state machine of CiA 402-2, without an axis:

    >>> from drive_profiles.standard.cia402 import State
    >>> from plant_emulator.drive.state_machine import Power, commanded
    >>> step = commanded(Power(State.SWITCH_ON_DISABLED), 0x0006)  # shutdown
    >>> step.power.state.value
    'ready to switch on'
"""
