"""Opening the bus at an address."""

from drive_profiles.address import LOCAL, SOCKETCAN, Address
from hil.can.channel import Channel


def open_channel(address: Address) -> Channel:
    """Open the bus at an address.

    Raises:
        BusUnavailableError: The bus does not exist, or cannot be used.
    """
    if address.interface == LOCAL:
        from hil.can.local import LocalChannel  # noqa: PLC0415 - a bus loads its own means only

        return LocalChannel(address)
    if address.interface == SOCKETCAN:
        from hil.can.socketcan import SocketCanChannel  # noqa: PLC0415 - likewise

        return SocketCanChannel(address)
    from hil.can.adapter import AdapterChannel  # noqa: PLC0415 - python-can is slow to load

    return AdapterChannel(address)
