"""Units of a drive, from its objects or from the bench file."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, decode
from drive_profiles.standard.object_address import object_address
from drive_profiles.standard.objects import OBJECTS
from drive_profiles.standard.units import Scaling, counts_per_rev
from hil.bench.bench import AxisTable
from hil.errors import NoAnswerError, NodeError, SdoAbortedError
from hil.master.drive.needs import ABSENT, Need

if TYPE_CHECKING:
    from hil.logs.nodes import Node
    from hil.master.network import Network


class Questions:
    """Objects of a node, read one after the other, and missing ones.

    Attributes:
        missing: Objects that were needed and are not there.
    """

    def __init__(self, network: "Network", node: int) -> None:
        self.network, self.node = network, node
        self.missing: list[Need] = []

    def number(self, need: Need, kind: DataType | None = None, *, is_optional: bool = False) -> int | None:
        """Read an integer; None if the node does not have it.

        Args:
            kind: Data type of the object; None for an unsigned integer of any length.
            is_optional: Do not count it as missing.

        Raises:
            NoAnswerError: The node is silent, or its answer has another length.
            SdoAbortedError: The node has the object, and refuses.
        """
        try:
            data = self.network.read_raw(self.node, *need.address, need.name)
        except SdoAbortedError as error:
            if error.code not in ABSENT:
                raise
            if not is_optional:
                self.missing.append(need)
            return None
        if kind is None:
            return int.from_bytes(data, "little")
        if len(data) != kind.size:
            raise NoAnswerError(
                self.node, f"{need.name} of {kind.size} bytes (received: {len(data)} bytes)", self.network.timeout_s
            )
        return int(decode(kind, data))


def read_scaling(asked: Questions, number: int, table: "AxisTable | NothingStated", profile: Profile) -> Scaling | None:
    """Read the units of a drive.

    Returns:
        The scaling; None if an object for it is missing.

    Raises:
        NodeError: The objects make no sense, choose units of their own, or contradict the bench file.
    """
    counts, torque_nm = _counts_per_rev(asked, number, table, profile), _rated_torque_nm(asked, number, table, profile)
    _check_units(asked, number, profile)
    feed = _feed(asked, profile)
    if counts is None or torque_nm is None or feed is None:
        return None
    try:
        return Scaling(counts, torque_nm, **feed)
    except DriveProfileError as error:
        raise NodeError(asked.node, f"its units are invalid: {error}") from error


@dataclass(frozen=True)
class NothingStated:
    """Units of a drive in a bench file still to be written."""

    encoder_counts_per_rev: int | None = None
    rated_torque_nm: float | None = None
    torque_constant_nm_a: float | None = None


def keys_to_state(asked: Questions, number: int, profile: Profile) -> tuple[str, ...]:
    """Return the keys of units that the bench file has to state.

    They are those that the drive itself does not have.

    Raises:
        NodeError: The objects make no sense.
    """
    keys = []
    if _counts_per_rev(asked, number, NothingStated(), profile) is None:
        keys.append("encoder_counts_per_rev")
    if _rated_torque_nm(asked, number, NothingStated(), profile) is None:
        keys.append("torque_constant_nm_a" if _reports_a_current(profile) else "rated_torque_nm")
    return tuple(keys)


def _reports_a_current(profile: Profile) -> bool:
    """True for a drive that reports a current in known steps only."""
    facts = profile.torque
    return facts is not None and facts.actual is None and facts.current_step_a is not None


def check_load_encoder(asked: Questions, number: int, table: AxisTable, profile: Profile) -> None:
    """Refuse a second encoder with other steps than the bench file's.

    A drive need not have objects for them (60E6h and 60EBh).

    Raises:
        NodeError: Its steps per revolution are others.
    """
    encoder, facts = table.load_encoder, profile.load_encoder
    if encoder is None or facts is None or facts.increments is None or encoder.object not in {None, facts.position}:
        return
    steps = asked.number(Need(object_address(facts.increments), "steps of the second encoder", ""), is_optional=True)
    turns: int | None = 1
    if facts.revolutions is not None:
        turns = asked.number(Need(object_address(facts.revolutions), "its revolutions", ""), is_optional=True)
    if steps and turns and steps != encoder.counts_per_rev * turns:
        raise NodeError(
            asked.node,
            f"the second encoder of axis {number} has {steps}/{turns} steps per revolution ({facts.increments})",
            f"axis.{number}.load_encoder.counts_per_rev is {encoder.counts_per_rev}: make the two equal",
        )


def _counts_per_rev(asked: Questions, number: int, table: AxisTable | NothingStated, profile: Profile) -> int | None:
    facts, stated, key = profile.encoder, table.encoder_counts_per_rev, f"axis.{number}.encoder_counts_per_rev"
    if facts is None or facts.increments is None:
        found = None if facts is None else facts.counts_per_rev
    else:
        purpose = f"positions are scaled by it; {key} of the bench file can replace it"
        increments = asked.number(
            Need(object_address(facts.increments), "encoder increments", purpose), is_optional=stated is not None
        )
        revolutions: int | None = 1
        if facts.revolutions is not None and increments is not None:
            revolutions = asked.number(Need(object_address(facts.revolutions), "motor revolutions of the encoder", purpose))
        if increments is None or revolutions is None:
            return stated
        try:
            found = counts_per_rev(facts.increments, increments, revolutions)
        except DriveProfileError as error:
            raise NodeError(asked.node, f"its units are invalid: {error}") from error
    if stated is not None and found is not None and found != stated:
        raise NodeError(
            asked.node,
            f"axis {number} counts {found} increments per revolution, but {key} = {stated}; check drive and bench file",
        )
    return stated if found is None else found


def _rated_torque_nm(asked: Questions, number: int, table: AxisTable | NothingStated, profile: Profile) -> float | None:
    facts, stated, key = profile.torque, table.rated_torque_nm, f"axis.{number}.rated_torque_nm"
    if facts is not None and facts.current_step_a is not None and _reports_a_current(profile):
        constant = table.torque_constant_nm_a  # a thousand steps of its current make this torque
        return None if constant is None else 1000.0 * facts.current_step_a * constant
    if facts is None or facts.rated_torque is None:
        return stated
    purpose = f"torques are per mille of it; {key} of the bench file can replace it"
    steps = asked.number(Need(object_address(facts.rated_torque), "motor rated torque", purpose), is_optional=stated is not None)
    if steps is None:
        return stated
    found = steps * facts.rated_torque_step_nm
    if stated is not None and not math.isclose(found, stated, rel_tol=0.0, abs_tol=facts.rated_torque_step_nm):
        raise NodeError(
            asked.node, f"axis {number} has a rated torque of {found:g} N·m, but {key} = {stated:g}; check drive and bench file"
        )
    return found


def _check_units(asked: Questions, number: int, profile: Profile) -> None:
    """Refuse units for which the profile's scales are wrong."""
    for address in () if profile.encoder is None else profile.encoder.zero:
        need = Need(object_address(address), "", "positions are counted in increments while it is 0")
        value = asked.number(need, is_optional=True)
        if value:
            index, subindex = need.address
            raise NodeError(
                asked.node,
                f"axis {number} has position units of its own: {index:04X}h:{subindex:02X}h is {value:X}h",
                "write 0 to it",
            )


def _feed(asked: Questions, profile: Profile) -> dict[str, int] | None:
    """Read gear ratio (6091h) and feed constant (6092h) where positions need them."""
    objects = {} if profile.encoder is None else profile.encoder.feed_objects
    found = {
        name: asked.number(Need(object_address(address), name, "positions are scaled by it")) for name, address in objects.items()
    }
    whole = {name: value for name, value in found.items() if value is not None}
    return whole if len(whole) == len(found) else None


_USUAL_SIZE = 4


class OverheardQuestions(Questions):
    """Answers about a drive from overheard frames.

    The default of an EDS is not an answer: the drive may have other settings by now. The parameter value of a DCF is an answer,
    unless a frame has another.
    """

    def __init__(self, node: "Node") -> None:
        self._told = node
        self.node, self.missing = node.number, []

    def number(self, need: Need, kind: DataType | None = None, *, is_optional: bool = False) -> int | None:
        """Return the number as the master would have read it, or None."""
        told = self._told
        is_stated = told.description is not None and need.address in told.description.values
        value = told.value(*need.address) if need.address in told.heard or is_stated else None
        if value is None:
            if not is_optional:
                self.missing.append(need)
            return None
        known = OBJECTS.get(need.address)
        size = (kind.size if kind is not None else known[1].size if known is not None else 0) or _USUAL_SIZE
        if kind is None and value >= 0:
            return value
        octets = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        return int.from_bytes(octets, "little") if kind is None else int(decode(kind, octets))
