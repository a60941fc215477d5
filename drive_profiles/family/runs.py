"""Results of a run with each drive family, emulated (``runs.toml``)."""

import functools
from pathlib import Path
from typing import Annotated

import pydantic

from drive_profiles.files import toml as files
from drive_profiles.files.toml import Table

FILE = Path(__file__).with_name("runs.toml")


class FamilyRun(Table):
    """Result of a run with a family's emulated drive.

    Attributes:
        mode: Mode in which a run gives it set-points.
        is_moved: True if a run has moved it and left it as it was.
        refusal: Why its transmission error was not identified or not cancelled; empty if both were done.
        plant_refusal: Why its plant was not identified; empty if it was.
        tip_mm: Tip's peak of the reference robot's axis 2 without a treatment; None if it was not identified.
        cancelled_tip_mm: The same with cancellation by set-points, all other things equal; None if it was refused.
        held_by_drive: Limits of a bench file that the drive holds as well as the master.
        held_by_master: Limits that the master alone holds.
        kept_by_drive: Limits for which the drive keeps its own value.
    """

    mode: str
    is_moved: bool
    refusal: str = ""
    plant_refusal: str = ""
    tip_mm: Annotated[float, pydantic.Field(gt=0)] | None = None
    cancelled_tip_mm: Annotated[float, pydantic.Field(gt=0)] | None = None
    held_by_drive: tuple[str, ...] = ()
    held_by_master: tuple[str, ...] = ()
    kept_by_drive: tuple[str, ...] = ()

    @property
    def is_identified(self) -> bool:
        """True if its transmission error was identified."""
        return self.tip_mm is not None

    @property
    def is_cancelled(self) -> bool:
        """True if a cancellation by set-points made the tip quieter."""
        return self.tip_mm is not None and self.cancelled_tip_mm is not None and self.cancelled_tip_mm < self.tip_mm


class FamilyRuns(Table):
    """All families by name."""

    family: dict[str, FamilyRun]


@functools.cache
def family_runs() -> dict[str, FamilyRun]:
    """Return the results of a run with each family, by name."""
    return files.load(FILE, FamilyRuns).family


def in_words(run: FamilyRun) -> str:
    """Return the mode in which a family runs, for a narrow column."""
    if not run.is_moved:
        return "no"
    return run.mode if len(run.mode) <= len("CSP") else "own"
