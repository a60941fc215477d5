"""Faults of a drive in words, and their clearing."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drive_profiles.device.device import Device
from drive_profiles.errors import SdoAbortedError
from drive_profiles.standard.cia402 import Object, State
from drive_profiles.standard.error_codes import error_text, register_words

ERROR_REGISTER, ERROR_HISTORY = (0x1001, 0), 0x1003
MOST_ERRORS = 254
_FAULT_RESET = (0x0000, 0x0080, 0x0000)
"""Control words that make the rising edge of bit 7; the drive goes no further than switch on disabled."""


@dataclass(frozen=True)
class FaultReport:
    """Faults that a node reports; None is an object that it lacks.

    `history` has the entries of 1003h, the newest first: error code in the lower half, the maker's own number in the upper. `own`
    has the maker's codes in words.
    """

    node: int
    state: State | None
    register: int | None
    code: int | None
    history: tuple[int, ...]
    own: Mapping[int, str] = field(default_factory=dict)

    @property
    def is_quiet(self) -> bool:
        """True if the node reports no fault, present or past."""
        return self.state is not State.FAULT and not self.register and not self.code and not self.history

    @property
    def sentences(self) -> list[tuple[str, str, str]]:
        """Return object, value and text of every report."""
        rows = [("6041", "" if self.state is None else self.state.value, "state")] if self.state is not None else []
        if self.register is not None:
            rows.append(("1001", f"0x{self.register:02X}", "error register: " + ", ".join(register_words(self.register))))
        if self.code is not None:
            rows.append(("603F", f"0x{self.code:04X}", error_text(self.code, self.own)))
        for number, entry in enumerate(self.history, 1):
            own = f"; the maker's own number {entry >> 16:04X}h" if entry >> 16 else ""
            rows.append((f"1003:{number}", f"0x{entry:08X}", error_text(entry & 0xFFFF, self.own) + own))
        return rows


def read_faults(device: Device) -> FaultReport:
    """Read the faults of a node; nothing is written.

    Raises:
        NoAnswerError: The device does not answer.
    """
    count = min(_number(device, (ERROR_HISTORY, 0)) or 0, MOST_ERRORS)
    history = [_number(device, (ERROR_HISTORY, number)) for number in range(1, count + 1)]
    return FaultReport(
        device.node,
        device.state(),
        _number(device, ERROR_REGISTER),
        _number(device, (Object.ERROR_CODE, 0)),
        tuple(entry for entry in history if entry is not None),
        device.profile.fault_texts if device.profile else {},
    )


def clear_faults(device: Device) -> list[str]:
    """Reset a fault by the control word, and clear the history.

    The result lists the refused steps in words.

    Raises:
        NodeError: The drive is enabled; nothing has been written.
        NoAnswerError: The device does not answer.
    """
    device.check_quiet()
    refused = []
    if device.state() is State.FAULT:
        for word in _FAULT_RESET:
            device.write((Object.CONTROL_WORD, 0), word.to_bytes(2, "little"))
        if device.state() is State.FAULT:
            refused.append(f"node {device.node} is still in fault; its cause persists, or the drive must be switched off and on")
    try:
        device.write((ERROR_HISTORY, 0), b"\0")
    except SdoAbortedError as error:
        refused.append(str(error))
    return refused


def _number(device: Device, address: tuple[int, int]) -> int | None:
    try:
        return int.from_bytes(device.read(address), "little")
    except SdoAbortedError:
        return None
