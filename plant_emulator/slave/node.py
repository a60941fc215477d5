"""A CANopen slave: frames and time in, frames and next deadline out."""

from collections.abc import Callable, Sequence
from functools import partial

from drive_profiles.standard.cia301 import (
    BROADCAST,
    MAX_NODE_ID,
    EmergencyCode,
    ErrorRegister,
    FunctionCode,
    NmtCommand,
    NmtState,
)
from drive_profiles.standard.cia305 import LSS_REQUEST, LSS_RESPONSE, UNCONFIGURED
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary, ResetKind
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.error_control import MASTER, ErrorControl
from plant_emulator.slave.lss import LssSlave
from plant_emulator.slave.nmt import ERROR_BEHAVIOUR, RESETS, SERVICES, TRANSITIONS, NmtService
from plant_emulator.slave.objects import ERROR_BEHAVIOUR as ERROR_BEHAVIOUR_OBJECT
from plant_emulator.slave.pdo.engine import PdoEngine
from plant_emulator.slave.pdo.rpdo import Rpdo
from plant_emulator.slave.pdo.tpdo import Tpdo
from plant_emulator.slave.sdo.channels import SdoChannels
from plant_emulator.slave.sdo.server import SdoServer, is_read
from plant_emulator.slave.store import ParameterStore, StoreCommand, standard_commands
from plant_emulator.slave.sync import SyncConsumer
from plant_emulator.slave.time_of_day import TimeConsumer

_NEVER = 1 << 63
_NMT_LENGTH = 2
_BUS_OFF = "bus-off"
_COMMANDS = {int(command): command for command in NmtCommand}


def _nothing(*_: object) -> None:
    """Stand in for a hook that the owner does not set."""


class Slave:
    """One node with all its CANopen services.

    No frame raises an exception, whatever its bytes. Error frames and 29-bit frames are ignored. So are remote requests, but
    for those for TPDOs and, while the node sends no heartbeats, for its NMT state (node guarding). Time is in ns and never
    decreases. A deadline that has passed is served before the next frame.

    Args:
        node_id: 1 to 127, or `UNCONFIGURED`: then it stays initialising until an LSS master gives it one.
        dictionary: Must have at least the `communication_entries`; the node sets its node-ID and puts its defaults back.
        sdo_max_bytes: The longest value that a client may write.
        sdo_timeout_ns: A client's silence that ends its transfer.
        store_commands: Entries that store or restore; those that the dictionary does not have are left out.
        autostart: The node becomes operational by itself after its boot-up message.

    Attributes:
        emergencies: The active errors, by causes that their owner names; their frames go out with the next ones.
        lss: The LSS slave, with the node-ID that an LSS master has configured.
        on_sync: Called with the time of each SYNC, when the TPDOs have been sampled and the RPDOs are in force.
        on_nmt: Called with the old and the new state.
        on_heartbeat_lost: Called with the number of a watched node; with 0 if the NMT master (life guarding) or the whole
            bus is lost.
        on_rpdo_timeout: Called with the number of an RPDO, 1 for the first, that has not come within its event timer.
        on_reset: Called when the dictionary has its stored values or defaults again and the boot-up message is about to be sent.
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
        sdo_max_bytes: int = 1024,
        sdo_timeout_ns: int = 5_000_000_000,
        store_commands: Sequence[StoreCommand] = standard_commands(),
        store_time_ns: int = 0,
        autostart: bool = False,
    ) -> None:
        if not 1 <= node_id <= MAX_NODE_ID and node_id != UNCONFIGURED:
            raise ValueError(f"node-ID {node_id}: expected 1 to {MAX_NODE_ID}, or {UNCONFIGURED} for none")
        self.dictionary = dictionary
        self.on_sync: Callable[[int], None] = _nothing
        self.on_nmt: Callable[[NmtState, NmtState], None] = _nothing
        self.on_heartbeat_lost: Callable[[int], None] = _nothing
        self.on_rpdo_timeout: Callable[[int], None] = _nothing
        self.on_reset: Callable[[ResetKind], None] = _nothing
        self.on_routes: Callable[[], None] = _nothing
        self.on_due: Callable[[], None] = _nothing
        self._autostart = autostart
        self._state = NmtState.INITIALISING
        self._now: int | None = None
        self._due = _NEVER
        self._out: list[Frame] = []
        self._event_driven: list[Tpdo] = []
        self._routes: dict[int, Callable[[bytes, int], None]] = {}
        make_server = partial(SdoServer, dictionary, max_bytes=sdo_max_bytes, timeout_ns=sdo_timeout_ns)
        self._sdo = SdoChannels(dictionary, make_server, self._route)
        self.lss = LssSlave(dictionary, node_id, lambda: not self.store.fails, self._start_configured)
        self.emergencies = EmergencyProducer(dictionary, self._send, self._clock, self._reschedule)
        self._error_control = ErrorControl(
            dictionary,
            self.emergencies,
            send=self._send,
            clock=self._clock,
            state=lambda: self._state,
            lost=self._on_lost,
            rerouted=self._route,
            rescheduled=self._reschedule,
        )
        self._time = TimeConsumer(dictionary, self._route)
        self.store = ParameterStore(dictionary, store_commands, store_time_ns)
        self._sync = SyncConsumer(dictionary, self.emergencies, lambda: self._pdo.sort())  # noqa: PLW0108 - made below
        self._pdo = PdoEngine(
            dictionary,
            emergency=self.emergencies,
            sync=self._sync,
            changed=self._route,
            send=self._send,
            on_started=self._reschedule,
            on_missing=lambda number: self.on_rpdo_timeout(number),  # noqa: PLW0108 - an owner sets another
        )
        if node_id != UNCONFIGURED:
            dictionary.renumber(node_id)
            dictionary.reset(ResetKind.NODE)
            self._load()

    @property
    def node_id(self) -> int:
        """Node-ID in force.

        An LSS master may change it, with a reset of communication.
        """
        return self.lss.active

    @property
    def nmt_state(self) -> NmtState:
        """The NMT state."""
        return self._state

    @property
    def time_of_day(self) -> int | None:
        """Network's time of day, ns since 1984-01-01 00:00; None before any TIME."""
        return self._time.at(self._clock())

    @property
    def due(self) -> int | None:
        """Next instant to call `advance`; None if only frames wake it."""
        if self._out:
            return self._now
        if self._state is NmtState.INITIALISING or self._due == _NEVER:
            return None
        return self._due  # kept by `_reschedule`: the world asks at every SYNC

    @property
    def waits_for_changes(self) -> bool:
        """True if there are event-driven TPDOs."""
        return bool(self._pdo.event_driven)

    def listens(self, can_id: int) -> bool:
        """Return True if the node processes frames of this identifier."""
        return can_id in self._routes

    @property
    def plain_pdos(self) -> tuple[list[Rpdo], list[Tpdo]] | None:
        """RPDOs and TPDOs of a node whose SYNC has no counter and no window.

        They are empty unless the node is operational. The result is None if a SYNC means more to the node than that they act: see
        `PdoEngine.plain`.
        """
        sync = self._sync
        if sync.overflow or sync.window_ns or sync.can_id != FunctionCode.SYNC:
            return None
        return self._pdo.plain

    @property
    def tpdo_delay_ns(self) -> int:
        """Time by which a TPDO leaves later than its SYNC."""
        return 0

    @property
    def is_settled(self) -> bool:
        """True if nothing waits for a SYNC, and the last PDOs and SYNC had the right length."""
        return self._sync.is_plain and self._pdo.is_settled

    def pass_to(self, now: int) -> None:
        """Note the time of a SYNC that was processed without the node."""
        self._now = now

    def power_on(self, now: int) -> list[Frame]:
        """Start, or restart after a loss of power."""
        self._set_time(now)
        self._out.clear()
        self._reset(ResetKind.NODE)
        self._reschedule()
        return self.take_frames()

    def receive(self, frame: Frame, now: int) -> list[Frame]:
        """Return the answers to a frame.

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
        """Return the frames that are due at an instant.

        They include event-driven TPDOs whose objects the owner has changed.

        Raises:
            ValueError: `now` lies before the time of the last call.
        """
        self._set_time(now)
        self._run_timers(now)
        return self.take_frames()

    def take_frames(self) -> list[Frame]:
        """Return the frames that wait to be sent."""
        frames, self._out = self._out, []
        return frames

    def bus_off(self) -> None:
        """Note a controller's bus-off; 1029h decides on this communication error."""
        self._on_lost(MASTER)
        self._reschedule()

    def bus_recovered(self) -> None:
        """Note that the controller has recovered from bus-off.

        An emergency that is cleared at once reports the recovery to the master.
        """
        self.emergencies.raise_cause(_BUS_OFF, EmergencyCode.BUS_OFF_RECOVERED, ErrorRegister.COMMUNICATION)
        self.emergencies.clear_cause(_BUS_OFF)

    def _clock(self) -> int:
        return self._now or 0

    def _set_time(self, now: int) -> None:
        if self._now is not None and now < self._now:
            raise self._backwards(now)
        self._now = now

    def _backwards(self, now: int) -> ValueError:
        return ValueError(f"time went back from {self._now} ns to {now} ns")

    def _send(self, frame: Frame) -> None:
        self._out.append(frame)
        self.on_due()

    def _reschedule(self) -> None:
        due = _NEVER
        for time in (self._error_control.due, self.emergencies.due, self._sdo.due, self._pdo.due):
            if time is not None and time < due:
                due = time
        if due != self._due:
            self._due = due
            self.on_due()

    def _run_timers(self, now: int) -> None:
        if self._state is NmtState.INITIALISING:
            return
        self.emergencies.advance(now)
        self._error_control.advance(now)
        self._out += self._sdo.advance(now)
        self._pdo.check_deadlines(now)
        self._pdo.poll(now, self._out)
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
        sync = self._sync
        if (data or not sync.is_plain) and not sync.accepts(data, now):
            return
        self._pdo.synchronise(self._out)
        self.on_sync(now)

    def _on_sdo(self, server: SdoServer, data: bytes, now: int) -> None:
        due = self._sdo.due
        self._out += self._sdo.receive(server, data, now)
        if due is not None or self._sdo.due is not None or not is_read(data):  # a read leaves all as it was
            self._reschedule()

    def _on_lss(self, data: bytes, _now: int) -> None:
        answer = self.lss.receive(data)
        if answer is not None:
            self._out.append(Frame(LSS_RESPONSE, answer))

    def _start_configured(self) -> None:
        self._reset(ResetKind.COMMUNICATION)
        self._reschedule()

    def _on_lost(self, node_id: int) -> None:
        self.on_heartbeat_lost(node_id)
        # CiA 301, 7.5.2.32, and its default where the object is absent.
        address = ERROR_BEHAVIOUR_OBJECT, 1
        behaviour = self.dictionary.get_int(*address) if address in self.dictionary else 0
        target = ERROR_BEHAVIOUR.get((self._state, behaviour))
        if target is not None:
            self._change(target)

    # State

    def _reset(self, kind: ResetKind) -> None:
        self._change(NmtState.INITIALISING)
        if kind is ResetKind.NODE:
            self.lss.reload()
            self._time.forget()
        self.lss.activate()
        has_node_id = self.node_id != UNCONFIGURED
        if has_node_id:
            self.dictionary.renumber(self.node_id)
        self.dictionary.reset(kind)
        self.emergencies.reset(kind)
        if has_node_id:
            self._load()
        # An error that the owner still has is reported after the boot-up message, before which a node is silent.
        before_boot_up = len(self._out)
        self.emergencies.enable(has_node_id)
        self.on_reset(kind)
        if not has_node_id:
            self._route()
            return
        self._out.insert(before_boot_up, self._error_control.boot_up())
        self._change(NmtState.PRE_OPERATIONAL)
        if self._autostart:
            self._change(NmtState.OPERATIONAL)

    def _load(self) -> None:
        self.emergencies.load()
        self._error_control.load(self.node_id)
        self._time.load()
        self._sync.load()
        self._sdo.load()
        self._pdo.load()

    def _change(self, new: NmtState) -> None:
        old, self._state = self._state, new
        if old is new:
            return
        services = SERVICES[new]
        self.emergencies.enable(NmtService.EMERGENCY in services)
        if NmtService.LSS not in services:
            self.lss.wait()
        if NmtService.SDO not in services:
            self._sdo.reset()
        if NmtService.PDO in services:
            self._pdo.start()
        else:
            self._pdo.stop()
        self._route()
        self.on_nmt(old, new)

    def _route(self) -> None:
        """Look up the identifiers that concern the node now; later entries win."""
        services = SERVICES[self._state]
        self._event_driven = self._pdo.event_driven
        routes: dict[int, Callable[[bytes, int], None]] = {}
        if NmtService.LSS in services and (self._state is not NmtState.INITIALISING or self.node_id == UNCONFIGURED):
            routes[LSS_REQUEST] = self._on_lss
        if self._state is not NmtState.INITIALISING:
            routes |= self._pdo.listeners
            if NmtService.SDO in services:
                routes |= {can_id: partial(self._on_sdo, server) for can_id, server in self._sdo.servers.items()}
            if NmtService.TIME in services and self._time.can_id is not None:
                routes[self._time.can_id] = self._time.receive
            if NmtService.SYNC in services:
                routes[self._sync.can_id] = self._on_sync
            routes |= self._error_control.routes
            routes[FunctionCode.NMT] = self._on_command
        self._routes = routes
        self.on_routes()
        self.on_due()


class SlaveNode:
    """A node of the world, with a slave underneath."""

    slave: Slave

    @property
    def node_id(self) -> int:
        """Node-ID of the node."""
        return self.slave.node_id

    def power_on(self, now: int) -> list[Frame]:
        """Start; return the boot-up frame."""
        return self.slave.power_on(now)

    def advance(self, now: int) -> list[Frame]:
        """Let time pass up to now."""
        return self.slave.advance(now)
