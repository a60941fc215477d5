"""Gains of the P-PI cascade; `cascade.h` has the cascade itself."""

from dataclasses import dataclass, fields
from typing import Any

from numpy.typing import NDArray

from hil.core.library import CORE

CASCADE_CONFIG, CASCADE_STATE = CORE.dtype("cascade_config"), CORE.dtype("cascade_state")


@dataclass(frozen=True)
class Cascade:
    """Gains of the P-PI cascade.

    Attributes:
        position_gain_per_s: K_pp in 1/s.
        velocity_gain_nm_s_rad: K_vp in N·m·s/rad.
        velocity_integral_gain_nm_rad: K_vi in N·m/rad.
        lowpass_hz: Corner of F_lp, first order.

    Raises:
        ValueError: A negative gain or a corner that is not above zero.
    """

    position_gain_per_s: float
    velocity_gain_nm_s_rad: float
    velocity_integral_gain_nm_rad: float
    lowpass_hz: float = 300.0

    def __post_init__(self) -> None:
        """Refuse a sign that would turn the loop round."""
        for field in fields(self):
            if not getattr(self, field.name) >= 0.0:
                raise ValueError(f"{field.name} = {getattr(self, field.name)} must not be below 0")
        if not self.lowpass_hz > 0.0:
            raise ValueError(f"lowpass_hz = {self.lowpass_hz} must be above 0")

    def write(self, row: NDArray[Any]) -> None:
        """Put the gains into one record of a `CASCADE_CONFIG` array."""
        for field in fields(self):
            row[field.name] = getattr(self, field.name)
