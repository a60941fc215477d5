"""The bench file: where the robot is, what its axes are believed to be, and what must never be exceeded."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from drive_profiles.address import AddressError, parse_address
from drive_profiles.files import Table, load
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, NOTCHES, Notch
from hil.control.trajectory import ConstantAcceleration, Line, PlanarChain, Smooth
from hil.design.frequency import Loop, TwoInertia
from hil.master.serial_table import SerialTable
from hil.realtime import Settings

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
NodeId = Annotated[int, Field(ge=1, le=127)]

CHAIN_AXES = (2, 3, 5)
"""The axes that move the arm in its vertical plane."""

REFERENCE = Path(__file__).parents[1] / "benches" / "reference.toml"


class RealTimeTable(Table):
    """What is asked of the operating system where time is the wall clock's; what it refuses is said in the result."""

    priority: Annotated[int, Field(ge=0, le=98)] = 80
    cpus: tuple[Annotated[int, Field(ge=0)], ...] = ()
    lock_memory: bool = True
    spin_s: Annotated[float, Field(ge=0.0, le=0.01)] = 0.0

    def settings(self) -> Settings:
        """As the context takes them."""
        return Settings(**self.model_dump(exclude={"spin_s"}))


class Bus(Table):
    """The bus and how it is watched."""

    address: str
    sync_period_s: Positive = 0.002
    host_sync_period_s: Positive = 250e-6
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
    """What an axis must never exceed, motor side; enforced by the master and written to the drive."""

    torque_nm: Positive
    speed_rps: Positive
    position_min_rev: float
    position_max_rev: float
    following_error_rev: Positive = 4.0
    following_error_timeout_s: Positive = 0.05
    quick_stop_rps_s: Positive = 50.0

    @model_validator(mode="after")
    def _range(self) -> "Limits":
        if self.position_min_rev >= self.position_max_rev:
            raise ValueError(f"position_min_rev {self.position_min_rev} is not below position_max_rev {self.position_max_rev}")
        return self


class Control(Table):
    """Gains of the P-PI cascade."""

    position_gain_per_s: NotNegative
    velocity_gain_nm_s_rad: NotNegative
    velocity_integral_gain_nm_rad: NotNegative
    lowpass_hz: Positive = 300.0

    def cascade(self) -> Cascade:
        """The gains as the law takes them."""
        return Cascade(**self.model_dump())


class NotchTable(Table):
    """One variable notch: Table 3 of the paper."""

    shape: Literal["switched", "trapezoid"] = "switched"
    order: Annotated[int, Field(ge=1, le=8)] = 2
    start_rps: Positive
    end_rps: Positive
    offset_hz: NotNegative
    zeta_rn: Positive
    zeta_rdth: Positive
    hysteresis_rps: NotNegative = 0.15
    speed_lowpass_hz: Positive = 50.0
    ramp_rps: Positive = 1.0

    @model_validator(mode="after")
    def _range(self) -> "NotchTable":
        if self.start_rps >= self.end_rps:
            raise ValueError(f"start_rps {self.start_rps} is not below end_rps {self.end_rps}")
        self.notch()
        return self

    def notch(self) -> Notch:
        """The filter as the law takes it."""
        mode = NOTCH_SWITCHED if self.shape == "switched" else NOTCH_TRAPEZOID
        return Notch(mode=mode, **self.model_dump(exclude={"shape"}))


class TransmissionError(Table):
    """What the transmission error is believed to be; eq. (2)."""

    a2_arcsec: NotNegative
    phi2_deg: float
    a4_arcsec: NotNegative = 0.0
    phi4_deg: float = 0.0


class Model(Table):
    """The plant as it is believed to be, for design and report; nothing in a run depends on it but the host-closed check."""

    motor_inertia_kg_m2: Positive
    motor_damping_nm_s_rad: NotNegative
    arm_inertia_kg_m2: Positive
    arm_damping_nm_s_rad: NotNegative
    gear_stiffness_nm_rad: Positive
    gear_damping_nm_s_rad: NotNegative
    ate: TransmissionError


class Axis(Table):
    """One axis of the robot and the drive that moves it."""

    node_id: NodeId
    profile: str = "emulated_drive"
    serial_number: Annotated[int, Field(ge=0)] | None = None
    reduction_ratio: Positive
    tip_lever_m: Positive
    limits: Limits
    control: Control
    notch: Annotated[tuple[NotchTable, ...], Field(max_length=NOTCHES)] = ()
    model: Model | None = None

    def plant(self) -> TwoInertia | None:
        """The linear plant of the model, or None without one."""
        if self.model is None:
            return None
        return TwoInertia(reduction_ratio=self.reduction_ratio, **self.model.model_dump(exclude={"ate"}))

    def loop(self, period_s: float, delay_samples: int = 0, *, with_notch: bool = True) -> Loop | None:
        """The loop around the model, or None without one."""
        plant = self.plant()
        if plant is None:
            return None
        notches = tuple(table.notch() for table in self.notch) if with_notch else ()
        return Loop(plant, self.control.cascade(), notches, period_s, delay_samples)


class Accelerometer(Table):
    """The sensor at the tip: a node of the bus, or a device on a serial port.

    Attributes:
        node_id: Of the node; None for a sensor on a serial port.
        profile: Of the node; a sensor on a serial port has none.
        serial: The serial port and what comes from it; None for a node.
        range_m_s2: What the sensor can measure; a run in which it reaches that is not judged. None where nobody knows.
    """

    node_id: NodeId | None = None
    profile: str = "emulated_accelerometer"
    serial: SerialTable | None = None
    range_m_s2: Positive | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> "Accelerometer":
        if (self.node_id is None) == (self.serial is None):
            raise ValueError("the accelerometer has either a node_id on the bus or a serial table")
        return self


class Geometry(Table):
    """The planar chain of axes 2, 3 and 5."""

    shoulder_offset_m: float
    shoulder_height_m: float
    upper_arm_m: Positive
    forearm_m: tuple[Positive, float]
    tool_m: Positive

    def chain(self) -> PlanarChain:
        """The arm as the trajectory takes it."""
        return PlanarChain(**self.model_dump())


class Point(Table):
    """A tip position in the vertical plane, in m."""

    x: float
    z: float


class LineMotion(Table):
    """The line motion; its start is where all motor angles are zero."""

    start_m: Point
    end_m: Point
    duration_s: Positive
    ramp_s: Positive = 0.3
    dwell_s: NotNegative = 0.2
    tail_s: NotNegative = 0.6

    @model_validator(mode="after")
    def _ramps_fit(self) -> "LineMotion":
        Smooth(self.duration_s, self.ramp_s)
        return self

    def line(self, chain: PlanarChain) -> Line:
        """The trajectory of the joints."""
        start, end = (self.start_m.x, self.start_m.z), (self.end_m.x, self.end_m.z)
        return Line(chain, start, end, Smooth(self.duration_s, self.ramp_s), self.dwell_s, self.tail_s)


class ConstantAccelerationMotion(Table):
    """The single-axis motion through the resonant speeds."""

    acceleration_rps_s: Positive
    end_rps: Positive
    deceleration_rps_s: Positive = 20.0
    dwell_s: NotNegative = 0.2
    tail_s: NotNegative = 0.5

    def trajectory(self) -> ConstantAcceleration:
        """The trajectory of the motor."""
        return ConstantAcceleration(**self.model_dump())


class Specification(Table):
    """What the tip is to keep, and the speeds at which it is judged."""

    tip_mm: Positive = 0.05
    line_area_reduction_pct: float = 26.0


class Bench(Table):
    """A robot on a bus, as its engineer describes it."""

    name: str
    bus: Bus
    axis: Annotated[dict[Annotated[int, Field(ge=1, le=6)], Axis], Field(min_length=1)]
    accelerometer: Accelerometer
    geometry: Geometry | None = None
    line_motion: LineMotion | None = None
    constant_acceleration: ConstantAccelerationMotion | None = None
    specification: Specification = Specification()
    settle_s: Annotated[float, Field(ge=0.05, le=60.0)] = 0.5
    approach_rps: Positive = 8.0

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
                raise ValueError("line_motion needs a geometry table")
            if not set(CHAIN_AXES) <= set(self.axis):
                raise ValueError(f"line_motion needs axes {', '.join(map(str, CHAIN_AXES))}")
        return self


def load_bench(path: str | Path) -> Bench:
    """The bench of a file, or of the name `reference`.

    Raises:
        FileError: With every problem, by line.
    """
    return load(REFERENCE if str(path) == "reference" else Path(path), Bench)
