"""A CANopen slave without socket, thread or clock: frames and time in, frames and the next deadline out."""

from collections.abc import Callable, Sequence
from functools import partial

from drive_profiles.cia301 import (
    BROADCAST,
    MAX_NODE_ID,
    EmergencyCode,
    ErrorRegister,
    FunctionCode,
    NmtCommand,
    NmtState,
    SdoAbortCode,
    is_restricted,
)
from hil.can.frame import CAN_SFF_MASK, Frame
from plant_emulator.slave.dictionary import Dictionary, ResetKind
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.nmt import (
    ERROR_BEHAVIOUR,
    RESETS,
    SERVICES,
    TRANSITIONS,
    HeartbeatConsumer,
    HeartbeatProducer,
    Service,
)
from plant_emulator.slave.objects import ERROR_BEHAVIOUR as ERROR_BEHAVIOUR_OBJECT
from plant_emulator.slave.objects import SYNC_COB_ID
from plant_emulator.slave.pdo import PdoEngine, Tpdo
from plant_emulator.slave.sdo import SdoServer
from plant_emulator.slave.store import ParameterStore, StoreCommand, standard_commands

_NEVER = 1 << 63
_NMT_LENGTH = 2
_SYNC_CAUSE = "SYNC length"
_COMMANDS = {int(command): command for command in NmtCommand}


def _nothing(*_: object) -> None:
    """Stand in for a hook that the owner does not set."""


class Slave:
    """One node: dictionary, SDO server, PDOs, NMT, SYNC, heartbeats and emergencies, put together.

    No frame makes it raise, whatever its bytes; remote requests, error frames and 29-bit frames are ignored. Time is in
    ns and never goes back. A deadline that has passed is served before the frame that comes after it.

    Args:
        node_id: 1 to 127.
        dictionary: Brings at least the `communication_entries`; the node sets its node-ID and puts its defaults back.
        on_sync: Called with the time of each SYNC, when the TPDOs have been sampled and the RPDOs are in force.
        on_nmt: Called with the old and the new state.
        on_heartbeat_lost: Called with the number of a watched node.
        on_reset: Called when the dictionary has its stored values or defaults again and the boot-up message is about to be sent.
        sdo_max_bytes: The longest value that a client may write.
        sdo_timeout_ns: A client's silence that ends its transfer.
        store_commands: Entries that store or restore; those that the dictionary does not have are left out.
        store_time_ns: How long storing takes.

    Attributes:
        store: What survives a loss of power.
        on_routes: Called when the node may listen to other identifiers than before, or no longer.
        on_due: Called when `due` may be another than before.

    Raises:
        ValueError: No such node-ID, or the dictionary describes an impossible PDO.
        KeyError: The dictionary lacks an object of the `communication_entries`.
    """

    def __init__(
        self,
        node_id: int,
        dictionary: Dictionary,
        *,
        on_sync: Callable[[int], None] = _nothing,
        on_nmt: Callable[[NmtState, NmtState], None] = _nothing,
        on_heartbeat_lost: Callable[[int], None] = _nothing,
        on_reset: Callable[[ResetKind], None] = _nothing,
        sdo_max_bytes: int = 1024,
        sdo_timeout_ns: int = 5_000_000_000,
        store_commands: Sequence[StoreCommand] = standard_commands(),
        store_time_ns: int = 0,
    ) -> None:
        if not 1 <= node_id <= MAX_NODE_ID:
            raise ValueError(f"node-ID {node_id} is not in 1 to {MAX_NODE_ID}")
        self.node_id = node_id
        self.dictionary = dictionary
        self.on_sync = on_sync
        self.on_nmt = on_nmt
        self.on_heartbeat_lost = on_heartbeat_lost
        self.on_reset = on_reset
        self.on_routes: Callable[[], None] = _nothing
        self.on_due: Callable[[], None] = _nothing
        self._state = NmtState.INITIALISING
        self._now: int | None = None
        self._due = _NEVER
        self._out: list[Frame] = []
        self._event_driven: list[Tpdo] = []
        self._has_long_sync = False
        self._routes: dict[int, Callable[[bytes, int], None]] = {}
        self._sdo = SdoServer(dictionary, node_id, max_bytes=sdo_max_bytes, timeout_ns=sdo_timeout_ns)
        self._emergency = EmergencyProducer(dictionary, self._send)
        self._producer = HeartbeatProducer(dictionary, lambda: self._now or 0)
        self._consumer = HeartbeatConsumer(dictionary, self._lose, self._find, self._route)
        self.store = ParameterStore(dictionary, store_commands, store_time_ns)
        self._pdo = PdoEngine(dictionary, self._emergency, self._route)
        dictionary.on_write(SYNC_COB_ID, 0, self._set_sync)
        dictionary.node_id = node_id
        dictionary.reset(ResetKind.NODE)
        self._load()

    @property
    def nmt_state(self) -> NmtState:
        """The NMT state."""
        return self._state

    @property
    def emergency_causes(self) -> tuple[str, ...]:
        """The causes that are active, in the order in which they arose."""
        return self._emergency.causes

    @property
    def rejected_values(self) -> int:
        """Values of RPDOs that were not written, being out of range or refused by the owner."""
        return self._pdo.rejected

    @property
    def due(self) -> int | None:
        """The next instant at which `advance` must be called; None where only a frame can wake the node."""
        if self._out:
            return self._now
        if self._state is NmtState.INITIALISING or self._due == _NEVER:
            return None
        return self._due  # kept by `_reschedule`: the world asks at every SYNC

    @property
    def waits_for_changes(self) -> bool:
        """Whether there are event-driven TPDOs: `advance` must then be called when the owner may have changed an object."""
        return bool(self._pdo.event_driven)

    def listens(self, can_id: int) -> bool:
        """Tell whether the node does anything with frames of this identifier; the others need not be given to it before `due`."""
        return can_id in self._routes

    def power_on(self, now: int) -> list[Frame]:
        """Start, or start again after a loss of power: reset to what is kept, boot-up message, pre-operational."""
        self._set_time(now)
        self._out.clear()
        self._reset(ResetKind.NODE)
        return self._finish()

    def receive(self, frame: Frame, now: int) -> list[Frame]:
        """Give the answers to a frame.

        Raises:
            ValueError: `now` lies before the time of the last call.
        """
        if self._now is not None and now < self._now:
            raise self._backwards(now)
        self._now = now
        if now >= self._due:
            self._run_timers(now)
        can_id, data = frame
        # Flags of remote, error and extended frames make other numbers than any of these.
        route = self._routes.get(can_id)
        if route is not None:
            route(data, now)
            if self._event_driven:
                self._pdo.poll(now, self._out)
                self._reschedule()
        frames = self._out
        if frames:
            self._out = []
            return frames
        return []

    def advance(self, now: int) -> list[Frame]:
        """Give what time makes the node send, and the event-driven TPDOs whose objects the owner has changed.

        Raises:
            ValueError: `now` lies before the time of the last call.
        """
        self._set_time(now)
        self._run_timers(now)
        return self.take_frames()

    def take_frames(self) -> list[Frame]:
        """Give what waits to be sent; `receive` and `advance` do it by themselves."""
        frames, self._out = self._out, []
        return frames

    def raise_emergency(
        self, cause: str, code: int, register_bit: ErrorRegister = ErrorRegister.GENERIC, vendor_bytes: bytes = b""
    ) -> None:
        """Report an error under a name of the owner's choice; the frame goes with the next ones that are returned."""
        self._emergency.raise_cause(cause, code, register_bit, vendor_bytes)

    def clear_emergency(self, cause: str) -> None:
        """Withdraw an error; when it was the last, the master is told so."""
        self._emergency.clear_cause(cause)

    def _set_time(self, now: int) -> None:
        if self._now is not None and now < self._now:
            raise self._backwards(now)
        self._now = now

    def _backwards(self, now: int) -> ValueError:
        return ValueError(f"time went back from {self._now} ns to {now} ns")

    def _send(self, frame: Frame) -> None:
        self._out.append(frame)
        self.on_due()

    def _finish(self) -> list[Frame]:
        self._reschedule()
        return self.take_frames()

    def _reschedule(self) -> None:
        times = (self._producer.due, self._consumer.due, self._sdo.due, self._pdo.due)
        due = min((time for time in times if time is not None), default=_NEVER)
        if due != self._due:
            self._due = due
            self.on_due()

    def _run_timers(self, now: int) -> None:
        if self._state is NmtState.INITIALISING:
            return
        self._consumer.advance(now)
        self._out += self._sdo.advance(now)
        self._pdo.poll(now, self._out)
        if self._producer.is_due(now):
            self._out.append(Frame(FunctionCode.HEARTBEAT + self.node_id, bytes((self._state,))))
        self._reschedule()

    # Services

    def _on_command(self, data: bytes, _now: int) -> None:
        if len(data) != _NMT_LENGTH or data[1] not in {BROADCAST, self.node_id}:
            return
        command = _COMMANDS.get(data[0])
        target = None if command is None else TRANSITIONS.get((self._state, command))
        if command is None or target is None:
            return
        if command in RESETS:
            self._reset(RESETS[command])
        else:
            self._change(target)
        self._reschedule()

    def _on_sync(self, data: bytes, now: int) -> None:
        if len(data) > 1:  # it comes with or without the counter of 1019h
            self._emergency.raise_cause(_SYNC_CAUSE, EmergencyCode.SYNC_LENGTH, ErrorRegister.COMMUNICATION)
            self._has_long_sync = True
            return
        if self._has_long_sync:
            self._has_long_sync = False
            self._emergency.clear_cause(_SYNC_CAUSE)
        self._pdo.synchronise(self._out)
        self.on_sync(now)

    def _on_sdo(self, data: bytes, now: int) -> None:
        self._out += self._sdo.receive(data, now)
        self._reschedule()

    def _on_heartbeat(self, node_id: int, data: bytes, now: int) -> None:
        self._consumer.receive(node_id, data, now)
        self._reschedule()

    def _lose(self, node_id: int) -> None:
        self._emergency.raise_cause(f"heartbeat {node_id}", EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION)
        self.on_heartbeat_lost(node_id)
        # CiA 301, 7.5.2.32, and its default where the object is absent.
        place = ERROR_BEHAVIOUR_OBJECT, 1
        behaviour = self.dictionary.get_int(*place) if place in self.dictionary else 0
        target = ERROR_BEHAVIOUR.get(behaviour)
        if self._state is NmtState.OPERATIONAL and target is not None:
            self._change(target)

    def _find(self, node_id: int) -> None:
        self._emergency.clear_cause(f"heartbeat {node_id}")

    # State

    def _reset(self, kind: ResetKind) -> None:
        self._change(NmtState.INITIALISING)
        self.dictionary.reset(kind)
        self._emergency.reset(kind)
        self._load()
        # An error that the owner still has is told after the boot-up message, before which a node is silent.
        place = len(self._out)
        self._emergency.enabled = True
        self.on_reset(kind)
        self._out.insert(place, Frame(FunctionCode.HEARTBEAT + self.node_id, bytes((NmtState.INITIALISING,))))
        self._change(NmtState.PRE_OPERATIONAL)

    def _load(self) -> None:
        self._sync_id = self.dictionary.get_int(SYNC_COB_ID) & CAN_SFF_MASK
        self._producer.load()
        self._consumer.load()
        self._pdo.load()

    def _change(self, new: NmtState) -> None:
        old, self._state = self._state, new
        if old is new:
            return
        services = SERVICES[new]
        self._emergency.enabled = Service.EMERGENCY in services
        if Service.SDO not in services:
            self._sdo.reset()
        if Service.PDO in services:
            self._pdo.start()
        else:
            self._pdo.stop()
        self._route()
        self.on_nmt(old, new)

    def _set_sync(self, cob_id: int) -> SdoAbortCode | None:
        # CiA 301, 7.5.2.5: bit 31 does not care; bit 30, to generate SYNC, and 29-bit identifiers are not supported.
        can_id = cob_id & 0x7FFF_FFFF
        if can_id > CAN_SFF_MASK or is_restricted(can_id):
            return SdoAbortCode.INVALID_VALUE
        self._sync_id = can_id
        self._route()
        return None

    def _route(self) -> None:
        """Look up which identifiers concern the node now; what comes later here wins."""
        services = SERVICES[self._state]
        self._event_driven = self._pdo.event_driven
        routes: dict[int, Callable[[bytes, int], None]] = {}
        if self._state is not NmtState.INITIALISING:
            routes |= self._pdo.listeners
            if Service.SYNC in services:
                routes[self._sync_id] = self._on_sync
            for node_id in self._consumer.nodes:
                routes[FunctionCode.HEARTBEAT + node_id] = partial(self._on_heartbeat, node_id)
            if Service.SDO in services:
                routes[FunctionCode.SDO_REQUEST + self.node_id] = self._on_sdo
            routes[FunctionCode.NMT] = self._on_command
        self._routes = routes
        self.on_routes()
        self.on_due()
