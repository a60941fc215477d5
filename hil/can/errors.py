"""Errors of a bus."""

import re

from drive_profiles.address import Address

_ERRNO = re.compile(r"\[Errno \d+\] ")
"""The number that Python puts before the words of an error of the system."""


class ChannelError(Exception):
    """Root of a bus' errors."""


class BusUnavailableError(ChannelError):
    """The bus could not be opened."""

    def __init__(self, address: Address, reason: str) -> None:
        self.address, self.reason = address, _ERRNO.sub("", reason)
        super().__init__(f"no bus at {address}: {self.reason}")


class BusLostError(ChannelError):
    """The bus has failed since it was opened.

    It is closed, its interface is down, or its queue does not drain.
    """

    def __init__(self, address: Address, reason: str) -> None:
        self.address, self.reason = address, reason
        super().__init__(f"bus {address} lost: {reason}")
