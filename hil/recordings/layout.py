"""Layout of a recording: role and unit of each column."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import Field

from drive_profiles.files.toml import Table, load
from hil.errors import RecordingFileError
from hil.recordings.units import ROLES, Role, Unit, unit_of
from hil.robot_tables import Positive

AXIS = "{axis}"
"""Stands in a name for the number of the axis."""


class LayoutFile(Table):
    """A layout as a file (TOML).

    Attributes:
        column: Name of the column by its role; `{axis}` stands for the number of the axis.
        unit: Unit by the role.
        reduction_ratio: Reduction ratio N by the number of the axis.
        robot: Name of the robot, for its model file.
    """

    column: dict[Role, str] = Field(default_factory=dict)
    unit: dict[Role, str] = Field(default_factory=dict)
    reduction_ratio: dict[int, Positive] = Field(default_factory=dict)
    robot: str | None = None


@dataclass(frozen=True)
class Said:
    """The user's statements on a recording.

    Attributes:
        column: Names of columns by their role.
        description: What decodes frames of a bus; None for other formats.
    """

    column: Mapping[Role, str] = field(default_factory=dict)
    unit: Mapping[Role, str] = field(default_factory=dict)
    reduction_ratio: float | None = None
    robot: str | None = None
    description: Path | None = None
    node_id: int | None = None


@dataclass(frozen=True)
class Column:
    """A column of a recording.

    Attributes:
        is_guessed: True if name or unit follows from the known names.
    """

    role: Role
    name: str
    unit: Unit
    is_guessed: bool

    @property
    def words(self) -> str:
        """The column in words: `motor: encoder_motorinc_1 (2^24/rev)`."""
        return f"{self.role}: {self.name} ({self.unit.text})"


KNOWN: tuple[tuple[str, dict[Role, tuple[str, str]]], ...] = (
    (
        "hil run",
        {
            "time": ("time_s", "s"),
            "motor": ("axis{axis}_position_rad", "rad"),
            "load": ("axis{axis}_load_rad", "rad"),
            "acceleration": ("tip_z_m_s2", "m/s2"),
            "torque": ("axis{axis}_torque_nm", "Nm"),
        },
    ),
    (  # 2^24 increments: README of the data, and the two ranges, whose ratio is that of the gear
        "NEURA LARA",
        {
            "time": ("Timestamp", "s"),
            "motor": ("encoder_motorinc_{axis}", "2^24/rev"),
            "load": ("encoder_loadinc_{axis}", "2^24/rev"),
        },
    ),
)
"""Layouts that are known by their names: motor and time must both be there."""

_STEMS: dict[Role, str] = {
    "time": r"(?:time|timestamp|timestamps|t)",
    "motor": r"(?:motor|motor_angle|motor_position|theta_m)",
    "load": r"(?:load|load_angle|load_position|joint|joint_angle|theta_l)",
    "acceleration": r"(?:acceleration|tip_acceleration|tip_z|accel|acc)",
    "torque": r"(?:torque|motor_torque|tau)",
}
_ANGLES = {suffix[1:]: suffix[1:] for suffix in ("_rad", "_deg", "_rev")}
_SUFFIXES: dict[Role, dict[str, str]] = {
    "time": {"s": "s", "ms": "ms", "us": "us", "ns": "ns"},
    "motor": _ANGLES,
    "load": _ANGLES,
    "acceleration": {"m_s2": "m/s2", "mm_s2": "mm/s2", "g": "g"},
    "torque": {"nm": "Nm", "mnm": "mNm"},
}


def load_layout(path: Path, axis: int) -> Said:
    """Read a layout file for one axis.

    Raises:
        FileError: The file is not valid.
    """
    file = load(path, LayoutFile)
    return Said(file.column, file.unit, file.reduction_ratio.get(axis), file.robot)


def said_with(texts: Sequence[str], ratio: float | None, robot: str | None, file: Said | None = None) -> Said:
    """Return the command line's statements, completed by a file's.

    >>> said_with(["motor=enc_m,2^20/rev"], 100.0, None).unit["motor"]
    '2^20/rev'

    Columns are `ROLE=NAME` or `ROLE=NAME,UNIT`; `file` is a layout file's.

    Raises:
        ValueError: A text is not a column.
    """
    file = file or Said()
    column, unit = dict(file.column), dict(file.unit)
    for text in texts:
        role, _, rest = text.partition("=")
        matching = [each for each in ROLES if each == role.strip()]
        name, _, spelled = rest.rpartition(",") if "," in rest else (rest, "", "")
        if not matching or not name.strip():
            raise ValueError(f"{text!r} is not a column; expected e.g. motor=encoder_2,2^20/rev; roles are {', '.join(ROLES)}")
        column[matching[0]] = name.strip()
        if spelled.strip():
            unit[matching[0]] = spelled.strip()
    return Said(column, unit, ratio if ratio is not None else file.reduction_ratio, robot or file.robot)


def choose_columns(path: Path, names: Sequence[str], said: Said, axis: int) -> dict[Role, Column]:
    """Choose the columns of a recording.

    Those that the user names, and those with known names. The path is for errors.

    Raises:
        RecordingFileError: A column is not there, its unit is not known, or there is no motor angle or time.
    """
    guessed = _known(names, axis)
    chosen: dict[Role, Column] = {}
    for role in ROLES:
        name, is_guessed = said.column.get(role, "").replace(AXIS, str(axis)), False
        spelled = said.unit.get(role)
        if name and name not in names:
            raise RecordingFileError(path, f"no column {name!r} for {role}; there are {_some(names)}")
        if not name:
            if role not in guessed:
                continue
            name, is_guessed = guessed[role][0], True
        if spelled is None:
            spelled = guessed[role][1] if role in guessed and guessed[role][0] == name else _suffix(role, name)
            is_guessed = True
        if spelled is None:
            raise RecordingFileError(path, f"the unit of {name!r} is not known; give --column {role}={name},UNIT")
        try:
            chosen[role] = Column(role, name, unit_of(role, spelled), is_guessed)
        except ValueError as error:
            raise RecordingFileError(path, str(error)) from error
    for role in ("motor", "time"):
        if role not in chosen:
            raise RecordingFileError(
                path, f"no column is recognised as {role}; give --column {role}=NAME,UNIT; there are {_some(names)}"
            )
    return chosen


def _known(names: Sequence[str], axis: int) -> dict[Role, tuple[str, str]]:
    """Return names and units of columns with known names."""
    for _, layout in KNOWN:
        there = {role: (name.replace(AXIS, str(axis)), unit) for role, (name, unit) in layout.items()}
        if there["time"][0] in names and there["motor"][0] in names:
            return {role: each for role, each in there.items() if each[0] in names}
    found: dict[Role, tuple[str, str]] = {}
    for role in ROLES:
        fitting = [
            (name, unit)
            for name in names
            if (unit := _suffix(role, name)) is not None
            and re.fullmatch(rf"(?:axis{axis}_)?{_STEMS[role]}(?:_?{axis})?_[a-z0-9_]+", name.lower())
        ]
        if len(fitting) == 1:  # of two nobody knows which
            found[role] = fitting[0]
    return found


def _suffix(role: Role, name: str) -> str | None:
    """Unit by the end of a name: `motor_rad`."""
    ends = sorted(_SUFFIXES[role], key=len, reverse=True)
    return next((_SUFFIXES[role][end] for end in ends if name.lower().endswith(f"_{end}")), None)


def _some(names: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
