"""Control words of the master, and states without torque (CiA 402-2)."""

from drive_profiles.standard.cia402 import State

SHUTDOWN, SWITCH_ON, QUICK_STOP, DISABLE_VOLTAGE, FAULT_RESET = 0x0006, 0x0007, 0x0002, 0x0000, 0x0080

DISABLED = frozenset({
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.FAULT,
})  # fmt: skip
"""States without torque."""
