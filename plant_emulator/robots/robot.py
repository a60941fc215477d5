"""The robot file: what the emulated robot is. Units are in the names of the keys; SI inside."""

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drive_profiles.family.profile import is_name
from drive_profiles.files.toml import Table, load
from hil.control.angles import ARCSEC
from hil.control.trajectory import PlanarChain
from hil.robot_tables import (
    ORDERS,
    ConstantAccelerationMotion,
    Control,
    Geometry,
    LineMotion,
    NotchShape,
    NotNegative,
    PlantTable,
    Positive,
    TransmissionErrorTable,
    amplitude_key,
    phase_key,
)
from plant_emulator.physics.axis import PLANT
from plant_emulator.physics.sensing import HIGHEST_FREQUENCY

MAX_AXES = 126
"""The most drives that one bus has node IDs for, beside the accelerometer (CiA 301, 7.2.8.2: 1 to 127)."""

SDO_DOWNLOAD_BYTES = 64 * 1024
"""The longest value that an SDO channel takes, unless the file says otherwise: what a client can make it keep in memory."""

DownloadBytes = Annotated[int, Field(ge=8, le=16 * 1024 * 1024)]


class Switches(Table):
    """Positions of an axis' switches: angles of the joint, which is the motor angle by the reduction ratio.

    What is not given is not there, and its input stays off. The index pulse comes once per motor revolution.

    Attributes:
        negative_limit_deg: Limit switch, active from here downwards.
        positive_limit_deg: Limit switch, active from here upwards.
        home_deg: Home switch, active between these two.
        index_deg: Angle of the motor at which its encoder gives the index pulse.
        probe_1_deg: Range of the joint within which touch probe 1 is active.
        probe_2_deg: The same of touch probe 2.
    """

    negative_limit_deg: float | None = None
    positive_limit_deg: float | None = None
    home_deg: tuple[float, float] | None = None
    index_deg: Annotated[float, Field(ge=0.0, lt=360.0)] = 0.0
    probe_1_deg: tuple[float, float] | None = None
    probe_2_deg: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> "Switches":
        ranges = {"home_deg": self.home_deg, "probe_1_deg": self.probe_1_deg, "probe_2_deg": self.probe_2_deg}
        if self.negative_limit_deg is not None and self.positive_limit_deg is not None:
            ranges["negative_limit_deg to positive_limit_deg"] = (self.negative_limit_deg, self.positive_limit_deg)
        for name, limits_deg in ranges.items():
            if limits_deg is not None and not limits_deg[0] < limits_deg[1]:
                raise ValueError(f"{name} goes from {limits_deg[0]:g} to {limits_deg[1]:g}: the first must be the lower")
        return self


class Behaviour(Table):
    """Differences of this drive from one that does all at once: what masters meet in real drives. All is off unless given.

    Attributes:
        tpdo_delay_us: Delay of the TPDOs after their cause (a SYNC, an event).
        tpdo_jitter_us: Up to so much is added to each of these delays, drawn from the robot's seed.
        sdo_delay_ms: Delay of an SDO answer.
        transition_delay_ms: Duration of a transition of the state machine.
        halt_blocks_mode_change: A new mode is not taken while the halt bit is set.
        quick_stop_ends_disabled_at_once: Quick stop leads to switch on disabled, also with 605Ah from 5 to 8.
        pp_handshake_cycles: SYNCs after which a set-point of profile position is acknowledged.
        needs_mode_to_enable: Without a mode of operation (6060h = 0) it does not enable, but reports emergency 6320h.
        operational_at_boot: The node goes to NMT state operational by itself.
        unconfigured: It has left the factory without a node-ID, and does nothing but LSS until a master gives it one (CiA 305).
        bus_off_restart_ms: Time from bus-off until its controller restarts by itself; left out, it stays off until the fault or
            its supply is over.
    """

    tpdo_delay_us: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    tpdo_jitter_us: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    sdo_delay_ms: Annotated[float, Field(ge=0.0, le=10e3)] = 0.0
    transition_delay_ms: Annotated[float, Field(ge=0.0, le=10e3)] = 0.0
    halt_blocks_mode_change: bool = False
    quick_stop_ends_disabled_at_once: bool = False
    pp_handshake_cycles: Annotated[int, Field(ge=0, le=1000)] = 0
    needs_mode_to_enable: bool = False
    operational_at_boot: bool = False
    unconfigured: bool = False
    bus_off_restart_ms: Annotated[float, Field(ge=0.0, le=60e3)] | None = None

    @property
    def delays_frames(self) -> bool:
        """True where any frame leaves the node later than its cause."""
        return bool(self.tpdo_delay_us or self.tpdo_jitter_us or self.sdo_delay_ms)

    @property
    def given(self) -> dict[str, float | bool]:
        """The keys that differ from their defaults."""
        return self.model_dump(exclude_defaults=True)


class RobotAxis(PlantTable):
    """One axis: motor, gearing, arm, encoder; the reference robot's keys, and options that are off unless given.

    Attributes:
        profile: The drive that moves it: a profile of the package by its name, with /PRODUCT behind it or not, or a path.
        eds: Path of the drive's EDS file; its objects that the profile does not state are there, but do nothing.
        store_time_s: Time for which the drive is silent on SDO while it stores.
        torque_constant_nm_a: Assumed motor constant, for drives whose gains are in amperes, and for 6075h.
        sdo_download_bytes: The longest value that an SDO channel of the node takes.
        switches: Limit and home switches and what the touch probes see; left out, there are none.
        behaviour: Differences from a drive that does all at once.
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
    behaviour: Behaviour = Behaviour()

    @property
    def rated_torque(self) -> float:
        """Rated motor torque in N·m; a third of the peak torque unless the file says otherwise, in whole mN·m."""
        wanted = self.torque_limit_nm / 3.0 if self.rated_torque_nm is None else self.rated_torque_nm
        return max(1, round(1000.0 * wanted)) / 1000.0

    @property
    def rated_torque_mnm(self) -> int:
        """Rated motor torque in mN·m, as 6076h states it."""
        return round(1000.0 * self.rated_torque)

    @property
    def rated_current_ma(self) -> int:
        """Rated motor current in mA, as 6075h states it: the rated torque by the motor constant."""
        return min(2**32 - 1, max(1, round(1000.0 * self.rated_torque / self.torque_constant_nm_a)))

    @property
    def peak_per_mille(self) -> int:
        """Peak torque in per mille of the rated torque, as 6072h states it."""
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
        row["is_more"] = float(bool(self.ate.more))
        row["more_orders"], row["more_rad"], row["more_phi_rad"] = 0.0, 0.0, 0.0
        for column, line in enumerate(self.ate.more):
            row["more_orders"][column], row["more_rad"][column] = line.order, line.a_arcsec * ARCSEC
            row["more_phi_rad"][column] = math.radians(line.phi_deg)
        row["wind_up_torsion_rad"] = self.wind_up_torsion_arcsec * ARCSEC
        row["hysteresis_torsion_rad"] = self.hysteresis_torsion_arcsec * ARCSEC


class RobotAccelerometer(Table):
    """The sensor at the tip and its node on the bus; `unconfigured` as in `Behaviour`, `sdo_download_bytes` as in `RobotAxis`.

    Attributes:
        noise_m_s2: Standard deviation of the white noise of each sample.
        resolution_m_s2: Step of the output; 0 for none.
        range_m_s2: Acceleration at which it saturates.
        delay_s: Time by which the output is behind the tip's motion; any fraction of a control period.
        lowpass_hz: Corner of the sensor's low-pass of order 2 (Butterworth); None for none.
        mounting_resonance_hz: Resonance of the sensor on its mounting; None for a stiff one.
        mounting_damping: Damping ratio of the mounting.
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

    @property
    def filters(self) -> bool:
        """True where the output is anything else than the tip's acceleration at the instant, noise and steps apart."""
        return bool(self.delay_s) or self.lowpass_hz is not None or self.mounting_resonance_hz is not None


class BusFacts(Table):
    """The bus on which the robot is found.

    Attributes:
        bitrate: Bit rate in bit/s, which its blank bench file names; None: the bus is ideal unless its address says otherwise.
    """

    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] | None = None


class Robot(Table):
    """A robot: axes by number, geometry, accelerometer, bus, and the seed of everything random."""

    name: str = "robot"
    seed: Annotated[int, Field(ge=0)] = 1
    control_period_s: Annotated[float, Field(ge=10e-6, le=0.01)] = 250e-6
    plant_substeps: Annotated[int, Field(ge=2, le=64)] = 4
    sync_period_s: Positive = 0.002
    axis: Annotated[dict[Annotated[int, Field(ge=1, le=MAX_AXES)], RobotAxis], Field(min_length=1)]
    accelerometer: RobotAccelerometer = RobotAccelerometer()
    bus: BusFacts = BusFacts()
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
            raise ValueError(f"node id {twice[0]} is given to two nodes of the bus, {given}: node_id changes it")
        if self.geometry is not None:
            self.geometry.check_axes(self.axis, "a geometry")
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
                    "0 is none, and plant_substeps makes the steps shorter"
                )
        return self

    @property
    def chain_axes(self) -> tuple[int, ...]:
        """Axes of the line motion: those of the geometry, from the base on; none without one."""
        return () if self.geometry is None else self.geometry.axes

    @property
    def node_ids(self) -> dict[int, int]:
        """Node id of each axis: the axis' number unless the file says otherwise."""
        return {number: axis.node_id or number for number, axis in self.axis.items()}

    @property
    def unconfigured(self) -> frozenset[int]:
        """Node IDs of the file that the nodes do not have, but wait for by LSS."""
        axes = {self.node_ids[number] for number, axis in self.axis.items() if axis.behaviour.unconfigured}
        return frozenset(axes | {self.accelerometer.node_id} if self.accelerometer.unconfigured else axes)

    def home_joints(self) -> NDArray[np.float64] | None:
        """Joint angles of the chain in rad where all motor angles are zero, at the start of the line motion; None without one."""
        if self.geometry is None or self.line_motion is None:
            return None
        start = self.line_motion.start_m
        return self.geometry.chain().joints(np.array([start.x, start.z]))

    def home_angle(self, number: int) -> float:
        """q₀ of one axis in rad, so that gravity's moment is m g l cos(θ_l + q₀).

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


REFERENCE = Path(__file__).parent / "reference.toml"


def load_robot(path: str | Path) -> Robot:
    """The robot of a file, or of the name `reference`; files that it names count from its folder.

    Raises:
        FileError: With every problem, by line.
    """
    file = REFERENCE if str(path) == "reference" else Path(path)
    robot = load(file, Robot)
    found = {number: _in_folder(axis, file.parent) for number, axis in robot.axis.items()}
    return robot.model_copy(update={"axis": found})


def _in_folder(axis: RobotAxis, folder: Path) -> RobotAxis:
    """The axis with the paths of its profile and EDS file as seen from here; a bare name is a profile of the package."""
    changes = {}
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
) -> Robot:
    """A robot some of whose axes have other drives.

    Args:
        robot: The robot of the file.
        profiles: Profile by axis: a name of the package or a path.
        eds: Path of the drive's EDS file, by axis.
        store_time_s: Time for which all drives are silent while they store; None: as the file says.

    Raises:
        ValueError: The robot has no such axis, or the time is negative.
    """
    for number in (*profiles, *eds):
        if number not in robot.axis:
            raise ValueError(f"the robot has no axis {number}; it has {', '.join(map(str, sorted(robot.axis)))}")
    if store_time_s is not None and not 0.0 <= store_time_s < math.inf:
        raise ValueError(f"storing cannot take {store_time_s} s")
    axes = {}
    for number, axis in robot.axis.items():
        changes: dict[str, Any] = {} if store_time_s is None else {"store_time_s": store_time_s}
        if number in profiles:
            changes["profile"] = profiles[number]
        if number in eds:
            changes["eds"] = eds[number]
        axes[number] = axis.model_copy(update=changes)
    return robot.model_copy(update={"axis": axes})
