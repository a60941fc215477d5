"""A device behind an SDO port."""

import contextlib
import datetime
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from drive_profiles.device.sdo import SdoPort
from drive_profiles.errors import (
    BusError,
    DriveProfileError,
    NoAnswerError,
    NodeError,
    OutOfRangeError,
    RefusedError,
    SdoAbortedError,
    SharedNodeError,
)
from drive_profiles.family.catalogue import Catalogue, CatalogueEntry
from drive_profiles.family.profile import Profile
from drive_profiles.parameter_set.commands import is_command
from drive_profiles.parameter_set.parameters import CLASSES, Header, Item, ParameterSet, Write, item_of
from drive_profiles.standard.cia301 import DataType, NmtCommand, SdoAbortCode, decode
from drive_profiles.standard.cia402 import Object, State, state_of
from drive_profiles.standard.object_address import ObjectAddress, object_address
from drive_profiles.standard.units import Scaling, counts_per_rev

_MOVING = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
_POLL_S = 0.05
_AXIS_STEP = 0x800
_DRIVE = 402
"""Device profile number in the lower half of 1000h."""


@dataclass(frozen=True)
class DeviceIdentity:
    """Identity that a device states of itself: 1000h, 1018h, 1008h, 100Ah.

    A number that the device does not state is None.
    """

    node: int
    device_type: int | None
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    serial_number: int | None
    name: str = ""
    firmware: str = ""

    @property
    def is_drive(self) -> bool:
        """True if the device states that it is a CiA 402 device."""
        return self.device_type is not None and self.device_type & 0xFFFF == _DRIVE


class Device:
    """A device on a bus, accessed through the objects of its catalogue."""

    def __init__(self, port: SdoPort, catalogue: Catalogue, nmt: Callable[[NmtCommand, int], None] | None = None) -> None:
        """Join port and catalogue; only `reset` needs `nmt`, to send a command."""
        self.port = port
        self.catalogue = catalogue
        self._nmt = nmt
        self._counts: int | None = None
        self._feed: dict[str, int] = {}
        self._torque_nm: float | None = None
        self._without_scaling: set[str] = set()

    @property
    def node(self) -> int:
        """Node-ID of the device."""
        return self.port.node

    @property
    def profile(self) -> Profile | None:
        """Drive profile of the device's family, None if it is not known."""
        return self.catalogue.profile

    def name_of(self, address: ObjectAddress) -> str:
        """Return the name of an object, or ""."""
        entry = self.catalogue.get(address)
        return "" if entry is None else entry.name

    def _may_be_long(self, address: ObjectAddress) -> bool:
        """True if an object holds bytes of any number."""
        entry = self.catalogue.get(address)
        return entry is not None and entry.data_type is DataType.DOMAIN

    def read(self, address: ObjectAddress) -> bytes:
        """Read the bytes of an object.

        A read without an answer is repeated once, since reading changes nothing.

        Raises:
            SdoAbortedError: The device refuses; the text is the maker's where the profile has it.
            NoAnswerError: The device does not answer, twice.
        """
        try:
            return _read(self.port, address, self.name_of(address), in_blocks=self._may_be_long(address))
        except SdoAbortedError as error:
            raise self._in_words(error) from None

    def write(self, address: ObjectAddress, data: bytes, value: object = None, timeout_s: float | None = None) -> None:
        """Write the bytes of an object, once.

        A message shows `value`, by default the bytes; the answer may take `timeout_s`, by default the port's.

        Raises:
            SdoAbortedError: The device refuses; the text is the maker's where the profile has it.
            NoAnswerError: The device does not answer; whether it has taken the value is not known.
        """
        try:
            self.port.write(address, data, self.name_of(address), value, timeout_s, in_blocks=self._may_be_long(address))
        except SdoAbortedError as error:
            raise self._in_words(error) from None

    def _in_words(self, error: SdoAbortedError) -> SdoAbortedError:
        for abort in self.profile.aborts if self.profile else ():
            if abort.code == error.code:
                return SdoAbortedError(error.node, error.index, error.subindex, error.code, abort.text, error.name, error.action)
        return error

    def identify(self) -> DeviceIdentity:
        """Read the identity objects; one that the device lacks gives None.

        Raises:
            NoAnswerError: The device does not answer.
        """
        return identity_at(self.port)

    def state(self) -> State | None:
        """Read the CiA 402 state; None without a readable status word."""
        try:
            word = decode(DataType.UNSIGNED16, self.read((Object.STATUS_WORD, 0)))
        except (SdoAbortedError, ValueError):
            return None
        return state_of(int(word))

    def check_quiet(self, axes: Collection[int] = (0,)) -> None:
        """Refuse a drive that is enabled: gains are not written under torque.

        The objects of axis n, counted from 0, are at + 800h n (CiA 402).

        Raises:
            NodeError: The drive is enabled, or its state cannot be read.
        """
        for axis in axes:
            address = (Object.STATUS_WORD + _AXIS_STEP * axis, 0)
            try:
                data = self.read(address)
            except SdoAbortedError as error:
                is_drive = self.profile is not None and self.profile.kind == "drive"
                if (is_drive and axis == 0) or error.code not in {SdoAbortCode.NO_OBJECT, SdoAbortCode.NO_SUBINDEX}:
                    raise NodeError(self.node, f"its state cannot be read ({error})", "nothing has been written") from None
                continue  # no drive, or no such axis
            state = state_of(int.from_bytes(data, "little"))
            if state is None:
                raise NodeError(self.node, f"its status word {data.hex(' ')} is not a state of CiA 402", "is it a drive?")
            if state in _MOVING:
                raise NodeError(self.node, f"it is in state {state.value!r}", "disable it first; nothing is written to it")

    def reset(self, within_s: float) -> None:
        """Reset the node, like a loss of power; wait until it answers.

        Raises:
            NoAnswerError: No boot-up message comes in time, or the node does not answer after it.
            RefusedError: The device was made without `nmt`.
        """
        if self._nmt is None:
            raise RefusedError(f"node {self.node} cannot be reset: this device was made without NMT")
        before = self.port.boots
        self._nmt(NmtCommand.RESET_NODE, self.node)
        deadline = time.monotonic() + within_s
        while self.port.boots == before:
            if time.monotonic() > deadline:
                raise NoAnswerError(self.node, "its reset: no boot-up message", within_s)
            with contextlib.suppress(NoAnswerError, SdoAbortedError):
                self.port.read((0x1000, 0))
            time.sleep(_POLL_S)
        while True:
            try:
                self.port.read((0x1000, 0))
                return
            except (NoAnswerError, SdoAbortedError):
                if time.monotonic() > deadline:
                    raise NoAnswerError(self.node, "anything after its reset", within_s) from None

    def scaling(self, entries: Collection[CatalogueEntry]) -> Scaling | None:
        """Read the drive's scaling; None if no entry needs it.

        Raises:
            RefusedError: The profile does not name the objects that hold the scaling.
            OutOfRangeError: The drive holds a zero in one of them.
        """
        needed = {entry.scale for entry in entries if entry.scale}
        if not needed:
            return None
        if "counts" in needed and self._counts is None:
            self._counts, self._feed = self._counts_per_rev(), self._feed_constant()
        if "per mille" in needed and self._torque_nm is None:
            self._torque_nm = self._rated_torque_nm()
        # what is not needed gets a stand-in; what is needed and 0 is refused by the scaling itself
        scaling = Scaling(1 if self._counts is None else self._counts, 1.0 if self._torque_nm is None else self._torque_nm)
        return replace(scaling, **self._feed) if "counts" in needed else scaling

    def scaling_addresses(self) -> set[ObjectAddress]:
        """Return the addresses of the objects that decide the scaling of others."""
        encoder = self.profile.encoder if self.profile else None
        torque = self.profile.torque if self.profile else None
        named = [torque.rated_torque] if torque else []
        if encoder:
            named += [encoder.increments, encoder.revolutions, *encoder.feed_objects.values(), *encoder.zero]
        return {object_address(address) for address in named if address}

    def _scaling_for(self, entry: CatalogueEntry) -> Scaling | None:
        """Return the scaling for one object; None if it cannot be read."""
        if entry.scale in self._without_scaling:
            return None
        try:
            return self.scaling([entry])
        except (RefusedError, OutOfRangeError, SdoAbortedError):
            return None
        except NoAnswerError:
            self._check_that_it_answers()
            self._without_scaling.add(entry.scale)  # asked once: each time would cost two time-outs
            return None

    def _check_that_it_answers(self) -> None:
        """Raise `NoAnswerError` if the device no longer answers at all."""
        with contextlib.suppress(SdoAbortedError):
            _read(self.port, (0x1000, 0))

    def _counts_per_rev(self) -> int:
        facts = self.profile.encoder if self.profile else None
        if facts is None or (facts.increments is None and facts.counts_per_rev is None):
            raise RefusedError(
                f"node {self.node}: no object is known for the resolution of its encoder; give a profile that names it"
            )
        if facts.increments is None:
            return facts.counts_per_rev or 0
        increments = self._number(facts.increments)
        revolutions = 1 if facts.revolutions is None else self._number(facts.revolutions)
        return counts_per_rev(f"node {self.node}, {facts.increments}", increments, revolutions)

    def _feed_constant(self) -> dict[str, int]:
        """Read gear ratio and feed constant (6091h, 6092h), where they decide positions."""
        facts = self.profile.encoder if self.profile else None
        if facts is None:
            return {}
        for address in facts.zero:
            if self._number(address):
                raise RefusedError(f"node {self.node} has units of its own, which are not supported: {address} is not 0")
        return {name: self._number(address) for name, address in facts.feed_objects.items()}

    def _rated_torque_nm(self) -> float:
        facts = self.profile.torque if self.profile else None
        if facts is None or facts.rated_torque is None:
            raise RefusedError(f"node {self.node}: no object is known for its rated torque; give a profile that names it")
        return self._number(facts.rated_torque) * facts.rated_torque_step_nm

    def _number(self, address: str) -> int:
        return int.from_bytes(self.read(object_address(address)), "little")

    def resolve(self, parameter_set: ParameterSet, classes: Collection[str] = CLASSES, *, limits: bool = True) -> list[Write]:
        """Encode each line of a parameter set for this device."""
        named = {key for _, key, item in parameter_set.items() if item.type is None}
        scaling = self.scaling([entry for entry in self.catalogue if entry.needs_scaling and entry.name in named])
        return parameter_set.writes(self.catalogue, scaling, classes=classes, limits=limits)

    def pull(
        self, classes: Collection[str] = CLASSES, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> ParameterSet:
        """Read every value that could be written back, as a parameter set.

        Values that the device refuses to give, for which it is silent, or that make no sense, are listed in the header's
        ``not_read``; so are the objects that the EDS keeps out of a scan or a download (``ObjFlags``). `progress` is called after
        each object with the number read and the total.

        Raises:
            NoAnswerError: The device does not answer any more.
            BusError: The bus was lost.
        """
        identity = self.identify()
        known = [
            e
            for e in self.catalogue
            if e.is_readable
            and e.is_writable
            and not is_command(e.address, self.catalogue.profile)
            and e.parameter_class in classes
        ]
        wanted = [entry for entry in known if not entry.flags]
        tables: dict[str, dict[str, Item]] = {name: {} for name in CLASSES}
        not_read: list[str] = []
        if skipped_by_objflags := ", ".join(str(entry) for entry in known if entry.flags):
            not_read.append(f"{skipped_by_objflags}: excluded from scans or downloads by the ObjFlags of the EDS")
        for number, entry in enumerate(wanted, 1):
            try:
                data = self.read(entry.address)
                key, item = item_of(entry, data, self._scaling_for(entry))
            except BusError:
                raise
            except NoAnswerError as error:
                try:
                    self._check_that_it_answers()
                except NoAnswerError:
                    raise error from None
                not_read.append(f"{entry}: {error.what}")
                continue
            except (ValueError, DriveProfileError) as error:
                not_read.append(f"{entry}: {error}")
                continue
            finally:
                progress(number, len(wanted))
            tables[entry.parameter_class][key] = item
        return ParameterSet.model_validate({"header": self._header(identity, tuple(not_read)), **tables})

    def _header(self, identity: DeviceIdentity, not_read: tuple[str, ...]) -> Header:
        now = datetime.datetime.now(datetime.UTC)
        return Header(
            profile=self.profile.label if self.profile else "",
            node_id=self.node,
            title=identity.name,
            vendor_id=identity.vendor_id,
            product_code=identity.product_code,
            revision=identity.revision,
            serial_number=identity.serial_number,
            firmware=identity.firmware,
            date=now.isoformat(timespec="seconds"),
            not_read=not_read,
            counts_per_rev=self._counts,
            rated_torque_nm=self._torque_nm,
        ).model_copy(update=self._feed)


def identity_at(port: SdoPort) -> DeviceIdentity:
    """Read the identity of the device behind a port.

    Raises:
        NoAnswerError: The device does not answer.
    """

    def number(address: ObjectAddress) -> int | None:
        data = _ask(port, address)
        return None if data is None or not 1 <= len(data) <= 4 else int.from_bytes(data, "little")

    def text(index: int) -> str:
        try:
            data = _ask(port, (index, 0)) or b""
        except NoAnswerError:  # a name is not worth more; a node that is gone does not answer the next read either
            data = b""
        return "".join(c for c in data.decode("latin-1") if c.isprintable()).strip()[:64]

    known = ((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4))
    device_type, vendor, product, revision, serial = (number(address) for address in known)
    return DeviceIdentity(port.node, device_type, vendor, product, revision, serial, text(0x1008), text(0x100A))


def _ask(port: SdoPort, address: ObjectAddress) -> bytes | None:
    """Read an object; None if the device refuses."""
    try:
        return _read(port, address)
    except SdoAbortedError:
        return None


def _read(port: SdoPort, address: ObjectAddress, name: str = "", *, in_blocks: bool = False) -> bytes:
    """Read an object; retry once, since reading changes nothing."""
    try:
        return port.read(address, name, in_blocks=in_blocks)
    except NoAnswerError as first:
        try:
            return port.read(address, name, in_blocks=in_blocks)
        except NoAnswerError as second:  # the first names the object; the second may name only what follows a time-out
            raise second if isinstance(second, SharedNodeError) else first from None
