"""The master's interface of a bus: send and receive frames."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from drive_profiles.address import Address
from hil.can.frame import Frame


class Channel(Protocol):
    """One bus, for one thread."""

    @property
    def address(self) -> Address:
        """The address of the bus."""
        ...

    @property
    def is_lock_step(self) -> bool:
        """True if time on this bus is counted in SYNCs."""
        ...

    @property
    def waits(self) -> bool:
        """True if frames may come that no `send` has caused.

        Else what `receive` does not find is not there until the next `send`.
        """
        ...

    @property
    def overflows(self) -> int | None:
        """Received frames that were lost for want of room.

        Since the bus was opened; None if the bus does not count them.
        """
        ...

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        Raises:
            BusLostError: The frame cannot be sent, and will not be sent later.
        """
        ...

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, one after the other.

        Raises:
            BusLostError: A frame cannot be sent; those behind it are not sent either.
        """
        ...

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Receive the next frame and those in one message with it.

        Empty if none comes in time.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def close(self) -> None:
        """Leave the bus; a second call does nothing."""
        ...


class OneByOne:
    """Base of the channels on which frames go and come one by one."""

    def send_all(self: Channel, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, one after the other."""
        for frame in frames:
            self.send(frame)

    def receive_all(self: Channel, timeout_s: float) -> list[Frame]:
        """Receive the next frame as a list of one, or of none."""
        frame = self.receive(timeout_s)
        return [] if frame is None else [frame]


@runtime_checkable
class MessageChannel(Protocol):
    """A bus in lock-step that takes a cycle in one message each way, as records."""

    @property
    def line(self) -> Any:
        """The core's `struct line`, if it can exchange messages itself; else None."""
        ...

    def open_line(self) -> None:
        """Prepare the line for cycles that the core exchanges by itself.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def close_line(self) -> None:
        """Take over what has happened on the line since."""
        ...

    @property
    def takes_messages(self) -> bool:
        """True if it does so now: no frame of an earlier message may still be unread."""
        ...

    def send_message(self, records: bytes) -> None:
        """Send the records of a cycle in one message; the last is SYNC.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def receive_message(self, timeout_s: float) -> bytes:
        """Receive the records of the next message; empty if none comes.

        Raises:
            BusLostError: The bus is gone.
        """
        ...

    def put_back(self, message: bytes) -> None:
        """Let a message that `receive_message` has given be read frame by frame."""
        ...
