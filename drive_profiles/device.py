"""A device behind an SDO port, with what is known of it: who it is, whether it stands, how it counts, what it holds."""

from __future__ import annotations

import contextlib
import datetime
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

from drive_profiles.catalogue import Catalogue, Entry
from drive_profiles.cia301 import DataType, NmtCommand, SdoAbortCode, decode
from drive_profiles.cia402 import Object, State, state_of
from drive_profiles.errors import DriveProfileError, NoAnswerError, NodeError, OutOfRangeError, RefusedError, SdoAbortedError
from drive_profiles.parameter import Place, place_of
from drive_profiles.parameters import CLASSES, Header, Item, ParameterSet, Write, is_command, item_of
from drive_profiles.profile import Profile
from drive_profiles.sdo import SdoPort
from drive_profiles.units import Scaling

_MOVING = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
_POLL_S = 0.05
_AXIS_STEP = 0x800
_DRIVE = 402
"""Device profile number in the lower half of 1000h."""


@dataclass(frozen=True)
class Found:
    """Who answers at a node.

    Attributes:
        node: Its id.
        device_type: 1000h.
        vendor_id: 1018h:1; None, as all below, where the device does not say it.
        product_code: 1018h:2.
        revision: 1018h:3.
        serial_number: 1018h:4.
        name: 1008h.
        firmware: 100Ah.
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
        """Whether it says that it is a CiA 402 device."""
        return self.device_type is not None and self.device_type & 0xFFFF == _DRIVE


class Device:
    """One node, its profile and its objects.

    Attributes:
        port: Its SDO client.
        catalogue: What is known of its objects.
    """

    def __init__(self, port: SdoPort, catalogue: Catalogue, nmt: Callable[[NmtCommand, int], None] | None = None) -> None:
        """Join them; nothing is sent.

        Args:
            port: Its SDO client.
            catalogue: What is known of its objects.
            nmt: Sends an NMT command to a node; needed to reset it.
        """
        self.port = port
        self.catalogue = catalogue
        self._nmt = nmt
        self._counts: int | None = None
        self._feed: dict[str, int] = {}
        self._torque_nm: float | None = None

    @property
    def node(self) -> int:
        """Its id."""
        return self.port.node

    @property
    def profile(self) -> Profile | None:
        """Its family."""
        return self.catalogue.profile

    def name_of(self, place: Place) -> str:
        """What the object is called."""
        entry = self.catalogue.get(place)
        return "" if entry is None else entry.name

    def read(self, place: Place) -> bytes:
        """An object's bytes; a read that is not answered is tried once more, since nothing can come of it.

        Raises:
            SdoAbortedError: The device refuses; the vendor's words where the profile has them.
            NoAnswerError: It is silent twice.
        """
        try:
            return _read(self.port, place, self.name_of(place))
        except SdoAbortedError as error:
            raise self._in_words(error) from None

    def write(self, place: Place, data: bytes, value: object = None, timeout_s: float | None = None) -> None:
        """Write an object's bytes, once.

        Raises:
            SdoAbortedError: The device refuses; the vendor's words where the profile has them.
            NoAnswerError: It is silent; whether it has taken the value is not known.
        """
        try:
            self.port.write(place, data, self.name_of(place), value, timeout_s)
        except SdoAbortedError as error:
            raise self._in_words(error) from None

    def _in_words(self, error: SdoAbortedError) -> SdoAbortedError:
        for abort in self.profile.aborts if self.profile else ():
            if abort.code == error.code:
                return SdoAbortedError(error.node, error.index, error.subindex, error.code, error.name, error.action, abort.text)
        return error

    def identify(self) -> Found:
        """Ask it who it is; an identity object that it does not have is None.

        Raises:
            NoAnswerError: It is silent.
        """
        return found_at(self.port)

    def state(self) -> State | None:
        """CiA 402 state; None where the device has no status word."""
        try:
            word = decode(DataType.UNSIGNED16, self.read((Object.STATUS_WORD, 0)))
        except (SdoAbortedError, ValueError):
            return None
        return state_of(int(word))

    def check_quiet(self, axes: Collection[int] = (0,)) -> None:
        """Refuse a drive that is enabled: its gains are not touched while a motor is under torque.

        Args:
            axes: Of a device with several axes (CiA 402: objects of axis n are at + 800h n), those that are concerned.

        Raises:
            NodeError: It is, or its state cannot be read.
        """
        for axis in axes:
            place = (Object.STATUS_WORD + _AXIS_STEP * axis, 0)
            try:
                data = self.read(place)
            except SdoAbortedError as error:
                is_drive = self.profile is not None and self.profile.kind == "drive"
                if (is_drive and axis == 0) or error.code not in {SdoAbortCode.NO_OBJECT, SdoAbortCode.NO_SUBINDEX}:
                    raise NodeError(self.node, f"its state cannot be read ({error})", "nothing has been written") from None
                continue  # no drive, or no such axis
            state = state_of(int.from_bytes(data, "little"))
            if state is None:
                raise NodeError(self.node, f"its status word {data.hex(' ')} is no state of CiA 402", "is it a drive?")
            if state in _MOVING:
                raise NodeError(self.node, f"it is in state {state.value!r}", "disable it first; it is not written to")

    def reset(self, within_s: float) -> None:
        """Reset the node as a loss of power would, and wait until it answers again.

        Raises:
            NoAnswerError: It does not say that it has started, or does not answer then, in time.
            RefusedError: There is no way to send it an NMT command.
        """
        if self._nmt is None:
            raise RefusedError(f"node {self.node} cannot be reset here")
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

    def scaling(self, entries: Collection[Entry]) -> Scaling | None:
        """How the drive counts, as far as these objects need it; None where none does.

        Raises:
            RefusedError: The profile does not say where the drive tells it.
            OutOfRangeError: The drive holds a zero there.
        """
        needed = {str(entry.parameter.scale) for entry in entries if entry.parameter is not None and entry.needs_scaling}
        if not needed:
            return None
        if "counts" in needed and self._counts is None:
            self._counts, self._feed = self._counts_per_rev(), self._feed_constant()
        if "per mille" in needed and self._torque_nm is None:
            self._torque_nm = self._rated_torque_nm()
        # what is not needed gets a stand-in; what is needed and 0 is refused by the scaling itself
        scaling = Scaling(1 if self._counts is None else self._counts, 1.0 if self._torque_nm is None else self._torque_nm)
        return replace(scaling, **self._feed) if "counts" in needed else scaling

    def scaling_places(self) -> set[Place]:
        """The objects that decide what a step of others is worth."""
        encoder = self.profile.encoder if self.profile else None
        torque = self.profile.torque if self.profile else None
        named = [torque.rated_torque] if torque else []
        if encoder:
            named += [encoder.increments, encoder.revolutions]
            if encoder.feed:
                named += [encoder.feed, encoder.feed_shaft_revs, encoder.gear_motor_revs, encoder.gear_shaft_revs, *encoder.zero]
        return {place_of(address) for address in named if address}

    def _scaling_for(self, entry: Entry) -> Scaling | None:
        """How the drive counts for this entry; None where it cannot be known."""
        try:
            return self.scaling([entry])
        except (RefusedError, OutOfRangeError, SdoAbortedError):
            return None

    def _counts_per_rev(self) -> int:
        facts = self.profile.encoder if self.profile else None
        if facts is None or (facts.increments is None and facts.counts_per_rev is None):
            raise RefusedError(f"node {self.node}: no object is known that says how its encoder counts")
        if facts.increments is None:
            return facts.counts_per_rev or 0
        increments = self._number(facts.increments)
        revolutions = 1 if facts.revolutions is None else self._number(facts.revolutions)
        if revolutions <= 0 or increments % revolutions:
            what = f"node {self.node}, {facts.increments}"
            raise OutOfRangeError(what, f"{increments}/{revolutions}", "counts/rev", "must be a whole number per revolution")
        return increments // revolutions

    def _feed_constant(self) -> dict[str, int]:
        """What of its scaling 6091h and 6092h decide, where the profile says that positions are counted by them."""
        facts = self.profile.encoder if self.profile else None
        if facts is None:
            return {}
        for address in facts.zero:
            if self._number(address):
                raise RefusedError(f"node {self.node} counts in units of its own: {address} is not 0")
        named = {
            "gear_motor_revs": facts.gear_motor_revs,
            "gear_shaft_revs": facts.gear_shaft_revs,
            "feed": facts.feed,
            "feed_shaft_revs": facts.feed_shaft_revs,
        }
        return {name: self._number(address) for name, address in named.items() if address} if facts.feed else {}

    def _rated_torque_nm(self) -> float:
        facts = self.profile.torque if self.profile else None
        if facts is None or facts.rated_torque is None:
            raise RefusedError(f"node {self.node}: no object is known that holds its rated torque")
        return self._number(facts.rated_torque) * facts.rated_torque_step_nm

    def _number(self, address: str) -> int:
        return int.from_bytes(self.read(place_of(address)), "little")

    def resolve(self, parameter_set: ParameterSet, classes: Collection[str] = CLASSES, *, limits: bool = True) -> list[Write]:
        """What each line of a set means in bytes on this very drive; see `ParameterSet.writes`."""
        named = {key for _, key, item in parameter_set.items() if item.type is None}
        scaling = self.scaling([entry for entry in self.catalogue if entry.needs_scaling and entry.name in named])
        return parameter_set.writes(self.catalogue, scaling, classes=classes, limits=limits)

    def pull(
        self, classes: Collection[str] = CLASSES, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> ParameterSet:
        """Read every value that could be written back: the set that this device is.

        What it refuses or what makes no sense is listed in the header's ``not_read``, never left out in silence.

        Raises:
            NoAnswerError: It is silent.
        """
        found = self.identify()
        wanted = [
            e
            for e in self.catalogue
            if e.is_readable and e.is_writable and not is_command(e.place) and e.parameter_class in classes
        ]
        held = _Held()
        for number, entry in enumerate(wanted, 1):
            try:
                data = self.read(entry.place)
                key, item = item_of(entry, data, self._scaling_for(entry))
            except NodeError:
                raise
            except (ValueError, DriveProfileError) as error:
                held.not_read.append(f"{entry}: {error}")
                continue
            finally:
                progress(number, len(wanted))
            held.tables[entry.parameter_class][key] = item
        return ParameterSet.model_validate({"header": self._header(found, tuple(held.not_read)), **held.tables})

    def _header(self, found: Found, not_read: tuple[str, ...]) -> Header:
        now = datetime.datetime.now(datetime.UTC)
        return Header(
            profile=self.profile.name if self.profile else "",
            node_id=self.node,
            title=found.name,
            vendor_id=found.vendor_id,
            product_code=found.product_code,
            revision=found.revision,
            serial_number=found.serial_number,
            firmware=found.firmware,
            date=now.isoformat(timespec="seconds"),
            not_read=not_read,
        )


@dataclass
class _Held:
    """What a pull collects."""

    tables: dict[str, dict[str, Item]] = field(default_factory=lambda: {name: {} for name in CLASSES})
    not_read: list[str] = field(default_factory=list)


def found_at(port: SdoPort) -> Found:
    """Ask a node who it is.

    Raises:
        NoAnswerError: It is silent.
    """

    def number(index: int, subindex: int) -> int | None:
        data = _ask(port, (index, subindex))
        return None if data is None or not 1 <= len(data) <= 4 else int.from_bytes(data, "little")

    def text(index: int) -> str:
        data = _ask(port, (index, 0)) or b""
        return "".join(c for c in data.decode("latin-1") if c.isprintable()).strip()[:64]

    return Found(
        port.node,
        number(0x1000, 0),
        number(0x1018, 1),
        number(0x1018, 2),
        number(0x1018, 3),
        number(0x1018, 4),
        text(0x1008),
        text(0x100A),
    )


def _ask(port: SdoPort, place: Place) -> bytes | None:
    """A read that may be refused."""
    try:
        return _read(port, place)
    except SdoAbortedError:
        return None


def _read(port: SdoPort, place: Place, name: str = "") -> bytes:
    """A read that is not answered is tried once more, since nothing can come of it."""
    try:
        return port.read(place, name)
    except NoAnswerError:
        return port.read(place, name)
