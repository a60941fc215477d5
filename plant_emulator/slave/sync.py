"""The consumer of SYNC (CiA 301, 7.2.5; 1005h, 1007h, 1019h)."""

from collections.abc import Callable
from functools import partial

from drive_profiles.standard.cia301 import EmergencyCode, ErrorRegister, SdoAbortCode, identifier_refusal
from hil.can.frame import CAN_SFF_MASK
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.emergency import EmergencyProducer

COB_ID = 0x1005
CYCLE_PERIOD = 0x1006
WINDOW = 0x1007
COUNTER_OVERFLOW = 0x1019

MAX_COUNTER = 240

_CAUSE = "SYNC length"
_DO_NOT_CARE = 1 << 31
_NEVER = 1 << 63


class SyncConsumer:
    """Consumer of SYNC; the node does not produce it.

    With 1019h = 0 a SYNC has no data (7.2.5.3), but a counter byte is tolerated and ignored. With
    a counter the length is 1. Any other length is reported as emergency 8240h, which is withdrawn with the next right SYNC.
    A SYNC that is too long is not acted upon; one that lacks the counter is, except by TPDOs that wait for a counter value.

    The synchronous window 1007h acts on RPDOs: what comes after it waits for no SYNC, but is dropped. TPDOs need none: they
    leave in the instant of SYNC, and what holds them back afterwards is the bus.

    Args:
        dictionary: Must have 1005h, 1007h and 1019h; 1006h if there is one.
        emergency: Hears of a SYNC of the wrong length.
        changed: Called when one of the objects has been written.

    Attributes:
        can_id: Identifier to listen to.
        overflow: 1019h: highest value of the counter, or 0.
        window_ns: 1007h, or 0.
        counter: That of the last SYNC; None if it had none.
        closes_at: End of the window that the last SYNC opened; far away if there is none.
        is_plain: True if a SYNC without data is right and opens no window, so that `accepts` need not be asked.
    """

    def __init__(self, dictionary: Dictionary, emergency: EmergencyProducer, changed: Callable[[], None]) -> None:
        self._dictionary, self._emergency, self._changed = dictionary, emergency, changed
        self._has_wrong_length = False
        self._refusals: dict[int, Callable[[int], SdoAbortCode | None]] = {
            # CiA 301, 7.5.2.5: bit 31 does not care; bit 30, to generate SYNC, is not supported
            COB_ID: lambda new: identifier_refusal(new & ~_DO_NOT_CARE),
            COUNTER_OVERFLOW: lambda new: SdoAbortCode.INVALID_VALUE if new == 1 or new > MAX_COUNTER else None,
        }
        self.can_id = self.overflow = self.window_ns = 0
        self.counter: int | None = None
        self.closes_at = _NEVER
        self.is_plain = True
        for index in (COB_ID, COUNTER_OVERFLOW, WINDOW):
            dictionary.on_write(index, 0, partial(self._write, index))

    def load(self) -> None:
        """Read the objects from the dictionary.

        A value that could not have been written is replaced by the default.
        """
        for index, refusal in self._refusals.items():
            cell = self._dictionary.cell(index)
            if refusal(self._dictionary.get_int(index)) is not None:
                cell.value = cell.entry.default_for(self._dictionary.node_id)
        self._has_wrong_length = False
        self._apply(*(self._dictionary.get_int(index) for index in (COB_ID, COUNTER_OVERFLOW, WINDOW)))

    def accepts(self, data: bytes, now: int) -> bool:
        """Process a SYNC, counter and window; True if the node must act."""
        length = len(data)
        is_right = length == 1 if self.overflow else length <= 1
        if is_right == self._has_wrong_length:
            self._report(is_right)
        if length > 1:
            return False
        self.counter = data[0] if is_right and self.overflow else None
        if self.window_ns:
            self.closes_at = now + self.window_ns
        return True

    def _report(self, is_right: bool) -> None:
        self._has_wrong_length = not is_right
        self._judge()
        if is_right:
            self._emergency.clear_cause(_CAUSE)
        else:
            self._emergency.raise_cause(_CAUSE, EmergencyCode.SYNC_LENGTH, ErrorRegister.COMMUNICATION)

    def _judge(self) -> None:
        self.is_plain = not (self.overflow or self.window_ns or self._has_wrong_length)

    def _apply(self, cob_id: int, overflow: int, window_us: int) -> None:
        self.can_id, self.overflow, self.window_ns = cob_id & CAN_SFF_MASK, overflow, 1000 * window_us
        self.counter, self.closes_at = None, _NEVER
        self._judge()

    def _write(self, index: int, value: int) -> SdoAbortCode | None:
        refusal = self._refusals.get(index)
        code = None if refusal is None else refusal(value)
        if code is None and index == COUNTER_OVERFLOW and value != self.overflow and self._has_period():
            code = SdoAbortCode.DEVICE_STATE  # CiA 301, 7.5.2.22: only while 1006h is 0
        if code is None:
            values = {each: self._dictionary.get_int(each) for each in (COB_ID, COUNTER_OVERFLOW, WINDOW)} | {index: value}
            self._apply(values[COB_ID], values[COUNTER_OVERFLOW], values[WINDOW])
            self._changed()
        return code

    def _has_period(self) -> bool:
        return (CYCLE_PERIOD, 0) in self._dictionary and self._dictionary.get_int(CYCLE_PERIOD) != 0
