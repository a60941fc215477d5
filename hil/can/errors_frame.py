"""SocketCAN's error frames in words.

A controller's report about itself, and its meaning for the bench.

Source: <linux/can/error.h>.
"""

from typing import NamedTuple

from hil.can.frame import CAN_ERR_FLAG, Frame

ALL_CLASSES = 0x1FFF_FFFF
"""The mask that asks a raw socket for error frames of every class."""

TX_TIMEOUT, LOST_ARBITRATION, CONTROLLER, PROTOCOL = 0x001, 0x002, 0x004, 0x008
TRANSCEIVER, NO_ACKNOWLEDGE, BUS_OFF, BUS_ERROR, RESTARTED, COUNTERS = 0x010, 0x020, 0x040, 0x080, 0x100, 0x200
"""Error classes: bits of the identifier."""

RX_OVERFLOW, TX_OVERFLOW, RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE, ACTIVE = (1 << bit for bit in range(7))
"""State of the controller: bits of data byte 1, class CONTROLLER."""

_STATES = {
    RX_OVERFLOW: "a frame was lost in the controller's receive buffer",
    TX_OVERFLOW: "the controller's transmit buffer has overflowed",
    RX_WARNING: "error-warning level of received frames",
    TX_WARNING: "error-warning level of sent frames",
    RX_PASSIVE: "error-passive by received frames",
    TX_PASSIVE: "error-passive by sent frames",
    ACTIVE: "error-active again",
}
_PROTOCOL = {
    0x01: "single bit error",
    0x02: "frame format error",
    0x04: "bit stuffing error",
    0x08: "a dominant bit could not be sent",
    0x10: "a recessive bit could not be sent",
    0x20: "bus overload",
    0x40: "active error announcement",
    0x80: "while sending",
}
_PLAIN = {
    TX_TIMEOUT: "a frame could not be sent in time",
    LOST_ARBITRATION: "arbitration lost",
    TRANSCEIVER: "transceiver error: check the wires",
    NO_ACKNOWLEDGE: "no node acknowledges: no other node, another bit rate, or no termination",
    BUS_OFF: "the controller is bus-off",
    BUS_ERROR: "bus error",
    RESTARTED: "the controller was bus-off and has restarted automatically; set restart-ms 0",
}
_KNOWN = sum(_PLAIN) | CONTROLLER | PROTOCOL | COUNTERS


class ControllerEvent(NamedTuple):
    """Content of an error frame.

    Attributes:
        words: The whole content in words.
        is_lost: The controller is, or has been, off the bus, and has not sent the frames of that time.
        is_warning: The controller is error-warning or error-passive, so near to bus-off.
        is_overflow: The controller has lost a received frame before this machine saw it.
    """

    words: str
    is_lost: bool
    is_warning: bool
    is_overflow: bool


def decode(frame: Frame) -> ControllerEvent | None:
    """Return the event of an error frame, or None.

    None for any other frame, and for undefined classes. No bytes raise an error.
    """
    can_id, data = frame
    if not can_id & CAN_ERR_FLAG or not can_id & _KNOWN:
        return None
    data = data.ljust(8, b"\0")
    state = data[1] if can_id & CONTROLLER else 0
    words = [text for bit, text in _PLAIN.items() if can_id & bit]
    words += [text for bit, text in _STATES.items() if state & bit]
    if can_id & CONTROLLER and not state:
        words.append("unknown controller problem")
    if can_id & PROTOCOL:
        kinds = [text for bit, text in _PROTOCOL.items() if data[2] & bit]
        words.append("protocol violation" + (f" ({', '.join(kinds)})" if kinds else ""))
    if can_id & COUNTERS or data[6] or data[7]:
        words.append(f"error counters: transmit {data[6]}, receive {data[7]}")
    return ControllerEvent(
        words="; ".join(words),
        is_lost=bool(can_id & (BUS_OFF | RESTARTED)),
        is_warning=bool(state & (RX_WARNING | TX_WARNING | RX_PASSIVE | TX_PASSIVE)),
        is_overflow=bool(state & RX_OVERFLOW),
    )
