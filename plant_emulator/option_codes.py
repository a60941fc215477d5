"""The option codes of CiA 402 in a drive's dictionary: which values they take, and what is in force."""

from collections.abc import Callable
from enum import IntEnum

from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.cia402 import (
    AbortConnectionOption,
    DisableOperationOption,
    FaultReactionOption,
    HaltOption,
    Object,
    QuickStopOption,
    ShutdownOption,
)
from plant_emulator.cia402_objects import HOMING_METHODS
from plant_emulator.personality import Personality
from plant_emulator.robot import Behaviour
from plant_emulator.state_machine import Options

SUPPORTED: dict[Object, type[IntEnum]] = {
    Object.ABORT_CONNECTION_OPTION: AbortConnectionOption,
    Object.QUICK_STOP_OPTION: QuickStopOption,
    Object.SHUTDOWN_OPTION: ShutdownOption,
    Object.DISABLE_OPERATION_OPTION: DisableOperationOption,
    Object.HALT_OPTION: HaltOption,
    Object.FAULT_REACTION_OPTION: FaultReactionOption,
}
RELATIVE_OPTIONS = 3
"""60F2h takes 0, 1 and 2, what a relative set-point counts from; its other fields are not supported."""


def _one_of(values: frozenset[int]) -> Callable[[int], SdoAbortCode | None]:
    return lambda value: None if value in values else SdoAbortCode.INVALID_VALUE


class OptionCodes:
    """The option codes of one drive.

    A value that the standard does not know is refused (0609 0030h), but of an entry that is the vendor's to state.
    """

    def __init__(self, personality: Personality, behaviour: Behaviour) -> None:
        """Take hold of the entries."""
        dictionary = personality.dictionary
        allowed = {index: frozenset(int(option) for option in options) for index, options in SUPPORTED.items()}
        allowed |= {
            Object.POSITIONING_OPTION: frozenset(range(RELATIVE_OPTIONS)),
            Object.HOMING_METHOD: frozenset((0, *HOMING_METHODS)),
        }
        for index, values in allowed.items():
            if not personality.states((index, 0)):
                dictionary.on_write(index, 0, _one_of(values))
        self._quick_stop, self._shutdown = dictionary.cell(Object.QUICK_STOP_OPTION), dictionary.cell(Object.SHUTDOWN_OPTION)
        self._disable = dictionary.cell(Object.DISABLE_OPERATION_OPTION)
        self._fault_reaction = dictionary.cell(Object.FAULT_REACTION_OPTION)
        self._ends = behaviour.quick_stop_ends_disabled_at_once

    def now(self) -> Options:
        """What is in force."""
        return Options(
            self._quick_stop.value,  # type: ignore[arg-type] # whole numbers, all of them
            self._shutdown.value,  # type: ignore[arg-type]
            self._disable.value,  # type: ignore[arg-type]
            self._fault_reaction.value,  # type: ignore[arg-type]
            self._ends,
        )
