"""Bus addresses: one spelling everywhere, `interface:channel[@bitrate]`."""

import re
from dataclasses import dataclass

LOCAL = "local"
SOCKETCAN = "socketcan"

_SPELLING = re.compile(r"(?P<interface>[a-z][a-z0-9_]*):(?P<channel>[^@]+)(?:@(?P<rate>\d+(?:\.\d+)?)(?P<unit>[kM]?))?")
_UNITS = {"": 1, "k": 1_000, "M": 1_000_000}


class AddressError(ValueError):
    """A bus address that cannot be read."""

    def __init__(self, text: str) -> None:
        """Compose the message; `text` is the spelling that was refused."""
        self.text = text
        super().__init__(
            f"{text!r} is no bus address; expected INTERFACE:CHANNEL[@BITRATE], e.g. local:/tmp/robot.sock, "
            "socketcan:can0, slcan:/dev/ttyACM0@1M"
        )


@dataclass(frozen=True)
class Address:
    """Address of a CAN bus: the interface, its channel and its bit rate.

    Attributes:
        interface: `local` (the emulator's socket), `socketcan`, or any python-can interface.
        channel: Path of the socket, name of the network interface, or what the interface takes.
        bitrate: Bit rate in bit/s, or None where the interface is already set up.
    """

    interface: str
    channel: str
    bitrate: int | None = None

    def __str__(self) -> str:
        """Return the spelling that `parse_address` reads."""
        rate = "" if self.bitrate is None else f"@{self.bitrate}"
        return f"{self.interface}:{self.channel}{rate}"


def parse_address(text: str) -> Address:
    """Read a bus address.

    Raises:
        AddressError: The text is no bus address.
    """
    match = _SPELLING.fullmatch(text.strip())
    if match is None:
        raise AddressError(text)
    rate = match["rate"]
    bitrate = None if rate is None else round(float(rate) * _UNITS[match["unit"]])
    if bitrate == 0:
        raise AddressError(text)
    return Address(match["interface"], match["channel"], bitrate)
