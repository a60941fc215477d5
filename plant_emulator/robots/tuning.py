"""Tuning of the drives in a run without a bus."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, field_validator

from drive_profiles.files.toml import Table, load
from hil.control.notch import NOTCHES
from hil.robot_tables import AxisNumber, Control, NotchTable
from plant_emulator.robots.robot import Robot


class TunedAxis(Table):
    """Drive-related part of an axis' table.

    Other keys are ignored.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)

    control: Control | None = None
    notch: Annotated[tuple[NotchTable, ...], Field(max_length=NOTCHES)] = ()

    @field_validator("notch", mode="before")
    @classmethod
    def _one_is_a_list(cls, value: object) -> object:
        """Convert a single filter to a list of one."""
        if isinstance(value, dict):
            return (value,)
        return tuple(value) if isinstance(value, list) else value


class Tuning(Table):
    """Gains and filters by axis.

    They come from a tuning file, a bench file or a design file.

    Other keys are ignored, so that those files can be used as they are.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)

    axis: Annotated[dict[AxisNumber, TunedAxis], Field(min_length=1)]

    def gains(self, axes: Iterable[int]) -> dict[int, Control]:
        """Return the gains of these axes.

        Raises:
            ValueError: One has none.
        """
        known = {number: table.control for number, table in self.axis.items() if table.control is not None}
        if without := [number for number in axes if number not in known]:
            raise ValueError(f"the tuning has no gains for axis {without[0]}; add axis.{without[0]}.control")
        return {number: known[number] for number in axes}


REFERENCE_TUNING = Path(__file__).parent / "reference_tuning.toml"


def load_tuning(path: str | Path) -> Tuning:
    """Load the tuning of a file, or of the name `reference`.

    Raises:
        FileError: With every problem, by line.
    """
    return load(REFERENCE_TUNING if str(path) == "reference" else path, Tuning)


def tuned(robot: Robot, gains: Mapping[int, Control]) -> Robot:
    """Return a robot with gains as if set by its makers' tools."""
    axes = {number: robot.axis[number].model_copy(update={"control": control}) for number, control in gains.items()}
    return robot.model_copy(update={"axis": {**robot.axis, **axes}})


def own_tuning(name: str, robot: Robot) -> dict[int, TunedAxis]:
    """Return gains and filters by axis from the robot file; those of `reference` are in a file beside it."""
    return dict(load_tuning(name).axis) if name == "reference" else robot_tuning(robot)


def robot_tuning(robot: Robot) -> dict[int, TunedAxis]:
    """Return gains and filters by axis from the robot file."""
    found = {}
    for number, axis in robot.axis.items():
        filters = () if axis.notch is None else (NotchTable(**axis.notch.model_dump()),)
        if axis.control is not None or filters:
            found[number] = TunedAxis(control=axis.control, notch=filters)
    return found
