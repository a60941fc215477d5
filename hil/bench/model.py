"""The model file: the identified plant and transmission error of a robot's axes, each number with its standard error."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from drive_profiles.files.safefile import write_atomically
from drive_profiles.files.toml import Table, load, toml_value
from hil.bench.bench import Bench, Model
from hil.errors import NotPossibleError
from hil.robot_tables import NotNegative, PlantTable, Positive, TransmissionErrorTable, amplitude_key, phase_key

Errors = dict[str, NotNegative]
"""Standard error by the name of its number; a number without one was not identified, or is believed."""


class IdentifiedPlant(Table):
    """The plant of one axis, identified from its frequency response.

    Attributes:
        values: The plant.
        standard_error: Standard errors of the values, and of `antiresonance_hz`, `resonance_hz` and `damping`.
        antiresonance_hz: Antiresonance f_a.
        resonance_hz: Resonance f_r.
        damping: Damping ratio ζ of the arm on its gear.
        cannot_tell: Facts that these data cannot show, in words.
        coulomb_friction_nm: Coulomb friction τ_C at the motor; None where no slow run was made.
        gravity_moment_nm: Gravity moment m g l of the arm; None where no slow run was made.
        note: Notes of the engineer: date, load, temperature.
        emulated: True where it was identified on an emulated robot; None where that was not recorded.
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
    emulated: bool | None = None


class IdentifiedError(Table):
    """The transmission error of one axis, eq. (2).

    Attributes:
        values: Amplitudes A_k and phases φ_k.
        standard_error: Standard errors by the names of `values`.
        arm_hz: Resonance ω/2π of the arm on its gear, refined by the fit.
        damping: Damping ratio ζ, likewise.
        accelerometer_delay_s: Delay of the accelerometer behind the motor angle.
        set_point_delay_s: Delay of the motor behind its set-points beyond SYNC period and interpolation.
        learnt_by: Source of the values: `identify` or `adaptive`.
        motor_inertia_kg_m2: J_m with which it was learnt, as it was given; None where a plant was known.
        note: Notes of the engineer: date, load, temperature.
        emulated: True where it was identified on an emulated robot; None where that was not recorded.
    """

    values: TransmissionErrorTable
    standard_error: Errors = Field(default_factory=dict)
    arm_hz: Positive | None = None
    damping: Positive | None = None
    accelerometer_delay_s: float = 0.0
    set_point_delay_s: float = 0.0
    learnt_by: str = "identify"
    motor_inertia_kg_m2: Positive | None = None
    note: str = ""
    emulated: bool | None = None


def values_in_words(part: IdentifiedError) -> list[str]:
    """Amplitude and phase of each order with their standard errors: `A_2 = 5.00 ± 0.02 arcsec`, `φ_2 = 222.0 ± 0.1°`."""
    values, errors = part.values, part.standard_error
    words = []
    for order, amplitude in values.amplitudes_arcsec().items():
        words.append(f"A_{order:g} = {amplitude:.2f} ± {errors.get(amplitude_key(order), 0.0):.2f} arcsec")
        words.append(f"φ_{order:g} = {values.phases_deg()[order]:.2f} ± {errors.get(phase_key(order), 0.0):.2f}°")
    return words


SIGNIFICANT_SIGMAS = 3.0
"""Standard errors from which an amplitude is believed: noise alone reaches them in 1.1 % of cases, e^{−9/2}."""


def significant(part: IdentifiedError) -> TransmissionErrorTable:
    """The orders whose amplitude is more than noise makes: a cancellation of noise would only add to the vibration.

    An amplitude without a standard error is believed.
    """
    values, errors = part.values, part.standard_error
    kept = {
        order: amplitude
        for order, amplitude in values.amplitudes_arcsec().items()
        if amplitude >= SIGNIFICANT_SIGMAS * errors.get(amplitude_key(order), 0.0)
    }
    return TransmissionErrorTable.of(kept, values.phases_deg())


class IdentifiedAxis(Table):
    """The identified parts of one axis; either may be missing."""

    plant: IdentifiedPlant | None = None
    ate: IdentifiedError | None = None


class Identified(Table):
    """A model file.

    Attributes:
        robot: Name of the bench on which it was identified.
        axis: Identified parts of each axis, by its number.
    """

    robot: str
    axis: dict[Annotated[int, Field(ge=1, le=6)], IdentifiedAxis] = Field(default_factory=dict)

    def with_part(self, number: int, part: IdentifiedPlant | IdentifiedError) -> "Identified":
        """The file with one part of one axis added or replaced."""
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
        """Write the file whole or not at all; an existing one is replaced.

        Raises:
            FileError: The file cannot be written.
        """
        write_atomically(path, self.dumps().encode(), force=True)


def load_identified(path: Path) -> Identified:
    """Read a model file.

    Raises:
        FileError: The file is not valid; every problem is listed by line.
    """
    return load(path, Identified)


def update_file(path: Path, robot: str, number: int, part: IdentifiedPlant | IdentifiedError) -> Identified:
    """Put one part into a model file; a missing file is created.

    Args:
        path: The file.
        robot: Name of the bench on which the part was identified.
        number: Number of the axis.
        part: Plant or transmission error of the axis.

    Raises:
        FileError: The file is not a model file, or cannot be written.
        NotPossibleError: The file belongs to another robot.
    """
    known = load_identified(path) if path.exists() else Identified(robot=robot)
    if known.robot != robot:
        raise NotPossibleError(f"{path} holds what was identified of {known.robot!r}, this is {robot!r}: choose another file")
    updated = known.with_part(number, part)
    updated.save(path)
    return updated


def with_identified(bench: Bench, identified: Identified) -> Bench:
    """The bench with the believed models of its axes replaced by the identified ones.

    Where only one part of an axis was identified, the other is kept from the bench. Without either plant the axis has no model;
    without either error it has none. Of an identified error the bench believes the significant orders.
    """
    axes = {}
    for number, table in bench.axis.items():
        known = identified.axis.get(number, IdentifiedAxis())
        plant: Mapping[str, Any] | None = None
        if known.plant is not None:
            plant = known.plant.values.model_dump()
        elif table.model is not None:
            plant = table.model.model_dump(exclude={"ate"})
        if plant is None:
            axes[number] = table
            continue
        if known.ate is not None:
            ate = significant(known.ate)
        else:
            ate = table.model.ate if table.model is not None else TransmissionErrorTable.of({}, {})
        axes[number] = table.model_copy(update={"model": Model(**plant, ate=ate)})
    return bench.model_copy(update={"axis": axes})


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    """A table with its plain values first, then its tables."""
    lines = [f"[{name}]"]
    lines += [f"{_key(key)} = {toml_value(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for key, value in values.items():
        if isinstance(value, dict) and value:
            lines += ["", *_table(f"{name}.{key}", value)]
    return lines


def _key(name: str) -> str:
    """A key as TOML writes it: `a0.5_arcsec` would be two keys without quotes."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)
