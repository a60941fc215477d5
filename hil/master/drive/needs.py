"""Objects and parameters that a run needs, each with its use."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress, address_text
from hil.bench.bench import AS_FOUND, AxisTable, Bench
from hil.control.treatments import LoopName
from hil.errors import NodeError, NotPossibleError
from hil.master.drive import mapping
from hil.master.drive.limits import LIMITS, limit_words, tells_current
from hil.robot_tables import Control

ABSENT: Final = frozenset({SdoAbortCode.NO_OBJECT, SdoAbortCode.NO_SUBINDEX})
"""Abort codes by which a drive says that it has no such object."""


class Need(NamedTuple):
    """An object that a run needs of a drive."""

    address: ObjectAddress
    name: str
    purpose: str

    def __str__(self) -> str:
        return f"{address_text(self.address)} {self.name}: {self.purpose}"


STATUS = Need((Object.STATUS_WORD, 0), "status word", "it shows the state of the drive")
VELOCITY = Need((Object.VELOCITY_ACTUAL, 0), "velocity actual value", "it shows standstill before anything is written")

ERROR_CODE = Need((Object.ERROR_CODE, 0), "error code", "it shows the fault of the drive")
CYCLE_PERIOD = Need((0x1006, 0), "communication cycle period", "it sets the SYNC period, in drives that have it")

_SUPERVISION = (
    Need((Object.ABORT_CONNECTION_OPTION, 0), "abort connection option code", "the drive stops when the master stops sending"),
    Need((Object.QUICK_STOP_OPTION, 0), "quick stop option code", "a stop ends on its ramp, disabled"),
    Need((0x1016, 1), "consumer heartbeat time", "the drive watches the master"),
    Need((0x1017, 0), "producer heartbeat time", "the master watches the drive"),
)
_CYCLE = (
    Need((Object.MODES_OF_OPERATION, 0), "modes of operation", "it selects the mode of the run"),
    Need((Object.INTERPOLATION_PERIOD, 1), "interpolation time period value", "it sets the SYNC period of the drive"),
    Need((Object.INTERPOLATION_PERIOD, 2), "interpolation time index", "it sets the SYNC period of the drive"),
)
_MAPPED: Final[Mapping[int, tuple[str, str]]] = {
    Object.CONTROL_WORD: ("control word", "it enables and stops the drive"),
    Object.STATUS_WORD: ("status word", "the master watches the state of the drive with it"),
    Object.POSITION_ACTUAL: ("position actual value", "the master watches position limits and following error with it"),
    Object.TORQUE_ACTUAL: ("torque actual value", "the master watches the torque limit with it"),
    Object.TARGET_POSITION: ("target position", "it is the set-point of a drive-closed run"),
    Object.TARGET_TORQUE: ("target torque", "it is the set-point of a host-closed run"),
    Object.TORQUE_OFFSET: ("torque offset", "it adds a torque to the drive's own"),
    Object.INTERPOLATION_DATA: ("interpolation data", "it is the set-point of a drive-closed run in IP"),
}


_MANUFACTURERS = ("object of the manufacturer", "a run maps it in place of the standard's")


class MissingObjectsError(NodeError):
    """Drives lack objects that a run needs; nothing has been written.

    Args:
        missing: The objects by axis: its number, its node-ID, and the missing objects.
    """

    def __init__(self, missing: list[tuple[int, int, tuple[Need, ...]]]) -> None:
        self.missing = missing
        lines = [f"\n  axis {axis}, node {node}, has no {need}" for axis, node, needs in missing for need in needs]
        super().__init__(missing[0][1], "drives lack objects that the bench needs; nothing has been written:" + "".join(lines))


class ProfileGapsError(NotPossibleError):
    """Drive profiles lack entries that the bench needs; nothing has been written."""

    def __init__(self, gaps: Iterable[str]) -> None:
        """Keep the gaps, a sentence each, as `profile_gaps` gives them."""
        self.gaps = tuple(gaps)
        super().__init__("\n  ".join(("drive profiles lack entries that the bench needs; nothing has been written:", *self.gaps)))


def objects_needed(
    table: AxisTable,
    profile: Profile,
    loop: LoopName | None = None,
    *,
    with_notch_state: bool = False,
    with_torque_offset: bool = False,
) -> Iterator[Need]:
    """Yield the objects that a run needs, except a drive's scaling.

    Args:
        loop: Place of the loop; None before it is known.
    """
    for limit in LIMITS:
        if limit.si(table.limits) is not None:
            yield from _parameter(profile, limit.held_by(profile), f"the drive holds limits.{limit.key} with it")
    if table.writes_gains:
        for name in Control.model_fields:
            yield from _parameter(profile, name, f"control.{name} is written to it")
    yield from _CYCLE
    yield from _SUPERVISION
    yield from _pdo("RPDO1", 0x1400, "it carries the set-points")
    yield from _pdo("TPDO1", 0x1800, "it carries state, position and torque")
    if with_notch_state and mapping.notch_state(profile):
        yield from _pdo("TPDO2", 0x1801, "it carries the state of the filter")
    yield from encoder_objects(table, profile, with_notch_state=with_notch_state)
    mode = None if loop is None else mapping.mode_of(loop, profile)
    commands = () if mode is None else mapping.command(mode, with_torque_offset=with_torque_offset)
    for entry in (*commands, *mapping.feedback(profile)):
        yield Need((entry.index, entry.subindex), *_MAPPED.get(entry.index, _MANUFACTURERS))


def encoder_objects(table: AxisTable, profile: Profile, *, with_notch_state: bool) -> Iterator[Need]:
    """Yield the objects for a drive's second encoder, if there is one."""
    for entry in mapping.load_position(table, profile):
        number = mapping.load_tpdo(profile, with_notch_state=with_notch_state)
        yield from _pdo(f"TPDO{number}", 0x17FF + number, "it carries the position of the second encoder")
        address = (entry.index, entry.subindex)
        yield Need(address, "position of the second encoder", "the master records it for load_encoder of the bench file")


def _parameter(profile: Profile, name: str | None, purpose: str) -> Iterator[Need]:
    """Yield the object of a parameter.

    None if the profile lacks the parameter, which `profile_gaps` reports.
    """
    parameter = None if name is None else profile.parameters.get(name)
    if name is not None and parameter is not None:
        yield Need(parameter.address, name, purpose)


def _pdo(name: str, communication: int, purpose: str) -> Iterator[Need]:
    yield Need((communication, 1), f"COB-ID of {name}", purpose)
    yield Need((communication, 2), f"transmission type of {name}", purpose)
    yield Need((communication + 0x200, 0), f"mapping of {name}", purpose)


def run_gaps(bench: Bench, axes: Iterable[int], loop: LoopName, *, with_notch: bool) -> list[str]:
    """Return sentences on what profiles or bench file lack for a run.

    Args:
        axes: Numbers of the axes that take part; others than the bench's are left out.
    """
    found: list[str] = []
    in_drive = with_notch and loop == "drive"
    tables = {number: bench.axis[number] for number in axes if number in bench.axis}
    profiles = {name: Profile.load(name) for name in {table.profile for table in tables.values()}}
    for number, table in tables.items():
        found += profile_gaps(number, table, profiles[table.profile], loop, with_notch=in_drive)
        if loop == "host" and table.control == AS_FOUND:
            found.append(
                f'axis {number}: control = "{AS_FOUND}" leaves the gains to the drive; a host-closed loop needs them in the '
                "bench file"
            )
    return found


def run_remarks(bench: Bench, axes: Iterable[int], loop: LoopName) -> list[str]:
    """Return remarks on a run's drives: limits, modes with a loss."""
    said: list[str] = []
    for number in axes:
        if number not in bench.axis:
            continue
        profile = Profile.load(bench.axis[number].profile)
        said += limit_words(number, profile, bench.axis[number].limits)
        mode = mapping.mode_of(loop, profile)
        if mode is not None and mode.loss:
            said.append(f"axis {number}: {profile.label} has no CSP and runs in {mode.name}: {mode.loss}")
    return said


def profile_gaps(
    number: int, table: AxisTable, profile: Profile, loop: LoopName | None = None, *, with_notch: bool = False
) -> list[str]:
    """Return sentences on what a profile lacks for a run."""
    gaps = [*scale_gaps(number, table, profile), *_gain_gaps(table, profile, loop)]
    if loop is not None and mapping.mode_of(loop, profile) is None:
        mode = "CST" if loop == "host" else "CSP or IP"
        gaps.append(f"no mode {mode}, in which the {loop} closes the loop")
    filters = [f"notch_{column}.mode" for column in range(1, len(table.notch) + 1)] if with_notch else []
    gaps += [f"no {name}, the filter that axis.{number}.notch describes" for name in filters if name not in profile.parameters]
    return [f"axis {number}: profile {profile.label} has {gap}" for gap in gaps]


def scale_gaps(number: int, table: AxisTable, profile: Profile) -> list[str]:
    """The scales that neither the profile nor the bench file knows."""
    gaps = []
    encoder, torque = profile.encoder, profile.torque
    if table.encoder_counts_per_rev is None and (encoder is None or (encoder.increments or encoder.counts_per_rev) is None):
        gaps.append(f"no scale of positions; state axis.{number}.encoder_counts_per_rev in the bench file")
    if tells_current(profile):
        if table.torque_constant_nm_a is None:
            gaps.append(f"no torque, only a current; state axis.{number}.torque_constant_nm_a in the bench file")
    elif table.rated_torque_nm is None and (torque is None or torque.rated_torque is None):
        gaps.append(f"no scale of torques; state axis.{number}.rated_torque_nm in the bench file")
    return gaps


def _gain_gaps(table: AxisTable, profile: Profile, loop: LoopName | None) -> Iterable[str]:
    if loop == "host" or not table.writes_gains:
        return  # the host has the gains, or they are not written
    lacking = [name for name in Control.model_fields if name not in profile.parameters]
    if lacking:
        remedy = f'state gains_are_set = true if the drive has these gains already, else control = "{AS_FOUND}"'
        yield f"no {', '.join(lacking)} for the gains of control; {remedy}"
