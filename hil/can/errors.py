"""Errors of a bus."""

from drive_profiles.address import Address, without_errno


class ChannelError(Exception):
    """Root of a bus' errors."""


class BusUnavailableError(ChannelError):
    """The bus could not be opened."""

    def __init__(self, address: Address, reason: str) -> None:
        self.address, self.reason = address, without_errno(reason)
        super().__init__(f"no bus at {address}: {self.reason}")


class BusLostError(ChannelError):
    """The bus has failed since it was opened.

    It is closed, its interface is down, or its queue does not drain.
    """

    def __init__(self, address: Address, reason: str) -> None:
        self.address, self.reason = address, reason
        super().__init__(f"bus {address} lost: {reason}")
