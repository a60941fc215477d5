"""Bench file: bus, drives, assumed models and strict limits of a robot."""

import math
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Final, Literal, TypeVar

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from drive_profiles.address import AddressError, parse_address
from drive_profiles.family.profile import file_of
from drive_profiles.files.toml import FileError, Problem, Table, WrongKeyError, load
from hil.arm.kinematics import Kinematics
from hil.arm.line import moved_axes
from hil.arm.tables import ArmTable
from hil.arm.urdf import with_links
from hil.bench.sensors import AccelerometerTable, LoadEncoderTable, NodeId, ProfileText
from hil.control.notch import NOTCHES
from hil.design.frequency import CONTROL_PERIOD_S, Loop, TwoInertia
from hil.errors import NotPossibleError
from hil.robot_tables import (
    AxisNumber,
    ConstantAccelerationMotion,
    Control,
    Geometry,
    Lever,
    LineMotion,
    NotchTable,
    PlantTable,
    PointToPointMotion,
    Positive,
    TransmissionErrorTable,
)

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


AS_FOUND: Final = "as found"
"""Value of `control` where the drive keeps the gains that it has: its maker's tool has set them, and nobody else can."""

TO_BE_TYPED: Final = "TYPE:"
"""Beginning of a text that stands for what only a person can say; no bench file with one is accepted."""

LEAST_LEVER_M = 0.001
"""Lever from which an accelerometer feels an axis: 1 rad/s² there is 1 mm/s², a tenth of what real ones resolve."""

IDENTIFICATION_TRAVEL_DEG = 10.0
"""Angle by which an identification turns an arm's joint to either side: within it a resonance moves by some per cent."""
REFERENCE = Path(__file__).parent / "reference.toml"
REFERENCE_ARM = Path(__file__).parent / "reference_arm.toml"
SHIPPED = {"reference": REFERENCE, "reference-arm": REFERENCE_ARM}
"""Benches of the package, by name."""


class RealTimeTable(Table):
    """Requests to the operating system for runs in wall-clock time.

    The result lists those that were refused.
    """

    priority: Annotated[int, Field(ge=0, le=98)] = 80
    cpus: tuple[Annotated[int, Field(ge=0)], ...] = ()
    lock_memory: bool = True
    spin_s: Annotated[float, Field(ge=0.0, le=0.01)] = 0.0


SyncPeriod = Annotated[float, Field(gt=0.0, le=0.1)]
"""Period of a SYNC in s, up to the longest that drives interpolate over; 2 in place of 0.002 is one in ms."""


class Bus(Table):
    """The bus, its periods and time-outs."""

    address: str
    sync_period_s: SyncPeriod = 0.002
    host_sync_period_s: SyncPeriod = CONTROL_PERIOD_S
    answer_timeout_s: Positive = 1.0
    missing_limit: Annotated[int, Field(ge=1, le=100)] = 3
    heartbeat_s: Annotated[float, Field(ge=0.01, le=10.0)] = 0.1
    master_node_id: NodeId = 127
    max_lateness_s: Positive | None = None
    real_time: RealTimeTable = RealTimeTable()

    @field_validator("address")
    @classmethod
    def _address(cls, text: str) -> str:
        try:
            parse_address(text)
        except AddressError as error:
            raise ValueError(str(error)) from None
        return text


class Limits(Table):
    """Limits of an axis (motor side), held by master and drive.

    `acceleration_rps_s` is the largest acceleration of a motion; left out, `torque_nm` alone bounds it, by the inertia in
    the bench file. The additions of an identification or a cancellation to the set-points are not part of the
    motion: torque, speed and `cancellation_rev` bound them. `cancellation_rev` is the largest addition of a cancellation to
    a set-point; left out, a twentieth of `following_error_rev`.
    """

    torque_nm: Positive
    speed_rps: Positive
    acceleration_rps_s: Positive | None = None
    position_min_rev: float
    position_max_rev: float
    following_error_rev: Positive = 4.0
    following_error_timeout_s: Positive = 0.05
    cancellation_rev: Positive | None = None
    quick_stop_rps_s: Positive = 50.0

    @model_validator(mode="after")
    def _range(self) -> "Limits":
        if self.position_min_rev >= self.position_max_rev:
            raise ValueError(f"position_min_rev {self.position_min_rev} is not below position_max_rev {self.position_max_rev}")
        return self


class Model(PlantTable):
    """The assumed plant and transmission error, for design and report.

    In a run, only the check of a host-closed loop depends on it.
    """

    ate: TransmissionErrorTable


def _kind_of_gains(value: object) -> str:
    return "text" if isinstance(value, str) else "table"


Gains = Annotated[
    Annotated[Control, Tag("table")] | Annotated[Literal["as found"], Tag("text")],
    Discriminator(_kind_of_gains),  # so that a mistake in the table is not reported as a text that it is not
]
"""Gains of a loop, or `AS_FOUND`."""


class AxisTable(Table):
    """One axis of the robot and the drive that moves it.

    Attributes:
        node_id: Node-ID of the drive.
        profile: Drive profile, by its name or by the path of its file; a path counts from the bench file.
        serial_number: Serial number of the drive; None if any is accepted.
        reduction_ratio: Reduction ratio N of the gear.
        joint: Name of its joint in the arm's URDF file.
        tip_lever_m: Distance of the tip from the axis; left out on a bench with an arm, whose links give it.
        limits: Limits that the axis must never exceed.
        control: Gains of its loop, or `as found`: the drive's, which are neither written nor known.
        gains_are_set: True if the drive has the gains of `control` already, since only its maker's tool can set them.
        notch: Variable notches.
        model: Assumed plant; None without one.
        gear_stiffness_nm_rad: Stiffness of its gear at the joint; left out, that of `model`, which may be that of one mode alone.
        encoder_counts_per_rev: Position units per motor revolution, for a drive without an object for it.
        rated_torque_nm: Torque of which torques are per mille, for a drive without an object for it.
        torque_constant_nm_a: Torque of the motor per ampere, for a drive that reports a current and no torque.
        motor_inertia_kg_m2: J_m of the motor's data sheet, for cancelling and learning if no plant is known.
        motor: Poles and slots of the motor, for a passport; None if nothing is known of them.
        load_encoder: Second encoder, on the joint; its position is recorded. None: there is none, or it is not wanted.
    """

    node_id: NodeId
    profile: ProfileText = "emulated_drive"
    serial_number: Annotated[int, Field(ge=0)] | None = None
    joint: str | None = None
    reduction_ratio: Positive
    tip_lever_m: Lever = 0.0
    limits: Limits
    control: Gains
    gains_are_set: bool = False
    notch: Annotated[tuple[NotchTable, ...], Field(max_length=NOTCHES)] = ()
    model: Model | None = None
    gear_stiffness_nm_rad: Positive | None = None
    encoder_counts_per_rev: Annotated[int, Field(gt=0)] | None = None
    rated_torque_nm: Positive | None = None
    torque_constant_nm_a: Positive | None = None
    motor_inertia_kg_m2: Positive | None = None
    motor: MotorTable | None = None
    load_encoder: LoadEncoderTable | None = None

    @field_validator("profile", "joint")
    @classmethod
    def _is_typed(cls, text: str | None) -> str | None:
        if text is not None and text.startswith(TO_BE_TYPED):
            raise ValueError(f"is not filled in yet:{text.removeprefix(TO_BE_TYPED)}")
        return text

    def gains(self, purpose: str) -> Control:
        """The gains of the loop.

        Their purpose is the subject of the error's sentence.

        Raises:
            NotPossibleError: They are as found in the drive, and so not known.
        """
        if isinstance(self.control, Control):
            return self.control
        raise NotPossibleError(f'{purpose} needs gains in the bench file: control = "{AS_FOUND}" leaves them to the drive')

    @property
    def writes_gains(self) -> bool:
        """True if a run writes the gains into the drive."""
        return isinstance(self.control, Control) and not self.gains_are_set

    def felt_lever_m(self, purpose: str) -> float:
        """Lever by which the axis moves the accelerometer.

        The purpose of the accelerometer is the subject of the error's sentence.

        Raises:
            NotPossibleError: It is too short for a measurement.
        """
        if self.tip_lever_m >= LEAST_LEVER_M:
            return self.tip_lever_m
        raise NotPossibleError(
            f"{purpose} needs an accelerometer that the axis moves: its lever at home is {1e3 * self.tip_lever_m:.2g} mm; "
            f"at least {1e3 * LEAST_LEVER_M:g} mm is needed. Mount it elsewhere, or leave out the table"
        )

    @property
    def has_loop(self) -> bool:
        """True if plant and gains are both known."""
        return self.model is not None and isinstance(self.control, Control)

    def plant(self) -> TwoInertia | None:
        """The linear plant of the model, or None without one."""
        if self.model is None:
            return None
        return TwoInertia(reduction_ratio=self.reduction_ratio, **self.model.model_dump(exclude={"ate"}))

    def loop(self, period_s: float, delay_samples: int = 0, *, with_notch: bool = True) -> Loop | None:
        """Return the loop around the model; None without plant or gains."""
        plant = self.plant()
        if plant is None or not isinstance(self.control, Control):
            return None
        notches = tuple(table.notch() for table in self.notch) if with_notch else ()
        return Loop(plant, self.control.cascade(), notches, period_s, delay_samples)


class Specification(Table):
    """Tolerances of the tip.

    Attributes:
        tip_mm: Largest displacement.
        quiet_mm: Largest displacement that a cancellation may leave with an unknown cause.
        line_area_reduction_pct: Reduction of the spectrum's area that is asked in the line motion; None: only the peak is asked.
        band_hz: Band of the line motion's vibration on a bench with an arm, which several resonances share; None: by f_al.
    """

    tip_mm: Positive = 0.05
    quiet_mm: Positive = 0.010
    line_area_reduction_pct: float | None = None
    band_hz: tuple[Positive, Positive] | None = None

    @model_validator(mode="after")
    def _is_a_band(self) -> "Specification":
        if self.band_hz is not None and not self.band_hz[0] < self.band_hz[1]:
            raise ValueError(f"band_hz goes from {self.band_hz[0]:g} to {self.band_hz[1]:g} Hz: the first must be the lower")
        return self


class Bench(Table):
    """A robot on a bus, as its engineer describes it.

    Attributes:
        reference: `paper` for the robot of the paper, which is judged in the paper's windows and beside its numbers; None for
            every other robot.
        identification_travel_deg: Largest joint angle of an identification on an arm, to either side: beyond it the plant is
            another. Left out, `IDENTIFICATION_TRAVEL_DEG`; a bench without an arm has none.
    """

    name: str
    reference: Literal["paper"] | None = None
    bus: Bus
    axis: Annotated[dict[AxisNumber, AxisTable], Field(min_length=1)]
    accelerometer: AccelerometerTable
    geometry: Geometry | None = None
    arm: ArmTable | None = None
    line_motion: LineMotion | None = None
    constant_acceleration: ConstantAccelerationMotion | None = None
    point_to_point: PointToPointMotion | None = None
    specification: Specification = Specification()
    settle_s: Annotated[float, Field(ge=0.05, le=60.0)] = 0.5
    approach_rps: Positive = 8.0
    identification_travel_deg: Annotated[float, Field(gt=0.0, le=180.0)] | None = None

    @property
    def is_paper(self) -> bool:
        """True for the paper's robot."""
        return self.reference == "paper"

    def check_axis(self, number: int) -> None:
        """Refuse the number of an axis that the bench does not have.

        Raises:
            NotPossibleError: It has none.
        """
        if number not in self.axis:
            raise NotPossibleError(f"bench {self.name!r} has no axis {number}; it has {', '.join(map(str, self.axis))}")

    @property
    def chain_axes(self) -> tuple[int, ...]:
        """Axes of the line motion, from the base on.

        Those of the geometry, or of an arm those that move; empty without either.
        """
        if self.arm is not None:
            return moved_axes(self.arm, self.line_motion)
        return () if self.geometry is None else self.geometry.axes

    @property
    def travel_deg(self) -> float:
        """Largest joint angle of an identification, either side; infinite without arm."""
        return math.inf if self.arm is None else self.identification_travel_deg or IDENTIFICATION_TRAVEL_DEG

    def travel_rev(self, axis: int) -> float:
        """The same in motor revolutions, end to end."""
        return 2.0 * self.travel_deg / 360.0 * self.axis[axis].reduction_ratio

    def on(self, address: str) -> "Bench":
        """The same bench on another bus.

        Raises:
            AddressError: The address cannot be read.
        """
        parse_address(address)
        return self.model_copy(update={"bus": self.bus.model_copy(update={"address": address})})

    @model_validator(mode="after")
    def _consistent(self) -> "Bench":
        nodes: list[tuple[int | None, tuple[str, ...]]] = [
            (self.bus.master_node_id, ("bus", "master_node_id")),
            *((axis.node_id, ("axis", str(number), "node_id")) for number, axis in self.axis.items()),
            (self.accelerometer.node_id, ("accelerometer", "node_id")),
        ]
        first: dict[int, tuple[str, ...]] = {}
        for node, key in nodes:
            if node is not None and first.setdefault(node, key) != key:
                raise WrongKeyError(f"node-ID {node} is given twice on this bus: {'.'.join(first[node])} has it as well", key)
        for number, axis in self.axis.items():
            if self.approach_rps > axis.limits.speed_rps:
                raise ValueError(f"approach_rps {self.approach_rps} is above axis {number}'s speed_rps {axis.limits.speed_rps}")
        if self.accelerometer.from_load_encoders:
            self._check_load_encoders()
        if self.arm is not None:
            self._check_arm(self.arm)
            return with_levers(self, self.arm) if self.arm.link else self
        bare = [number for number, axis in self.axis.items() if axis.tip_lever_m <= 0.0]
        if bare:
            raise ValueError(f"axis {bare[0]} has no tip_lever_m, the tip's distance from it; state it, or add an arm table")
        if self.specification.band_hz is not None:
            raise ValueError("specification.band_hz needs an arm table: without one a line is judged by the f_al of its axes")
        if self.identification_travel_deg is not None:
            raise ValueError("identification_travel_deg needs an arm table; without one, position does not change a plant")
        if self.accelerometer.mounting is not None:
            raise ValueError("accelerometer.mounting needs an arm table: the links on which the sensor sits")
        if self.line_motion is not None:
            if self.geometry is None:
                raise ValueError(
                    "line_motion needs a geometry table: the lengths of the arm, and axes = [shoulder, elbow, wrist], by number; "
                    "or an arm table"
                )
            self.geometry.check_axes(self.axis, "line_motion")
            self.line_motion.check_planar()
        return self

    def _check_load_encoders(self) -> None:
        without = [number for number, axis in self.axis.items() if axis.load_encoder is None]
        if without:
            raise ValueError(
                f"accelerometer.from_load_encoders: axis {without[0]} has no load_encoder table; every axis needs one"
            )

    def _check_arm(self, arm: ArmTable) -> None:
        """Refuse a bench file that contradicts its arm's links."""
        if self.geometry is not None:
            raise ValueError("geometry and arm both define the tip; leave the geometry out")
        if arm.link:
            arm.check_axes(tuple(self.axis))
            if self.accelerometer.mounting is not None:
                self.accelerometer.mounting.check_arm(arm)


def source_of(path: str | Path) -> Path:
    """The file of a path, or of a name of `SHIPPED`."""
    return SHIPPED.get(str(path), Path(path))


def load_bench(path: str | Path) -> Bench:
    """Load the bench of a file, or of a name of `SHIPPED`.

    Relative paths of profiles in it count from the file.

    Raises:
        FileError: The file is not valid; every problem is listed by line.
    """
    file = source_of(path)
    close = [] if file.exists() else get_close_matches(str(path), SHIPPED, n=1)
    if close:
        raise FileError(file, (Problem(0, "", "does not exist", f"a bench file; did you mean {close[0]}?"),))
    bench = load(file, Bench)
    folder = file.absolute().parent
    named = {f"axis.{number}": table for number, table in bench.axis.items()} | {"accelerometer": bench.accelerometer}
    missing = [
        Problem(0, f"{key}.profile", f"no file {table.profile!r}", "a drive profile's path from this folder, or its name")
        for key, table in named.items()
        if (profile := file_of(table.profile, folder)) is not None and not profile.exists()
    ]
    if missing:
        raise FileError(file, tuple(missing))
    axes = {number: _with_profile_in(folder, table) for number, table in bench.axis.items()}
    bench = bench.model_copy(update={"axis": axes, "accelerometer": _with_profile_in(folder, bench.accelerometer)})
    try:
        return with_arm(bench, folder)
    except ValueError as error:
        raise FileError(file, (Problem(1, "arm", str(error), "an arm that the axes of the file move"),)) from None


ROUNDING_M = 1e-9
"""Lever that is none: rounding in a chain of rotations."""
LEVER_TOLERANCE = 0.02
"""Relative difference of a stated lever from the arm's up to which it is a rounded one."""


def with_arm(bench: Bench, folder: Path) -> Bench:
    """Return a bench whose arm has its links.

    Raises:
        FileError: The URDF file describes no such arm.
        ValueError: The bench file contradicts the arm.
    """
    if bench.arm is None or bench.arm.link:
        return bench
    joints = {table.joint: number for number, table in bench.axis.items() if table.joint is not None}
    arm, reductions = with_links(bench.arm, folder, joints)
    for number, ratio in reductions.items():
        if not math.isclose(ratio, bench.axis[number].reduction_ratio, rel_tol=1e-6):
            raise ValueError(
                f"axis {number}: reduction_ratio is {bench.axis[number].reduction_ratio:g}, but {ratio:g} in the URDF file"
            )
    bench = bench.model_copy(update={"arm": arm})
    bench._check_arm(arm)
    return with_levers(bench, arm)


def with_levers(bench: Bench, arm: ArmTable) -> Bench:
    """Return a bench with levers from the arm's links.

    Raises:
        ValueError: The file states another lever.
    """
    kinematics, mounting = Kinematics.of(arm), bench.accelerometer.mounting
    of = kinematics.tip if mounting is None else mounting.frame(arm)
    levers = np.linalg.norm(kinematics.jacobian(arm.home_rad(), of)[:3], axis=0).tolist()
    axes = {}
    for number, table in bench.axis.items():
        found = float(levers[arm.axes.index(number)])
        lever = found if found > ROUNDING_M else 0.0
        stated = table.tip_lever_m if "tip_lever_m" in table.model_fields_set else lever
        if abs(stated - lever) > LEVER_TOLERANCE * max(lever, stated):
            raise ValueError(
                f"axis {number}: tip_lever_m is {stated:g}, but the arm table gives {lever:.4g} m at home; leave tip_lever_m out"
            )
        axes[number] = table.model_copy(update={"tip_lever_m": lever})
        axes[number].model_fields_set.discard("tip_lever_m")  # worked out, not stated: another mounting gives another
    return bench.model_copy(update={"axis": axes})


T = TypeVar("T", AxisTable, AccelerometerTable)


def _with_profile_in(folder: Path, table: T) -> T:
    if file_of(table.profile, folder) is None:
        return table
    return table.model_copy(update={"profile": str(folder / table.profile)})
