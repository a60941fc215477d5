"""The model file: what has been identified of a robot, each number with its standard error, and whatever else was learnt."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from drive_profiles.files import Table, load, toml_value
from drive_profiles.safefile import write_atomically
from hil.errors import NotPossibleError
from hil.master.bench import Bench, Model, NotNegative, Positive, TransmissionError

Errors = dict[str, NotNegative]
"""Standard error by the name of what it belongs to; what has none was not identified, or is believed."""


class PlantTable(Table):
    """The linear plant: motor side for the motor, arm side for gear and arm."""

    motor_inertia_kg_m2: Positive
    motor_damping_nm_s_rad: NotNegative
    arm_inertia_kg_m2: Positive
    arm_damping_nm_s_rad: NotNegative
    gear_stiffness_nm_rad: Positive
    gear_damping_nm_s_rad: NotNegative


class IdentifiedPlant(Table):
    """The plant of one axis as its frequency response gave it.

    Attributes:
        values: The plant.
        standard_error: Of the values, and of `antiresonance_hz`, `resonance_hz` and `damping`.
        antiresonance_hz: f_a.
        resonance_hz: f_r.
        damping: ζ of the arm on its gear.
        cannot_tell: What these data cannot tell, in words.
        coulomb_friction_nm: τ_C at the motor; None where no slow run was made.
        gravity_moment_nm: m g l of the arm, likewise.
        note: Date, load, temperature: what the engineer wants to remember.
    """

    values: PlantTable
    standard_error: Errors = Field(default_factory=dict)
    antiresonance_hz: Positive
    resonance_hz: Positive
    damping: Positive
    cannot_tell: tuple[str, ...] = ()
    coulomb_friction_nm: NotNegative | None = None
    gravity_moment_nm: float | None = None
    note: str = ""


class IdentifiedError(Table):
    """The transmission error of one axis, eq. (2).

    Attributes:
        values: A_k, φ_k.
        standard_error: By the names of `values`.
        arm_hz: ω/2π of the arm on its gear, refined by the fit.
        damping: ζ likewise.
        accelerometer_delay_s: By how much the accelerometer lags the motor angle.
        set_point_delay_s: By how much the motor follows its set-points later than SYNC period and interpolation explain.
        learnt_by: `identify` or `adaptive`.
        note: Date, load, temperature.
    """

    values: TransmissionError
    standard_error: Errors = Field(default_factory=dict)
    arm_hz: Positive | None = None
    damping: Positive | None = None
    accelerometer_delay_s: float = 0.0
    set_point_delay_s: float = 0.0
    learnt_by: str = "identify"
    note: str = ""


class IdentifiedAxis(Table):
    """What is known of one axis; either part may be missing."""

    plant: IdentifiedPlant | None = None
    ate: IdentifiedError | None = None


class Identified(Table):
    """A model file.

    Attributes:
        robot: Name of the bench that it was identified on.
        axis: By number.
    """

    robot: str
    axis: dict[Annotated[int, Field(ge=1, le=6)], IdentifiedAxis] = Field(default_factory=dict)

    def with_part(self, number: int, part: IdentifiedPlant | IdentifiedError) -> "Identified":
        """The file with one part of one axis put in, or in the place of an older one."""
        name = "plant" if isinstance(part, IdentifiedPlant) else "ate"
        axis = self.axis.get(number, IdentifiedAxis()).model_copy(update={name: part})
        return self.model_copy(update={"axis": dict(sorted({**self.axis, number: axis}.items()))})

    def dumps(self) -> str:
        """The file as TOML; `loads` of it gives the same."""
        lines = [f"robot = {toml_value(self.robot)}"]
        for number, axis in self.axis.items():
            for name in ("plant", "ate"):
                part = getattr(axis, name)
                if part is not None:
                    lines += ["", *_table(f"axis.{number}.{name}", part.model_dump(exclude_none=True))]
        return "\n".join(lines) + "\n"

    def save(self, path: Path) -> None:
        """Write it whole or not at all; what is there is replaced.

        Raises:
            FileError: It cannot be written.
        """
        write_atomically(path, self.dumps().encode(), force=True)


def load_identified(path: Path) -> Identified:
    """Read a model file.

    Raises:
        FileError: With every problem, by line.
    """
    return load(path, Identified)


def update_file(path: Path, robot: str, number: int, part: IdentifiedPlant | IdentifiedError) -> Identified:
    """Put one part into a model file, which need not be there yet.

    Raises:
        FileError: It is no model file, or cannot be written.
        NotPossibleError: It is another robot's.
    """
    known = load_identified(path) if path.exists() else Identified(robot=robot)
    if known.robot != robot:
        raise NotPossibleError(f"{path} holds what was identified of {known.robot!r}, this is {robot!r}: choose another file")
    updated = known.with_part(number, part)
    updated.save(path)
    return updated


def with_identified(bench: Bench, identified: Identified) -> Bench:
    """The bench with what is believed of its axes replaced by what has been identified.

    An axis of which only one part was identified keeps its other one; without any there the axis has no model, or no error.
    """
    axes = {}
    for number, table in bench.axis.items():
        found = identified.axis.get(number, IdentifiedAxis())
        plant: Mapping[str, Any] | None = None
        if found.plant is not None:
            plant = found.plant.values.model_dump()
        elif table.model is not None:
            plant = table.model.model_dump(exclude={"ate"})
        if plant is None:
            axes[number] = table
            continue
        if found.ate is not None:
            ate = found.ate.values
        else:
            ate = table.model.ate if table.model is not None else TransmissionError(a2_arcsec=0.0, phi2_deg=0.0)
        axes[number] = table.model_copy(update={"model": Model(**plant, ate=ate)})
    return bench.model_copy(update={"axis": axes})


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    """A table with its plain values first, then its tables."""
    lines = [f"[{name}]"]
    lines += [f"{key} = {toml_value(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for key, value in values.items():
        if isinstance(value, dict) and value:
            lines += ["", *_table(f"{name}.{key}", value)]
    return lines
