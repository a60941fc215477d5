"""The emergency producer (CiA 301, 7.2.7): causes, 1001h, 1003h and frames."""

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from drive_profiles.standard.cia301 import CobIdBit, EmergencyCode, ErrorRegister, SdoAbortCode, Value, identifier_refusal
from hil.can.frame import CAN_SFF_MASK, Frame
from plant_emulator.slave.dictionary import Dictionary, ResetKind, SdoAbort

ERROR_REGISTER = 0x1001
HISTORY = 0x1003
COB_ID = 0x1014
INHIBIT_TIME = 0x1015
MAX_WAITING = 8
"""Emergencies that wait for the end of the inhibit time; of more the oldest are dropped, since the newest state must be sent."""

_LAYOUT = struct.Struct("<HB5x")
"""Code, error register, and five bytes that are the manufacturer's: this one has nothing to say in them."""
_INHIBIT_UNIT_NS = 100_000
_LONG_AGO = -(1 << 63)


@dataclass(frozen=True, slots=True)
class _Error:
    code: int
    register: ErrorRegister


class EmergencyProducer:
    """Keeper of the active causes, and sender of their emergencies.

    A frame is sent when a cause arises, and when the last one has gone.

    Args:
        dictionary: Must have 1001h, 1003h with as many sub-indices as the history is long, 1014h and 1015h.
        changed: Called when `due` has become another.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        send: Callable[[Frame], None],
        clock: Callable[[], int],
        changed: Callable[[], None],
    ) -> None:
        self._is_enabled = False
        self._send, self._clock, self._changed = send, clock, changed
        self._inhibit_ns = 0
        self._sent_at = _LONG_AGO
        self._waiting: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._active: dict[str, _Error] = {}
        depth = sum(entry.index == HISTORY and entry.subindex > 0 for entry in dictionary)
        self._history: deque[int] = deque(maxlen=depth)
        self._dictionary = dictionary
        dictionary.on_write(COB_ID, 0, self._check_cob_id)
        dictionary.on_write(INHIBIT_TIME, 0, self._set_inhibit_time)
        dictionary.on_read(ERROR_REGISTER, 0, lambda: int(self.register))
        dictionary.on_read(HISTORY, 0, lambda: len(self._history))
        dictionary.on_write(HISTORY, 0, self._clear_history)
        for subindex in range(1, depth + 1):
            dictionary.on_read(HISTORY, subindex, partial(self._past, subindex))

    def load(self) -> None:
        """Read the parameters from the dictionary, after a reset."""
        self._dictionary.load(COB_ID)
        self._dictionary.load(INHIBIT_TIME)

    def enable(self, is_enabled: bool) -> None:
        """Allow or forbid the sending of frames.

        Register and history are updated in any case. Forbidding drops the waiting frames.
        """
        self._is_enabled = is_enabled
        if not is_enabled:
            self._waiting.clear()

    @property
    def due(self) -> int | None:
        """End of the next waiting frame's inhibit time, or None."""
        return self._sent_at + self._inhibit_ns if self._waiting else None

    def advance(self, now: int) -> None:
        """Send the waiting frames whose inhibit time is over."""
        while self._waiting and now >= self._sent_at + self._inhibit_ns:
            self._transmit(self._waiting.popleft(), now)

    @property
    def register(self) -> ErrorRegister:
        """Error register: the bits of all active causes.

        The generic bit is set while there is any cause (CiA 301, 7.5.2.2).
        """
        register = ErrorRegister(0)
        for error in self._active.values():
            register |= error.register | ErrorRegister.GENERIC
        return register

    @property
    def last_code(self) -> int:
        """Error code in 1003h:01h; 0 if empty."""
        return self._history[0] if self._history else 0

    @property
    def causes(self) -> tuple[str, ...]:
        """The active causes, in the order in which they arose."""
        return tuple(self._active)

    def raise_cause(self, cause: str, code: int, register: ErrorRegister = ErrorRegister.GENERIC) -> None:
        """Report an error.

        Nothing happens while the same cause is active with the same code.

        Raises:
            ValueError: The code does not fit 16 bits, or says "no error".
        """
        if not 0x0100 <= code <= 0xFFFF:
            raise ValueError(f"an emergency with code {code:#x}; expected a code from 0x100 to 0xFFFF")
        error = _Error(code, register)
        if self._active.get(cause) == error:
            return
        self._active[cause] = error
        self._history.appendleft(code)  # CiA 301, 7.5.2.4: the newest at sub-index 1
        self._emit(code)

    def join_cause(self, cause: str, code: int, register: ErrorRegister = ErrorRegister.GENERIC) -> None:
        """Report an error that another cause may have reported.

        While another cause is active with this code, no frame is sent.
        """
        if any(error.code == code for error in self._active.values()):
            self._active[cause] = _Error(code, register)
        else:
            self.raise_cause(cause, code, register)

    def clear_cause(self, cause: str) -> None:
        """Withdraw a cause.

        After the last one error code 0000h is sent (CiA 301, 7.2.7.2).
        """
        if self._active.pop(cause, None) is not None and not self._active:
            self._emit(EmergencyCode.NO_ERROR)

    def reset(self, kind: ResetKind) -> None:
        """Clear causes, history and waiting frames without sending a frame.

        A reset of communication clears the communication causes and the waiting frames only.
        """
        self._waiting.clear()
        self._sent_at = _LONG_AGO
        if kind is ResetKind.NODE:
            self._active.clear()
            self._history.clear()
        else:
            left = {c: e for c, e in self._active.items() if ErrorRegister.COMMUNICATION not in e.register}
            self._active = left

    def _emit(self, code: int) -> None:
        if not self._is_enabled:
            return
        data, now = _LAYOUT.pack(code, self.register), self._clock()
        if self._waiting or now < self._sent_at + self._inhibit_ns:
            self._waiting.append(data)
            self._changed()
        else:
            self._transmit(data, now)

    def _transmit(self, data: bytes, now: int) -> None:
        cob_id = self._dictionary.get_int(COB_ID)
        if not cob_id & CobIdBit.INVALID:
            self._sent_at = now
            self._send(Frame(cob_id & CAN_SFF_MASK, data))

    def _past(self, subindex: int) -> Value:
        if subindex > len(self._history):
            raise SdoAbort(SdoAbortCode.NO_DATA)  # CiA 301, 7.5.2.4
        return self._history[subindex - 1]

    def _clear_history(self, count: int) -> SdoAbortCode | None:
        if count != 0:
            return SdoAbortCode.INVALID_VALUE
        self._history.clear()
        return None

    def _set_inhibit_time(self, multiple_of_100us: int) -> None:
        self._inhibit_ns = multiple_of_100us * _INHIBIT_UNIT_NS

    def _check_cob_id(self, new: int) -> SdoAbortCode | None:
        old = self._dictionary.get_int(COB_ID)
        in_use = None if old & CobIdBit.INVALID else old
        return identifier_refusal(new & ~CobIdBit.INVALID, is_valid=not new & CobIdBit.INVALID, in_use=in_use)
