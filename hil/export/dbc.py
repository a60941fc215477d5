"""DBC file of the actual PDO mapping.

cantools is loaded only to write one.
"""

from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drive_profiles.standard.cia301 import FunctionCode, NmtState
from drive_profiles.standard.cia402 import Object, commands, state_of
from hil.errors import ExportError, MissingPackageError
from hil.export.decoded import Decoded, NamedNumber

LONGEST_NAME = 32
"""Characters of a name in a DBC file."""
MASTER = "master"
STATUS_BITS = ("warning", "manufacturer_8", "remote", "target_reached", "internal_limit_active", "mode_specific_12",
    "mode_specific_13", "manufacturer_14", "manufacturer_15")  # fmt: skip
"""Bits 7 to 15 of 6041h."""
CONTROL_BITS = (("mode_specific", 4, 3), ("fault_reset", 7, 1), ("halt", 8, 1), ("control_word_high", 9, 7))
"""Parts of 6040h behind its command: name, first bit, bits."""


def write_dbc(path: Path, what: Decoded) -> None:
    """Write a DBC file.

    The status word is parted into its state, with a table of words, and its bits; the control word into its command and the rest.
    SDOs are left out: a DBC file has no form for them that programs agree on.

    Raises:
        MissingPackageError: cantools is not installed.
        ExportError: No PDO's mapping is known.
    """
    try:
        from cantools.database import conversion  # noqa: PLC0415 - an extra
        from cantools.database.can import Database, Message, Signal  # noqa: PLC0415
        from cantools.database.can import Node as Sender  # noqa: PLC0415
    except ImportError:
        raise MissingPackageError(path, "cantools", "dbc") from None
    if not what.pdos:
        raise ExportError(path, f"no PDO of {what.trace.log.path} has a known mapping; give --description FILE:NODE")

    def signal(name: str, start: int, bits: int, choices: dict[int, str] | None = None, each: NamedNumber | None = None) -> Any:
        factor, is_real = (1, False) if each is None else (each.unit.factor, each.entry.is_real)
        held = conversion.BaseConversion.factory(
            scale=factor, offset=0, choices=None if choices is None else OrderedDict(choices), is_float=is_real
        )
        is_signed = each is not None and each.entry.is_signed and not is_real
        unit = None if each is None else each.unit.unit or None
        return Signal(name[:LONGEST_NAME], start, bits, "little_endian", is_signed, conversion=held, unit=unit)

    messages, senders = [], {MASTER: Sender(MASTER)}
    for named in what.pdos:
        signals = [signal(*args) for each in named.numbers for args in _parts(each)]
        sender = MASTER if named.pdo.direction == "rpdo" else named.prefix
        senders.setdefault(sender, Sender(sender))
        length = max(each.entry.bytes for each in named.numbers)
        messages.append(Message(named.pdo.can_id, named.name[:LONGEST_NAME], length, signals, senders=[sender], strict=True))
    taken = {message.frame_id for message in messages}
    for number, can_id in ((n, FunctionCode.HEARTBEAT + n) for n in what.trace.nodes):
        if can_id in what.trace.log and can_id not in taken:
            choices = {int(state): state.name.lower().replace("_", " ") for state in NmtState}
            messages.append(Message(int(can_id), f"heartbeat_{number}", 1, [signal("nmt_state", 0, 7, choices)], senders=[]))
    database = Database(messages, list(senders.values()), version="")
    path.write_text(database.as_dbc_string(), encoding="cp1252", newline="")


def _parts(each: NamedNumber) -> Iterator[tuple[Any, ...]]:
    """Arguments of the signals of one number: words of bits are parted."""
    start, bits = each.entry.start, each.entry.bits
    if each.entry.address == (Object.STATUS_WORD, 0) and bits == 16:
        states = {word: state.value for word in range(0x80) if (state := state_of(word)) is not None}
        yield "state", start, 7, states
        yield from ((name, start + 7 + place, 1) for place, name in enumerate(STATUS_BITS))
    elif each.entry.address == (Object.CONTROL_WORD, 0) and bits == 16:
        words = {word: command.value for word in range(0x10) if (command := commands(word, 0)) is not None}
        yield "command", start, 4, words
        yield from ((name, start + first, size) for name, first, size in CONTROL_BITS)
    else:
        yield each.unit.name, start, bits, None, each
