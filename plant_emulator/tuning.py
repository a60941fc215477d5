"""What drives are set to in a run without a bus: gains and filters by axis, read from a bench, design or tuning file."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from drive_profiles.files import Table, load
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, NOTCHES, Notch
from plant_emulator.robot import Control, NotchTable, NotNegative, Positive, Robot


class FilterTable(NotchTable):
    """A variable notch with all that a bench or design file may state of it."""

    shape: Literal["switched", "trapezoid"] = "switched"
    hysteresis_rps: NotNegative = 0.15
    speed_lowpass_hz: Positive = 50.0
    ramp_rps: Positive = 1.0

    @model_validator(mode="after")
    def _possible(self) -> "FilterTable":
        self.notch()
        return self

    def notch(self) -> Notch:
        """The filter as the law takes it."""
        values = self.model_dump(exclude={"shape"})
        return Notch(mode=NOTCH_SWITCHED if self.shape == "switched" else NOTCH_TRAPEZOID, **values)


class TunedAxis(Table):
    """What concerns the drive of one axis; the rest of its table is somebody else's."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)

    control: Control | None = None
    notch: Annotated[tuple[FilterTable, ...], Field(max_length=NOTCHES)] = ()

    @field_validator("notch", mode="before")
    @classmethod
    def _one_is_a_list(cls, value: object) -> object:
        """A robot file has one filter as a table, not as a list of one."""
        if isinstance(value, dict):
            return (value,)
        return tuple(value) if isinstance(value, list) else value


class Tuning(Table):
    """Gains and filters by axis: of a tuning file, or what a bench file or a design file says of them.

    Keys that concern neither are passed over, so that those files can be given as they are.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)

    axis: Annotated[dict[Annotated[int, Field(ge=1, le=6)], TunedAxis], Field(min_length=1)]


REFERENCE_TUNING = Path(__file__).parent / "robots" / "reference_tuning.toml"


def load_tuning(path: str | Path) -> Tuning:
    """The tuning of a file, or of the name `reference`.

    Raises:
        FileError: With every problem, by line.
    """
    return load(REFERENCE_TUNING if str(path) == "reference" else path, Tuning)


def robot_tuning(robot: Robot) -> dict[int, TunedAxis]:
    """What the robot file itself says of gains and filters."""
    found = {}
    for number, axis in robot.axis.items():
        filters = () if axis.notch is None else (FilterTable(**axis.notch.model_dump()),)
        if axis.control is not None or filters:
            found[number] = TunedAxis(control=axis.control, notch=filters)
    return found
