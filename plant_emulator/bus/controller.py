"""Fault confinement of one CAN controller.

It has error counters, a state, and the error messages that SocketCAN makes of state changes.

Source: ISO 11898-1:2015, 12.1.4 (CAN 2.0 specification, part B, clause 8). The words and numbers of an error message are those of
<linux/can/error.h>; which of them a change of state gives is ``can_change_state`` of drivers/net/can/dev/dev.c.

One rule is left out: a receiver that was the first to see an error (a dominant bit follows its flag) adds 8, not 1. Here an error
is seen by all receivers, as the noise on a short bus is.
"""

from enum import IntEnum

from hil.can.frame import CAN_ERR_FLAG, Frame

CAN_ERR_CRTL = 0x004
"""Controller problems, detailed in data[1]."""
CAN_ERR_BUSOFF = 0x040
CAN_ERR_RESTARTED = 0x100
CAN_ERR_CNT = 0x200
"""data[6] and data[7] hold the transmit and the receive error counter."""

WARNING_AT, PASSIVE_AT, OFF_AT = 96, 128, 256
TRANSMIT_ERROR, RECEIVE_ERROR = 8, 1
_REC_AFTER_PASSIVE = 120
"""Receive counter after a good frame, if it was above 127: "a value between 119 and 127" (rule h)."""
_REC_MAX = 255


class ErrorState(IntEnum):
    """State of a controller, numbered as in ``enum can_state``.

    Source: <linux/can/netlink.h>.
    """

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    OFF = 3


_TRANSMIT_WORD = {ErrorState.WARNING: 0x08, ErrorState.PASSIVE: 0x20}
_RECEIVE_WORD = {ErrorState.WARNING: 0x04, ErrorState.PASSIVE: 0x10}
_ACTIVE_AGAIN = 0x40


class Controller:
    """Error counters of one controller.

    Every change returns the error message of a change of state, or None.

    Attributes:
        tec: Transmit error counter.
        rec: Receive error counter.
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
        return self.state >= ErrorState.PASSIVE

    def transmit_failed(self, times: int = 1) -> Frame | None:
        """Rules c, d, f: add eight for each transmitter's error flag."""
        self.tec = min(self.tec + TRANSMIT_ERROR * times, OFF_AT)
        return self._changed()

    def receive_failed(self, by: int = RECEIVE_ERROR) -> Frame | None:
        """Rules a, f: add one for an error seen as receiver.

        `by` is eight for every eight bits of a stuck bus.
        """
        self.rec = min(self.rec + by, _REC_MAX)
        return self._changed()

    def transmitted(self) -> Frame | None:
        """Rule g: subtract one, down to 0."""
        self.tec = max(self.tec - 1, 0)
        return self._changed()

    def received(self) -> Frame | None:
        """Rule h: subtract one, down to 0.

        A counter above 127 returns to a value at which the controller is error-active.
        """
        self.rec = max(self.rec - 1, 0) if self.rec < PASSIVE_AT else _REC_AFTER_PASSIVE
        return self._changed()

    def switch_off(self) -> Frame | None:
        """Go bus-off at once."""
        self.tec = OFF_AT
        return self._changed()

    def restart(self) -> Frame:
        """Return from bus-off (rule 12): both counters at 0."""
        self.tec, self.rec, self.state = 0, 0, ErrorState.ACTIVE
        return Frame(CAN_ERR_FLAG | CAN_ERR_RESTARTED, bytes(8))

    def _changed(self) -> Frame | None:
        worst = max(self.tec, self.rec)
        if self.tec >= OFF_AT or self.state is ErrorState.OFF:
            state = ErrorState.OFF
        elif worst >= PASSIVE_AT:
            state = ErrorState.PASSIVE
        else:
            state = ErrorState.WARNING if worst >= WARNING_AT else ErrorState.ACTIVE
        if state is self.state:
            return None
        self.state = state
        return self._message()

    def _message(self) -> Frame:
        if self.state is ErrorState.OFF:
            return Frame(CAN_ERR_FLAG | CAN_ERR_BUSOFF, bytes(8))
        word = _ACTIVE_AGAIN if self.state is ErrorState.ACTIVE else 0
        if self.tec >= self.rec:
            word |= _TRANSMIT_WORD.get(self.state, 0)
        if self.rec >= self.tec:
            word |= _RECEIVE_WORD.get(self.state, 0)
        return Frame(CAN_ERR_FLAG | CAN_ERR_CRTL | CAN_ERR_CNT, bytes((0, word, 0, 0, 0, 0, self.tec, self.rec)))
