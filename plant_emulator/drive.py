"""The emulated servo drive: CANopen slave, CiA 402 state machine and the servo law, joined to one axis of the robot."""

import math
from collections.abc import Callable
from typing import Any

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
from hil.control.notch import NOTCH_OFF, NOTCHES, Notch
from plant_emulator import drive_objects as objects
from plant_emulator import motion as law
from plant_emulator.axes import NEVER, Axes
from plant_emulator.slave.dictionary import Dictionary, ResetKind
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

_MOTION_OF_MODE = {Mode.PP: law.PROFILE, Mode.CSP: law.POSITION, Mode.CST: law.TORQUE}
_INT16, _INT32 = 2**15 - 1, 2**31 - 1
_POWERED = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}


def _clip(value: float, limit: int) -> int:
    return int(max(-limit, min(limit, round(value))))


class Drive:
    """A servo drive on the bus, sans IO: `receive`, `advance`, `due` as every node; `update` after each advance of the axes.

    Attributes:
        slave: The CANopen engine underneath.
        state: State of the power drive system.
    """

    def __init__(self, axes: Axes, number: int) -> None:
        """Join axis `number` to a node with the id that the robot file gives it."""
        axis = axes.robot.axis[number]
        self.axes, self.row = axes, axes.row(number)
        self.state = State.NOT_READY_TO_SWITCH_ON
        self._motion: Any = axes.motion[self.row]
        self._control_period_s = axes.robot.control_period_s
        self._motor_limit_nm = axis.torque_limit_nm
        rated_mnm = round(1000.0 * axis.rated_torque)
        self.scaling = Scaling(axis.encoder_counts_per_rev, rated_mnm / 1000.0)
        gains = (0.0, 0.0, 0.0, 300.0)
        if axis.control is not None:
            control = axis.control
            gains = (
                control.position_gain_per_s,
                control.velocity_gain_nm_s_rad,
                control.velocity_integral_gain_nm_rad,
                control.lowpass_hz,
            )
        dictionary = Dictionary(
            objects.drive_entries(
                encoder_counts_per_rev=axis.encoder_counts_per_rev,
                rated_torque_mnm=rated_mnm,
                max_torque_per_mille=min(65535, math.floor(1e6 * axis.torque_limit_nm / rated_mnm)),
                control_period_ns=round(1e9 * self._control_period_s),
                gains=gains,
                serial_number=number,
            )
        )
        self._previous_control_word = 0
        self._halted = False
        self._acknowledged = False
        self.slave = Slave(axes.robot.node_ids[number], dictionary)
        self.slave.on_sync = self._on_sync
        self.slave.on_nmt = self._on_nmt
        self.slave.on_heartbeat_lost = self._on_heartbeat_lost
        self.slave.on_reset = self._on_reset
        self._bind(dictionary)

    # -- the node, for the world ---------------------------------------------------------------------------------------

    @property
    def node_id(self) -> int:
        """The node's id."""
        return self.slave.node_id

    @property
    def due(self) -> int | None:
        """The next instant, in ns, at which `advance` must be called."""
        return self.slave.due

    @property
    def cycle_period_us(self) -> int:
        """1006h, 0 where nobody has set it."""
        return int(self._value(0x1006))

    def power_on(self, now: int) -> list[Frame]:
        """Start: the boot-up frame."""
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
        motion = self._motion
        trip = int(motion["trip"])
        if trip:
            motion["trip"] = 0
            for bit, cause, code in FAULTS:
                if trip & bit:
                    self._fault(cause, code)
        if self.state in {State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE} and self._stop_is_over():
            self._stopped()
        return self.slave.take_frames()

    # -- dictionary ----------------------------------------------------------------------------------------------------

    def _value(self, index: int, subindex: int = 0) -> Any:
        return self.slave.dictionary.cell(index, subindex).value

    def _bind(self, dictionary: Dictionary) -> None:
        """Tie the dictionary's entries to the axis: live values, and checks of what is written."""
        read: dict[tuple[int, int], Callable[[], Any]] = {
            (Object.STATUS_WORD, 0): self._status_word,
            (Object.MODES_OF_OPERATION_DISPLAY, 0): lambda: self._value(Object.MODES_OF_OPERATION),
            (Object.POSITION_ACTUAL, 0): lambda: _clip(self.axes.counts(self.row), _INT32),
            (Object.VELOCITY_ACTUAL, 0): self._velocity_counts,
            (Object.TORQUE_ACTUAL, 0): self._torque_per_mille,
            (Object.FOLLOWING_ERROR_ACTUAL, 0): self._following_error_counts,
            (objects.TORQUE_COMMAND, 0): lambda: float(self._motion["torque_nm"]),
        }
        for column, index in enumerate(objects.NOTCH_STATE_OBJECTS):
            state = self.axes.notch_state[self.row, column]
            read[index, 1] = lambda state=state: int(state["active"])  # type: ignore[misc]
            read[index, 2] = lambda state=state: float(state["frequency_hz"]) if state["active"] else 0.0  # type: ignore[misc]
            read[index, 3] = lambda state=state: float(state["zeta_rd"]) if state["active"] else 0.0  # type: ignore[misc]
        for (index, sub), hook in read.items():
            dictionary.on_read(index, sub, hook)
        dictionary.on_write(Object.CONTROL_WORD, 0, self._write_control_word)
        dictionary.on_write(Object.MODES_OF_OPERATION, 0, self._write_mode)
        dictionary.on_write(0x1006, 0, self._write_cycle_period)
        for sub, field in ((1, "velocity_gain_nm_s_rad"), (2, "velocity_integral_gain_nm_rad"), (3, "lowpass_hz")):
            dictionary.on_write(objects.VELOCITY_LOOP, sub, self._gain_writer(field))
        dictionary.on_write(objects.POSITION_LOOP, 1, self._gain_writer("position_gain_per_s"))
        for column, index in enumerate(objects.NOTCH_OBJECTS):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                dictionary.on_write(index, sub, self._notch_writer(column, parameter[0]))
        for index, sub in (
            (Object.MAX_TORQUE, 0),
            (Object.MAX_MOTOR_SPEED, 0),
            (Object.SOFTWARE_POSITION_LIMIT, 1),
            (Object.SOFTWARE_POSITION_LIMIT, 2),
            (Object.FOLLOWING_ERROR_WINDOW, 0),
            (Object.FOLLOWING_ERROR_TIMEOUT, 0),
            (Object.PROFILE_VELOCITY, 0),
            (Object.PROFILE_ACCELERATION, 0),
            (Object.PROFILE_DECELERATION, 0),
            (Object.QUICK_STOP_DECELERATION, 0),
        ):
            dictionary.on_write(index, sub, self._limit_writer(index, sub))
        scaling = self.scaling
        for index, field, factor in (
            (Object.POSITION_OFFSET, "position_offset_counts", 1.0),
            (Object.VELOCITY_OFFSET, "velocity_offset_rad_s", scaling.speed_rad_s(1)),
            (Object.TORQUE_OFFSET, "torque_offset_nm", scaling.torque_quantum_nm),
            (Object.TARGET_TORQUE, "target_torque_nm", scaling.torque_quantum_nm),
        ):
            dictionary.on_write(index, 0, self._set_point_writer(field, factor))
        self._apply_all()

    def _gain_writer(self, field: str) -> Callable[[float], SdoAbortCode | None]:
        def write(value: float) -> SdoAbortCode | None:
            if self.state in _POWERED:
                return SdoAbortCode.DEVICE_STATE
            self.axes.cascade_config[self.row][field] = value
            return None

        return write

    def _notch_writer(self, column: int, field: str) -> Callable[[float], SdoAbortCode | None]:
        """Filters may be switched on and off while the motor turns; their other parameters not."""

        def write(value: float) -> SdoAbortCode | None:
            if self.state in _POWERED and field != "mode":
                return SdoAbortCode.DEVICE_STATE
            row = self.axes.notch_config[self.row, column]
            wanted = {name: row[name].item() for name in row.dtype.names} | {field: value}
            try:
                if wanted["mode"] != NOTCH_OFF:
                    Notch(**wanted)
            except ValueError:
                return SdoAbortCode.PARAMETER_INCOMPATIBLE
            row[field] = value
            return None

        return write

    def _limit_writer(self, index: int, sub: int) -> Callable[[Any], SdoAbortCode | None]:
        cell = self.slave.dictionary.cell(index, sub)

        def write(value: Any) -> SdoAbortCode | None:
            cell.value = value
            self._apply_limits()
            return None

        return write

    def _set_point_writer(self, field: str, factor: float) -> Callable[[int], SdoAbortCode | None]:
        motion = self._motion

        def write(value: int) -> SdoAbortCode | None:
            motion[field] = value * factor
            return None

        return write

    def _write_cycle_period(self, value: int) -> SdoAbortCode | None:
        """1006h must be a whole number of control periods: the world advances by it."""
        control_us = round(1e6 * self._control_period_s)
        return SdoAbortCode.INVALID_VALUE if value % control_us else None

    def _write_mode(self, value: int) -> SdoAbortCode | None:
        if value and value not in objects.MODES:
            return SdoAbortCode.INVALID_VALUE
        if self.state in _POWERED and value != self._value(Object.MODES_OF_OPERATION):
            return SdoAbortCode.DEVICE_STATE
        return None

    def _apply_all(self) -> None:
        """Put the whole dictionary into force, after a reset."""
        cascade = self.axes.cascade_config[self.row]
        cascade["position_gain_per_s"] = self._value(objects.POSITION_LOOP, 1)
        for sub, field in ((1, "velocity_gain_nm_s_rad"), (2, "velocity_integral_gain_nm_rad"), (3, "lowpass_hz")):
            cascade[field] = self._value(objects.VELOCITY_LOOP, sub)
        for column in range(NOTCHES):
            for sub, parameter in enumerate(objects.NOTCH_PARAMETERS, start=1):
                value = self._value(objects.NOTCH_OBJECTS[column], sub)
                self.axes.notch_config[self.row, column][parameter[0]] = value
        self._apply_limits()

    def _apply_limits(self) -> None:
        motion, scaling = self._motion, self.scaling
        rated = scaling.rated_torque_nm / 1000.0
        motion["torque_limit_nm"] = min(self._motor_limit_nm, self._value(Object.MAX_TORQUE) * rated)
        motion["max_speed_rad_s"] = self._value(Object.MAX_MOTOR_SPEED) * 2.0 * math.pi / 60.0
        motion["low_counts"] = self._value(Object.SOFTWARE_POSITION_LIMIT, 1)
        motion["high_counts"] = self._value(Object.SOFTWARE_POSITION_LIMIT, 2)
        window = self._value(Object.FOLLOWING_ERROR_WINDOW)
        motion["following_window_rad"] = math.inf if window == 2**32 - 1 else scaling.position_rad(window)
        timeout_ms = self._value(Object.FOLLOWING_ERROR_TIMEOUT)
        motion["following_ticks"] = round(1e-3 * timeout_ms / self._control_period_s) if window != 2**32 - 1 else NEVER
        motion["profile_speed_rad_s"] = scaling.speed_rad_s(self._value(Object.PROFILE_VELOCITY))
        motion["profile_acceleration_rad_s2"] = scaling.speed_rad_s(self._value(Object.PROFILE_ACCELERATION))
        motion["profile_deceleration_rad_s2"] = scaling.speed_rad_s(self._value(Object.PROFILE_DECELERATION))
        if motion["mode"] != law.STOPPING:
            motion["stop_deceleration_rad_s2"] = scaling.speed_rad_s(self._value(Object.QUICK_STOP_DECELERATION))
        motion["position_offset_counts"] = self._value(Object.POSITION_OFFSET)
        motion["velocity_offset_rad_s"] = scaling.speed_rad_s(self._value(Object.VELOCITY_OFFSET))
        motion["torque_offset_nm"] = self._value(Object.TORQUE_OFFSET) * rated
        motion["target_torque_nm"] = self._value(Object.TARGET_TORQUE) * rated

    # -- what is read --------------------------------------------------------------------------------------------------

    def _velocity_counts(self) -> int:
        speed = float(self.axes.cascade_state[self.row]["speed_rad_s"])
        return _clip(speed * self.scaling.counts_per_rad, _INT32)

    def _torque_per_mille(self) -> int:
        return _clip(1000.0 * float(self._motion["torque_nm"]) / self.scaling.rated_torque_nm, _INT16)

    def _following_error_counts(self) -> int:
        return _clip(float(self._motion["following_error_rad"]) * self.scaling.counts_per_rad, _INT32)

    def _status_word(self) -> int:
        word = status_bits(self.state) | REMOTE | VOLTAGE_ENABLED
        motion = self._motion
        if motion["mode"] == law.POSITION:
            word |= FOLLOWS_COMMAND
        if motion["mode"] == law.PROFILE:
            at_rest = motion["reference_speed_rad_s"] == 0.0
            target = motion["target_counts"] / motion["counts_per_rad"]
            if at_rest and (self._halted or abs(motion["reference_rad"] - target) < 1e-9):
                word |= TARGET_REACHED
            if self._acknowledged:
                word |= SET_POINT_ACKNOWLEDGE
        if self.state in _POWERED and abs(motion["torque_nm"]) >= motion["torque_limit_nm"]:
            word |= INTERNAL_LIMIT
        if motion["following_count"] > 0:
            word |= FOLLOWING_ERROR
        return word

    # -- state machine -------------------------------------------------------------------------------------------------

    def _write_control_word(self, word: int) -> SdoAbortCode | None:
        """Run the state machine on a control word until it stands; the fault reset acts on the edge only."""
        previous, self._previous_control_word = self._previous_control_word, word
        if word == previous and self.state is State.OPERATION_ENABLED:
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
        if self.slave.nmt_state is not NmtState.OPERATIONAL or mode not in objects.MODES:
            return False
        ticks = self._interpolation_ticks()
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

    def _interpolation_ticks(self) -> float:
        """Control periods per set-point, from 60C2h."""
        value, index = self._value(Object.INTERPOLATION_PERIOD, 1), self._value(Object.INTERPOLATION_PERIOD, 2)
        return float(value * 10.0**index / self._control_period_s)

    def _enter(self, state: State) -> None:
        before, self.state = self.state, state
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
        counts = self.axes.counts(self.row)
        self.slave.dictionary.cell(Object.TARGET_POSITION).value = counts
        self.slave.dictionary.cell(Object.TARGET_TORQUE).value = 0
        self._halted = self._acknowledged = False
        self._apply_limits()
        self.axes.energise(self.row, _MOTION_OF_MODE[mode], max(1, round(self._interpolation_ticks())))

    def _brake(self) -> None:
        """Close the brake: no torque, and the motor stands."""
        self._motion["mode"] = law.BRAKED

    def _begin_stop(self, option: int) -> None:
        """Brake as 605Ah or 605Eh says: at once, on the profile's ramp or on the quick-stop ramp."""
        if option == QuickStopOption.DISABLE or not self.axes.cascade_config[self.row]["velocity_gain_nm_s_rad"] > 0.0:
            self._motion["stopped"] = 1
            self._brake()
            return
        slow = option in {QuickStopOption.SLOW_DOWN_RAMP, QuickStopOption.SLOW_DOWN_RAMP_AND_STAY}
        ramp = Object.PROFILE_DECELERATION if slow else Object.QUICK_STOP_DECELERATION
        deceleration = self.scaling.speed_rad_s(self._value(ramp))
        axes = self.axes
        law.begin_stop(axes.motion, axes.cascade_config, axes.cascade_state, self.row, deceleration)

    def _stop_is_over(self) -> bool:
        motion = self._motion
        if motion["stopped"]:
            return True
        patience = motion["stop_ticks"] * self._control_period_s - STOP_PATIENCE_S
        return bool(patience > 0.0 and motion["reference_speed_rad_s"] == 0.0)

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
        self.slave.clear_emergency("connection")

    # -- motion --------------------------------------------------------------------------------------------------------

    def _on_sync(self, now: int) -> None:
        """With SYNC the newest set-point comes into force: the drive goes there in one interpolation period."""
        if self._motion["mode"] == law.POSITION:
            self.axes.set_point(self.row, self._value(Object.TARGET_POSITION))

    def _profile_command(self, word: int) -> None:
        """PP: bit 4 rising takes the set-point (bit 6: relative), bit 8 halts on the profile's ramp."""
        motion = self._motion
        if word & NEW_SET_POINT and not self._acknowledged:
            target = int(self._value(Object.TARGET_POSITION))
            if word & 0x40:
                target += int(motion["target_counts"])
            if motion["low_counts"] <= target <= motion["high_counts"]:
                motion["target_counts"] = target
            else:
                motion["trip"] = int(motion["trip"]) | law.SET_POINT_RANGE
            self._acknowledged = True
        elif not word & NEW_SET_POINT:
            self._acknowledged = False
        halted = bool(word & HALT)
        if halted != self._halted:
            speed = 0.0 if halted else self.scaling.speed_rad_s(self._value(Object.PROFILE_VELOCITY))
            motion["profile_speed_rad_s"] = speed
            self._halted = halted

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
                self._fault("connection", EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION)
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
        elif self.state is State.OPERATION_ENABLED:
            self._connection_lost()

    def _restart(self) -> None:
        self._brake()
        self._previous_control_word = 0
        self.state = state_after(State.NOT_READY_TO_SWITCH_ON, Event.INITIALISED)
        self._apply_all()

