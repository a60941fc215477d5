"""The bench file: bus and drives of a robot, the believed model of its axes, and limits that must never be exceeded."""

from pathlib import Path
from typing import Annotated, Final, Literal, TypeVar

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from drive_profiles.address import AddressError, parse_address
from drive_profiles.family.profile import is_name
from drive_profiles.files.toml import Table, load
from hil.control.notch import NOTCHES
from hil.design.frequency import CONTROL_PERIOD_S, Loop, TwoInertia
from hil.errors import NotPossibleError
from hil.robot_tables import (
    ConstantAccelerationMotion,
    Control,
    Geometry,
    LineMotion,
    NotchTable,
    PlantTable,
    Positive,
    TransmissionErrorTable,
)
from hil.sensor.table import SerialTable

AS_FOUND: Final = "as found"
"""Value of `control` where the drive keeps the gains that it has: its maker's tool has set them, and nobody else can."""

NodeId = Annotated[int, Field(ge=1, le=127)]

REFERENCE = Path(__file__).parent / "reference.toml"


class RealTimeTable(Table):
    """Requests to the operating system for runs in wall-clock time; the result lists those that were refused."""

    priority: Annotated[int, Field(ge=0, le=98)] = 80
    cpus: tuple[Annotated[int, Field(ge=0)], ...] = ()
    lock_memory: bool = True
    spin_s: Annotated[float, Field(ge=0.0, le=0.01)] = 0.0


class Bus(Table):
    """The bus, its periods and time-outs."""

    address: str
    sync_period_s: Positive = 0.002
    host_sync_period_s: Positive = CONTROL_PERIOD_S
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
    """Limits that an axis must never exceed, motor side; enforced by the master and written to the drive.

    `cancellation_rev` is the largest addition of a cancellation to a set-point; left out, a twentieth of `following_error_rev`.
    """

    torque_nm: Positive
    speed_rps: Positive
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
    """The believed plant, for design and report; in a run only the check of a host-closed loop depends on it."""

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
        serial_number: Serial number of the drive; None where any is accepted.
        reduction_ratio: Reduction ratio N of the gear.
        tip_lever_m: Distance of the tip from the axis.
        limits: Limits that the axis must never exceed.
        control: Gains of its loop, or `as found`: the drive's, which are neither written nor known.
        notch: Variable notches.
        model: Believed plant; None without one.
        encoder_counts_per_rev: Position units per motor revolution, for a drive without an object that says it.
        rated_torque_nm: Torque of which torques are per mille, for a drive without an object that says it.
    """

    node_id: NodeId
    profile: str = "emulated_drive"
    serial_number: Annotated[int, Field(ge=0)] | None = None
    reduction_ratio: Positive
    tip_lever_m: Positive
    limits: Limits
    control: Gains
    notch: Annotated[tuple[NotchTable, ...], Field(max_length=NOTCHES)] = ()
    model: Model | None = None
    encoder_counts_per_rev: Annotated[int, Field(gt=0)] | None = None
    rated_torque_nm: Positive | None = None

    def gains(self, purpose: str) -> Control:
        """The gains of the loop.

        Args:
            purpose: Use of the gains, as the subject of the error's sentence.

        Raises:
            NotPossibleError: They are as found in the drive, so nobody knows them.
        """
        if isinstance(self.control, Control):
            return self.control
        raise NotPossibleError(f'{purpose} needs gains in the bench file: control = "{AS_FOUND}" leaves them to the drive')

    @property
    def has_loop(self) -> bool:
        """True where plant and gains are both known."""
        return self.model is not None and isinstance(self.control, Control)

    def plant(self) -> TwoInertia | None:
        """The linear plant of the model, or None without one."""
        if self.model is None:
            return None
        return TwoInertia(reduction_ratio=self.reduction_ratio, **self.model.model_dump(exclude={"ate"}))

    def loop(self, period_s: float, delay_samples: int = 0, *, with_notch: bool = True) -> Loop | None:
        """The loop around the model; None where plant or gains are not known."""
        plant = self.plant()
        if plant is None or not isinstance(self.control, Control):
            return None
        notches = tuple(table.notch() for table in self.notch) if with_notch else ()
        return Loop(plant, self.control.cascade(), notches, period_s, delay_samples)


class AccelerometerTable(Table):
    """The sensor at the tip: a node of the bus, or a device on a serial port.

    Attributes:
        node_id: Node-ID of the sensor; None for a sensor on a serial port.
        profile: Drive profile of the node; None for a sensor on a serial port.
        serial: Port and framing of a serial sensor; None for a node.
        range_m_s2: Largest measurement of the sensor, or None; a run in which a sample reaches it is not judged.
    """

    node_id: NodeId | None = None
    profile: str = "emulated_accelerometer"
    serial: SerialTable | None = None
    range_m_s2: Positive | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> "AccelerometerTable":
        if (self.node_id is None) == (self.serial is None):
            raise ValueError("the accelerometer has either a node_id on the bus or a serial table")
        return self


class Specification(Table):
    """Tolerances of the tip.

    Attributes:
        tip_mm: Largest displacement.
        line_area_reduction_pct: Reduction of the spectrum's area that is asked in the line motion; None: only the peak is asked.
    """

    tip_mm: Positive = 0.05
    line_area_reduction_pct: float | None = None


class Bench(Table):
    """A robot on a bus, as its engineer describes it.

    Attributes:
        reference: `paper` for the robot of the paper, which is judged in the paper's windows and beside its numbers; None for
            every other robot.
    """

    name: str
    reference: Literal["paper"] | None = None
    bus: Bus
    axis: Annotated[dict[Annotated[int, Field(ge=1, le=6)], AxisTable], Field(min_length=1)]
    accelerometer: AccelerometerTable
    geometry: Geometry | None = None
    line_motion: LineMotion | None = None
    constant_acceleration: ConstantAccelerationMotion | None = None
    specification: Specification = Specification()
    settle_s: Annotated[float, Field(ge=0.05, le=60.0)] = 0.5
    approach_rps: Positive = 8.0

    @property
    def is_paper(self) -> bool:
        """True for the paper's robot."""
        return self.reference == "paper"

    @property
    def chain_axes(self) -> tuple[int, ...]:
        """Axes of the line motion: those of the geometry, from the base on; none without one."""
        return () if self.geometry is None else self.geometry.axes

    def on(self, address: str) -> "Bench":
        """The same bench on another bus.

        Raises:
            AddressError: The address cannot be read.
        """
        parse_address(address)
        return self.model_copy(update={"bus": self.bus.model_copy(update={"address": address})})

    @model_validator(mode="after")
    def _consistent(self) -> "Bench":
        nodes = [axis.node_id for axis in self.axis.values()]
        nodes += [node for node in (self.accelerometer.node_id, self.bus.master_node_id) if node is not None]
        twice = {node for node in nodes if nodes.count(node) > 1}
        if twice:
            raise ValueError(f"node id {min(twice)} is given twice on this bus")
        for number, axis in self.axis.items():
            if self.approach_rps > axis.limits.speed_rps:
                raise ValueError(f"approach_rps {self.approach_rps} is above axis {number}'s speed_rps {axis.limits.speed_rps}")
        if self.line_motion is not None:
            if self.geometry is None:
                raise ValueError(
                    "line_motion needs a geometry table: the lengths of the arm, and axes = [shoulder, elbow, wrist], by number"
                )
            self.geometry.check_axes(self.axis, "line_motion")
        return self


def load_bench(path: str | Path) -> Bench:
    """The bench of a file, or of the name `reference`; relative paths of profiles in it count from the file.

    Raises:
        FileError: The file is not valid; every problem is listed by line.
    """
    file = REFERENCE if str(path) == "reference" else Path(path)
    bench = load(file, Bench)
    folder = file.absolute().parent
    axes = {number: _with_profile_in(folder, table) for number, table in bench.axis.items()}
    return bench.model_copy(update={"axis": axes, "accelerometer": _with_profile_in(folder, bench.accelerometer)})


T = TypeVar("T", AxisTable, AccelerometerTable)


def _with_profile_in(folder: Path, table: T) -> T:
    """The table with the path of its profile made absolute; a name of the package stays a name."""
    if is_name(table.profile):
        return table
    return table.model_copy(update={"profile": str(folder / table.profile)})
