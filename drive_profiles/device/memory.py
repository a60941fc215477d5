"""Store and restore: the commands by which a drive keeps its values over a loss of power, or forgets them."""

from __future__ import annotations

from dataclasses import dataclass

from drive_profiles.device.device import Device
from drive_profiles.errors import RefusedError, SdoAbortedError
from drive_profiles.family.capability import StoreFacts
from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.object_address import ObjectAddress, object_address

_STANDARD = StoreFacts(
    object="1010:1", restore="1011:1", wait_s=5.0, source="CiA 301, 7.5.2.13 and 7.5.2.14", evidence="definition"
)  # fmt: skip
"""The commands of CiA 301, for a device without a profile."""

_NOTHING_DONE = frozenset({
    SdoAbortCode.NOT_STORED, SdoAbortCode.LOCAL_CONTROL, SdoAbortCode.DEVICE_STATE, SdoAbortCode.NO_OBJECT,
    SdoAbortCode.NO_SUBINDEX, SdoAbortCode.READ_ONLY, SdoAbortCode.INVALID_VALUE, SdoAbortCode.UNSUPPORTED_ACCESS,
})  # fmt: skip


@dataclass(frozen=True)
class MemoryCommand:
    """A store or restore command.

    Attributes:
        name: ``store`` or ``restore``, for messages.
        written_address: The object, as ``1010:1``.
        signature: Number that is written to it.
        wait_s: Time that the drive may take to answer, s.
    """

    name: str
    written_address: str
    signature: int
    wait_s: float

    @property
    def address(self) -> ObjectAddress:
        """Address of the object."""
        return object_address(self.written_address)

    def give(self, device: Device) -> None:
        """Send the command to a device.

        Raises:
            SdoAbortedError: The device refuses, or fails: see `has_done_nothing`.
            NoAnswerError: The device does not answer; it may have carried the command out.
        """
        device.write(self.address, self.signature.to_bytes(4, "little"), f"the {self.name} signature", self.wait_s)


def store_command(device: Device) -> MemoryCommand:
    """Command by which the device stores the values that it holds.

    Raises:
        RefusedError: The device has no such command.
    """
    facts = device.profile.store if device.profile else _STANDARD
    if facts.object is None:
        raise RefusedError(f"node {device.node}: {_who(device)} has no store command: {facts.note}")
    return MemoryCommand("store", facts.object, facts.signature, facts.wait_s)


def restore_command(device: Device) -> MemoryCommand:
    """Command after which the device holds its factory's values, from its next reset on.

    Raises:
        RefusedError: The device has no such command.
    """
    facts = device.profile.store if device.profile else _STANDARD
    if facts.restore is None:
        raise RefusedError(f"node {device.node}: {_who(device)} has no restore command: {facts.note}")
    return MemoryCommand("restore", facts.restore, facts.restore_signature, facts.wait_s)


def has_done_nothing(error: SdoAbortedError) -> bool:
    """True where the abort says that nothing was done. Other aborts, such as a fault of the memory, leave it open."""
    return error.code in _NOTHING_DONE


def _who(device: Device) -> str:
    return f"a {device.profile.label}" if device.profile else "a device of no known profile"
