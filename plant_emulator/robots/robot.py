"""The robot file of the emulated robot; its keys name their units."""

import cmath
import math
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drive_profiles.errors import FileError, Problem
from drive_profiles.files.reading import read_file
from drive_profiles.files.toml import MAX_BYTES, Table, load
from hil.arm.masses import check_masses, levers, mass_matrix
from hil.arm.mounting import Mounting
from hil.arm.tables import ArmTable
from hil.control.angles import ARCSEC
from hil.control.order_keys import amplitude_key, phase_key
from hil.control.trajectory import PlanarChain
from hil.robot_tables import (
    ORDERS,
    AxisNumber,
    ConstantAccelerationMotion,
    Control,
    Geometry,
    LineMotion,
    NotchShape,
    NotNegative,
    PlantTable,
    Positive,
    TransmissionErrorTable,
)
from plant_emulator.physics.axis import MORE_LINES, PLANT
from plant_emulator.physics.sensing import HIGHEST_FREQUENCY
from plant_emulator.robots.angle_lines import CoggingLine, EccentricityLine, check_lines, write_lines
from plant_emulator.robots.behaviour import Behaviour, Switches
from plant_emulator.robots.encoders import LoadEncoder, MotorEncoder
from plant_emulator.robots.gear_change import MOST_LINES, ErrorChange, GearTemperature, check_changes

SDO_DOWNLOAD_BYTES = 64 * 1024
"""The longest value that an SDO channel accepts by default; it bounds the memory that a client can occupy."""

DownloadBytes = Annotated[int, Field(ge=8, le=16 * 1024 * 1024)]


class RobotAxis(PlantTable):
    """One axis: motor, gear, arm, encoder.

    Keys that the reference robot does not have are options, off unless given.

    Attributes:
        profile: The drive that moves it: a profile of the package by its name, with /PRODUCT behind it or not, or a path.
        eds: Path of the drive's EDS file; its objects that the profile does not state are there, but do nothing.
        store_time_s: Time for which the drive is silent on SDO while it stores.
        torque_constant_nm_a: Assumed motor constant, for drives whose gains are in amperes, and for 6075h.
        sdo_download_bytes: The longest value that an SDO channel of the node takes.
        switches: Limit and home switches and what the touch probes see; left out, there are none.
        behaviour: Differences from a drive that does all at once.
        eccentricity: Orders of the joint in the transmission error, beside those of the motor.
        cogging: Torque of the motor's own magnets, in the motor's angle.
        encoder: Errors of the encoder on the motor; left out, it only rounds.
        load_encoder: A second encoder, on the joint; None: the drive has none.
        ate_change: Changes of the transmission error from the values of `ate`; left out, it is constant.
        temperature: Temperature of the gear, on which that may depend.
    """

    node_id: Annotated[int, Field(ge=1, le=127)] | None = None
    reduction_ratio: Positive
    coulomb_friction_nm: NotNegative = 0.0
    static_friction_nm: NotNegative = 0.0
    stribeck_velocity_rad_s: Positive = 1.0
    gravity_moment_nm: float = 0.0
    home_deg: float | None = None
    torque_limit_nm: Positive
    rated_torque_nm: Positive | None = None
    encoder_counts_per_rev: Annotated[int, Field(ge=4, le=2**24)]
    tip_lever_m: Positive
    ate: TransmissionErrorTable
    control: Control | None = None
    notch: NotchShape | None = None
    gear_reaction: bool = False
    wind_up_softness: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    wind_up_torsion_arcsec: Positive = 60.0
    hysteresis_torque_nm: NotNegative = 0.0
    hysteresis_torsion_arcsec: Positive = 20.0
    current_time_constant_s: NotNegative = 0.0
    profile: str = "emulated_drive"
    eds: str | None = None
    store_time_s: NotNegative = 0.4
    torque_constant_nm_a: Positive = 1.0
    sdo_download_bytes: DownloadBytes = SDO_DOWNLOAD_BYTES
    switches: Switches | None = None
    behaviour: Behaviour = Behaviour.model_construct()
    eccentricity: Annotated[tuple[EccentricityLine, ...], Field(max_length=MORE_LINES)] = ()
    cogging: Annotated[tuple[CoggingLine, ...], Field(max_length=MORE_LINES)] = ()
    encoder: MotorEncoder = MotorEncoder.model_construct()
    load_encoder: LoadEncoder | None = None
    ate_change: Annotated[tuple[ErrorChange, ...], Field(max_length=MOST_LINES)] = ()
    temperature: GearTemperature = GearTemperature.model_construct()

    @model_validator(mode="after")
    def _changes_are_of_its_error(self) -> "RobotAxis":
        check_changes(self.ate_change, self.ate, self.torque_limit_nm * self.reduction_ratio)
        check_lines(self.eccentricity, self.cogging, self.torque_limit_nm)
        return self

    @property
    def apparent_ate(self) -> TransmissionErrorTable:
        """Transmission error that a master finds: its own, and that of the encoder which the motor follows.

        A_k e^{jφ_k} − (E_k/N) e^{jφ_E,k}: behind a gear of ratio N nothing tells the two apart.
        """
        amplitudes, phases = self.ate.amplitudes_arcsec(), self.ate.phases_deg()
        for order, error in self.encoder.errors_arcsec().items():
            found = cmath.rect(amplitudes.get(order, 0.0), math.radians(phases.get(order, 0.0))) - error / self.reduction_ratio
            amplitudes[order], phases[order] = abs(found), math.degrees(cmath.phase(found)) % 360.0
        return TransmissionErrorTable.of(amplitudes, phases) if self.encoder.errors_arcsec() else self.ate

    @property
    def rated_torque(self) -> float:
        """Rated torque in N·m (whole mN·m), by default a third of peak."""
        wanted = self.torque_limit_nm / 3.0 if self.rated_torque_nm is None else self.rated_torque_nm
        return max(1, round(1000.0 * wanted)) / 1000.0

    @property
    def rated_torque_mnm(self) -> int:
        """Rated motor torque in mN·m, as in 6076h."""
        return round(1000.0 * self.rated_torque)

    @property
    def rated_current_ma(self) -> int:
        """Rated motor current in mA (6075h): rated torque over motor constant."""
        return min(2**32 - 1, max(1, round(1000.0 * self.rated_torque / self.torque_constant_nm_a)))

    @property
    def peak_per_mille(self) -> int:
        """Peak torque in per mille of the rated torque, as 6072h."""
        return min(65535, math.floor(1e6 * self.torque_limit_nm / self.rated_torque_mnm))

    def write(self, row: NDArray[Any], home_rad: float) -> None:
        """Put the axis into one record of a `PLANT` array."""
        direct = {name for name in PLANT.names or () if name in type(self).model_fields}
        for name in direct:
            row[name] = getattr(self, name)
        row["home_angle_rad"] = home_rad
        for order in ORDERS:
            row[f"a{order}_rad"] = getattr(self.ate, amplitude_key(order)) * ARCSEC
            row[f"phi{order}_rad"] = math.radians(getattr(self.ate, phase_key(order)))
        row["has_more_orders"] = float(bool(self.ate.more))
        row["more_orders"], row["more_rad"], row["more_phi_rad"] = 0.0, 0.0, 0.0
        for column, line in enumerate(self.ate.more):
            row["more_orders"][column], row["more_rad"][column] = line.order, line.a_arcsec * ARCSEC
            row["more_phi_rad"][column] = math.radians(line.phi_deg)
        write_lines(self.eccentricity, self.cogging, self.reduction_ratio, row)
        row["wind_up_torsion_rad"] = self.wind_up_torsion_arcsec * ARCSEC
        row["hysteresis_torsion_rad"] = self.hysteresis_torsion_arcsec * ARCSEC


class RobotAccelerometer(Table):
    """Sensor at the tip, and its node on the bus.

    `unconfigured` is as in `Behaviour`, `sdo_download_bytes` as in `RobotAxis`.

    Attributes:
        noise_m_s2: Standard deviation of the white noise of each sample.
        resolution_m_s2: Step of the output; 0 for none.
        range_m_s2: Acceleration at which it saturates.
        delay_s: Time by which the output is behind the tip's motion; any fraction of a control period.
        lowpass_hz: Corner of the sensor's low-pass of order 2 (Butterworth); None for none.
        mounting_resonance_hz: Resonance of the sensor on its mounting; None for a stiff one.
        mounting_damping: Damping ratio of the mounting.
        sensitivity_percent: Error of the sensitivity of each channel.
        cross_axis_percent: Fraction of each other channel that a channel reads too.
        tilt_deg: Angle by which it is turned about Y, of which the bench knows nothing: Z reads some of X.
        mounting: Where it sits on the arm, and how it is turned; None: an ideal one at the tip, along the axes of the base.
    """

    node_id: Annotated[int, Field(ge=1, le=127)] = 16
    unconfigured: bool = False
    sdo_download_bytes: DownloadBytes = SDO_DOWNLOAD_BYTES
    noise_m_s2: NotNegative = 0.02
    resolution_m_s2: NotNegative = 0.00981
    range_m_s2: Annotated[float, Field(gt=0.0, le=32.0)] = 19.62
    delay_s: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    lowpass_hz: Annotated[float, Field(ge=1.0, le=2000.0)] | None = None
    mounting_resonance_hz: Annotated[float, Field(ge=5.0, le=2000.0)] | None = None
    mounting_damping: Annotated[float, Field(gt=0.0, le=2.0)] = 0.05
    sensitivity_percent: Annotated[float, Field(gt=-100.0, lt=100.0)] = 0.0
    cross_axis_percent: Annotated[float, Field(gt=-100.0, lt=100.0)] = 0.0
    tilt_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0
    mounting: Mounting | None = None

    @property
    def mixing(self) -> NDArray[np.float64]:
        """What each channel reads of the true X, Y and Z; shape (3, 3)."""
        sensitivity, cross = 1.0 + 0.01 * self.sensitivity_percent, 0.01 * self.cross_axis_percent
        cos, sin = math.cos(math.radians(self.tilt_deg)), math.sin(math.radians(self.tilt_deg))
        turned = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        return np.asarray((np.full((3, 3), cross) + (sensitivity - cross) * np.eye(3)) @ turned)

    @property
    def filters(self) -> bool:
        """True if the sensor filters or delays (noise and steps aside)."""
        return bool(self.delay_s) or self.lowpass_hz is not None or self.mounting_resonance_hz is not None


class BusFacts(Table):
    """The bus on which the robot is found.

    Attributes:
        bitrate: Bit rate in bit/s, which its blank bench file names; None: the bus is ideal unless its address has a bit rate.
    """

    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] | None = None


class Robot(Table):
    """A robot.

    It has axes by number, geometry, accelerometer, bus, and the seed of all random numbers.
    """

    name: str = "robot"
    seed: Annotated[int, Field(ge=0)] = 1
    control_period_s: Annotated[float, Field(ge=10e-6, le=0.01)] = 250e-6
    plant_substeps: Annotated[int, Field(ge=2, le=64)] = 4
    sync_period_s: Positive = 0.002
    axis: Annotated[dict[AxisNumber, RobotAxis], Field(min_length=1)]
    accelerometer: RobotAccelerometer = RobotAccelerometer.model_construct()
    bus: BusFacts = BusFacts.model_construct()
    geometry: Geometry | None = None
    line_motion: LineMotion | None = None
    constant_acceleration: ConstantAccelerationMotion | None = None

    @model_validator(mode="after")
    def _nodes_differ(self) -> "Robot":
        holders: dict[int, list[str]] = {}
        for number, node in self.node_ids.items():
            holders.setdefault(node, []).append(f"axis {number}")
        holders.setdefault(self.accelerometer.node_id, []).append("the accelerometer")
        twice = [node for node in sorted(holders) if len(holders[node]) > 1]
        if twice:
            given = " and ".join(holders[twice[0]][:2])
            raise ValueError(f"node-ID {twice[0]} is given to two nodes of the bus, {given}; change the node_id of one")
        if self.geometry is not None:
            self.geometry.check_axes(self.axis, "a geometry")
        if self.accelerometer.mounting is not None and "arm" not in type(self).model_fields:
            raise ValueError("accelerometer: mounting names a link, but the robot has no [arm]")
        for name in ("lowpass_hz", "mounting_resonance_hz"):
            frequency = getattr(self.accelerometer, name)
            if frequency is not None and frequency * self.control_period_s > HIGHEST_FREQUENCY:
                raise ValueError(
                    f"accelerometer: {name} {frequency:g} is above {HIGHEST_FREQUENCY / self.control_period_s:g} Hz, the most "
                    f"that a control_period_s of {self.control_period_s:g} shows; leave it out"
                )
        step_s = self.control_period_s / self.plant_substeps
        for number, axis in self.axis.items():
            lag_s = axis.current_time_constant_s
            if 0.0 < lag_s < 0.5 * step_s:  # Runge-Kutta of 4th order diverges from 0.36 steps down
                raise ValueError(
                    f"axis {number}: current_time_constant_s {lag_s:g} is less than half of the solver's step of {step_s:g} s; "
                    "use 0 for none, or a larger plant_substeps"
                )
        return self

    @property
    def links(self) -> ArmTable | None:
        """Arm whose links couple the axes, or None."""
        return None

    @property
    def chain_axes(self) -> tuple[int, ...]:
        """Axes of the line motion from the base on; none without geometry."""
        return () if self.geometry is None else self.geometry.axes

    @property
    def node_ids(self) -> dict[int, int]:
        """Node-ID of each axis: its number unless the file states another."""
        return {number: axis.node_id or number for number, axis in self.axis.items()}

    @property
    def unconfigured(self) -> frozenset[int]:
        """Node-IDs of the file that the nodes get only by LSS."""
        axes = {self.node_ids[number] for number, axis in self.axis.items() if axis.behaviour.unconfigured}
        return frozenset(axes | {self.accelerometer.node_id} if self.accelerometer.unconfigured else axes)

    def home_joints(self) -> NDArray[np.float64] | None:
        """Return the chain's joint angles at the line motion's start, rad.

        All motor angles are zero there. The result is None without a chain or a line motion.
        """
        if self.geometry is None or self.line_motion is None:
            return None
        start = self.line_motion.start_m
        return self.geometry.chain().joints(np.array([start.x, start.z]))

    def home_angle(self, number: int) -> float:
        """Return q₀ of one axis in rad.

        Gravity's moment is m g l cos(θ_l + q₀).

        Elbow and wrist lift their links: q₀ is the link's angle above the horizontal at home. The shoulder leans its link
        forwards from the vertical, and its weight pulls it on: q₀ is the lean at home plus 90°.
        """
        axis = self.axis[number]
        if axis.home_deg is not None:
            return math.radians(axis.home_deg)
        joints = self.home_joints()
        if joints is None or number not in self.chain_axes:
            return 0.0
        link = self.chain_axes.index(number)
        return float(joints[0] + 0.5 * math.pi) if link == 0 else float(PlanarChain.link_angles(joints)[link])


class ArmAxis(RobotAxis):
    """An axis of an arm; the links define its load.

    See `OF_THE_LINKS`.

    Attributes:
        joint: Name of its joint in the arm's URDF file.
        arm_inertia_kg_m2: Inertia that it turns at home while all other joints are held.
        tip_lever_m: Distance of the tip from its axis at home.
    """

    joint: str | None = None
    arm_inertia_kg_m2: Annotated[float, Field(gt=0.0, exclude=True)] = 1.0
    gravity_moment_nm: Annotated[float, Field(exclude=True)] = 0.0
    home_deg: Annotated[float | None, Field(exclude=True)] = None
    tip_lever_m: Annotated[float, Field(gt=0.0, exclude=True)] = 1.0


OF_THE_LINKS = ("arm_inertia_kg_m2", "gravity_moment_nm", "home_deg", "tip_lever_m")
"""Keys of an axis that a robot with links does not have: masses, places and home are those of its links."""


class ArmRobot(Robot):
    """A robot whose axes are coupled by an arm's links."""

    arm: ArmTable
    axis: Annotated[  # type: ignore[assignment]
        dict[AxisNumber, ArmAxis], Field(min_length=1)
    ]

    @model_validator(mode="after")
    def _links_carry(self) -> "ArmRobot":
        for number, axis in self.axis.items():
            given = [key for key in OF_THE_LINKS if key in axis.model_fields_set]
            if given:
                raise ValueError(f"axis {number}: the links of [arm] define {given[0]}; leave it out")
            if (axis.joint is None) == (self.arm.urdf is not None):
                needed = (
                    "needs joint, the name of its joint in the URDF file"
                    if axis.joint is None
                    else "joint needs a URDF file in [arm]; leave it out"
                )
                raise ValueError(f"axis {number}: {needed}")
        joints = [axis.joint for axis in self.axis.values() if axis.joint is not None]
        twice = [joint for joint in joints if joints.count(joint) > 1]
        if twice:
            raise ValueError(f"joint {twice[0]!r} is given to two axes; each axis needs a joint of its own")
        if self.geometry is not None:
            raise ValueError("the links of [arm] define the tip; leave out [geometry]")
        if self.arm.link:
            self._check_links(self.arm)
        return self

    def _check_links(self, arm: ArmTable) -> None:
        arm.check_axes(list(self.axis))
        check_masses(arm)
        if self.accelerometer.mounting is not None:
            self.accelerometer.mounting.check_arm(arm)

    @property
    def links(self) -> ArmTable:
        """The arm."""
        return self.arm

    def home_angle(self, number: int) -> float:
        """Return 0: gravity acts through the links."""
        return 0.0

    def with_links_read(self, folder: Path) -> "ArmRobot":
        """Return the robot with its URDF links, inertias and home levers.

        Raises:
            FileError: The URDF file describes no arm of these axes.
            ValueError: It describes one that cannot be moved, or that contradicts the robot file.
        """
        from hil.arm.urdf import with_links  # noqa: PLC0415 - for an arm only

        arm, reductions = with_links(self.arm, folder, {axis.joint or "": number for number, axis in self.axis.items()})
        for number, ratio in reductions.items():
            if not math.isclose(ratio, self.axis[number].reduction_ratio, rel_tol=1e-6):
                raise ValueError(
                    f"axis {number}: reduction_ratio is {self.axis[number].reduction_ratio:g}, but {ratio:g} in the URDF file"
                )
        self._check_links(arm)
        inertias, reach = np.diag(mass_matrix(arm, arm.home_rad())), levers(arm, arm.home_rad())
        found = {
            link.axis: self.axis[link.axis].model_copy(update={"arm_inertia_kg_m2": float(inertia), "tip_lever_m": float(lever)})
            for link, inertia, lever in zip(arm.link, inertias, reach, strict=True)
        }
        return self.model_copy(update={"arm": arm, "axis": {number: found[number] for number in self.axis}})


FOLDER = Path(__file__).parent
REFERENCE = FOLDER / "reference.toml"
SHIPPED = {"reference": REFERENCE, "reference-arm": FOLDER / "reference_arm.toml"}
"""Robots of the package, by name."""


AnyRobot = ArmRobot | Robot
"""Kinds of robot files, for their JSON Schema."""


def load_robot(path: str | Path) -> Robot:
    """Load the robot of a file, or of a name in `SHIPPED`.

    Paths of files that it names are relative to its folder.

    Raises:
        FileError: With every problem, by line.
    """
    file = SHIPPED.get(str(path), Path(path))
    robot = load(file, ArmRobot if _has_arm(file) else Robot)
    if isinstance(robot, ArmRobot):
        try:
            robot = robot.with_links_read(file.parent)
        except ValueError as error:
            raise FileError(file, (Problem(0, "arm", str(error), ""),)) from error
    found = {number: _in_folder(axis, file.parent) for number, axis in robot.axis.items()}
    return robot.model_copy(update={"axis": found})


def _has_arm(file: Path) -> bool:
    """Return True for a file with a table [arm]."""
    try:
        return "arm" in tomllib.loads(read_file(file, "a TOML file", max_bytes=MAX_BYTES).decode("utf-8-sig"))
    except (FileError, ValueError, RecursionError):
        return False


def _in_folder(axis: RobotAxis, folder: Path) -> RobotAxis:
    """Return the axis with paths relative to the working directory."""
    changes = {}
    if "profile" in axis.model_fields_set:
        from drive_profiles.family.profile import is_name  # noqa: PLC0415 - slow to load, and our own drive has none

        if not is_name(axis.profile):
            changes["profile"] = str(folder / axis.profile)
    if axis.eds is not None:
        changes["eds"] = str(folder / axis.eds)
    return axis.model_copy(update=changes) if changes else axis


def with_drives(
    robot: Robot,
    profiles: Mapping[int, str] = MappingProxyType({}),
    *,
    eds: Mapping[int, str] = MappingProxyType({}),
    store_time_s: float | None = None,
    load_encoder_bits: int | None = None,
) -> Robot:
    """Return a robot with other drives on some axes.

    Args:
        profiles: Profile by axis: a name of the package or a path.
        store_time_s: Time for which all drives are silent while they store; None: as in the file.
        load_encoder_bits: Bits of a second encoder on every joint; None: as in the file.

    Raises:
        ValueError: The robot has no such axis, or the time is negative.
    """
    for number in (*profiles, *eds):
        if number not in robot.axis:
            raise ValueError(f"the robot has no axis {number}; it has {', '.join(map(str, sorted(robot.axis)))}")
    if store_time_s is not None and not 0.0 <= store_time_s < math.inf:
        raise ValueError(f"store_time_s is {store_time_s} s; expected a finite time of at least 0")
    axes = {}
    for number, axis in robot.axis.items():
        changes: dict[str, Any] = {} if store_time_s is None else {"store_time_s": store_time_s}
        if load_encoder_bits is not None:
            changes["load_encoder"] = LoadEncoder(counts_per_rev=2**load_encoder_bits)
        if number in profiles:
            changes["profile"] = profiles[number]
        if number in eds:
            changes["eds"] = eds[number]
        axes[number] = axis.model_copy(update=changes)
    return robot.model_copy(update={"axis": axes})


def part_of(robot: Robot, axes: Collection[int]) -> Robot:
    """Return a robot with some axes alone.

    Without all axes of its geometry it has no line motion.

    Raises:
        ValueError: Its links couple the axes.
    """
    if robot.links is not None and set(axes) != robot.axis.keys():
        raise ValueError("the links of this robot couple all axes, so they cannot be served one by one; leave --axis out")
    changes: dict[str, object] = {"axis": {number: table for number, table in robot.axis.items() if number in axes}}
    if not set(robot.chain_axes) <= set(axes):
        changes |= {"geometry": None, "line_motion": None}
    return robot.model_copy(update=changes)
