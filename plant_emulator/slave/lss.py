"""The LSS slave (CiA 305): node-ID and bit rate by identity alone."""

from collections.abc import Callable
from enum import Enum, IntEnum

from drive_profiles.standard.cia301 import MAX_NODE_ID
from drive_profiles.standard.cia305 import BIT_TIMINGS, UNCONFIGURED
from plant_emulator.slave.dictionary import Dictionary

_LENGTH = 8
_IDENTITY = 0x1018
_PARTS = range(1, 5)
"""Sub-indices of 1018h that make the LSS address: vendor-ID, product code, revision number, serial number."""
_FAST_SCAN_BEGIN = 0x80


class LssService(IntEnum):
    """Command specifiers (CiA 305, 3.9 to 3.11)."""

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SWITCH_VENDOR = 0x40
    SWITCH_PRODUCT = 0x41
    SWITCH_REVISION = 0x42
    SWITCH_SERIAL = 0x43
    SWITCHED = 0x44
    IDENTIFY_VENDOR = 0x46
    IDENTIFY_PRODUCT = 0x47
    IDENTIFY_REVISION_LOW = 0x48
    IDENTIFY_REVISION_HIGH = 0x49
    IDENTIFY_SERIAL_LOW = 0x4A
    IDENTIFY_SERIAL_HIGH = 0x4B
    IDENTIFY_UNCONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    IDENTIFIED_UNCONFIGURED = 0x50
    FAST_SCAN = 0x51
    INQUIRE_VENDOR = 0x5A
    INQUIRE_PRODUCT = 0x5B
    INQUIRE_REVISION = 0x5C
    INQUIRE_SERIAL = 0x5D
    INQUIRE_NODE_ID = 0x5E


class LssResult(IntEnum):
    """First byte of the answer to a configuration service."""

    DONE = 0
    REFUSED = 1
    """Node-ID out of range, bit timing not supported."""
    NOT_STORED = 2
    """The memory failed."""


class LssState(Enum):
    """States of the LSS slave (CiA 305, 3.8)."""

    WAITING = "waiting"
    CONFIGURATION = "configuration"


class LssSlave:
    """LSS slave: one frame in, at most one out.

    Three node-IDs (CiA 305, 3.6): `stored` is what the node keeps without power; `pending` is what the master has configured,
    and what NMT reset node takes from `stored`; `active`, the one of the identifiers on the bus, follows `pending` at each reset
    of communication. Only frames of 8 bytes are LSS. A request unknown in the state is not answered, since all slaves receive all
    requests.

    Args:
        dictionary: Must have 1018h; parts that are not there count as 0.
        node_id: The stored one: 1 to 127, or `UNCONFIGURED`.
        is_memory_good: Asked before the node-ID is stored.
        on_configured: Called when an unconfigured node has been given a node-ID and shall start with it.

    Attributes:
        state: Waiting, or in configuration.
        stored: Node-ID after the next loss of power.
        pending: Node-ID after the next reset of communication.
        bit_rate: Configured bit rate in bit/s, or None before any has been; no more than a wish: the wire is the owner's.
        stored_bit_rate: Bit rate that the node keeps without power.
        on_bit_rate: Called with the bit rate to be activated and the switch delay in ms: that long the owner waits before he
            changes over, and as long again before anyone sends.
    """

    def __init__(
        self, dictionary: Dictionary, node_id: int, is_memory_good: Callable[[], bool], on_configured: Callable[[], None]
    ) -> None:
        self.stored = self.pending = self.active = node_id
        self.bit_rate: int | None = None
        self.stored_bit_rate: int | None = None
        self.on_bit_rate: Callable[[int, int], None] = lambda bit_rate, delay_ms: None
        self._dictionary, self._is_memory_good, self._on_configured = dictionary, is_memory_good, on_configured
        self.wait()

    def wait(self) -> None:
        """Go to the waiting state; drop a partial selection or scan."""
        self.state = LssState.WAITING
        self._selection: list[int] = []
        self._identification: list[int] = []
        self._scanned = 0

    def reload(self) -> None:
        """Drop values that have not been stored.

        A loss of power and NMT reset node do so.
        """
        self.pending, self.bit_rate = self.stored, self.stored_bit_rate

    def activate(self) -> None:
        """Put the pending node-ID in force, at a reset of communication."""
        self.active = self.pending
        self.wait()

    @property
    def address(self) -> list[int]:
        """Vendor-ID, product code, revision number and serial number."""
        addresses = [(_IDENTITY, part) for part in _PARTS]
        return [self._dictionary.get_int(*address) if address in self._dictionary else 0 for address in addresses]

    def receive(self, data: bytes) -> bytes | None:
        """Return the 8 bytes of the answer, or None."""
        if len(data) != _LENGTH:
            return None
        handler = _SERVICES[self.state].get(data[0])
        answer = None if handler is None else handler(self, data)
        return None if answer is None else bytes(answer).ljust(_LENGTH, b"\0")

    # States

    def _switch_global(self, data: bytes) -> None:
        if data[1] == 1:
            self.state = LssState.CONFIGURATION
        elif data[1] == 0:
            self.wait()
            if self.active == UNCONFIGURED != self.pending:
                self._on_configured()

    def _switch_selective(self, data: bytes) -> tuple[int, ...] | None:
        if _collect(self._selection, data, LssService.SWITCH_VENDOR, LssService.SWITCH_SERIAL) != self.address:
            return None
        self.state = LssState.CONFIGURATION
        return (LssService.SWITCHED,)

    # Configuration

    def _configure_node_id(self, data: bytes) -> tuple[int, ...]:
        node_id = data[1]
        if node_id != UNCONFIGURED and not 1 <= node_id <= MAX_NODE_ID:
            return LssService.CONFIGURE_NODE_ID, LssResult.REFUSED
        self.pending = node_id
        return LssService.CONFIGURE_NODE_ID, LssResult.DONE

    def _configure_bit_timing(self, data: bytes) -> tuple[int, ...]:
        selector, index = data[1], data[2]
        if selector != 0 or index not in BIT_TIMINGS:
            return LssService.CONFIGURE_BIT_TIMING, LssResult.REFUSED
        self.bit_rate = BIT_TIMINGS[index]
        return LssService.CONFIGURE_BIT_TIMING, LssResult.DONE

    def _activate_bit_timing(self, data: bytes) -> None:
        if self.bit_rate is not None:
            self.on_bit_rate(self.bit_rate, int.from_bytes(data[1:3], "little"))

    def _store(self, _data: bytes) -> tuple[int, ...]:
        if not self._is_memory_good():
            return LssService.STORE, LssResult.NOT_STORED
        self.stored, self.stored_bit_rate = self.pending, self.bit_rate
        return LssService.STORE, LssResult.DONE

    # Questions

    def _inquire(self, data: bytes) -> tuple[int, ...]:
        return data[0], *self.address[data[0] - LssService.INQUIRE_VENDOR].to_bytes(4, "little")

    def _identify(self, data: bytes) -> tuple[int, ...] | None:
        asked = _collect(self._identification, data, LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_SERIAL_HIGH)
        if asked is None:
            return None
        vendor, product, revision, serial = self.address
        is_meant = asked[:2] == [vendor, product] and asked[2] <= revision <= asked[3] and asked[4] <= serial <= asked[5]
        return (LssService.IDENTIFIED,) if is_meant else None

    def _identify_unconfigured(self, _data: bytes) -> tuple[int, ...] | None:
        return (LssService.IDENTIFIED_UNCONFIGURED,) if self._is_unconfigured else None

    def _fast_scan(self, data: bytes) -> tuple[int, ...] | None:
        """Compare the upper bits of one part of the address.

        Source: CiA 305, LSS fastscan.

        Byte 5 is the lowest bit that is compared, byte 6 the part, byte 7 the next part. After the last bit of a part the
        slave goes on to the next part; if that part lies before this one, the slave is selected.
        """
        if not self._is_unconfigured:
            return None
        bit, part, following = data[5:8]
        if bit == _FAST_SCAN_BEGIN:
            self._scanned = 0
            return (LssService.IDENTIFIED,)
        if bit > 31 or following >= len(_PARTS) or part != self._scanned:
            return None
        if (self.address[part] ^ int.from_bytes(data[1:5], "little")) >> bit:
            return None
        if bit == 0:
            self._scanned = following
            if following < part:
                self.state = LssState.CONFIGURATION
        return (LssService.IDENTIFIED,)

    @property
    def _is_unconfigured(self) -> bool:
        return self.active == self.pending == UNCONFIGURED


def _collect(values: list[int], data: bytes, first: LssService, last: LssService) -> list[int] | None:
    """Collect one number of a service of several frames.

    Returns all numbers with the last frame, else None. Frames out of order are discarded.
    """
    if data[0] == first:
        values.clear()
    elif not values or data[0] != first + len(values):
        values.clear()
        return None
    values.append(int.from_bytes(data[1:5], "little"))
    if data[0] != last:
        return None
    collected = values[:]
    values.clear()
    return collected


_Handler = Callable[[LssSlave, bytes], tuple[int, ...] | None]

_IN_BOTH: dict[int, _Handler] = {
    LssService.SWITCH_GLOBAL: LssSlave._switch_global,
    **dict.fromkeys(range(LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_SERIAL_HIGH + 1), LssSlave._identify),
    LssService.IDENTIFY_UNCONFIGURED: LssSlave._identify_unconfigured,
}
_SERVICES: dict[LssState, dict[int, _Handler]] = {
    LssState.WAITING: {
        **_IN_BOTH,
        **dict.fromkeys(range(LssService.SWITCH_VENDOR, LssService.SWITCH_SERIAL + 1), LssSlave._switch_selective),
        LssService.FAST_SCAN: LssSlave._fast_scan,
    },
    LssState.CONFIGURATION: {
        **_IN_BOTH,
        LssService.CONFIGURE_NODE_ID: LssSlave._configure_node_id,
        LssService.CONFIGURE_BIT_TIMING: LssSlave._configure_bit_timing,
        LssService.ACTIVATE_BIT_TIMING: LssSlave._activate_bit_timing,
        LssService.STORE: LssSlave._store,
        **dict.fromkeys(range(LssService.INQUIRE_VENDOR, LssService.INQUIRE_SERIAL + 1), LssSlave._inquire),
        LssService.INQUIRE_NODE_ID: lambda slave, _: (LssService.INQUIRE_NODE_ID, slave.active),
    },
}
"""Answers by state; a request that is not listed is for other slaves."""
