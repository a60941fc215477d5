"""The robot file's `[axis.N.load_encoder]`."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.robot_tables import NotNegative
from plant_emulator.robots.angle_lines import EccentricityLine

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
        orders: Sequence[int] = [line.order for line in self.eccentricity]
        if len(set(orders)) < len(orders):
            raise ValueError(f"eccentricity: order {next(order for order in orders if orders.count(order) > 1)} is given twice")
        return self
