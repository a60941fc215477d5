"""A drive's counting, frozen: shown numbers ↔ encoder counts, rad/s and N·m."""

from dataclasses import dataclass, field, replace
from typing import Any

from drive_profiles.standard.units import Scaling

INT16_MAX, INT32_MAX = 2**15 - 1, 2**31 - 1


def clip(value: float, limit: int = INT32_MAX) -> int:
    """Round to the nearest whole number within ±limit, an object's range."""
    nearest = round(value)
    return nearest if -limit <= nearest <= limit else int(max(-limit, min(limit, nearest)))


@dataclass(frozen=True, slots=True)
class Counting:
    """Scaling of a drive and zero of its positions.

    `shown_position` and `encoder_counts` are inverses of each other, and so are `shown_speed` and `speed_rad_s`, as far as an
    object of 32 bits and whole numbers reach.

    Args:
        offset_counts: The position that the drive shows, less the encoder's counts: homing shifts the zero by it.

    Attributes:
        is_encoder: True if a position is shown in the encoder's own counts.
        units_per_count: Position units per count of the encoder, with the sign of the polarity.
        units_per_rad_s: Velocity units per rad/s of the motor, with the sign of the polarity.
        rad_s_per_unit: The inverse of it.
    """

    scaling: Scaling
    offset_counts: int = 0
    is_encoder: bool = field(init=False, repr=False, compare=False)
    units_per_count: float = field(init=False, repr=False, compare=False)
    units_per_rad_s: float = field(init=False, repr=False, compare=False)
    rad_s_per_unit: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Compute the factors once, since every SYNC uses them."""
        scaling = self.scaling
        factors = {
            "is_encoder": scaling.counts_are_increments,
            "units_per_count": scaling.position_sign * scaling.counts_per_rad / scaling.encoder_counts_per_rad,
            "units_per_rad_s": scaling.speed_units_per_rad_s,
            "rad_s_per_unit": float(scaling.speed_rad_s(1)),
        }
        for name, value in factors.items():
            object.__setattr__(self, name, value)

    def scaled(self, scaling: Scaling) -> "Counting":
        """Return the same zero in other units."""
        return replace(self, scaling=scaling)

    def shifted(self, offset_counts: int) -> "Counting":
        """Return the same units with another zero."""
        return replace(self, offset_counts=offset_counts)

    def homed(self, shown: Any, counts: float) -> "Counting":
        """Return the same units with the zero of a homing.

        The drive then shows the position `shown` at these counts of the encoder.
        """
        unshifted = self.shifted(0)
        return self.shifted(clip(unshifted.encoder_counts(shown) - counts))

    def shown_position(self, counts: float) -> int:
        """Return the position that the drive shows at encoder counts."""
        if self.is_encoder:
            return clip(counts + self.offset_counts)
        return clip((counts + self.offset_counts) * self.units_per_count)

    def encoder_counts(self, position: Any) -> int:
        """Return the encoder counts of a position that the drive shows."""
        if self.is_encoder:
            return int(position) - self.offset_counts
        counts: int = round(position / self.units_per_count)
        return counts - self.offset_counts

    def shown_speed(self, speed_rad_s: float) -> int:
        """Return the number that the drive shows for a speed."""
        return clip(speed_rad_s * self.units_per_rad_s)

    def speed_rad_s(self, shown: Any) -> float:
        """Return the motor speed in rad/s of a shown number."""
        return float(shown * self.rad_s_per_unit)

    def shown_torque(self, torque_nm: float) -> int:
        """Return a torque in per mille of the rated torque."""
        return clip(1000.0 * torque_nm / self.scaling.rated_torque_nm, INT16_MAX)

    def torque_nm(self, per_mille: int) -> float:
        """Return the torque in N·m of a shown number."""
        return per_mille * self.scaling.torque_quantum_nm
