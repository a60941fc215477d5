"""Names of signals: quantity and source."""

from dataclasses import dataclass
from enum import StrEnum

from drive_profiles.standard.cia402 import state_of

UNKNOWN_STATE = "unknown state"


class SignalQuantity(StrEnum):
    """Quantities, in the order of their figures."""

    POSITION = "position"
    SPEED = "speed"
    FOLLOWING_ERROR = "following error"
    TORQUE = "torque"
    TIP = "tip acceleration"
    NOTCH = "notch frequency"
    BUS_LOAD = "bus load"
    MISSES = "misses"
    SYNC_DISTANCE = "SYNC interval"
    STATUS_WORD = "status word"


@dataclass(frozen=True)
class Signal:
    """A signal.

    Attributes:
        of: Whose it is: `axis 2`, `node 5`, `tip x`, `bus`.
        unit: Unit; "" for a number.
    """

    of: str
    quantity: SignalQuantity
    unit: str

    @property
    def name(self) -> str:
        """Name: `axis 2 position`, `tip z acceleration`, `bus load`."""
        if self.of == "bus":
            return self.quantity.value
        return f"{self.of} {self.quantity.removeprefix(self.of.split()[0]).strip()}"

    @property
    def entry(self) -> dict[str, str]:
        """Entry of the signal for the page."""
        return {"name": self.name, "of": self.of, "quantity": self.quantity.value, "unit": self.unit}


def state_words() -> list[str]:
    """Return the state for each value of a status word."""
    states = [state_of(word) for word in range(128)]
    return [UNKNOWN_STATE if state is None else state.value for state in states]
