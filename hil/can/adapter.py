"""A channel on any python-can bus."""

from typing import Any

import can

from hil.can.address import Address
from hil.can.channel import BusLostError, BusUnavailableError
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame


class AdapterChannel:
    """python-can's `Bus` as a channel; time on it is the wall clock's."""

    is_lock_step = False

    def __init__(self, address: Address) -> None:
        """Open the bus; `BusUnavailableError` where python-can cannot."""
        self.address = address
        settings: dict[str, Any] = {} if address.bitrate is None else {"bitrate": address.bitrate}
        try:
            self._bus = can.Bus(interface=address.interface, channel=address.channel, **settings)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise BusUnavailableError(address, str(error)) from error

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus."""
        can_id = frame.can_id
        message = can.Message(
            arbitration_id=can_id & 0x1FFFFFFF,
            is_extended_id=bool(can_id & CAN_EFF_FLAG),
            is_remote_frame=bool(can_id & CAN_RTR_FLAG),
            data=frame.data,
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise BusLostError(self.address, str(error)) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time."""
        try:
            message = self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise BusLostError(self.address, str(error)) from error
        if message is None:
            return None
        flags = (
            (CAN_EFF_FLAG if message.is_extended_id else 0)
            | (CAN_RTR_FLAG if message.is_remote_frame else 0)
            | (CAN_ERR_FLAG if message.is_error_frame else 0)
        )
        return Frame(message.arbitration_id | flags, bytes(message.data))

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()
