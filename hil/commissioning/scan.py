"""Scan of a bus by reading alone."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from drive_profiles.address import parse_address
from drive_profiles.device.bus import SdoBus
from drive_profiles.device.device import DeviceIdentity, identity_at
from drive_profiles.device.target import matching, named_profile
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, decode
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.units import Scaling
from hil.can.opening import open_channel
from hil.errors import HilError, NodeError
from hil.master.drive.scale import NothingStated, Questions, keys_to_state, read_scaling
from hil.master.network import Network
from hil.recording import BusLog
from hil.robot_tables import Control

ASK_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True)
class FoundNode:
    """A node that answers.

    Attributes:
        scaling: Units of a drive; None for other nodes, and if the drive lacks them.
        doubt: Reason why it is not known how it counts, or None.
        unsaid: Keys of the bench file for units that the drive lacks.
        control: Gains that it holds; None if it holds none, or its profile does not know them.
        speed_limit_rps: Speed that the drive itself allows; None if it has no object for it.
        position_rev: Position of its motor; None if that is not known.
    """

    identity: DeviceIdentity
    profiles: tuple[str, ...]
    scaling: Scaling | None = None
    doubt: str | None = None
    unsaid: tuple[str, ...] = ()
    control: Control | None = None
    knows_gains: bool = False
    speed_limit_rps: float | None = None
    position_rev: float | None = None

    @property
    def node(self) -> int:
        """Its node-ID."""
        return self.identity.node

    @property
    def is_drive(self) -> bool:
        """True for a drive: by its own words, or by its profile's."""
        return self.identity.is_drive or (self.profile is not None and self.profile.kind == "drive")

    @property
    def profile(self) -> Profile | None:
        """Its profile; None if none or several fit."""
        return Profile.load(self.profiles[0]) if len(self.profiles) == 1 else None


def scan_bus(address: str, named: Mapping[int, str] = MappingProxyType({})) -> list[FoundNode]:
    """Read the identity of all nodes, and the drives' units.

    Nothing is written. Profiles are those that the user names, by node-ID; the others follow from the identity.

    Raises:
        BusError: There is no such bus.
        ChannelError: Likewise.
        NodeError: No node answers, or one that is named does not.
        DriveProfileError: A named profile does not exist, or is of another maker's devices.
    """
    with SdoBus(address, ASK_TIMEOUT_S) as bus:
        identities = [identity_at(bus.port(node)) for node in bus.answering(range(1, 128))]
    if not identities:
        raise NodeError(0, f"no node answers on {address}", "is the bit rate right, and is everything powered?")
    if silent := sorted(named.keys() - {identity.node for identity in identities}):
        answering = ", ".join(str(identity.node) for identity in identities)
        raise NodeError(silent[0], f"it does not answer on {address}; nodes {answering} do", "is the node-ID right?")
    there = [(identity, profiles_of(identity, named.get(identity.node))) for identity in identities]
    channel = open_channel(parse_address(address))
    try:
        network = Network(channel, BusLog(None), ASK_TIMEOUT_S, 1.0)
        return [_found(network, identity, profiles) for identity, profiles in there]
    finally:
        channel.close()


def profiles_of(identity: DeviceIdentity, name: str | None) -> tuple[str, ...]:
    """Return the labels of a device's profiles.

    Raises:
        DriveProfileError: The named profile does not exist, or is of another maker's devices.
    """
    if name is None:
        return tuple(matching(identity))
    known = named_profile(identity, name)
    return (name if known.products or Path(name).suffix else known.label,)


def _found(network: Network, identity: DeviceIdentity, profiles: tuple[str, ...]) -> FoundNode:
    """A node with all data that it has on itself."""
    found = FoundNode(identity, profiles)
    profile = found.profile
    if profile is None or profile.kind != "drive":
        return found
    knows = all(name in profile.parameters for name in Control.model_fields)
    questions = Questions(network, identity.node)
    try:
        scaling = read_scaling(questions, identity.node, NothingStated(), profile)
        unsaid = () if scaling is not None else keys_to_state(questions, identity.node, profile)
    except HilError as error:
        return FoundNode(identity, profiles, doubt=str(error), knows_gains=knows)
    if scaling is None:
        return FoundNode(identity, profiles, unsaid=unsaid, knows_gains=knows)
    asked = _Parameters(network, identity.node, profile, scaling)
    values = {name: asked.value(name) for name in Control.model_fields}
    control = None
    if all(value is not None and math.isfinite(value) and value > 0.0 for value in values.values()):
        control = Control.model_validate(values)
    speed = asked.value("speed_limit_rad_s")
    return FoundNode(
        identity, profiles, scaling, None, (), control, knows,
        None if speed is None or not 0.0 < speed < math.inf else speed / math.tau, asked.position_rev(),
    )  # fmt: skip


@dataclass(frozen=True)
class _Parameters:
    """Parameters of a drive, read one at a time; None if missing."""

    network: Network
    node: int
    profile: Profile
    scaling: Scaling

    def value(self, name: str) -> float | None:
        """A parameter of the profile, in its unit."""
        parameter = self.profile.parameters.get(name)
        if parameter is None:
            return None
        try:
            raw = self.network.read(self.node, parameter.index, parameter.subindex, DataType[parameter.data_type], name)
        except HilError:
            return None
        return float(parameter.value(raw, self.scaling))

    def position_rev(self) -> float | None:
        """Position of the motor in revolutions."""
        try:
            data = self.network.read_raw(self.node, Object.POSITION_ACTUAL, 0, "position actual value")
        except HilError:
            return None
        return self.scaling.position_rad(int(decode(DataType.INTEGER32, data))) / math.tau if len(data) == 4 else None
