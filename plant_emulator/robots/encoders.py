"""The robot file's `[axis.N.encoder]` and `[axis.N.load_encoder]`: encoders on motor and joint."""

import cmath
import math
from typing import Annotated, Any

from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.control.angles import ARCSEC
from hil.robot_tables import NotNegative
from plant_emulator.robots.angle_lines import EccentricityLine, check_orders


class MotorEncoder(Table):
    """Errors of the encoder on the motor, by which the drive closes its loop.

    E₁ cos(θ_m + φ₁) + E₂ cos(2 θ_m + φ₂), counted from where the motor angle is zero, and white noise.

    An error of order k looks like a transmission error of order k with the amplitude E_k/N, since the motor follows it.

    Attributes:
        error_1_arcsec: E₁, of a disc off centre: once per revolution, on the motor side.
        phase_1_deg: φ₁.
        error_2_arcsec: E₂, of an oval or tilted disc: twice per revolution.
        phase_2_deg: φ₂.
        noise_counts: Standard deviation of the noise of each control period, in counts of the encoder.
    """

    error_1_arcsec: NotNegative = 0.0
    phase_1_deg: float = 0.0
    error_2_arcsec: NotNegative = 0.0
    phase_2_deg: float = 0.0
    noise_counts: NotNegative = 0.0

    def errors_arcsec(self) -> dict[float, complex]:
        """E_k e^{jφ_k} of the orders that it has."""
        named = {1.0: (self.error_1_arcsec, self.phase_1_deg), 2.0: (self.error_2_arcsec, self.phase_2_deg)}
        return {order: cmath.rect(size, math.radians(phase)) for order, (size, phase) in named.items() if size > 0.0}

    def write(self, row: Any, counts_per_rev: int, seed: int) -> None:
        """Put the errors into a record of an `ENCODER` array."""
        e1, phi1 = self.error_1_arcsec * ARCSEC, math.radians(self.phase_1_deg)
        e2, phi2 = self.error_2_arcsec * ARCSEC, math.radians(self.phase_2_deg)
        row["e1_rad"], row["phi1_rad"], row["e2_rad"], row["phi2_rad"] = e1, phi1, e2, phi2
        row["at_home_rad"] = e1 * math.cos(phi1) + e2 * math.cos(phi2)
        row["noise_rad"], row["draws"] = self.noise_counts * math.tau / counts_per_rev, seed


MOST_BITS = 26
"""Steps of an encoder of 0.02″: finer than any that is sold for a joint."""


class LoadEncoder(Table):
    """An encoder on the load side of the gear.

    Its drive shows it as 60E4h, additional position actual value.

    Attributes:
        counts_per_rev: Steps per revolution of the joint.
        offset_deg: What it shows where the motor angle is zero.
        is_reversed: It counts down where the motor counts up.
        noise_arcsec: Standard deviation of the white noise of each reading, before it is rounded.
        eccentricity: Its own error: orders of the joint, since its disc is off centre.
    """

    counts_per_rev: Annotated[int, Field(ge=256, le=2**MOST_BITS)]
    offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    is_reversed: bool = False
    noise_arcsec: NotNegative = 0.0
    eccentricity: Annotated[tuple[EccentricityLine, ...], Field(max_length=4)] = ()

    @model_validator(mode="after")
    def _orders_differ(self) -> "LoadEncoder":
        check_orders("eccentricity", self.eccentricity)
        return self
