"""Option codes of CiA 402 in force, from a drive's dictionary."""

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object
from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.drive.state_machine import Options
from plant_emulator.robots.behaviour import Behaviour


def _check_homing_method(method: int) -> SdoAbortCode | None:
    return None if method in {0, *HOMING_METHODS} else SdoAbortCode.INVALID_VALUE


class OptionCodes:
    """Option codes of one drive.

    The limits of their entries state the permitted values.

    Homing methods are not contiguous, so limits cannot state them: methods that do not exist are refused (0609 0030h),
    unless the maker states the entry.
    """

    def __init__(self, family: DriveFamily, behaviour: Behaviour) -> None:
        """Keep references to the entries."""
        dictionary = family.dictionary
        if not family.states((Object.HOMING_METHOD, 0)):
            dictionary.on_write(Object.HOMING_METHOD, 0, _check_homing_method)
        self._quick_stop, self._shutdown = dictionary.cell(Object.QUICK_STOP_OPTION), dictionary.cell(Object.SHUTDOWN_OPTION)
        self._disable = dictionary.cell(Object.DISABLE_OPERATION_OPTION)
        self._fault_reaction = dictionary.cell(Object.FAULT_REACTION_OPTION)
        self._ends = behaviour.quick_stop_ends_disabled_at_once

    def now(self) -> Options:
        """Return the options in force."""
        return Options(
            self._quick_stop.value,  # type: ignore[arg-type] # whole numbers, all of them
            self._shutdown.value,  # type: ignore[arg-type]
            self._disable.value,  # type: ignore[arg-type]
            self._fault_reaction.value,  # type: ignore[arg-type]
            self._ends,
        )
