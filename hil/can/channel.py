"""What the master asks of a bus: send a frame, receive one by an instant."""

from collections.abc import Sequence
from typing import Protocol

from drive_profiles.address import LOCAL, SOCKETCAN, Address
from hil.can.frame import Frame


class ChannelError(Exception):
    """Root of what a bus can do to its user."""


class BusUnavailableError(ChannelError):
    """The bus could not be opened."""

    def __init__(self, address: Address, reason: str) -> None:
        """Keep address and reason."""
        self.address, self.reason = address, reason
        super().__init__(f"no bus at {address}: {reason}")


class BusLostError(ChannelError):
    """The bus was there and is gone: closed, interface down, or a queue that does not drain."""

    def __init__(self, address: Address, reason: str) -> None:
        """Keep address and reason."""
        self.address, self.reason = address, reason
        super().__init__(f"bus {address} lost: {reason}")


class Channel(Protocol):
    """One bus, for one thread."""

    @property
    def address(self) -> Address:
        """Where it is."""
        ...

    @property
    def is_lock_step(self) -> bool:
        """Whether time on this bus is counted in SYNCs."""
        ...

    @property
    def overflows(self) -> int | None:
        """Received frames that were lost for want of room since the bus was opened; None where nobody counts them."""
        ...

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        Raises:
            BusLostError: It cannot be sent; it will not be sent later either.
        """
        ...

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, one after the other; in one piece where the bus takes that.

        Raises:
            BusLostError: One cannot be sent; neither can those behind it.
        """
        ...

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """The next frame and those that have come in one piece with it; empty when none came in time.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def close(self) -> None:
        """Leave the bus. Again is allowed."""
        ...


def open_channel(address: Address) -> Channel:
    """Open the bus at an address: the local bus and SocketCAN raw, all others by python-can.

    Raises:
        BusUnavailableError: It is not there, or cannot be used.
    """
    if address.interface in {LOCAL, SOCKETCAN}:
        from hil.can.raw import RawChannel  # noqa: PLC0415 - a bus loads its own means only

        return RawChannel(address)
    from hil.can.adapter import AdapterChannel  # noqa: PLC0415 - python-can is slow to load

    return AdapterChannel(address)
