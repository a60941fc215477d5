"""A CiA 402 drive: its identity, units, and changed objects."""

import contextlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drive_profiles.errors import OutOfRangeError, UnknownProductError
from drive_profiles.family.parameter import Parameter
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Object, State, state_of
from drive_profiles.standard.emulation import HARDWARE_VERSION_OBJECT, is_emulated
from drive_profiles.standard.error_codes import code_text
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling, interpolation_period
from hil.bench.bench import AxisTable
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from hil.control.treatments import LoopName
from hil.errors import (
    AlreadyMovingError,
    HilError,
    NoAnswerError,
    NodeError,
    NotPossibleError,
    SdoAbortedError,
    WrongIdentityError,
)
from hil.master.control_words import DISABLED
from hil.master.drive.limits import LIMITS, Limit, value_in
from hil.master.drive.mapping import CyclicMode
from hil.master.drive.needs import (
    ABSENT,
    CYCLE_PERIOD,
    ERROR_CODE,
    STATUS,
    VELOCITY,
    MissingObjectsError,
    Need,
    ProfileGapsError,
    objects_needed,
    profile_gaps,
    scale_gaps,
)
from hil.master.drive.scale import Questions, check_load_encoder, read_scaling
from hil.master.whereabouts import rev_text
from hil.robot_tables import Control

if TYPE_CHECKING:
    from hil.master.network import Network

U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
I8, I32 = DataType.INTEGER8, DataType.INTEGER32

OUT_OF_RANGE = frozenset({0x06090030, 0x06090031, 0x06090032})
"""Abort codes of a value that an object does not take (CiA 301, 7.2.4.3.17)."""
STANDSTILL_RPS = 0.05
"""Below this speed an axis counts as standing."""


@dataclass
class Snapshot:
    """Former contents of changed objects, to be restored."""

    network: "Network"
    node: int
    _before: dict[ObjectAddress, bytes] = field(default_factory=dict)
    _seen: dict[ObjectAddress, bytes] = field(default_factory=dict)

    def look(self, needs: Iterable[Need]) -> tuple[Need, ...]:
        """Read objects before any is written; return those that are not there.

        Raises:
            NoAnswerError: The node is silent.
        """
        missing = []
        for need in needs:
            try:
                self._seen[need.address] = self.network.read_raw(self.node, *need.address, need.name)
            except SdoAbortedError as error:
                if error.code in ABSENT:
                    missing.append(need)
        return tuple(missing)

    def write(self, index: int, subindex: int, kind: DataType, value: Any, name: str = "") -> None:
        """Write an object and read it back, keeping its former content."""
        if (index, subindex) not in self._before:
            seen = self._seen.pop((index, subindex), None)
            self._before[index, subindex] = self.network.read_raw(self.node, index, subindex, name) if seen is None else seen
        self.network.write(self.node, index, subindex, kind, value, name)

    def has(self, index: int, subindex: int) -> bool:
        """True if an object has been changed."""
        return (index, subindex) in self._before

    def restore(self) -> list[str]:
        """Put everything back, the last change first; return the refusals in words."""
        refused = []
        self._seen.clear()
        while self._before:
            (index, subindex), data = self._before.popitem()
            try:
                self.network.write_raw(self.node, index, subindex, data)
            except HilError as error:
                refused.append(str(error))
        return refused


def ask_emulated(network: "Network", node: int) -> bool | None:
    """Ask a node by its hardware version (1009h) whether it is emulated."""
    try:
        return is_emulated(network.read_raw(node, *HARDWARE_VERSION_OBJECT, "manufacturer hardware version"))
    except SdoAbortedError:
        return False  # optional, and no emulated node lacks it
    except NoAnswerError:
        return None


def check_identity(network: "Network", node: int, profile: Profile, serial_number: int | None = None) -> Profile:
    """Check the identity of a node; return the profile of its product.

    Args:
        serial_number: Serial number in the bench file; None if any is accepted.

    Raises:
        NoAnswerError: The node is silent.
        WrongIdentityError: The node is another device than the profile (and the bench file's serial number) says.
    """
    _check_number(network, node, "vendor id (1018h:01h)", (0x1018, 1), profile.identity.vendor_id)
    profile = _product_at(network, node, profile)
    identity = profile.identity
    for what, address, expected in (
        ("device type (1000h)", (0x1000, 0), identity.device_type),
        ("product code (1018h:02h)", (0x1018, 2), identity.product_code),
        ("serial number (1018h:04h)", (0x1018, 4), serial_number),
    ):
        if expected is not None:  # else the profile does not know it, or any is accepted
            _check_number(network, node, what, address, expected)
    return profile


def _check_number(network: "Network", node: int, what: str, address: ObjectAddress, expected: int) -> None:
    value = network.read(node, *address, U32, what.partition(" (")[0])
    if value != expected:
        raise WrongIdentityError(node, what, expected, value)


def _product_at(network: "Network", node: int, profile: Profile) -> Profile:
    """Return the profile of the node's product."""
    if not profile.products and not profile.identity.has_range:
        return profile
    code, revision = (network.read(node, 0x1018, sub, U32, f"1018h:{sub:02X}h") for sub in (2, 3))
    try:
        return profile.product(code, revision)
    except UnknownProductError as error:
        raise NodeError(node, str(error), "is this the right bench file?") from error


class DriveAxis:
    """One axis: table of the bench file, profile, and node.

    Attributes:
        profile: Drive profile of the family that the bench file names; once identified, of the drive's product.
        notches: Filters that act in the drive, as it holds them; none before `write_notches`.
        snapshot: Former contents of the objects that were changed.
    """

    def __init__(self, network: "Network", number: int, table: AxisTable) -> None:
        self.network, self.number, self.table = network, number, table
        self.node = table.node_id
        self.profile = Profile.load(table.profile)
        if self.profile.kind != "drive":
            raise NotPossibleError(f"axis {number}: profile {table.profile} is not a drive")
        self.snapshot = Snapshot(network, self.node)
        self.scaling = Scaling(1, 1.0)
        self.notches: tuple[Notch, ...] = ()

    def scale_gaps(self) -> list[str]:
        """Return all gaps of the profile if the drive's units are unknown.

        A sentence each; empty if profile or bench file has the units. Until the drive is identified, it may be any
        product of its family.
        """
        is_lacking = all(scale_gaps(self.number, self.table, product) for product in self.profile.members)
        return profile_gaps(self.number, self.table, self.profile) if is_lacking else []

    def identify(self, *, may_be_in_fault: bool = False) -> None:
        """Check the drive's identity, units, disabled state and standstill.

        Args:
            may_be_in_fault: Accept a drive in fault; `fault` has the fault.

        Raises:
            ProfileGapsError: Neither profile nor bench file knows how it counts.
            MissingObjectsError: It lacks objects that every run needs; all of them are listed.
            NodeError: Another check failed; nothing has been written.
        """
        self._check_scale()
        self.profile = check_identity(self.network, self.node, self.profile, self.table.serial_number)
        self._check_scale()
        asked, node = Questions(self.network, self.node), self.node
        state = self._disabled_state(asked)
        scaling = read_scaling(asked, self.number, self.table, self.profile)
        check_load_encoder(asked, self.number, self.table, self.profile)
        velocity = asked.number(VELOCITY, I32)
        if scaling is None or velocity is None or asked.missing:
            more = self.snapshot.look(objects_needed(self.table, self.profile))
            missing = tuple({need.address: need for need in (*asked.missing, *more)}.values())
            raise MissingObjectsError([(self.number, node, missing)])
        self.scaling = scaling
        speed = self.scaling.speed_rad_s(velocity)
        if abs(speed) > 2.0 * math.pi * STANDSTILL_RPS:
            raise AlreadyMovingError(node, f"axis {self.number} turns at {speed / 2 / math.pi:.2f} rev/s", "stop it first")
        if state is State.FAULT and not may_be_in_fault:
            fault, here = self.fault() or "in fault", rev_text(self.position_rad() / math.tau)
            remedy = f"reset it with --reset-faults, or drive-profiles faults --node {node} --clear"
            raise NodeError(node, f"axis {self.number} is {fault}, and at {here} rev", remedy)

    def fault(self) -> str | None:
        """Return the drive's fault in words, or None."""
        asked = Questions(self.network, self.node)
        status_word = asked.number(STATUS)
        if status_word is None or state_of(status_word) is not State.FAULT:
            return None
        code = asked.number(ERROR_CODE, is_optional=True)
        return "in fault" if code is None else f"in fault, error code {code_text(code, self.profile.fault_texts)}"

    def identify_bystander(self) -> None:
        """Check identity and disabled state of a drive that will not move.

        Units and limits are checked if the profile knows them and the drive has the objects.

        Raises:
            NodeError: A check failed; nothing has been written.
        """
        if not self.scale_gaps():
            with contextlib.suppress(MissingObjectsError):
                self.identify()
                return
        self.profile = check_identity(self.network, self.node, self.profile, self.table.serial_number)
        self._disabled_state(Questions(self.network, self.node))

    def _disabled_state(self, asked: Questions) -> State | None:
        """Check that the drive has no torque; return its state."""
        status_word = asked.number(STATUS)
        state = None if status_word is None else state_of(status_word)
        if status_word is not None and state not in DISABLED:
            shown = "an unknown state" if state is None else f"state {state.value!r}"
            raise AlreadyMovingError(self.node, f"axis {self.number} is already in {shown}", "disable it first")
        return state

    def _check_scale(self) -> None:
        if gaps := self.scale_gaps():
            raise ProfileGapsError(gaps)

    def position_rad(self) -> float:
        """The motor angle now, by SDO."""
        counts: int = self.network.read(self.node, Object.POSITION_ACTUAL, 0, I32, "position actual value")
        return self.scaling.position_rad(counts)

    def check_standing(self, begun_rad: float, elapsed_s: float) -> None:
        """Check that the motor has not turned, by its position.

        The drive's speed (606Ch) is not used: some families have an unknown unit for it.

        Args:
            begun_rad: Motor angle some time ago.
            elapsed_s: The time since then; the answer to the question takes some more.

        Raises:
            AlreadyMovingError: The motor turns.
        """
        speed_rps = (self.position_rad() - begun_rad) / math.tau / elapsed_s
        if abs(speed_rps) > STANDSTILL_RPS:
            raise AlreadyMovingError(self.node, f"axis {self.number} turns at {speed_rps:.2f} rev/s", "stop it first")

    # -- parameters ----------------------------------------------------------------------------------------------------

    def write_parameter(self, name: str, value: float) -> float:
        """Write a parameter of the profile in its unit; read it back.

        Returns:
            The value that the drive holds, rounded to a step of its object.

        Raises:
            DriveProfileError: The profile does not have the parameter, or the object cannot hold the value.
        """
        parameter: Parameter = self.profile.parameter(name)
        try:
            raw = parameter.raw(value, self.scaling)
        except OutOfRangeError as error:
            raise NotPossibleError(f"axis {self.number}: {name} = {value:g} does not fit its object: {error}") from error
        self.snapshot.write(parameter.index, parameter.subindex, DataType[parameter.data_type], raw, name)
        return parameter.value(raw, self.scaling)

    def control_period_s(self) -> float:
        """Read the drive's control period in s."""
        parameter = self.profile.parameters.get("control_period_s")
        if parameter is None:
            loop = self.profile.loop
            return 0.0 if loop is None or loop.period_s is None else loop.period_s
        kind = DataType[parameter.data_type]
        raw: int = self.network.read(self.node, parameter.index, parameter.subindex, kind, "control period")
        return float(parameter.value(raw, self.scaling))

    def write_limits(self) -> None:
        """Write the bench file's limits, so that the drive enforces them."""
        for limit in LIMITS:
            value_si = limit.si(self.table.limits)
            if value_si is not None:
                self.write_limit(limit, value_si)

    def write_limit(self, limit: Limit, value_si: float) -> None:
        """Write one limit, if the drive has a parameter for it."""
        name = limit.held_by(self.profile)
        if name is not None:
            try:
                self.write_parameter(name, value_in(self.profile.parameters[name], value_si, self.scaling))
            except NotPossibleError as error:
                raise NotPossibleError(f"{error}: choose a limits.{limit.key} that the drive can hold") from error

    def write_gains(self, loop: LoopName) -> None:
        """Write the P-PI gains, unless the drive keeps its own."""
        if not self.table.writes_gains or not isinstance(self.table.control, Control):
            return
        for name, value in self.table.control.model_dump().items():
            if loop != "host" or name in self.profile.parameters:
                self.write_parameter(name, value)

    def write_notches(self, notches: tuple[Notch, ...]) -> None:
        """Upload the filters, and switch all others off."""
        held: list[Notch] = []
        for column in range(NOTCHES):
            name = f"notch_{column + 1}"
            if f"{name}.mode" not in self.profile.parameters:
                if column < len(notches):
                    raise NotPossibleError(f"axis {self.number}: drive family {self.profile.label} has no {name}")
                continue
            self.write_parameter(f"{name}.mode", NOTCH_OFF)
            if column < len(notches):
                values = vars(notches[column])
                keys = [*(key for key in values if key != "mode"), "mode"]
                read_back = {key: self.write_parameter(f"{name}.{key}", values[key]) for key in keys}
                held.append(Notch(**{key: type(values[key])(value) for key, value in read_back.items()}))
        self.notches = tuple(held)

    def restore(self) -> list[str]:
        """Restore all objects, filters last; return the refusals in words."""
        refused = []
        self.notches = ()
        for column in range(NOTCHES):
            mode = self.profile.parameters.get(f"notch_{column + 1}.mode")
            if mode is not None and self.snapshot.has(mode.index, mode.subindex):
                try:  # between two ranges a filter may be none at all, so it is off until its mode comes back
                    self.network.write_raw(self.node, mode.index, mode.subindex, bytes(DataType[mode.data_type].size or 1))
                except HilError as error:
                    refused.append(str(error))
        return refused + self.snapshot.restore()

    # -- cyclic operation ----------------------------------------------------------------------------------------------

    def write_mode(self, mode: CyclicMode, sync_period_s: float) -> None:
        """Set mode of operation, interpolation period and communication cycle period."""
        self.snapshot.write(Object.MODES_OF_OPERATION, 0, I8, mode.number, "modes of operation")
        try:
            self._write_period(sync_period_s)
        except SdoAbortedError as error:
            if error.code not in OUT_OF_RANGE:
                raise
            raise NotPossibleError(
                f"axis {self.number}: the drive refuses a SYNC period of {1e3 * sync_period_s:g} ms{self._period_step()}; choose "
                "another bus.sync_period_s, or bus.host_sync_period_s for a host-closed loop"
            ) from error

    def _write_period(self, sync_period_s: float) -> None:
        value, index = interpolation_period(sync_period_s)
        for subindex, kind, wanted, name in (
            (1, U8, value, "interpolation time period value"),
            (2, I8, index, "interpolation time index"),
        ):
            is_fixed = self.profile.is_fixed((Object.INTERPOLATION_PERIOD, subindex))
            if not is_fixed or self.network.read(self.node, Object.INTERPOLATION_PERIOD, subindex, kind, name) != wanted:
                self.snapshot.write(Object.INTERPOLATION_PERIOD, subindex, kind, wanted, name)
        if not self.snapshot.look((CYCLE_PERIOD,)):  # what only consumes SYNC need not have it (CiA 301, 1006h)
            self.snapshot.write(*CYCLE_PERIOD.address, U32, round(1e6 * sync_period_s), CYCLE_PERIOD.name)

    def _period_step(self) -> str:
        """Return a clause on the SYNC periods that a drive accepts."""
        control_s = self.control_period_s()
        return f"; its control period is {1e3 * control_s:g} ms, and most drives take multiples of that" if control_s else ""

    def write_supervision(self, master: int, heartbeat_s: float) -> None:
        """Let the drive watch the master's heartbeat, and send its own."""
        consumer = master << 16 | round(3e3 * heartbeat_s)
        self.snapshot.write(Object.ABORT_CONNECTION_OPTION, 0, DataType.INTEGER16, 3, "abort connection option code")
        self.snapshot.write(Object.QUICK_STOP_OPTION, 0, DataType.INTEGER16, 2, "quick stop option code")
        self.snapshot.write(0x1016, 1, U32, consumer, "consumer heartbeat time")
        self.snapshot.write(0x1017, 0, U16, round(1e3 * heartbeat_s), "producer heartbeat time")
