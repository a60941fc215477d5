"""Conversion between SI units and CiA 402's integers, as inverse pairs.

Angles, speeds and torques are on the motor side. The conversions take a number or a numpy array of any shape and return the
same. A value that the object cannot hold is refused with its numbers, never clamped or wrapped.

Source: CiA 402-2, 607Eh, 608Fh, 6076h, 6091h, 6092h, 60A8h to 60AAh and 60C2h.
"""

import math
import struct
from dataclasses import dataclass, field
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from drive_profiles.errors import OutOfRangeError
from drive_profiles.standard import unit_codes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Numbers = TypeVar("Numbers", float, NDArray[Any])
"""A number, or an array of numbers."""

TWO_PI = 2.0 * math.pi
INTEGER16 = (-(2**15), 2**15 - 1)
INTEGER32 = (-(2**31), 2**31 - 1)
UNSIGNED16 = (0, 2**16 - 1)
_UNSIGNED8_MAX = 2**8 - 1
_PERIOD_INDEX = (-128, 63)  # 60C2h sub 2, CiA 402


@overload
def to_integer(value: float, limits: tuple[int, int], what: str, unit: str, factor: float = 1.0) -> int: ...
@overload
def to_integer(value: FloatArray, limits: tuple[int, int], what: str, unit: str, factor: float = 1.0) -> IntArray: ...
def to_integer(value: Any, limits: tuple[int, int], what: str, unit: str, factor: float = 1.0) -> Any:
    """Round ``value · factor`` to the nearest integer, halves to even.

    The limits are those of the object, `factor` has integers per `unit`.

    Raises:
        OutOfRangeError: A value is outside the limits, or not finite; the first such element of an array is named.
    """
    low, high = limits
    if type(value) is float and low <= (product := value * factor) <= high:
        return round(product)  # every set-point of every cycle passes here
    if isinstance(value, np.ndarray):
        scaled = np.rint(np.asarray(value, dtype=np.float64) * factor)
        outside = ~((scaled >= low) & (scaled <= high))  # true for NaN as well
        if outside.any():
            raise _outside(what, value[outside].flat[0], unit, scaled[outside].flat[0], limits)
        return scaled.astype(np.int64)
    product = float(value) * factor
    if not math.isfinite(product) or not low <= round(product) <= high:
        raise _outside(what, value, unit, product, limits)
    return round(product)


def _outside(what: str, value: object, unit: str, integer: float, limits: tuple[int, int]) -> OutOfRangeError:
    return OutOfRangeError(what, value, unit, f"{integer:.10g} on the wire is outside {limits[0]} to {limits[1]}")


POSITION_REVERSED, VELOCITY_REVERSED = 1 << 7, 1 << 6
"""Bits of 607Eh, polarity."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """Scaling of one drive.

    Positions on the wire are in the user's unit, which is an increment of the encoder unless the feed constant or the units say
    otherwise. Without a feed constant the gear ratio does not act: such drives count at the motor.

    Args:
        encoder_counts_per_rev: 608Fh, increments per motor revolution.
        rated_torque_nm: 6076h in N·m, motor side; torques on the wire are per mille of it.
        gear_motor_revs: 6091h sub 1.
        gear_shaft_revs: 6091h sub 2.
        feed: 6092h sub 1, position units per `feed_shaft_revs` revolutions of the shaft; None: positions are increments.
        feed_shaft_revs: 6092h sub 2.
        polarity: 607Eh, bits 6 and 7.
        position_unit: 60A8h; an angle is counted in this unit, whatever the feed constant.
        velocity_unit: 60A9h; 0: position units per second.
        acceleration_unit: 60AAh; 0: position units per second².

    Raises:
        OutOfRangeError: A value is not positive, not finite, or a unit that is not known.
    """

    encoder_counts_per_rev: int
    rated_torque_nm: float
    gear_motor_revs: int = 1
    gear_shaft_revs: int = 1
    feed: int | None = None
    feed_shaft_revs: int = 1
    polarity: int = 0
    position_unit: int = 0
    velocity_unit: int = 0
    acceleration_unit: int = 0
    _position: float = field(init=False, repr=False, compare=False)
    _velocity: float = field(init=False, repr=False, compare=False)
    _acceleration: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse a scale without an inverse; compute units per revolution once."""
        for name, unit in (
            ("encoder_counts_per_rev", "counts"),
            ("rated_torque_nm", "N·m"),
            ("gear_motor_revs", "rev"),
            ("gear_shaft_revs", "rev"),
            ("feed", "units"),
            ("feed_shaft_revs", "rev"),
        ):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise OutOfRangeError(name, value, unit, "must be positive and finite")
        if self.polarity & ~(POSITION_REVERSED | VELOCITY_REVERSED):
            raise OutOfRangeError("607Eh", f"{self.polarity:02X}h", "", "must have no other bits than 6 and 7")
        counts = float(self.encoder_counts_per_rev)
        # the units of one revolution of the shaft, and those revolutions per revolution of the motor
        feed = counts if self.feed is None else self.feed / self.feed_shaft_revs
        gear = 1.0 if self.feed is None else self.gear_shaft_revs / self.gear_motor_revs
        position = unit_codes.position_units(self.position_unit, feed)
        velocity = unit_codes.velocity_units(self.velocity_unit, self.position_unit, feed)
        acceleration = unit_codes.acceleration_units(self.acceleration_unit, self.position_unit, feed)
        for name, units in (("_position", position), ("_velocity", velocity), ("_acceleration", acceleration)):
            object.__setattr__(self, name, units * gear)

    @property
    def counts_per_rad(self) -> float:
        """Position units on the wire per radian of the motor, without sign."""
        return self._position / TWO_PI

    @property
    def encoder_counts_per_rad(self) -> float:
        """Increments of the encoder per radian of the motor."""
        return self.encoder_counts_per_rev / TWO_PI

    @property
    def position_sign(self) -> int:
        """Sign of positions: -1 where 607Eh reverses them."""
        return -1 if self.polarity & POSITION_REVERSED else 1

    @property
    def velocity_sign(self) -> int:
        """Sign of velocities: -1 where 607Eh reverses them."""
        return -1 if self.polarity & VELOCITY_REVERSED else 1

    @property
    def speed_units_per_rad_s(self) -> float:
        """Velocity units on the wire per rad/s, with the polarity's sign."""
        return self.velocity_sign * self._velocity / TWO_PI

    @property
    def counts_are_increments(self) -> bool:
        """True if positions are increments of the encoder, with the same sign."""
        return self._position == self.encoder_counts_per_rev and not self.polarity & POSITION_REVERSED

    @property
    def torque_quantum_nm(self) -> float:
        """The smallest step of a torque on the wire, N·m."""
        return self.rated_torque_nm / 1000.0

    @overload
    def position_counts(self, position_rad: float) -> int: ...
    @overload
    def position_counts(self, position_rad: FloatArray) -> IntArray: ...
    def position_counts(self, position_rad: Any) -> Any:
        """Return the counts of a motor angle in rad, INTEGER32 (6064h, 607Ah).

        Raises:
            OutOfRangeError: The result is outside INTEGER32.
        """
        return to_integer(position_rad, INTEGER32, "position", "rad", self.position_sign * self._position / TWO_PI)

    def position_rad(self, counts: Numbers) -> Numbers:
        """Return the motor angle in rad of a position in counts."""
        return counts * (self.position_sign * TWO_PI / self._position)

    def speed_rad_s(self, counts_s: Numbers) -> Numbers:
        """Convert counts per second to a motor speed in rad/s."""
        return counts_s * (self.velocity_sign * TWO_PI / self._velocity)

    def acceleration_rad_s2(self, counts_s2: Numbers) -> Numbers:
        """Convert counts per second² to a motor acceleration in rad/s²."""
        return counts_s2 * (TWO_PI / self._acceleration)

    @overload
    def torque_per_mille(self, torque_nm: float) -> int: ...
    @overload
    def torque_per_mille(self, torque_nm: FloatArray) -> IntArray: ...
    def torque_per_mille(self, torque_nm: Any) -> Any:
        """Convert a motor's N·m to INTEGER16 per mille (6071h, 6077h, 60B2h).

        Raises:
            OutOfRangeError: The result is outside INTEGER16.
        """
        return to_integer(torque_nm, INTEGER16, "torque", "N·m", 1000.0 / self.rated_torque_nm)

    def torque_nm(self, per_mille: Numbers) -> Numbers:
        """Convert per mille of the rated torque to N·m."""
        return per_mille * (self.rated_torque_nm / 1000.0)


def rated_torque_nm(torque_mnm: int) -> float:
    """Return the rated torque in N·m of 6076h in mN·m."""
    return torque_mnm / 1000.0


def interpolation_period(period_s: float) -> tuple[int, int]:
    """Split an interpolation period into (value, index) of 60C2h.

    period = value · 10^index s: 250 us is (25, -5).

    The index is the largest that is exact.

    Raises:
        OutOfRangeError: No value from 1 to 255 gives this period exactly.
    """
    nanoseconds = round(period_s * 1e9) if math.isfinite(period_s * 1e9) else 0
    # A period written as a decimal is within an ulp of a whole number of nanoseconds; 1/3000 s is not.
    if nanoseconds <= 0 or not math.isclose(period_s * 1e9, nanoseconds, rel_tol=1e-12):
        raise OutOfRangeError("interpolation period", period_s, "s", "must be a positive whole number of nanoseconds")
    value, exponent = nanoseconds, -9
    while value % 10 == 0:
        value, exponent = value // 10, exponent + 1
    if value > _UNSIGNED8_MAX or exponent < _PERIOD_INDEX[0]:
        raise OutOfRangeError(
            "interpolation period", period_s, "s", f"is {value} × 10^{exponent} s: 60C2h sub 1 holds 1 to {_UNSIGNED8_MAX}"
        )
    return value, exponent


def counts_per_rev(what: str, increments: int, revolutions: int) -> int:
    """Return the encoder's increments per motor revolution, as in 608Fh.

    Args:
        what: The object, for the message.
        increments: Increments, 608Fh:1.
        revolutions: Revolutions in which they are counted, 608Fh:2.

    Raises:
        OutOfRangeError: They are not a whole number per revolution.
    """
    if revolutions <= 0 or increments % revolutions:
        raise OutOfRangeError(what, f"{increments}/{revolutions}", "counts/rev", "must be a whole number per revolution")
    return increments // revolutions


def interpolation_period_s(value: int, index: int) -> float:
    """Return the interpolation period in s from 60C2h sub 1 and 2.

    Raises:
        OutOfRangeError: The value is outside 1 to 255, or the index outside -128 to 63.
    """
    if not 1 <= value <= _UNSIGNED8_MAX or not _PERIOD_INDEX[0] <= index <= _PERIOD_INDEX[1]:
        limits = "60C2h:1 holds 1 to 255, and 60C2h:2 holds -128 to 63"
        raise OutOfRangeError("interpolation period", f"{value} × 10^{index}", "s", limits)
    return float(f"{value}e{index}")  # the decimal literal rounds once, value · 10**index would twice


def real32(value: float) -> float:
    """Round a value to IEEE 754 single precision, as REAL32 objects do.

    Raises:
        OutOfRangeError: The value is not finite, or beyond the largest REAL32.
    """
    if not math.isfinite(value):
        raise OutOfRangeError("REAL32", value, "", "must be finite")
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError as error:
        raise OutOfRangeError("REAL32", value, "", "is beyond the largest REAL32") from error


def shortest(value: float) -> float:
    """Return the shortest decimal of a REAL32: 0.1 for 0.10000000149011612."""
    return float(str(np.float32(value)))
