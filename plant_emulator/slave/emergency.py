"""The emergency producer: named causes, the error register 1001h, the history 1003h and the frames (CiA 301, 7.2.7)."""

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from drive_profiles.cia301 import CobIdBit, EmergencyCode, ErrorRegister, SdoAbortCode, Value, is_restricted
from hil.can.frame import CAN_SFF_MASK, Frame
from plant_emulator.slave.dictionary import Dictionary, ResetKind, SdoAbort

ERROR_REGISTER = 0x1001
HISTORY = 0x1003
COB_ID = 0x1014

_LAYOUT = struct.Struct("<HB5s")
_VENDOR_LENGTH = 5


@dataclass(frozen=True, slots=True)
class _Error:
    code: int
    register: ErrorRegister


class EmergencyProducer:
    """Keeps the causes that are active, and sends a frame when one arises and when the last has gone.

    Args:
        dictionary: Brings 1001h, 1003h with as many sub-indices as the history is long, and 1014h.
        send: Takes each frame.

    Attributes:
        enabled: Whether frames may be sent; register and history are kept in any case.
    """

    def __init__(self, dictionary: Dictionary, send: Callable[[Frame], None]) -> None:
        self.enabled = False
        self._send = send
        self._active: dict[str, _Error] = {}
        depth = sum(entry.index == HISTORY and entry.subindex > 0 for entry in dictionary)
        self._history: deque[int] = deque(maxlen=depth)
        self._dictionary = dictionary
        dictionary.on_write(COB_ID, 0, self._check_cob_id)
        dictionary.on_read(ERROR_REGISTER, 0, lambda: int(self.register))
        dictionary.on_read(HISTORY, 0, lambda: len(self._history))
        dictionary.on_write(HISTORY, 0, self._clear_history)
        for subindex in range(1, depth + 1):
            dictionary.on_read(HISTORY, subindex, partial(self._past, subindex))

    @property
    def register(self) -> ErrorRegister:
        """The bits of all active causes; the generic bit is set while there is any (CiA 301, 7.5.2.2)."""
        register = ErrorRegister(0)
        for error in self._active.values():
            register |= error.register | ErrorRegister.GENERIC
        return register

    @property
    def causes(self) -> tuple[str, ...]:
        """The active causes, in the order in which they arose."""
        return tuple(self._active)

    def raise_cause(self, cause: str, code: int, register: ErrorRegister = ErrorRegister.GENERIC, vendor: bytes = b"") -> None:
        """Report an error; nothing happens while the same cause is active with the same code.

        Raises:
            ValueError: The code does not fit 16 bits or says "no error", or there are more than 5 vendor bytes.
        """
        if not 0x0100 <= code <= 0xFFFF or len(vendor) > _VENDOR_LENGTH:
            raise ValueError(f"no emergency: code {code:#x}, {len(vendor)} vendor bytes")
        error = _Error(code, register)
        if self._active.get(cause) == error:
            return
        self._active[cause] = error
        # CiA 301, 7.5.2.4: the newest at sub-index 1; the upper half is the manufacturer's.
        self._history.appendleft(int.from_bytes(vendor[:2], "little") << 16 | code)
        self._emit(code, vendor)

    def clear_cause(self, cause: str) -> None:
        """Withdraw a cause; when it was the last, error code 0000h is sent (CiA 301, 7.2.7.2)."""
        if self._active.pop(cause, None) is not None and not self._active:
            self._emit(EmergencyCode.NO_ERROR, b"")

    def reset(self, kind: ResetKind) -> None:
        """Forget, without a frame: all causes and the history, or only those of communication."""
        if kind is ResetKind.NODE:
            self._active.clear()
            self._history.clear()
        else:
            kept = {c: e for c, e in self._active.items() if ErrorRegister.COMMUNICATION not in e.register}
            self._active = kept

    def _emit(self, code: int, vendor: bytes) -> None:
        cob_id = self._dictionary.get_int(COB_ID)
        if self.enabled and not cob_id & CobIdBit.INVALID:
            self._send(Frame(cob_id & CAN_SFF_MASK, _LAYOUT.pack(code, self.register, vendor)))

    def _past(self, subindex: int) -> Value:
        if subindex > len(self._history):
            raise SdoAbort(SdoAbortCode.NO_DATA)  # CiA 301, 7.5.2.4
        return self._history[subindex - 1]

    def _clear_history(self, count: int) -> SdoAbortCode | None:
        if count != 0:
            return SdoAbortCode.INVALID_VALUE
        self._history.clear()
        return None

    def _check_cob_id(self, new: int) -> SdoAbortCode | None:
        # CiA 301, 7.5.2.17: bits 0 to 29 do not change while the object exists. Only 11-bit identifiers are known here.
        old = self._dictionary.get_int(COB_ID)
        can_id = new & ~CobIdBit.INVALID
        is_valid = not new & CobIdBit.INVALID
        if can_id > CAN_SFF_MASK or (is_valid and is_restricted(can_id)):
            return SdoAbortCode.INVALID_VALUE
        if is_valid and not old & CobIdBit.INVALID and old != new:
            return SdoAbortCode.INVALID_VALUE
        return None
