"""The consumer of TIME, the time of day (CiA 301, 7.2.6, 7.5.2.15)."""

import struct
from collections.abc import Callable

from drive_profiles.standard.cia301 import CobIdBit, SdoAbortCode, identifier_refusal
from plant_emulator.slave.dictionary import Dictionary

COB_ID = 0x1012
DAY_MS = 86_400_000

_TIME_OF_DAY = struct.Struct("<IH")
_MILLISECONDS = 0x0FFF_FFFF
_NS_PER_MS = 1_000_000


class TimeConsumer:
    """Clock of the network's time between TIME messages, by the node's clock.

    A message that is not 6 bytes long, or names a millisecond that no day has, is ignored. The time is in ns since
    1984-01-01 00:00.

    Args:
        dictionary: Must have 1012h.
        changed: Called when the identifier to listen to has changed.

    Attributes:
        can_id: Identifier of TIME, or None.
    """

    def __init__(self, dictionary: Dictionary, changed: Callable[[], None]) -> None:
        self.can_id: int | None = None
        self._dictionary, self._changed = dictionary, changed
        self._offset: int | None = None
        dictionary.on_write(COB_ID, 0, self._set_cob_id)

    def load(self) -> None:
        """Read the COB-ID from the dictionary, after a reset."""
        self.can_id = None
        self._dictionary.load(COB_ID)

    def forget(self) -> None:
        """Lose the time, as a loss of power does."""
        self._offset = None

    def at(self, now: int) -> int | None:
        """Return the network's time at a node's instant, None before TIME."""
        return None if self._offset is None else now + self._offset

    def receive(self, data: bytes, now: int) -> None:
        """Process a TIME message.

        TIME_OF_DAY is 28 bits of ms after midnight, 4 unused, and 16 of days (CiA 301, 7.1.6.5).
        """
        if len(data) != _TIME_OF_DAY.size:
            return
        milliseconds, days = _TIME_OF_DAY.unpack(data)
        milliseconds &= _MILLISECONDS
        if milliseconds < DAY_MS:
            self._offset = (days * DAY_MS + milliseconds) * _NS_PER_MS - now

    def _set_cob_id(self, cob_id: int) -> SdoAbortCode | None:
        # Bit 31 to consume, bit 30 to produce, which is not supported.
        can_id = cob_id & ~CobIdBit.CONSUME
        consumes = bool(cob_id & CobIdBit.CONSUME)
        code = identifier_refusal(can_id, in_use=self.can_id if consumes else None)
        if code is None:
            self.can_id = can_id if consumes else None
            self._changed()
        return code
