"""The emulated servo drive: CANopen slave, CiA 402 state machine, modes and servo law, joined to one axis of the robot."""

from collections.abc import Callable

from drive_profiles.cia301 import EmergencyCode, NmtState, SdoAbortCode
from drive_profiles.cia402 import (
    FOLLOWING_ERROR,
    INTERNAL_LIMIT,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    WARNING,
    AbortConnectionOption,
    Mode,
    Object,
    State,
    status_bits,
)
from drive_profiles.units import Scaling
from hil.can.frame import Frame
from plant_emulator import motion as law
from plant_emulator.axes import Axes, live
from plant_emulator.delays import slave_with
from plant_emulator.drive_data import DriveData
from plant_emulator.faults import FAULTS, RPDO_TIMEOUT, TORQUE_OFF, TORQUE_OFF_FAULT, Faults
from plant_emulator.inputs import DigitalInputs
from plant_emulator.limit_switches import LimitSwitches
from plant_emulator.mode_selection import ModeSelection
from plant_emulator.modes.table import modes_of
from plant_emulator.option_codes import OptionCodes
from plant_emulator.personalities import personality_of
from plant_emulator.personality import Personality
from plant_emulator.power_stage import PowerStage
from plant_emulator.slave.dictionary import ResetKind
from plant_emulator.slave.node import Slave
from plant_emulator.state_machine import (
    POWERED,
    Action,
    Power,
    Step,
    commanded,
    disconnected,
    failed,
    initialised,
    restarted,
    stopped,
    torque_lost,
)
from plant_emulator.touch_probe import TouchProbes


class Drive:
    """A servo drive on the bus, sans IO: `receive`, `advance`, `due` as every node; `update` after each advance of the axes.

    Attributes:
        slave: The CANopen engine underneath.
        data: The process data, between the dictionary and the axis.
        stage: The power stage.
        inputs: The digital inputs, safe torque off among them.
        probes: The touch probes.
        limit_switches: What the limit switches do to the motion.
        personality: The drive's manufacturer: which drive it is, and what of it is not emulated.
        on_state: Called with the state before and the new one, before the power stage follows.
        stops: Whether there is something to be watched by `update`: a stop, a set-point that waits, a homing run.
    """

    def __init__(self, axes: Axes, number: int, personality: Personality | None = None) -> None:
        """Join an axis to a node with the id that the robot file gives it.

        Args:
            axes: The mechanics.
            number: Axis number.
            personality: The drive's manufacturer; left out, the one that the robot file names.

        Raises:
            DriveProfileError: There is no such profile, or its file or the EDS file has errors.
            ValueError: The profile is no drive's.
        """
        self.axes, self.row = axes, axes.row(number)
        self._trip, self._event, self._limited = (live(axes.motion, field) for field in ("trip", "event", "limited"))
        self._stopped, self._following_count = live(axes.motion, "stopped"), live(axes.motion, "following_count")
        self.behaviour = axes.robot.axis[number].behaviour
        self.personality = personality_of(axes.robot, number) if personality is None else personality
        dictionary = self.personality.dictionary
        store_time_s = min(axes.robot.axis[number].store_time_s, self.personality.store_limit_s)
        self.slave: Slave = slave_with(
            self.behaviour,
            axes.robot.seed + number,
            axes.robot.node_ids[number],
            dictionary,
            store_commands=self.personality.store_commands,
            store_time_ns=round(1e9 * store_time_s),
            autostart=self.behaviour.operational_at_boot,
        )
        self._power, self._has_power, self.stops = Power(), False, False
        self._has_torque_off = False
        self.on_state: Callable[[State, State], None] = lambda before, after: None
        self._held: Step | None = None
        self._held_until: int | None = None
        self._latest: int | None = None
        self._is_word_fresh = False
        self.data = DriveData(axes, number, self.personality, self._is_powered)
        self._value = self.data.value
        self.inputs = DigitalInputs(axes, number, dictionary)
        self.stage = PowerStage(axes, self.row, self.data)
        self.limit_switches = LimitSwitches(self.stage, self.inputs)
        self.probes = TouchProbes(dictionary, self.inputs, self.data.shown_position)
        self._faults = Faults(self.slave)
        modes = modes_of(self.stage, self.inputs, self.behaviour)
        self._modes = ModeSelection(
            self.slave,
            self.stage,
            {number: modes[number] for number in self.personality.modes},
            self._faults,
            self.limit_switches,
            power=lambda: self._power,
            halt_blocks=self.behaviour.halt_blocks_mode_change,
        )
        self._options = OptionCodes(self.personality, self.behaviour)
        self._bind()
        self._faults.on_lack = self._set_plain_status_word
        self._stand_in(Power())
        self.personality.bind(axes, self.row, self._is_powered)
        self.data.apply()

    def _bind(self) -> None:
        slave, dictionary = self.slave, self.slave.dictionary
        self.inputs.on_sto, self.inputs.on_force = self._set_torque_off, self._mark
        slave.on_nmt = self._on_nmt
        slave.on_heartbeat_lost = self._on_heartbeat_lost
        slave.on_reset = self._on_reset
        slave.on_rpdo_timeout = self._on_rpdo_timeout
        slave.store.may_store = lambda: SdoAbortCode.DEVICE_STATE if self._is_powered() else None
        dictionary.on_read(Object.STATUS_WORD, 0, self._status_word)
        dictionary.on_write(Object.CONTROL_WORD, 0, self._write_control_word)

    @property
    def scaling(self) -> Scaling:
        """How the drive counts."""
        return self.data.scaling

    @property
    def state(self) -> State:
        """State of the power drive system."""
        return self._power.state

    @property
    def mode(self) -> Mode | None:
        """The mode that acts; None where there is no torque."""
        return None if self._modes.acting is None else self._modes.acting.number

    def _is_powered(self) -> bool:
        return self._has_power

    # -- the node, for the world ---------------------------------------------------------------------------------------

    @property
    def node_id(self) -> int:
        """The node's id."""
        return self.slave.node_id

    @property
    def due(self) -> int | None:
        """The next instant, in ns, at which `advance` must be called."""
        return self.slave.due

    def power_on(self, now: int) -> list[Frame]:
        """Start, or start again after a loss of power: the boot-up frame. What was not stored is lost."""
        self._restart()
        return self.slave.power_on(now)

    def receive(self, frame: Frame, now: int) -> list[Frame]:
        """Take any frame from the bus; what the drive answers."""
        return self.slave.receive(frame, now)

    def advance(self, now: int) -> list[Frame]:
        """Let time pass up to now."""
        return self.slave.advance(now)

    def update(self, now: int) -> list[Frame]:
        """Look at what the axis has done since the last call: broken limits, finished stops, waiting set-points.

        After each advance of the axes.

        Args:
            now: The time, in ns.
        """
        trip = self._trip[self.row]
        if trip:
            self._trip[self.row] = 0
            for bit, cause, code in FAULTS:
                if trip & bit:
                    self._fault(cause, code)
        if self._event[self.row]:
            self.inputs.dispatch()
        if self._held is not None:
            self._wait_for_transition(now)
        acting = self._modes.acting
        if self._is_stopping:
            if self.stage.is_stopped:
                self._end_stop()
        elif acting is not None:
            if acting.watches:
                acting.look()
            if self.limit_switches.are_there:
                self.limit_switches.look(acting)
        self._mark()
        return self.slave.take_frames()

    def _mark(self) -> None:
        """Say whether `update` has something to watch."""
        self.stops = (
            self._is_stopping
            or self._held is not None
            or (self._modes.acting is not None and (self._modes.acting.watches or self.limit_switches.are_there))
        )

    # -- status and mode -----------------------------------------------------------------------------------------------

    def _stand_in(self, power: Power) -> None:
        """Be in a state, with what every SYNC asks of it: to look a state up costs more than the rest of a status word."""
        before, state = self._power.state, power.state
        self._power = power
        self._has_power = state in POWERED
        self._is_enabled = state is State.OPERATION_ENABLED
        self._is_stopping = self._has_power and (not self._is_enabled or power.leaving is not None)
        self._is_following = self._is_enabled and not self._is_stopping
        self._set_plain_status_word()
        self._mark()
        if state is not before:
            self.on_state(before, state)

    def _set_plain_status_word(self) -> None:
        word = status_bits(self.state) | REMOTE
        if not self._has_torque_off:
            word |= VOLTAGE_ENABLED
        if self._faults.is_lacking:
            word |= WARNING
        self._plain_status_word = word

    def _status_word(self) -> int:
        word, row = self._plain_status_word, self.row
        acting = self._modes.acting
        if self._is_enabled and acting is not None:
            word |= acting.status()
        else:
            if self._following_count[row] > 0:
                word |= FOLLOWING_ERROR
            if self._has_power and self._stopped[row]:
                word |= TARGET_REACHED
        if self._limited[row] or self.limit_switches.blocked:
            word |= INTERNAL_LIMIT
        return word

    # -- state machine -------------------------------------------------------------------------------------------------

    def _write_control_word(self, word: int) -> None:
        """Run the state machine on a control word until it stands; the fault reset acts on the edge only."""
        if word == self._power.control_word and self._is_following:
            return
        if self._held is not None:
            self._latest = word
            return
        self._is_word_fresh = self._is_stopping
        for _ in range(4):
            before = self._power
            step = commanded(before, word, self._options.now())
            if step.power.state is before.state and step.action is Action.NONE:
                self._power = step.power
                break
            if not self._may_take(step):
                self._power = before._replace(control_word=word)
                break
            if self.behaviour.transition_delay_ms and (step.action is Action.ENERGISE or not self._has_power):
                self._held, self._held_until, self._latest = step, None, word
                self._mark()
                return
            self._take(step)
        if self._is_following:
            self._modes.command(word)
            self._mark()

    def _may_take(self, step: Step) -> bool:
        if step.action is Action.ENERGISE:
            return self.slave.nmt_state is NmtState.OPERATIONAL and self._modes.is_ready()
        # without voltage nothing becomes ready; a fault may be reset
        return not (self._has_torque_off and step.power.state is State.READY_TO_SWITCH_ON)

    def _wait_for_transition(self, now: int) -> None:
        """A drive that takes its time for a transition: of the words that come meanwhile the last counts."""
        if self._held_until is None:
            self._held_until = now + round(1e6 * self.behaviour.transition_delay_ms)
        if now >= self._held_until and self._held is not None:
            step, self._held = self._held, None
            latest, self._latest = self._latest, None
            # a transition that has begun is finished, but for the one that opens the brake: that must still be wanted
            is_meant = step.action is not Action.ENERGISE or (
                latest is not None and commanded(self._power, latest, self._options.now()).power.state is step.power.state
            )
            if is_meant and self._may_take(step):
                self._take(step)
            if latest is not None:
                self._write_control_word(latest)

    def _forget_words(self) -> None:
        """What the master wrote before a fault, a lost connection or another NMT state does not act later: it must write anew."""
        self._latest, self._is_word_fresh = None, False
        if self._held is not None and self._held.action is Action.ENERGISE:
            self._held = None
            self._mark()

    def _take(self, step: Step) -> None:
        """Go one step of the state machine, with what it asks of the power stage."""
        if step.action is Action.NONE and step.power == self._power:
            return
        self._held = None
        self._stand_in(step.power)
        match step.action:
            case Action.ENERGISE:
                self.data.apply_limits()
                self._modes.begin()
            case Action.STOP:
                self._is_word_fresh = False
                self._modes.end()
                self.stage.stop(step.stop)
                self._stop_at_rest()
            case Action.RELEASE | Action.CLEAR:
                self._modes.release()
                self.stage.release()
                if step.action is Action.CLEAR:
                    self._faults.clear()
            case _:
                pass
        self._mark()

    def _end_stop(self) -> None:
        """The motor stands. A word that has come since the stop began acts now; the one that began it does not act again."""
        self._take(stopped(self._power, self._options.now()))
        if self._is_word_fresh and not self._has_power:
            self._write_control_word(self._power.control_word)

    def _stop_at_rest(self) -> None:
        """Disable operation and shutdown need no ramp where the motor stands; nor does a quick stop that ends by itself."""
        ends = self._power.leaving is not None or (
            self.state is State.QUICK_STOP_ACTIVE and self.behaviour.quick_stop_ends_disabled_at_once
        )
        if ends and (self.stage.law_mode == law.BRAKED or self.stage.stands):
            self._take(stopped(self._power, self._options.now()))

    def _fault(self, cause: str, code: int) -> None:
        self._faults.report(cause, code)
        self._forget_words()
        self._take(failed(self._power, self._options.now()))

    # -- safe torque off -----------------------------------------------------------------------------------------------

    def _set_torque_off(self, active: bool) -> None:
        """Take the torque away by the safe torque off input, or give the voltage back; see `torque_lost`.

        Under torque it is a fault without a ramp. While it is active the voltage is not enabled (bit 4), and the drive does not
        become ready to switch on. Nothing comes back by itself: the master resets the fault and enables anew.
        """
        self._has_torque_off = active
        self._set_plain_status_word()
        if active:
            if self._has_power:
                self._faults.report(TORQUE_OFF, TORQUE_OFF_FAULT)
            self._forget_words()
            self._take(torque_lost(self._power))

    # -- connection ----------------------------------------------------------------------------------------------------

    def _on_nmt(self, old: NmtState, new: NmtState) -> None:
        if old is NmtState.OPERATIONAL:
            self._connection_lost()
        else:
            self._forget_words()

    def _on_heartbeat_lost(self, *_: object) -> None:
        self._connection_lost()

    def _on_rpdo_timeout(self, *_: object) -> None:
        self._connection_lost(RPDO_TIMEOUT)

    def _connection_lost(self, code: int = EmergencyCode.HEARTBEAT, react: Callable[..., Step] = disconnected) -> None:
        """React as 6007h says; a drive that does not move has nothing to abort, but forgets what it was about to do."""
        self._forget_words()
        option = self._value(Object.ABORT_CONNECTION_OPTION)
        step = react(self._power, option, self._options.now())
        if step.power == self._power:
            return
        if option == AbortConnectionOption.FAULT:
            self._faults.report_connection(code)
        self._take(step)

    def _on_reset(self, kind: ResetKind) -> None:
        """NMT reset: the node's own values are back at their defaults.

        A reset of the node closes the brake at once. A reset of communication is a lost connection: 6007h decides, and where it
        asks for nothing, a quick stop. So a ramp may go on after it, until the motor stands.
        """
        if kind is ResetKind.NODE:
            self._restart()
            return
        self._connection_lost(react=restarted)
        if self.state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
            self._faults.repeat_connection()
        self._set_plain_status_word()
        self._mark()

    def _restart(self) -> None:
        self._faults.forget()
        self._forget_words()
        self._take(initialised(self._power))
        self.stage.motion["trip"] = 0  # what a set-point before the reset has broken is not the new start's fault
        self.data.halted = False
        self.data.apply()
        self.probes.reset()
