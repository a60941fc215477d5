"""The commands by which a drive keeps its values over a loss of power, or forgets them, and what its answers to them mean."""

from __future__ import annotations

from dataclasses import dataclass

from drive_profiles.capability import Store
from drive_profiles.cia301 import SdoAbortCode
from drive_profiles.device import Device
from drive_profiles.errors import RefusedError, SdoAbortedError
from drive_profiles.parameter import Place, place_of

_STANDARD = Store(
    object="1010:1", restore="1011:1", wait_s=5.0, source="CiA 301, 7.5.2.13 and 7.5.2.14", evidence="definition"
)  # fmt: skip
"""Of a device that has no profile."""

_NOTHING_DONE = frozenset({
    SdoAbortCode.NOT_STORED, SdoAbortCode.LOCAL_CONTROL, SdoAbortCode.DEVICE_STATE, SdoAbortCode.NO_OBJECT,
    SdoAbortCode.NO_SUBINDEX, SdoAbortCode.READ_ONLY, SdoAbortCode.INVALID_VALUE, SdoAbortCode.UNSUPPORTED_ACCESS,
})  # fmt: skip


@dataclass(frozen=True)
class Command:
    """One such command.

    Attributes:
        name: For messages.
        address: The object.
        signature: What is written to it.
        wait_s: How long the drive may take to answer.
    """

    name: str
    address: str
    signature: int
    wait_s: float

    @property
    def place(self) -> Place:
        """The object."""
        return place_of(self.address)

    def give(self, device: Device) -> None:
        """Let the device do it.

        Raises:
            SdoAbortedError: It refuses, or fails: see `has_done_nothing`.
            NoAnswerError: It does not say; it may have done it.
        """
        device.write(self.place, self.signature.to_bytes(4, "little"), f"the {self.name} signature", self.wait_s)


def store_command(device: Device) -> Command:
    """The device keeps what it holds.

    Raises:
        RefusedError: It has no such command.
    """
    facts = device.profile.store if device.profile else _STANDARD
    if facts.object is None:
        raise RefusedError(f"node {device.node}: {_who(device)} has no store command: {facts.note}")
    return Command("store", facts.object, facts.signature, facts.wait_s)


def restore_command(device: Device) -> Command:
    """The device forgets what it has kept, and holds its factory's values after its next reset.

    Raises:
        RefusedError: It has no such command.
    """
    facts = device.profile.store if device.profile else _STANDARD
    if facts.restore is None:
        raise RefusedError(f"node {device.node}: {_who(device)} has no restore command: {facts.note}")
    return Command("restore", facts.restore, facts.restore_signature, facts.wait_s)


def has_done_nothing(error: SdoAbortedError) -> bool:
    """Whether the device has refused the command; after other aborts, such as a fault of its memory, who knows."""
    return error.code in _NOTHING_DONE


def _who(device: Device) -> str:
    return f"a {device.profile.name}" if device.profile else "a device of no known profile"
