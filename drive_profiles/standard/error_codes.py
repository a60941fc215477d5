"""Error codes of drives in words.

Source: CiA 301, 7.2.7.1; CiA 402-2, object 603Fh.
"""

from collections.abc import Mapping

_CODES = {
    0x0000: "no error, or all errors have gone",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current on the input side of the device",
    0x2110: "short circuit or earth leakage on the input side",
    0x2120: "earth leakage on the input side",
    0x2130: "short circuit on the input side",
    0x2200: "current inside the device",
    0x2213: "over-current on the ramp",
    0x2214: "over-current in the sequence",
    0x2220: "continuous over-current inside the device",
    0x2230: "short circuit or earth leakage inside the device",
    0x2240: "earth leakage inside the device",
    0x2250: "short circuit inside the device",
    0x2300: "current on the output side of the device",
    0x2310: "continuous over-current on the output side",
    0x2320: "short circuit or earth leakage on the output side",
    0x2330: "earth leakage on the output side",
    0x2340: "short circuit on the output side",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "phase failure",
    0x3140: "mains frequency",
    0x3200: "voltage of the DC link",
    0x3210: "over-voltage of the DC link",
    0x3220: "under-voltage of the DC link",
    0x3230: "load error",
    0x3300: "output voltage",
    0x3310: "output over-voltage",
    0x4000: "temperature",
    0x4110: "too hot around the device",
    0x4120: "too cold around the device",
    0x4210: "device too hot",
    0x4220: "device too cold",
    0x4310: "drive too hot",
    0x4320: "drive too cold",
    0x5000: "hardware of the device",
    0x5100: "supply of the device",
    0x5200: "control hardware of the device",
    0x5400: "power section",
    0x5410: "output stages",
    0x5420: "chopper",
    0x5440: "contacts",
    0x5441: "contact 1: safe torque off on many drives",
    0x5450: "fuses",
    0x5500: "data storage",
    0x5530: "non-volatile data storage",
    0x6000: "software of the device",
    0x6010: "software reset by the watchdog",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data record",
    0x6310: "parameters lost",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error, or commutation fails",
    0x7300: "sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed",
    0x7320: "position sensor",
    0x7500: "communication inside the device",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun: frames were lost",
    0x8120: "CAN controller error-passive",
    0x8130: "heartbeat or life guarding lost: the master was not heard",
    0x8140: "CAN controller back from bus-off",
    0x8150: "collision of a transmit identifier: two nodes use it",
    0x8200: "protocol error",
    0x8210: "PDO shorter than its mapping",
    0x8220: "PDO longer than its mapping",
    0x8240: "SYNC of an unexpected length",
    0x8250: "RPDO timed out",
    0x8300: "torque control",
    0x8311: "torque too large",
    0x8331: "torque fault",
    0x8400: "speed controller",
    0x8500: "position controller",
    0x8600: "positioning controller",
    0x8611: "following error",
    0x8612: "reference limit: a set-point beyond the limits",
    0x8700: "synchronisation with the bus",
    0x8900: "process data monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "of the maker's own",
}


_MAKERS = ", of the maker's own"
_REGISTER = ("generic", "current", "voltage", "temperature", "communication", "of the device profile", "reserved", "of the maker")


def error_text(code: int, own: Mapping[int, str] | None = None) -> str:
    """Return a code's text: the maker's, the standard's, or its group's.

    >>> error_text(0x8612), error_text(0x8613)
    ('reference limit: a set-point beyond the limits', 'positioning controller (8613h is of the maker)')
    >>> error_text(0x8A82, {0x8A82: "software position limit"})
    'software position limit'
    """
    words, is_group = _found(code, own or {})
    return f"{words} ({code:04X}h is of the maker)" if is_group else words or f"unknown code {code:04X}h"


def _found(code: int, own: Mapping[int, str]) -> tuple[str, bool]:
    """Return the text of a code, and whether it is its group's."""
    if code in own or code in _CODES:
        return own.get(code) or _CODES[code], False
    group = next((_CODES[code & mask] for mask in (0xFFF0, 0xFF00, 0xF000) if code & mask in _CODES), "")
    return group, bool(group)


def code_text(code: int, own: Mapping[int, str] | None = None) -> str:
    """Return an error code with its words, as a sentence names it.

    >>> code_text(0x8611), code_text(0x8613), code_text(0xE123)
    ('8611h (following error)', "8613h (positioning controller, of the maker's own)", 'E123h (unknown code)')
    """
    words, is_group = _found(code, own or {})
    return f"{code:04X}h ({words or 'unknown code'}{_MAKERS if is_group else ''})"


def emergency_text(code: int, register: int, own: Mapping[int, str] | None = None) -> str:
    """Return an emergency message in words.

    >>> emergency_text(0x8611, 0x21)
    'emergency 8611h (following error; error register 21h)'
    """
    return f"emergency {code_text(code, own)[:-1]}; error register {register:02X}h)"


def register_words(register: int) -> list[str]:
    """Return the bits of an error register (1001h) in words.

    >>> register_words(0x21), register_words(0)
    (['generic', 'of the device profile'], ['no error'])
    """
    return [word for bit, word in enumerate(_REGISTER) if register >> bit & 1] or ["no error"]
