"""Bus addresses, spelt `interface:channel[@bitrate]`, and the choice among several."""

import difflib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

LOCAL = "local"
SOCKETCAN = "socketcan"
PYTHON_CAN_LOCAL = "hil_local"
"""Name by which python-can knows `local`."""

BUS_VARIABLE = "HIL_BUS"
"""Name of the environment variable that holds a bus address for all tools."""

_SPELLING = re.compile(r"(?P<interface>[a-z][a-z0-9_]*):(?P<channel>[^@]+)(?:@(?P<rate>\d+(?:\.\d+)?)(?P<unit>[kM]?))?")
_UNITS = {"": 1, "k": 1_000, "M": 1_000_000}


class AddressError(ValueError):
    """A bus address that cannot be read."""

    def __init__(self, text: str, origin: str = "") -> None:
        """Compose the message.

        `text` is the address that was refused; `origin` names the option, variable or file that gave it.
        """
        self.text, self.origin = text, origin
        where = f"{origin}: " if origin else ""
        super().__init__(
            f"{where}{text!r} is not a bus address; expected INTERFACE:CHANNEL[@BITRATE], e.g. local:/tmp/robot.sock, "
            "socketcan:can0, slcan:/dev/ttyACM0@1M"
        )


class UnknownInterfaceError(AddressError):
    """A bus address with an interface that there is not."""

    def __init__(self, text: str, interface: str, known: tuple[str, ...], origin: str = "") -> None:
        """Compose the message; `known` lists the valid interfaces."""
        self.text, self.origin, self.interface, self.known = text, origin, interface, known
        where = f"{origin}: " if origin else ""
        close = difflib.get_close_matches(interface, known, n=1)
        hint = f", did you mean {close[0]}" if close else ""
        ValueError.__init__(self, f"{where}{text!r}: unknown interface {interface!r}{hint}; expected one of {', '.join(known)}")


@dataclass(frozen=True)
class Address:
    """Address of a CAN bus: interface, channel and bit rate.

    Attributes:
        interface: `local` (the emulator's socket), `socketcan`, or any python-can interface.
        channel: Path of the socket, name of the network interface, or what the interface takes.
        bitrate: Bit rate in bit/s, or None if the interface is already set up.
    """

    interface: str
    channel: str
    bitrate: int | None = None

    def __str__(self) -> str:
        """Return the spelling that `parse_address` reads."""
        rate = "" if self.bitrate is None else f"@{_shortest(self.bitrate)}"
        return f"{self.interface}:{self.channel}{rate}"


def _shortest(bitrate: int) -> str:
    """Return the shortest spelling of a bit rate: 1M for 1000000."""
    unit = next(unit for unit in ("M", "k", "") if bitrate % _UNITS[unit] == 0)
    return f"{bitrate // _UNITS[unit]}{unit}"


def _is_same(text: str, other: str) -> bool:
    """Return True if both texts name the same bus.

    Paths of local sockets are made absolute before the comparison.
    """
    try:
        one, two = parse_address(text), parse_address(other)
    except AddressError:
        return text == other
    if one.interface == two.interface == LOCAL:
        return (os.path.abspath(one.channel), one.bitrate) == (os.path.abspath(two.channel), two.bitrate)
    return one == two


def parse_address(text: str) -> Address:
    """Read a bus address.

    Raises:
        AddressError: The text is not a bus address.
    """
    match = _SPELLING.fullmatch(text.strip())
    if match is None:
        raise AddressError(text)
    rate = match["rate"]
    bitrate = None if rate is None else round(float(rate) * _UNITS[match["unit"]])
    if bitrate == 0:
        raise AddressError(text)
    return Address(match["interface"], match["channel"], bitrate)


def check_interface(text: str, origin: str = "") -> None:
    """Refuse an unreadable address or an unknown interface.

    The bus is not opened.

    Args:
        text: The address.
        origin: Place that names it, for the message.

    Raises:
        AddressError: There is no such address.
    """
    try:
        interface = parse_address(text).interface
    except AddressError:
        raise AddressError(text, origin) from None
    if interface in {LOCAL, SOCKETCAN}:
        return
    from can.interfaces import VALID_INTERFACES  # noqa: PLC0415 - python-can is slow to load

    if interface not in VALID_INTERFACES:
        known = (LOCAL, SOCKETCAN, *sorted(set(VALID_INTERFACES) - {SOCKETCAN, PYTHON_CAN_LOCAL}))
        raise UnknownInterfaceError(text, interface, known, origin)


@dataclass(frozen=True)
class BusChoice:
    """The bus of a command, and the origin of its address.

    Attributes:
        address: Address of the bus, as it was written.
        origin: Place that names it: an option, the environment, a file.
        passed_over: Places that name another bus, with what they name.
    """

    address: str
    origin: str
    passed_over: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        """Return the choice in words, for a command's first line."""
        others = "".join(f"; not {address}, as {origin} says" for origin, address in self.passed_over)
        return f"bus {self.address}, from {self.origin}{others}"


def choose_bus(
    option: str | None,
    otherwise: tuple[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
    *,
    option_name: str = "--bus",
) -> BusChoice | None:
    """Choose the bus of a command.

    The option comes first, then the environment (`HIL_BUS`), then the command's file or default.

    Args:
        option: Address that the user gave as `--bus`.
        otherwise: Name of a file, or of a default, and the address in it.
        environment: Environment variables; those of the process unless they are given. An empty one counts as none.
        option_name: Name of what comes first, for the words.

    Returns:
        The choice; None if no bus is given.

    Raises:
        AddressError: The chosen address cannot be read, or has an unknown interface; the message states its origin.
    """
    variables = os.environ if environment is None else environment
    named = ((option_name, option), (BUS_VARIABLE, variables.get(BUS_VARIABLE) or None), otherwise or ("", None))
    given = [(origin, address) for origin, address in named if address is not None]
    if not given:
        return None
    (origin, address), others = given[0], given[1:]
    check_interface(address, origin)
    return BusChoice(address, origin, tuple(other for other in others if not _is_same(other[1], address)))
