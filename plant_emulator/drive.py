"""The emulated servo drive: CANopen slave, CiA 402 state machine and the servo law, joined to one axis of the robot."""

from drive_profiles.cia301 import EmergencyCode, ErrorRegister, NmtState, SdoAbortCode
from drive_profiles.cia402 import (
    FOLLOWING_ERROR,
    FOLLOWS_COMMAND,
    HALT,
    INTERNAL_LIMIT,
    NEW_SET_POINT,
    REMOTE,
    SET_POINT_ACKNOWLEDGE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    AbortConnectionOption,
    Event,
    Mode,
    Object,
    QuickStopOption,
    State,
    next_state,
    state_after,
    status_bits,
)
from drive_profiles.units import Scaling
from hil.can.frame import Frame
from plant_emulator import motion as law
from plant_emulator.axes import Axes, live
from plant_emulator.drive_data import DriveData, clip
from plant_emulator.personalities import personality_of
from plant_emulator.personality import Personality
from plant_emulator.slave.dictionary import ResetKind
from plant_emulator.slave.node import Slave

FAULTS: tuple[tuple[int, str, int], ...] = (
    (law.FOLLOWING, "following error", 0x8611),
    (law.OVERSPEED, "motor speed", 0x8400),
    (law.OUT_OF_RANGE, "position limit", 0x8612),
    (law.SET_POINT_RANGE, "set-point outside position limit", 0x8612),
    (law.SET_POINT_STEP, "set-point faster than the motor", 0x8612),
)
"""Trip bit, cause and emergency code (CiA 402, error codes: 8400h velocity, 8611h following error, 8612h reference limit)."""

PARAMETER_FAULT = 0x6320
STOP_PATIENCE_S = 0.5
"""How long beyond its ramp a stop may take before the brake is closed on the moving motor."""

RELATIVE = 1 << 6
"""Control word in profile position: the new set-point counts from the last one."""

_FOLLOWING_MODES = (law.POSITION, law.TORQUE)
_CONNECTION = "connection"
_MOTION_OF_MODE = {Mode.PP: law.PROFILE, Mode.CSP: law.POSITION, Mode.CST: law.TORQUE}
_STOPPING = {State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
_POWERED = {State.OPERATION_ENABLED, *_STOPPING}


class Drive:
    """A servo drive on the bus, sans IO: `receive`, `advance`, `due` as every node; `update` after each advance of the axes.

    Attributes:
        slave: The CANopen engine underneath.
        data: The process data, between the dictionary and the axis.
        personality: The drive's manufacturer: which drive it is, and what of it is not emulated.
        stops: Whether a ramp to rest is to be watched by `update`.
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
        self._motion = axes.motion[self.row]
        self._mode, self._trip = live(axes.motion, "mode"), live(axes.motion, "trip")
        self._torque, self._torque_limit = live(axes.motion, "torque_nm"), live(axes.motion, "torque_limit_nm")
        self._following_count = live(axes.motion, "following_count")
        self._stand_in(State.NOT_READY_TO_SWITCH_ON)
        self._control_period_s = axes.robot.control_period_s
        self._previous_control_word = 0
        self._acknowledged = False
        self.personality = personality_of(axes.robot, number) if personality is None else personality
        dictionary = self.personality.dictionary
        store_time_s = min(axes.robot.axis[number].store_time_s, self.personality.store_limit_s)
        self.slave = Slave(
            axes.robot.node_ids[number],
            dictionary,
            store_commands=self.personality.store_commands,
            store_time_ns=round(1e9 * store_time_s),
        )
        self.slave.on_sync = self._on_sync
        self.slave.on_nmt = self._on_nmt
        self.slave.on_heartbeat_lost = self._on_heartbeat_lost
        self.slave.on_reset = self._on_reset
        self.slave.store.may_store = lambda: SdoAbortCode.DEVICE_STATE if self._is_powered() else None
        self.data = DriveData(axes, number, self.personality, self._is_powered)
        self._value = self.data.value
        dictionary.on_read(Object.STATUS_WORD, 0, self._status_word)
        # while the power stage is off the mode that will act is the one that is set; while it is on, no other can be set
        dictionary.on_read(Object.MODES_OF_OPERATION_DISPLAY, 0, lambda: self._value(Object.MODES_OF_OPERATION))
        dictionary.on_write(Object.CONTROL_WORD, 0, self._write_control_word)
        dictionary.on_write(Object.MODES_OF_OPERATION, 0, self._write_mode)
        self.personality.bind(axes, self.row, self._is_powered)
        self.data.apply()

    @property
    def scaling(self) -> Scaling:
        """How the drive counts."""
        return self.data.scaling

    @property
    def state(self) -> State:
        """State of the power drive system."""
        return self._state

    def _stand_in(self, state: State) -> None:
        """Be in a state, with what every SYNC asks of it: to look a state up costs more than the rest of a status word."""
        self._state = state
        self._has_power = state in _POWERED
        self.stops = state in _STOPPING
        self._plain_status_word = status_bits(state) | REMOTE | VOLTAGE_ENABLED

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

    def update(self) -> list[Frame]:
        """Look at what the axis has done since the last call: broken limits, finished ramps. After each advance of the axes."""
        trip = self._trip[self.row]
        if trip:
            self._trip[self.row] = 0
            for bit, cause, code in FAULTS:
                if trip & bit:
                    self._fault(cause, code)
        if self.stops and self._stop_is_over():
            self._stopped()
        return self.slave.take_frames()

    # -- status and mode -----------------------------------------------------------------------------------------------

    def _status_word(self) -> int:
        word, row = self._plain_status_word, self.row
        mode = self._mode[row]
        if mode in _FOLLOWING_MODES:
            word |= FOLLOWS_COMMAND
        elif mode == law.PROFILE:
            if self.data.is_target_reached:
                word |= TARGET_REACHED
            if self._acknowledged:
                word |= SET_POINT_ACKNOWLEDGE
        if self._has_power and abs(self._torque[row]) >= self._torque_limit[row]:
            word |= INTERNAL_LIMIT
        if self._following_count[row] > 0:
            word |= FOLLOWING_ERROR
        return word

    def _write_mode(self, value: int) -> SdoAbortCode | None:
        if value and value not in self.personality.modes:
            return SdoAbortCode.INVALID_VALUE
        if self._has_power and value != self._value(Object.MODES_OF_OPERATION):
            return SdoAbortCode.DEVICE_STATE
        return None

    # -- state machine -------------------------------------------------------------------------------------------------

    def _write_control_word(self, word: int) -> SdoAbortCode | None:
        """Run the state machine on a control word until it stands; the fault reset acts on the edge only."""
        previous, self._previous_control_word = self._previous_control_word, word
        if word == previous and self._state is State.OPERATION_ENABLED:
            return None
        option = self._value(Object.QUICK_STOP_OPTION)
        for _ in range(4):
            after = next_state(self.state, word, previous, option)
            if after is self.state or (after is State.OPERATION_ENABLED and not self._may_enable()):
                break
            self._enter(after)
            previous = word
        if self.state is State.OPERATION_ENABLED and self._motion["mode"] == law.PROFILE:
            self._profile_command(word)
        return None

    def _may_enable(self) -> bool:
        """Whether the power stage may open the brake: NMT operational, a mode, gains, and a whole interpolation period."""
        mode = self._value(Object.MODES_OF_OPERATION)
        if self.slave.nmt_state is not NmtState.OPERATIONAL or mode not in self.personality.modes:
            return False
        ticks = self.data.interpolation_ticks()
        if mode == Mode.CSP and (ticks < 1.0 - 1e-9 or abs(ticks - round(ticks)) > 1e-6):
            self.slave.raise_emergency("interpolation period", PARAMETER_FAULT, ErrorRegister.PROFILE)
            return False
        self.slave.clear_emergency("interpolation period")
        gains = self.axes.cascade_config[self.row]
        if mode != Mode.CST and not (gains["position_gain_per_s"] > 0.0 and gains["velocity_gain_nm_s_rad"] > 0.0):
            # a brake that opens on a loop without gains lets the arm fall
            self.slave.raise_emergency("no gains", PARAMETER_FAULT, ErrorRegister.PROFILE)
            return False
        self.slave.clear_emergency("no gains")
        return True

    def _enter(self, state: State) -> None:
        before = self._state
        self._stand_in(state)
        if state is State.OPERATION_ENABLED:
            self._energise()
        elif state is State.QUICK_STOP_ACTIVE:
            self._begin_stop(self._value(Object.QUICK_STOP_OPTION))
        elif state is State.FAULT_REACTION_ACTIVE:
            if before in _POWERED:
                self._begin_stop(self._value(Object.FAULT_REACTION_OPTION))
            else:
                self._enter(state_after(self.state, Event.FAULT_REACTION_COMPLETED))
        else:
            self._brake()
            if before is State.FAULT and state is State.SWITCH_ON_DISABLED:
                self._clear_faults()

    def _energise(self) -> None:
        """Open the brake; the set-point is where the motor stands, whatever was written before."""
        mode = Mode(self._value(Object.MODES_OF_OPERATION))
        standing = self.axes.counts(self.row)
        # less the offset, which cyclic position adds: else a 60B0h that is there already would make the motor jump
        offset = self._value(Object.POSITION_OFFSET) if mode == Mode.CSP else 0
        self.slave.dictionary.cell(Object.TARGET_POSITION).value = clip(standing - offset)
        self.slave.dictionary.cell(Object.TARGET_TORQUE).value = 0
        self.data.halted = self._acknowledged = False
        self.data.apply_limits()
        self.axes.energise(self.row, _MOTION_OF_MODE[mode], max(1, round(self.data.interpolation_ticks())))

    def _brake(self) -> None:
        """Close the brake: no torque, and the motor stands."""
        motion = self._motion
        motion["mode"] = law.BRAKED
        motion["torque_nm"], motion["following_count"] = 0.0, 0

    def _begin_stop(self, option: int) -> None:
        """Brake as 605Ah or 605Eh says: at once, on the profile's ramp or on the quick-stop ramp."""
        motion, axes = self._motion, self.axes
        # a brake that is closed already (605Ah = 0, then a fault) stays closed
        at_once = option == QuickStopOption.DISABLE or motion["mode"] == law.BRAKED
        if at_once or not axes.cascade_config[self.row]["velocity_gain_nm_s_rad"] > 0.0:
            motion["stopped"] = 1
            self._brake()
            return
        slow = option in {QuickStopOption.SLOW_DOWN_RAMP, QuickStopOption.SLOW_DOWN_RAMP_AND_STAY}
        ramp = Object.PROFILE_DECELERATION if slow else Object.QUICK_STOP_DECELERATION
        law.begin_stop(axes.motion, axes.cascade_config, axes.cascade_state, axes.notch_state, self.row, self.data.si(ramp))

    def _stop_is_over(self) -> bool:
        motion = self._motion
        return bool(motion["stopped"] or motion["stop_ticks"] * self._control_period_s > STOP_PATIENCE_S)

    def _stopped(self) -> None:
        """The ramp has ended: quick stop leads to switch on disabled (or stays, 605Ah 5 and 6), fault reaction to fault."""
        if self.state is State.FAULT_REACTION_ACTIVE:
            self._enter(state_after(self.state, Event.FAULT_REACTION_COMPLETED))
            return
        after = state_after(self.state, Event.QUICK_STOP_COMPLETED, self._value(Object.QUICK_STOP_OPTION))
        if after is not self.state:
            self._enter(after)

    def _fault(self, cause: str, code: int, register: ErrorRegister = ErrorRegister.PROFILE) -> None:
        self.slave.dictionary.cell(Object.ERROR_CODE).value = code
        self.slave.raise_emergency(cause, code, register)
        if self.state not in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
            self._enter(state_after(self.state, Event.FAULT_DETECTED))

    def _clear_faults(self) -> None:
        self.slave.dictionary.cell(Object.ERROR_CODE).value = 0
        for _, cause, _ in FAULTS:
            self.slave.clear_emergency(cause)
        self.slave.clear_emergency(_CONNECTION)

    # -- motion --------------------------------------------------------------------------------------------------------

    def _on_sync(self, now: int) -> None:
        """With SYNC the newest set-point comes into force: the drive goes there in one interpolation period."""
        if self._mode[self.row] == law.POSITION:
            self.axes.set_point(self.row, self.data.cyclic_target_counts())

    def _profile_command(self, word: int) -> None:
        """PP: bit 4 rising takes the set-point (bit 6: relative), bit 8 halts on the profile's ramp."""
        motion = self._motion
        if word & NEW_SET_POINT and not self._acknowledged:
            target = int(self._value(Object.TARGET_POSITION))
            if word & RELATIVE:
                target += int(motion["target_counts"])
            if motion["low_counts"] <= target <= motion["high_counts"]:
                motion["target_counts"] = target
            else:
                motion["trip"] = int(motion["trip"]) | law.SET_POINT_RANGE
            self._acknowledged = True
        elif not word & NEW_SET_POINT:
            self._acknowledged = False
        self.data.halted = bool(word & HALT)
        self.data.apply_profile_speed()

    # -- connection ----------------------------------------------------------------------------------------------------

    def _on_nmt(self, old: NmtState, new: NmtState) -> None:
        if old is NmtState.OPERATIONAL and self.state is State.OPERATION_ENABLED:
            self._connection_lost()

    def _on_heartbeat_lost(self, node: int) -> None:
        if self.state is State.OPERATION_ENABLED:
            self._connection_lost()

    def _connection_lost(self) -> None:
        """React as 6007h says."""
        match self._value(Object.ABORT_CONNECTION_OPTION):
            case AbortConnectionOption.FAULT:
                self._fault(_CONNECTION, EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION)
            case AbortConnectionOption.DISABLE_VOLTAGE:
                self._enter(State.SWITCH_ON_DISABLED)
            case AbortConnectionOption.QUICK_STOP:
                self._enter(State.QUICK_STOP_ACTIVE)
            case _:
                pass

    def _on_reset(self, kind: ResetKind) -> None:
        """NMT reset: the node's own values are back at their defaults; a reset of the application closes the brake."""
        if kind is ResetKind.NODE:
            self._restart()
            return
        if self.state is State.OPERATION_ENABLED:
            self._connection_lost()
        if self.state in {State.FAULT, State.FAULT_REACTION_ACTIVE} and self._value(Object.ERROR_CODE) == EmergencyCode.HEARTBEAT:
            # the node has forgotten its communication errors with the reset, but the drive is still in fault for this one
            self.slave.raise_emergency(_CONNECTION, EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION)

    def _restart(self) -> None:
        self._brake()
        self._motion["trip"] = 0  # what a set-point before the reset has broken is not the new start's fault
        self._previous_control_word = 0
        self.data.halted = self._acknowledged = False
        self._stand_in(state_after(State.NOT_READY_TO_SWITCH_ON, Event.INITIALISED))
        self.data.apply()
