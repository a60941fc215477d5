"""SocketCAN's error frames in words, for every bit that they may have."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.can import errors_frame
from hil.can.errors_frame import BUS_OFF, CONTROLLER, COUNTERS, PROTOCOL, RESTARTED, decode
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, Frame


def error(kind, *data):
    return Frame(CAN_ERR_FLAG | kind, bytes(data).ljust(8, b"\0"))


@pytest.mark.parametrize("can_id", [0x0, 0x40, 0x7FF, CAN_EFF_FLAG | 0x44])
def test_what_was_on_the_wire_is_no_event(can_id):
    assert decode(Frame(can_id, bytes(8))) is None


@pytest.mark.parametrize("can_id", [CAN_ERR_FLAG, CAN_ERR_FLAG | 0x1000_0000, CAN_ERR_FLAG | 0x400])
def test_a_class_that_nobody_has_defined_is_no_event(can_id):
    assert decode(Frame(can_id, b"\xff" * 8)) is None


@pytest.mark.parametrize(
    ("frame", "words", "flags"),
    [
        (error(BUS_OFF), "bus-off", "lost"),
        (error(RESTARTED), "restart-ms 0", "lost"),
        (error(CONTROLLER, 0, 0x04), "error-warning level of received frames", "warning"),
        (error(CONTROLLER, 0, 0x08), "error-warning level of sent frames", "warning"),
        (error(CONTROLLER, 0, 0x10), "error-passive by received frames", "warning"),
        (error(CONTROLLER, 0, 0x20), "error-passive by sent frames", "warning"),
        (error(CONTROLLER, 0, 0x20, 0, 0, 0, 0, 128, 3), "transmit 128, receive 3", "warning"),
        (error(CONTROLLER, 0, 0x40), "error-active again", ""),
        (error(CONTROLLER, 0, 0x01), "lost in the controller's receive buffer", "overflow"),
        (error(CONTROLLER, 0, 0x02), "transmit buffer", ""),
        (error(CONTROLLER), "unknown controller problem", ""),
        (error(PROTOCOL, 0, 0, 0x84), "protocol violation (bit stuffing error, while sending)", ""),
        (error(PROTOCOL), "protocol violation", ""),
        (error(0x001), "could not be sent in time", ""),
        (error(0x002), "arbitration lost", ""),
        (error(0x010), "transceiver", ""),
        (error(0x020), "no node acknowledges", ""),
        (error(0x080), "bus error", ""),
        (error(COUNTERS), "error counters: transmit 0, receive 0", ""),
        (error(CONTROLLER | BUS_OFF, 0, 0x20), "bus-off; error-passive by sent frames", "lost warning"),
    ],
)  # fmt: skip
def test_every_class_has_its_words_and_consequence(frame, words, flags):
    event = decode(frame)
    assert words in event.words
    assert {name for name in ("lost", "warning", "overflow") if getattr(event, f"is_{name}")} == set(flags.split())


@given(st.integers(0, errors_frame.ALL_CLASSES), st.binary(max_size=8))
def test_no_bytes_make_it_raise(kind, data):
    event = decode(Frame(CAN_ERR_FLAG | kind, data))
    assert (event is None) == (kind & 0x3FF == 0)
    assert event is None or event.words
