"""Store and restore commands of a drive."""

from dataclasses import dataclass

from drive_profiles.device.device import Device
from drive_profiles.errors import NoAnswerError, RefusedError, SdoAbortedError
from drive_profiles.family.capability import StoreFacts
from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.object_address import ObjectAddress, object_address

_STANDARD = StoreFacts(
    object="1010:1", restore="1011:1", wait_s=5.0, source="CiA 301, 7.5.2.13 and 7.5.2.14", evidence="definition"
)  # fmt: skip
"""The commands of CiA 301, for a device without a profile."""

_STANDARD_OBJECTS = (0x1010, 0x1011)
_ON_COMMAND, _BY_ITSELF = 1, 2
"""Bits of 1010h and 1011h when they are read (CiA 301, 7.5.2.13 and 7.5.2.14)."""

_NOTHING_DONE = frozenset({
    SdoAbortCode.NOT_STORED, SdoAbortCode.LOCAL_CONTROL, SdoAbortCode.DEVICE_STATE, SdoAbortCode.NO_OBJECT,
    SdoAbortCode.NO_SUBINDEX, SdoAbortCode.READ_ONLY, SdoAbortCode.INVALID_VALUE, SdoAbortCode.UNSUPPORTED_ACCESS,
})  # fmt: skip


@dataclass(frozen=True)
class MemoryCommand:
    """A store or restore command: object, signature, and time to its answer."""

    name: str
    written_address: str
    signature: int
    wait_s: float

    @property
    def address(self) -> ObjectAddress:
        """Address of the object."""
        return object_address(self.written_address)

    def check(self, device: Device) -> None:
        """Check that the device executes the command on request.

        Raises:
            RefusedError: The device reports that it does not.
        """
        if self.address[0] not in _STANDARD_OBJECTS:
            return  # a maker's own object, of which nothing is known
        try:
            data = device.read(self.address)
        except SdoAbortedError:
            return  # it does not say; the command itself will
        held = int.from_bytes(data, "little")
        if not held & _ON_COMMAND:
            by_itself = "; it stores by itself" if held & _BY_ITSELF and self.address[0] == _STANDARD_OBJECTS[0] else ""
            what = f"{self.written_address} holds 0x{held:X}; bit 0 is 0, so the drive does not {self.name} on command{by_itself}"
            raise RefusedError(f"node {device.node}: {what}")

    def give(self, device: Device) -> None:
        """Send the command and wait until the device answers again.

        Raises:
            SdoAbortedError: The device refuses, or fails: see `has_done_nothing`.
            NoAnswerError: The device does not answer; it may have carried the command out.
        """
        device.write(self.address, self.signature.to_bytes(4, "little"), f"the {self.name} signature", self.wait_s)
        silence: NoAnswerError | None = None
        for _ in range(1 + round(self.wait_s / device.port.timeout_s)):
            try:
                device.read(self.address)
            except SdoAbortedError:
                return  # an object that is not read; an answer all the same
            except NoAnswerError as error:
                silence = silence or error
            else:
                return
        if silence is not None:
            raise silence


def store_command(device: Device) -> MemoryCommand:
    """Return the command that stores the device's values; `RefusedError` without one."""
    facts = _facts(device)
    return _command(device, "store", facts.object, facts.signature)


def restore_command(device: Device) -> MemoryCommand:
    """Return the factory-settings command, effective after a reset; `RefusedError` without one."""
    facts = _facts(device)
    return _command(device, "restore", facts.restore, facts.restore_signature)


def has_done_nothing(error: SdoAbortedError) -> bool:
    """Return True if the abort says that nothing was done."""
    return error.code in _NOTHING_DONE


def _facts(device: Device) -> StoreFacts:
    return device.profile.store if device.profile else _STANDARD


def _command(device: Device, name: str, written_address: str | None, signature: int) -> MemoryCommand:
    facts = _facts(device)
    if written_address is None:
        who = f"a {device.profile.label}" if device.profile else "a device without a known profile"
        raise RefusedError(f"node {device.node}: {who} has no {name} command: {facts.note}")
    return MemoryCommand(name, written_address, signature, facts.wait_s)
