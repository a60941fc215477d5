"""Errors of a bus."""

from drive_profiles.address import Address


class ChannelError(Exception):
    """Root of a bus' errors."""


class BusUnavailableError(ChannelError):
    """The bus could not be opened."""

    def __init__(self, address: Address, reason: str) -> None:
        """Keep address and reason."""
        self.address, self.reason = address, reason
        super().__init__(f"no bus at {address}: {reason}")


class BusLostError(ChannelError):
    """The bus has failed since it was opened.

    It is closed, its interface is down, or its queue does not drain.
    """

    def __init__(self, address: Address, reason: str) -> None:
        """Keep address and reason."""
        self.address, self.reason = address, reason
        super().__init__(f"bus {address} lost: {reason}")
