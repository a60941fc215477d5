"""Unit codes of 60A8h, 60A9h and 60AAh.

One number holds prefix, numerator and denominator, a byte each; the lowest byte is 0.

A position unit that is an angle is counted as the code says. Increments and metres are counted by the feed constant (6092h), in
the unit that the code names.

Source: CiA 303-2; CiA 402-2, 60A8h to 60AAh.
"""

import math

from drive_profiles.errors import OutOfRangeError

METRE, RADIAN, DEGREE, ARC_MINUTE, ARC_SECOND, REVOLUTION, INCREMENT = 0x01, 0x10, 0x41, 0x42, 0x43, 0xB4, 0xB5
SECOND, MINUTE, SECOND_SQUARED = 0x03, 0x47, 0x57
RPM = 0xC0
"""Revolutions per minute as one numerator, with which makers write an acceleration in rev/min per second."""

_PER_TURN = {RADIAN: 2.0 * math.pi, DEGREE: 360.0, ARC_MINUTE: 21600.0, ARC_SECOND: 1_296_000.0, REVOLUTION: 1.0}
_BY_FEED = (INCREMENT, METRE)
_PREFIXES = range(-9, 1)


def code(numerator: int, denominator: int = 0, prefix: int = 0) -> int:
    """Return the code of a unit.

    The prefix is a power of ten: thousandths of a degree are ``code(DEGREE, prefix=-3)``.
    """
    return (prefix & 0xFF) << 24 | numerator << 16 | denominator << 8


def position_units(unit: int, feed: float) -> float:
    """Return the position units (60A8h) per revolution of the shaft.

    `feed` has those of the feed constant, which a unit of 0 means.

    Raises:
        OutOfRangeError: The unit is not known.
    """
    if not unit:
        return feed
    prefix, numerator, denominator = _parts("60A8h", unit)
    if denominator or (numerator not in _PER_TURN and numerator not in _BY_FEED):
        raise _unknown("60A8h", unit)
    return feed if numerator in _BY_FEED else _PER_TURN[numerator] / 10.0**prefix


def velocity_units(unit: int, position_unit: int, feed: float) -> float:
    """Return the velocity units (60A9h) per shaft revolution in a second.

    A unit of 0 is position units per second.

    Raises:
        OutOfRangeError: The unit is not known, or does not go with that of the position.
    """
    if not unit:
        return position_units(position_unit, feed)
    prefix, numerator, denominator = _parts("60A9h", unit)
    if denominator not in {SECOND, MINUTE}:
        raise _unknown("60A9h", unit)
    return _way("60A9h", unit, numerator, position_unit, feed) / 10.0**prefix * (1.0 if denominator == SECOND else 60.0)


def acceleration_units(unit: int, position_unit: int, feed: float) -> float:
    """Return the acceleration units (60AAh) per shaft revolution in a second².

    A unit of 0 is position units per second².

    Raises:
        OutOfRangeError: The unit is not known, or does not go with that of the position.
    """
    if not unit:
        return position_units(position_unit, feed)
    prefix, numerator, denominator = _parts("60AAh", unit)
    if (numerator, denominator) == (RPM, SECOND):
        return 60.0 / 10.0**prefix
    if denominator != SECOND_SQUARED:
        raise _unknown("60AAh", unit)
    return _way("60AAh", unit, numerator, position_unit, feed) / 10.0**prefix


def _way(what: str, unit: int, numerator: int, position_unit: int, feed: float) -> float:
    """Return the numerator's units per revolution of the shaft, without the prefix."""
    if numerator in _PER_TURN:
        return _PER_TURN[numerator]
    prefix, counted, _ = _parts("60A8h", position_unit) if position_unit else (0, INCREMENT, 0)
    if numerator not in _BY_FEED or numerator != counted:
        raise _unknown(what, unit)
    return feed * 10.0**prefix


def _parts(what: str, unit: int) -> tuple[int, int, int]:
    prefix, numerator, denominator = unit >> 24, unit >> 16 & 0xFF, unit >> 8 & 0xFF
    prefix -= 0x100 if prefix & 0x80 else 0
    if unit & 0xFF or prefix not in _PREFIXES:
        raise _unknown(what, unit)
    return prefix, numerator, denominator


def _unknown(what: str, unit: int) -> OutOfRangeError:
    return OutOfRangeError(what, f"{unit:08X}h", "", "is not a known unit")
