"""Table of the bench file for what an axis' motor is made of."""

from typing import Annotated

from pydantic import Field

from drive_profiles.files.toml import Table

Count = Annotated[int, Field(ge=1, le=1000)]


class MotorTable(Table):
    """Poles and slots of a motor, which say what orders it can make of its own; of its data sheet.

    Attributes:
        pole_pairs: Pole pairs p; None if they are not known.
        slots: Slots of the stator, likewise.
    """

    pole_pairs: Count | None = None
    slots: Count | None = None
