"""The emulated servo drive, joined to one axis of the robot."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

from drive_profiles.standard.cia301 import EmergencyCode, NmtState, SdoAbortCode
from drive_profiles.standard.cia402 import (
    FOLLOWING_ERROR,
    INTERNAL_LIMIT,
    TARGET_REACHED,
    AbortConnectionOption,
    Mode,
    Object,
    State,
)
from drive_profiles.standard.units import Scaling
from hil.can.frame import Frame
from plant_emulator.core import CORE
from plant_emulator.drive.binding.process_data import SHARED, DriveData, share_set_points
from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.drive.family.choice import family_of
from plant_emulator.drive.faults import FAULTS, NOT_OPERATIONAL, RPDO_TIMEOUT, TORQUE_OFF, TORQUE_OFF_FAULT, DriveFaults
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.limit_switches import LimitSwitches
from plant_emulator.drive.modes.selection import ModeSelection, modes_of
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import (
    Action,
    DriveStatus,
    Options,
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
from plant_emulator.drive.touch_probe import TouchProbes
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes, live
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.slave.delays import slave_with
from plant_emulator.slave.dictionary import Cell, ReadHook, ResetKind
from plant_emulator.slave.node import SlaveNode


def option_codes(family: DriveFamily, behaviour: Behaviour) -> Callable[[], Options]:
    """Return what gives the option codes in force, 605Ah to 605Eh.

    Homing methods are not contiguous, so limits cannot state them: methods that do not exist are refused (0609 0030h),
    unless the maker states the entry.
    """
    dictionary = family.dictionary
    if not family.states((Object.HOMING_METHOD, 0)):
        known = {0, *HOMING_METHODS}
        dictionary.on_write(Object.HOMING_METHOD, 0, lambda method: None if method in known else SdoAbortCode.INVALID_VALUE)
    codes = Object.QUICK_STOP_OPTION, Object.SHUTDOWN_OPTION, Object.DISABLE_OPERATION_OPTION, Object.FAULT_REACTION_OPTION
    cells: list[Any] = [dictionary.cell(code) for code in codes]
    return lambda: Options._make((*(cell.value for cell in cells), behaviour.quick_stop_ends_disabled_at_once))


class DelayedTransition(NamedTuple):
    """A transition that a drive executes only after a delay.

    Args:
        word: The last control word that has come; None if it must not act any more.
        due: Time of the step in ns; None before the first look at the clock.
    """

    step: Step
    word: int | None
    due: int | None = None


class Drive(SlaveNode):
    """A servo drive on the bus, sans IO.

    `receive`, `advance` and `due` are those of every node; `update` is called after each advance of the axes.

    Attributes:
        behaviour: The quirks that the robot file gives the drive.
        family: The drive's family: which drive it is, and what of it is not emulated.
        on_state: Called with the state before and the new one, before the power stage follows.
        on_change: Called when the status or the units have changed: the process image has to be written anew.
        shown: Read hooks of the entries that the process image shows, and what they show.
    """

    def __init__(self, axes: Axes, number: int) -> None:
        """Join an axis to a node.

        Raises:
            DriveProfileError: There is no such profile, or its file or the EDS file has errors.
            ValueError: The profile is not a drive's.
        """
        self.axes, self.row = axes, axes.row(number)
        self.behaviour = axes.robot.axis[number].behaviour
        self.family = family_of(axes.robot, number)
        dictionary = self.family.dictionary
        share_set_points(dictionary, axes, self.row)
        self.slave = slave_with(
            self.behaviour,
            axes.robot.seed + number,
            axes.robot.node_ids[number],
            dictionary,
            store_commands=self.family.store_commands,
            store_time_ns=round(1e9 * min(axes.robot.axis[number].store_time_s, self.family.store_limit_s)),
            sdo_max_bytes=axes.robot.axis[number].sdo_download_bytes,
            autostart=self.behaviour.operational_at_boot,
        )
        self.on_state: Callable[[State, State], None] = lambda before, after: None
        self.on_change: Callable[[], None] = lambda: None
        signals = ("trip", "event", "limited", "stopped", "following_count")  # by which the control period wakes the drive
        self._signals = SimpleNamespace(**{name: live(axes.motion, name) for name in signals})
        self._status = DriveStatus.of(Power())  # replaced whole with each change of state, input or lack: see `_set_power`
        self._delayed: DelayedTransition | None = None  # where the robot file says that transitions take their time
        self._is_word_fresh = False  # whether a control word has come since the stop began: it acts when the motor stands
        self.data = DriveData(axes, number, self.family, self._is_powered)
        self.inputs = DigitalInputs(axes, number, dictionary)
        self.stage = PowerStage(axes, self.row, self.data)
        self.limit_switches = LimitSwitches(self.stage, self.inputs)
        self.probes = TouchProbes(dictionary, self.inputs, self.data.shown_position)
        self._faults = DriveFaults(self.slave)  # 603Fh and the emergencies, as far as they are the drive's
        modes = modes_of(self.stage, self.inputs, self.behaviour, self.family)
        self._modes = ModeSelection(
            self.slave,
            self.stage,
            modes,
            self._faults,
            self.limit_switches,
            power=lambda: self._status.power,
            halt_blocks=self.behaviour.halt_blocks_mode_change,
        )
        self._options = option_codes(self.family, self.behaviour)
        self._bind()
        # the family wraps write hooks of the parts above (a hook that comes after it is an error); `restart` wants its values
        self.family.bind(axes, self.row, self._is_powered)
        self.shown |= self.family.shown
        self.data.restart()

    def _bind(self) -> None:
        """Connect the callbacks of the parts."""
        slave, dictionary = self.slave, self.slave.dictionary
        self.shown: dict[ReadHook, int] = {
            self.status_word: CORE.call.STATUS_WORD,
            self.data.position_counts: CORE.call.POSITION_SHOWN,
            self.data.shown_torque: CORE.call.TORQUE_SHOWN,
        }
        self.inputs.on_sto = self._set_torque_off
        self.data.on_units = self.inputs.on_forced = self._report_change
        self._faults.on_lack = self._set_status
        slave.on_nmt = self._on_nmt
        slave.on_heartbeat_lost = lambda _: self._connection_lost()
        slave.on_reset = self._on_reset
        slave.on_rpdo_timeout = lambda _: self._connection_lost(RPDO_TIMEOUT)
        slave.store.may_store = lambda: SdoAbortCode.DEVICE_STATE if self._is_powered() else None
        dictionary.on_read(Object.STATUS_WORD, 0, self.status_word)
        dictionary.on_write(Object.CONTROL_WORD, 0, self._write_control_word)

    @property
    def scaling(self) -> Scaling:
        """The units of the drive."""
        return self.data.counting.scaling

    @property
    def state(self) -> State:
        """State of the power drive system."""
        return self._status.power.state

    @property
    def mode(self) -> Mode | None:
        """Mode that acts; None without torque or without a mode."""
        acting = self._modes.acting
        return Mode(acting.number) if acting is not None and acting.number else None

    def _is_powered(self) -> bool:
        return self._status.is_powered

    # -- the node, for the world ---------------------------------------------------------------------------------------

    def power_on(self, now: int) -> list[Frame]:
        """Start, or restart after a loss of power.

        Values that were not stored are lost. Returns the boot-up frame.
        """
        self._restart()
        return super().power_on(now)

    def update(self, now: int) -> list[Frame]:
        """Process what the axis has done since the last call."""
        row, signals = self.row, self._signals
        trip = signals.trip[row]
        if trip:
            signals.trip[row] = 0
            for bit, cause, code in FAULTS:
                if trip & bit:
                    self._fault(cause, code)
        if signals.event[row]:
            self.inputs.dispatch()
        if self._delayed is not None:
            self._wait_for_transition(self._delayed, now)
        acting = self._modes.acting
        if self._status.is_stopping:
            if self.stage.is_stopped:
                self._end_stop()
        elif acting is not None:
            if acting.watches:
                acting.look()
            if self.limit_switches.are_there:
                self.limit_switches.look(acting)
        return self.slave.take_frames()

    @property
    def needs_update(self) -> bool:
        """True while `update` has work that the axis does not signal.

        Such work is a stop, a delayed transition, a queued set-point or homing.
        """
        acting = self._modes.acting
        if self._status.is_stopping or self._delayed is not None:
            return True
        return acting is not None and (acting.watches or self.limit_switches.are_there)

    # -- status and mode -----------------------------------------------------------------------------------------------

    def _set_power(self, power: Power) -> None:
        """Replace the status, and report a change of state."""
        before = self.state
        self._status = DriveStatus.of(power, torque_off=self.inputs.is_sto_active, lack=self._faults.is_lacking)
        self.on_change()
        if power.state is not before:
            self.on_state(before, power.state)

    def _set_status(self) -> None:
        """Replace the status if something other than the state has changed."""
        self._set_power(self._status.power)

    def status_word(self) -> int:
        """Return the present status word."""
        status, signals, row = self._status, self._signals, self.row
        word, acting = status.plain_word, self._modes.acting
        if status.is_enabled and acting is not None:
            word |= acting.status()
        else:
            if signals.following_count[row] > 0:
                word |= FOLLOWING_ERROR
            if status.is_powered and signals.stopped[row]:
                word |= TARGET_REACHED
        if signals.limited[row] or self.limit_switches.blocked:
            word |= INTERNAL_LIMIT
        return word

    def _report_change(self) -> None:
        self.on_change()

    # -- the process image ---------------------------------------------------------------------------------------------

    def takes(self, cell: Cell) -> int | None:
        """Return what an entry means in an RPDO of the process image."""
        if cell.write_hook == self._write_control_word:
            return int(CORE.call.CONTROL_WORD)
        return int(getattr(CORE.call, SHARED[cell.entry.index].upper())) if self.data.shares(cell) else None

    @property
    def ignores_sync(self) -> bool:
        """True if no mode acts and nothing is under way: a SYNC without process data then means nothing."""
        return self._modes.acting is None and not self.needs_update

    def write_process(self) -> bool:
        """Write state, mode and units into the process image.

        Returns:
            True if the drive only follows the set-points of a cyclic mode, so that the image may act for it.
        """
        acting, status, process = self._modes.acting, self._status, self.data.process
        if acting is None or not acting.is_plain or not status.is_following or self.needs_update:
            return False
        if self.slave.on_sync != acting.synchronise:
            return False
        self.data.write_units()
        process["motion"], process["control_word"] = acting.motion, status.power.control_word
        process["status_word"] = status.plain_word | (INTERNAL_LIMIT if self.limit_switches.blocked else 0)
        return True

    # -- state machine -------------------------------------------------------------------------------------------------

    def _write_control_word(self, word: int) -> None:
        """Run the state machine on a control word until its state stays.

        The fault reset acts on the edge only.
        """
        status = self._status
        if status.is_following and word == status.power.control_word:
            return
        if self._delayed is not None:
            self._delayed = self._delayed._replace(word=word)
            return
        self._is_word_fresh = status.is_stopping
        for _ in range(4):
            before = self._status.power
            step = commanded(before, word, self._options())
            if step.power.state is before.state and step.action is Action.NONE:
                self._remember(step.power)
                break
            if not self._may_take(step):
                self._remember(before._replace(control_word=word))
                break
            if self.behaviour.transition_delay_ms and (step.action is Action.ENERGISE or not self._status.is_powered):
                self._delayed = DelayedTransition(step, word)
                return
            self._take(step)
        if self._status.is_following:
            self._modes.command(word)

    def _remember(self, power: Power) -> None:
        """Remember a control word that leaves the state unchanged.

        A master repeats the same word with every SYNC.
        """
        if power != self._status.power:
            self._set_power(power)

    def _may_take(self, step: Step) -> bool:
        if step.action is Action.ENERGISE:
            if self.slave.nmt_state is NmtState.OPERATIONAL:
                return self._modes.is_ready()
            self._faults.report_lack(NOT_OPERATIONAL)
            return False
        # without voltage nothing becomes ready; a fault may be reset
        return not (self.inputs.is_sto_active and step.power.state is State.READY_TO_SWITCH_ON)

    def _wait_for_transition(self, delayed: DelayedTransition, now: int) -> None:
        """Execute a transition when its delay is over.

        Of the control words that come meanwhile only the last counts.
        """
        step, latest, due = delayed
        if due is None:
            due = now + round(1e6 * self.behaviour.transition_delay_ms)
            self._delayed = delayed._replace(due=due)
        if now < due:
            return
        self._delayed = None
        # a transition that has begun is finished, but for the one that opens the brake: that must still be wanted
        is_meant = step.action is not Action.ENERGISE or (
            latest is not None and commanded(self._status.power, latest, self._options()).power.state is step.power.state
        )
        if is_meant and self._may_take(step):
            self._take(step)
        if latest is not None:
            self._write_control_word(latest)

    def _forget_words(self) -> None:
        """Discard the control words written before an interruption.

        After a fault, a lost connection or another NMT state the master must write a word anew.
        """
        self._is_word_fresh = False
        if self._delayed is not None:
            self._delayed = None if self._delayed.step.action is Action.ENERGISE else self._delayed._replace(word=None)

    def _take(self, step: Step) -> None:
        """Take one step of the state machine, with the power stage."""
        if step.action is Action.NONE and step.power == self._status.power:
            return
        self._delayed = None
        self._set_power(step.power)
        match step.action:
            case Action.ENERGISE:
                self.data.apply()
                self._modes.begin()
            case Action.STOP:
                self._is_word_fresh = False
                self._modes.end()
                self.stage.stop(step.stop)
                self._stop_at_rest()
            case Action.RELEASE | Action.CLEAR:
                self._modes.release()
                self.stage.close_brake()
                if step.action is Action.CLEAR:
                    self._faults.clear()
            case _:
                pass

    def _end_stop(self) -> None:
        """End a stop: the motor is at rest.

        A control word that came since the stop began takes effect now; the one that began it does not act again.
        """
        self._take(stopped(self._status.power, self._options()))
        if self._is_word_fresh and not self._status.is_powered:
            self._write_control_word(self._status.power.control_word)

    def _stop_at_rest(self) -> None:
        """End a stop at once if the motor is at rest.

        This concerns disable operation, shutdown, and a quick stop that ends by itself.
        """
        ends = self._status.power.leaving is not None or (
            self.state is State.QUICK_STOP_ACTIVE and self.behaviour.quick_stop_ends_disabled_at_once
        )
        if ends and (self.stage.law_mode == record.BRAKED or self.stage.is_at_rest):
            self._take(stopped(self._status.power, self._options()))

    def _fault(self, cause: str, code: int) -> None:
        self._faults.report(cause, code)
        self._forget_words()
        self._take(failed(self._status.power, self._options()))

    # -- safe torque off -----------------------------------------------------------------------------------------------

    def _set_torque_off(self, active: bool) -> None:
        """Activate or release safe torque off; see `torque_lost`.

        Under torque it is a fault without a ramp. While it is active the voltage is not enabled (bit 4), and the drive does
        not become ready to switch on. Nothing returns by itself: the master resets the fault and enables the drive again.
        """
        self._set_status()
        if active:
            if self._status.is_powered:
                self._faults.report(TORQUE_OFF, TORQUE_OFF_FAULT)
            self._forget_words()
            self._take(torque_lost(self._status.power))

    # -- connection ----------------------------------------------------------------------------------------------------

    def _on_nmt(self, old: NmtState, new: NmtState) -> None:
        if old is NmtState.OPERATIONAL:
            self._connection_lost()
        else:
            self._forget_words()
        if new is NmtState.OPERATIONAL:
            self._faults.end_lack(NOT_OPERATIONAL)

    def _connection_lost(self, code: int = EmergencyCode.HEARTBEAT, react: Callable[..., Step] = disconnected) -> None:
        """React to a lost connection as 6007h demands.

        A drive that does not move has nothing to abort, but discards waiting commands.
        """
        self._forget_words()
        option = self.data.value(Object.ABORT_CONNECTION_OPTION)
        step = react(self._status.power, option, self._options())
        if step.power == self._status.power:
            return
        if option == AbortConnectionOption.FAULT:
            self._faults.report_connection(code)
        self._take(step)

    def _on_reset(self, kind: ResetKind) -> None:
        """Restart after an NMT reset, with the node's values at defaults.

        A reset of the node closes the brake at once. A reset of communication is a lost connection: 6007h decides, and where it
        demands nothing, a quick stop. So a ramp may continue after it, until the motor is at rest.
        """
        if kind is ResetKind.NODE:
            self._restart()
            return
        self._connection_lost(react=restarted)
        if self.state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
            self._faults.repeat_connection()
        self._set_status()

    def _restart(self) -> None:
        self._faults.forget()
        self._forget_words()
        self._take(initialised(self._status.power))
        self.stage.motion["trip"] = 0  # what a set-point before the reset has broken is not the new start's fault
        self.data.restart()
        self.probes.reset()
