"""Table of the bench file for poles and slots of a motor."""

from typing import Annotated

from pydantic import Field

from drive_profiles.files.toml import Table

Count = Annotated[int, Field(ge=1, le=1000)]


class MotorTable(Table):
    """Poles and slots of a motor, from its data sheet.

    They determine the orders that the motor itself can cause.

    Attributes:
        pole_pairs: Pole pairs p; None if they are not known.
        slots: Slots of the stator; None if they are not known.
    """

    pole_pairs: Count | None = None
    slots: Count | None = None
