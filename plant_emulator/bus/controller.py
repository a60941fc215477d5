"""Fault confinement of one CAN controller: error counters and state.

Source: ISO 11898-1:2015, 12.1.4 (CAN 2.0 specification, part B, clause 8).

One rule is left out: a receiver that was the first to see an error (a dominant bit follows its flag) adds 8, not 1. Here an error
is seen by all receivers, as the noise on a short bus is.
"""

from enum import Enum

PASSIVE_AT, OFF_AT = 128, 256
TRANSMIT_ERROR, RECEIVE_ERROR = 8, 1
_REC_AFTER_PASSIVE = 120
"""Receive counter after a good frame, if it was above 127: "a value between 119 and 127" (rule h)."""
_REC_MAX = 255


class ErrorState(Enum):
    """State of a controller."""

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    OFF = "bus-off"


class Controller:
    """Error counters of one controller.

    Every change returns True if it has put the controller bus-off.

    Attributes:
        state: Error state that follows from both counters.
    """

    __slots__ = ("rec", "state", "tec")

    def __init__(self) -> None:
        """Start error-active, both counters at 0."""
        self.tec, self.rec, self.state = 0, 0, ErrorState.ACTIVE

    @property
    def is_passive(self) -> bool:
        """True while the controller is error-passive or bus-off.

        Its error flags are recessive, and its transmissions are suspended for 8 bits (12.1.4.3).
        """
        return self.state is not ErrorState.ACTIVE

    def transmit_failed(self, times: int = 1) -> bool:
        """Rules c, d, f: add eight for each transmitter's error flag."""
        self.tec = min(self.tec + TRANSMIT_ERROR * times, OFF_AT)
        return self._changed()

    def receive_failed(self, by: int = RECEIVE_ERROR) -> bool:
        """Rules a, f: add one for an error seen as receiver.

        `by` is eight for every eight bits of a stuck bus.
        """
        self.rec = min(self.rec + by, _REC_MAX)
        return self._changed()

    def transmitted(self) -> bool:
        """Rule g: subtract one, down to 0."""
        self.tec = max(self.tec - 1, 0)
        return self._changed()

    def received(self) -> bool:
        """Rule h: subtract one, down to 0.

        A counter above 127 returns to a value at which the controller is error-active.
        """
        self.rec = max(self.rec - 1, 0) if self.rec < PASSIVE_AT else _REC_AFTER_PASSIVE
        return self._changed()

    def switch_off(self) -> bool:
        """Go bus-off at once."""
        self.tec = OFF_AT
        return self._changed()

    def restart(self) -> None:
        """Return from bus-off (rule 12): both counters at 0."""
        self.tec, self.rec, self.state = 0, 0, ErrorState.ACTIVE

    def _changed(self) -> bool:
        was_off = self.state is ErrorState.OFF
        if was_off or self.tec >= OFF_AT:
            self.state = ErrorState.OFF
        else:
            self.state = ErrorState.PASSIVE if max(self.tec, self.rec) >= PASSIVE_AT else ErrorState.ACTIVE
        return self.state is ErrorState.OFF and not was_off
