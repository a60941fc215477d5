"""Frames as the participants of a bus send and hear them."""

from typing import NamedTuple

from hil.can.frame import Frame

FIRST_CLIENT = 1000
"""Ports of clients count from here; a node's port is its node-ID."""


class HeardFrame(NamedTuple):
    """A frame that has ended on the wire.

    Attributes:
        frame: The frame that every participant but the sender has received.
        port: Port of the sender.
        end_ns: End of the frame, in the world's time.
    """

    frame: Frame
    port: int
    end_ns: int
