"""Model file: identified plants and transmission errors of a robot."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drive_profiles.files.toml import Table, load, table_lines
from hil.bench.bench import Bench, Model
from hil.bench.robot_file import RobotFile
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.estimate import Estimate
from hil.robot_tables import AxisNumber, NotNegative, PlantTable, Positive, TransmissionErrorTable

Errors = dict[str, NotNegative]
"""Standard error by the name of its number; a number without one was not identified, but given."""


LEAST_EIGENVALUE = -1e-6
"""Least eigenvalue of a correlation matrix whose numbers have been rounded to `CORRELATION_DIGITS`."""
CORRELATION_DIGITS = 8


class Correlation(Table):
    """Correlation of the errors of some numbers.

    Attributes:
        names: Names of the numbers; n of them.
        below: Lower triangle of the correlation matrix without its diagonal: of each number but the first with those before it.
    """

    names: tuple[str, ...]
    below: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _is_of_numbers(self) -> Self:
        if len(set(self.names)) < len(self.names):
            raise ValueError("names: a number is there twice")
        lengths, needed = [len(row) for row in self.below], list(range(1, len(self.names)))
        if lengths != needed:
            raise ValueError(f"below has rows of {lengths} numbers; expected {needed} for {len(self.names)} names")
        least = float(np.linalg.eigvalsh(self.matrix).min(initial=1.0))
        if least < LEAST_EIGENVALUE:
            raise ValueError(f"below: no errors correlate like that, since an eigenvalue is {least:.3g}; expected none below 0")
        return self

    @classmethod
    def of(cls, estimate: Estimate) -> "Correlation | None":
        """Correlation of an estimate; None if it has fewer than two quantities."""
        rows = [row[:at] for at, row in enumerate(estimate.correlation.round(CORRELATION_DIGITS).tolist())]
        return cls(names=estimate.names, below=tuple(map(tuple, rows[1:]))) if len(rows) > 1 else None

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The whole correlation matrix; shape (n, n)."""
        matrix = np.eye(len(self.names))
        for at, row in enumerate(self.below, start=1):
            matrix[at, :at] = matrix[:at, at] = row
        return matrix


class Uncertain(Table):
    """Numbers with the covariance of their errors.

    Attributes:
        standard_error: Standard errors by the numbers' names.
        correlation: Correlation of the errors; None if nothing is known of it: then they count as independent.
    """

    standard_error: Errors = Field(default_factory=dict)
    correlation: Correlation | None = None

    @model_validator(mode="after")
    def _correlates_errors(self) -> Self:
        unknown = [] if self.correlation is None else [each for each in self.correlation.names if each not in self.standard_error]
        if unknown:
            raise ValueError(f"correlation: {', '.join(unknown)} has no standard error; expected names of [standard_error]")
        return self

    def correlations(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Correlation of some numbers' errors; shape (n, n). Those of which nothing is known are independent."""
        whole = np.eye(len(names))
        if self.correlation is not None:
            held = {name: at for at, name in enumerate(self.correlation.names)}
            rows = [at for at, name in enumerate(names) if name in held]
            own = [held[names[at]] for at in rows]
            whole[np.ix_(rows, rows)] = self.correlation.matrix[np.ix_(own, own)]
        return whole


class IdentifiedMode(Table):
    """A mode of an arm with several modes, with the motor held.

    Attributes:
        antiresonance_hz: Its frequency, a dip of the motor's response.
        resonance_hz: The peak above it.
        damping: Its damping ratio.
        inertia_kg_m2: Its effective inertia about the joint; the sum over all modes is the joint's.
        tip_part: Its part of the tip's rigid motion; None without an accelerometer.
        standard_error: Standard errors of these.
    """

    antiresonance_hz: Positive
    resonance_hz: Positive
    damping: Positive
    inertia_kg_m2: Positive
    tip_part: float | None = None
    standard_error: Errors = Field(default_factory=dict)


class IdentifiedPlant(Uncertain):
    """The plant of one axis, identified from its frequency response.

    Attributes:
        values: The plant. It has standard errors, as `antiresonance_hz`, `resonance_hz` and `damping` have.
        antiresonance_hz: Antiresonance f_a.
        resonance_hz: Resonance f_r.
        damping: Damping ratio ζ of the arm on its gear.
        torsion_arcsec: Amplitude of the gear's torsion for which stiffness and damping hold; None if it was not recorded.
        cannot_tell: Facts that these data cannot show, in words.
        coulomb_friction_nm: Coulomb friction τ_C at the motor; None if no slow run was made.
        gravity_moment_nm: Gravity moment m g l of the arm; None if no slow run was made.
        torque_lag_s: Lag of the drive's current loop, from the reported torque to the torque on the motor.
        accelerometer_delay_s: Delay of the accelerometer behind the motor angle; None without an accelerometer.
        note: Notes of the engineer: date, load, temperature.
        emulated: True if it was identified on an emulated robot; None if that was not recorded.
        modes: Modes of an arm with several, from the lowest; then the values are motor and leading mode, the lowest with a
            large part of the tip's motion. Empty for one mode.
    """

    values: PlantTable
    antiresonance_hz: Positive
    resonance_hz: Positive
    damping: Positive
    torsion_arcsec: Positive | None = None
    cannot_tell: tuple[str, ...] = ()
    coulomb_friction_nm: NotNegative | None = None
    gravity_moment_nm: float | None = None
    torque_lag_s: NotNegative = 0.0
    accelerometer_delay_s: float | None = None
    note: str = ""
    emulated: bool | None = None
    modes: tuple[IdentifiedMode, ...] = ()


LearntBy = Literal["identify", "sensorless", "recording", "adaptive", "probing"]
"""Source of a transmission error: ramps with a sensor at the tip or the joint, or by motor torque and encoder alone; recordings
of others; passes of ramps with a cancellation; a motion itself."""


class OrderNumber(NamedTuple):
    """Amplitude or phase of an identified order.

    Attributes:
        name: Name in the model file: `a2_arcsec`.
        letter: `A` or `φ`.
        unit: `arcsec` or `°`.
    """

    name: str
    order: float
    letter: str
    unit: str
    value: float
    error: float | None


class IdentifiedError(Uncertain):
    """The transmission error of one axis, eq. (2).

    Attributes:
        values: Amplitudes A_k and phases φ_k. They have standard errors by the same names.
        arm_hz: Resonance ω/2π of the arm on its gear, refined by the fit.
        damping: Damping ratio ζ, likewise.
        torsion_arcsec: Amplitude of the gear's torsion for which both hold: the largest of the ramps; None for a linear arm.
        accelerometer_delay_s: Delay of the accelerometer behind the motor angle.
        set_point_delay_s: Delay of the motor behind its set-points beyond SYNC period and interpolation.
        gear_reaction: Part of τ_g dθ_sync/dθ_m with which the gear's torque τ_g loads the motor, as the motor's torque lets
            expect it; 0 if that was not measured.
        motor_friction_nm: Friction of the motor, identified with that reaction: no load of the gear. A plant's value goes first.
        learnt_by: Source of the values, one of `LearntBy`.
        motor_inertia_kg_m2: J_m with which it was learnt, as it was given; None if a plant was known.
        note: Notes of the engineer: date, load, temperature.
        emulated: True if it was identified on an emulated robot; None if that was not recorded.
    """

    values: TransmissionErrorTable
    arm_hz: Positive | None = None
    damping: Positive | None = None
    torsion_arcsec: Positive | None = None
    accelerometer_delay_s: float = 0.0
    set_point_delay_s: float = 0.0
    gear_reaction: NotNegative = 0.0
    motor_friction_nm: NotNegative = 0.0
    learnt_by: LearntBy = "identify"
    motor_inertia_kg_m2: Positive | None = None
    note: str = ""
    emulated: bool | None = None

    def numbers(self) -> Iterator[OrderNumber]:
        """Yield amplitude and phase of each order in turn."""
        phases, errors = self.values.phases_deg(), self.standard_error
        for order, amplitude in self.values.amplitudes_arcsec().items():
            for key, letter, unit, value in (
                (amplitude_key(order), "A", "arcsec", amplitude),
                (phase_key(order), "φ", "°", phases[order]),
            ):
                yield OrderNumber(key, order, letter, unit, value, errors.get(key))


def values_in_words(part: IdentifiedError) -> list[str]:
    """Write amplitude and phase of each order with standard errors.

    `A_2 = 5.00 ± 0.02 arcsec`, `φ_2 = 222.0 ± 0.1°`.
    """
    return [
        f"{each.letter}_{each.order:g} = {each.value:.2f} ± {each.error or 0.0:.2f}{' arcsec' if each.letter == 'A' else '°'}"
        for each in part.numbers()
    ]


SIGNIFICANT_SIGMAS = 3.0
"""Standard errors from which an amplitude counts: noise alone reaches them in 1.1 % of cases, e^{−9/2}."""


def significant(part: IdentifiedError) -> TransmissionErrorTable:
    """Return the orders whose amplitude exceeds noise.

    A cancellation of noise would only add to the vibration. An amplitude without a standard error counts as significant,
    and so does one that was learnt on a motion: a run with it was quieter.
    """
    values, errors = part.values, part.standard_error
    sigmas = 0.0 if part.learnt_by == "probing" else SIGNIFICANT_SIGMAS
    kept = {
        order: amplitude
        for order, amplitude in values.amplitudes_arcsec().items()
        if amplitude >= sigmas * errors.get(amplitude_key(order), 0.0)
    }
    return TransmissionErrorTable.of(kept, values.phases_deg())


SAME_POSTURE_DEG = 3.0
"""Difference of every joint up to which a posture is measured again."""


class IdentifiedPosture(Table):
    """Modes of an arm in a posture, from one axis.

    All other motors were held.

    Attributes:
        joints_deg: The posture: joint angles from the base on.
        mode: The modes, from the lowest.
        emulated: True if it was identified on an emulated robot; None if that was not recorded.
    """

    joints_deg: tuple[float, ...]
    mode: tuple[IdentifiedMode, ...]
    emulated: bool | None = None

    def is_at(self, joints_deg: Sequence[float]) -> bool:
        """True for the same posture, or nearly."""
        return len(joints_deg) == len(self.joints_deg) and all(
            abs(a - b) < SAME_POSTURE_DEG for a, b in zip(self.joints_deg, joints_deg, strict=True)
        )


class IdentifiedAxis(Table):
    """The identified parts of one axis; any may be missing.

    Attributes:
        plant: The plant, as designs and cancellations use it.
        ate: The transmission error.
        posture: Modes of the arm that it has measured, by posture.
    """

    plant: IdentifiedPlant | None = None
    ate: IdentifiedError | None = None
    posture: tuple[IdentifiedPosture, ...] = ()


class IdentifiedArm(Table):
    """Masses of an arm and stiffnesses of its gears, from several postures.

    Attributes:
        axes: Axes with a known stiffness; all others count as rigid, at a constant angle.
        joints_deg: Joint angles from the base on; those of the other axes are used.
        masses: Numbers of `hil.arm.regressor`, ten for each link, which give its mass matrix: none of them is known by itself.
        stiffness_nm_rad: Stiffness of each gear, in the order of `axes`.
        standard_error_nm_rad: Standard errors of these.
        misfit: Residual of the fit in standard errors.
        postures: Number of postures.
        dip_error: Largest relative standard error of a dip along the line, or in the postures.
        note: Notes of the engineer.
        emulated: True if a part was identified on an emulated robot; None if that was not recorded.
    """

    axes: tuple[AxisNumber, ...]
    joints_deg: tuple[float, ...]
    masses: tuple[float, ...]
    stiffness_nm_rad: tuple[Positive, ...]
    standard_error_nm_rad: tuple[NotNegative, ...]
    misfit: NotNegative
    postures: int
    dip_error: NotNegative = 0.0
    note: str = ""
    emulated: bool | None = None


class Identified(RobotFile):
    """A model file.

    Attributes:
        robot: Name of the bench on which it was identified.
        axis: Identified parts of each axis, by its number.
        arm: Masses of the arm, from several postures of its axes.
    """

    kind = "the model file"

    axis: dict[AxisNumber, IdentifiedAxis] = Field(default_factory=dict)
    arm: IdentifiedArm | None = None

    def with_part(self, number: int, part: IdentifiedPlant | IdentifiedError) -> "Identified":
        """The file with one part of one axis added or replaced."""
        name = "plant" if isinstance(part, IdentifiedPlant) else "ate"
        axis = self.axis.get(number, IdentifiedAxis()).model_copy(update={name: part})
        return self.model_copy(update={"axis": dict(sorted({**self.axis, number: axis}.items()))})

    def with_posture(self, number: int, posture: IdentifiedPosture) -> "Identified":
        """Return the file with one posture of an axis added."""
        axis = self.axis.get(number, IdentifiedAxis())
        others = tuple(each for each in axis.posture if not each.is_at(posture.joints_deg))
        axis = axis.model_copy(update={"posture": (*others, posture)})
        return self.model_copy(update={"axis": dict(sorted({**self.axis, number: axis}.items()))})

    def with_arm(self, arm: IdentifiedArm) -> "Identified":
        """The file with the masses of the arm."""
        return self.model_copy(update={"arm": arm})

    def dumps(self) -> str:
        """The file as TOML, the inverse of `loads`."""
        values = self.model_dump(exclude_none=True)
        values["axis"] = {number: {name: part for name, part in axis.items() if part} for number, axis in values["axis"].items()}
        return "\n".join(table_lines(values)) + "\n"


def load_identified(path: Path) -> Identified:
    """Read a model file.

    Raises:
        FileError: The file is not valid; every problem is listed by line.
    """
    return load(path, Identified)


def update_file(
    path: Path,
    robot: str,
    number: int,
    part: IdentifiedPlant | IdentifiedError,
    posture: IdentifiedPosture | None = None,
    *,
    keeps_known: bool = False,
) -> Identified:
    """Put one part into a model file; a missing file is created.

    `posture` has the modes of the arm that the axis has measured in a posture; `keeps_known` keeps the file's own part if it
    has one.

    Raises:
        FileError: The file is not a model file, or cannot be written.
        NotPossibleError: The file belongs to another robot.
    """
    known = Identified.known(path, robot)
    name = "plant" if isinstance(part, IdentifiedPlant) else "ate"
    stays = keeps_known and getattr(known.axis.get(number, IdentifiedAxis()), name) is not None
    updated = known if stays else known.with_part(number, part)
    if posture is not None:
        updated = updated.with_posture(number, posture)
    updated.save(path)
    return updated


def identified_axis(identified: Identified | None, number: int) -> IdentifiedAxis:
    """Identified parts of an axis; none without a model file, or of an axis that is not in it."""
    return IdentifiedAxis() if identified is None else identified.axis.get(number, IdentifiedAxis())


def with_identified(bench: Bench, identified: Identified | None) -> Bench:
    """Return the bench with identified models, if any, for assumed ones.

    If only one part of an axis was identified, the other is kept from the bench. An axis without any plant, or without any
    transmission error, has no model. The bench takes the significant orders of an identified error.
    """
    if identified is None:
        return bench
    axes = {}
    for number, table in bench.axis.items():
        known = identified_axis(identified, number)
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
        change: dict[str, Any] = {"model": Model(**plant, ate=ate)}
        if known.plant is not None and known.plant.modes:
            change["gear_stiffness_nm_rad"] = stiffness_of(known.plant.modes)
        axes[number] = table.model_copy(update=change)
    return bench.model_copy(update={"axis": axes})


def stiffness_of(modes: Sequence[IdentifiedMode]) -> float:
    """Return the stiffness K_g = Σ J_i ω_i² of a gear.

    In N·m/rad at the joint, for an arm with several modes. Far above all modes the arm is at rest, and the motor turns the gear
    alone: the limit of Σ J_i s² ω_i²/(s² + ω_i²).
    """
    return sum(mode.inertia_kg_m2 * (2.0 * math.pi * mode.antiresonance_hz) ** 2 for mode in modes)
