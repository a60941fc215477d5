"""Consequences of a drive's state as one frozen value.

Every SYNC reads it, and each change replaces it whole.
"""

from dataclasses import dataclass

from drive_profiles.standard.cia402 import REMOTE, VOLTAGE_ENABLED, WARNING, State, status_bits
from plant_emulator.drive.state_machine import POWERED, Power


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """A state of the power drive system with its consequences.

    They are precomputed, since an enum lookup costs more than the rest of the status word.

    Attributes:
        is_powered: True if the motor is, or may be, under torque.
        is_enabled: True if the state is Operation enabled.
        is_stopping: True if the motor is being brought to rest, after which the state changes or the motor is held.
        is_following: True if the drive is enabled and not being brought to rest.
        plain_word: The status word without the bits that the mode and the motion add.
    """

    power: Power
    is_powered: bool
    is_enabled: bool
    is_stopping: bool
    is_following: bool
    plain_word: int

    @classmethod
    def of(cls, power: Power, *, torque_off: bool = False, lack: bool = False) -> "DriveStatus":
        """Derive everything from the state machine.

        Args:
            power: The memory of the state machine.
            torque_off: True if safe torque off is active: then the voltage is not enabled.
            lack: True if a mode has been kept from acting: the status word shows it as a warning.
        """
        is_powered = power.state in POWERED
        is_enabled = power.state is State.OPERATION_ENABLED
        is_stopping = is_powered and (not is_enabled or power.leaving is not None)
        word = status_bits(power.state) | REMOTE | (0 if torque_off else VOLTAGE_ENABLED) | (WARNING if lack else 0)
        return cls(power, is_powered, is_enabled, is_stopping, is_enabled and not is_stopping, word)
