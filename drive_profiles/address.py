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

_RATE = re.compile(r"(?P<rate>\d+(?:\.\d+)?)(?P<unit>[kM]?)")
_SPELLING = re.compile(rf"(?P<interface>[a-z][a-z0-9_]*):(?P<channel>[^@]+)(?:@{_RATE.pattern})?")
_UNITS = {"": 1, "k": 1_000, "M": 1_000_000}


NO_ADDRESS = (
    " is not a bus address; expected INTERFACE:CHANNEL[@BITRATE], e.g. local:/tmp/robot.sock, socketcan:can0, "
    "slcan:/dev/ttyACM0@1M"
)

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of CiA 301 and of makers' EDS files, in bit/s; the least and the largest bound those of classic CAN."""


class AddressError(ValueError):
    """A bus address that cannot be used."""

    def __init__(self, text: str, origin: str = "", why: str = NO_ADDRESS) -> None:
        """Compose the message, in which `why` follows the address."""
        self.text, self.origin, self.why = text, origin, why
        where = f"{origin}: " if origin else ""
        super().__init__(f"{where}{text!r}{why}")


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
    """Return True if both texts name the same bus."""
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
        AddressError: The text is not a bus address, or its bit rate is not one of classic CAN.
    """
    match = _SPELLING.fullmatch(text.strip())
    if match is None:
        raise AddressError(text)
    bitrate = None
    if match["rate"] is not None:
        rate = match["rate"] + match["unit"]
        try:
            bitrate = parse_bit_rate(rate)
        except AddressError as error:
            raise AddressError(text, "", f": {rate!r}{error.why}") from None
    return Address(match["interface"], match["channel"], bitrate)


def parse_bit_rate(text: str) -> int:
    """Read a bit rate of classic CAN, in bit/s: `1M`, `500k` or `125000`.

    Raises:
        AddressError: The text is not such a bit rate.
    """
    match = _RATE.fullmatch(text.strip())
    rate = 0 if match is None else round(float(match["rate"]) * _UNITS[match["unit"]])
    if not BIT_RATES[0] <= rate <= BIT_RATES[-1]:
        usual = [_shortest(each) for each in BIT_RATES]
        why = f" is not a bit rate of classic CAN; expected {', '.join(usual)}, or another from {usual[0]} to {usual[-1]}"
        raise AddressError(text, "", why)
    return rate


def check_interface(text: str, origin: str = "") -> None:
    """Refuse an unreadable address or an unknown interface; open nothing.

    Raises:
        AddressError: There is no such address; `origin` names its place.
    """
    try:
        interface = parse_address(text).interface
    except AddressError as error:
        raise AddressError(text, origin, error.why) from None
    if interface in {LOCAL, SOCKETCAN}:
        return
    from can.interfaces import VALID_INTERFACES  # noqa: PLC0415 - python-can is slow to load

    if interface not in VALID_INTERFACES:
        known = (LOCAL, SOCKETCAN, *sorted(set(VALID_INTERFACES) - {SOCKETCAN, PYTHON_CAN_LOCAL}))
        close = difflib.get_close_matches(interface, known, n=1)
        hint = f", did you mean {close[0]}" if close else ""
        raise AddressError(text, origin, f": unknown interface {interface!r}{hint}; expected one of {', '.join(known)}")


@dataclass(frozen=True)
class BusChoice:
    """The bus of a command, and the origin of its address.

    Attributes:
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
    """Choose the bus of a command; None if no bus is given.

    The option comes first, then the environment (`HIL_BUS`), then the command's file or default.

    Args:
        option: Address that the user gave as `--bus`.
        otherwise: Name of a file, or of a default, and the address in it.
        environment: Environment variables; those of the process unless they are given. An empty one counts as none.
        option_name: Name of what comes first, for the words.

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


_ERRNO = re.compile(r"\[Errno \d+\] ")


def without_errno(words: str) -> str:
    """Return why an address has no bus, without the numbers that Python puts before an error of the system."""
    return _ERRNO.sub("", words)
