"""The power drive system's state machine, pure.

State, control word, options and events go in; state and required action come out.

This module does not know a motor. `commanded` processes a control word and takes at most one transition, so that no state on
the path is skipped; the other functions process events. The transitions are those of `drive_profiles.standard.cia402`.

Transitions 5 and 8 (disable operation, shutdown) with option 1 end when the motor is at rest: until then the state remains
OPERATION_ENABLED, and `Power.leaving` states the target. Enable operation does not cancel such a stop; quick stop and
disable voltage do. Of disable operation and shutdown the last one counts. The owner repeats a word that arrives during a
stop when the motor is at rest.

Source: CiA 402-2 (IEC 61800-7-201), device control: state machine and option codes 6007h, 605Ah to 605Eh.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from drive_profiles.standard.cia402 import (
    REMOTE,
    VOLTAGE_ENABLED,
    WARNING,
    AbortConnectionOption,
    DisableOperationOption,
    Event,
    FaultReactionOption,
    HaltOption,
    QuickStopOption,
    ShutdownOption,
    State,
    next_state,
    state_after,
    status_bits,
)


class Action(Enum):
    """Action that a step demands of the power stage."""

    NONE = "nothing"
    ENERGISE = "open the brake, and begin to follow"
    STOP = "bring the motor to rest"
    RELEASE = "no torque, and the brake closed"
    CLEAR = "no torque, and the faults forgotten"


class Stop(Enum):
    """Method by which the motor is brought to rest."""

    AT_ONCE = "no torque, and the brake closed"
    SLOW_DOWN_RAMP = "on the ramp of 6084h"
    QUICK_STOP_RAMP = "on the ramp of 6085h"
    FULL_TORQUE = "with all the torque that the limits leave"


class Options(NamedTuple):
    """The option codes in force.

    Args:
        quick_stop: 605Ah.
        shutdown: 605Bh.
        disable_operation: 605Ch.
        fault_reaction: 605Eh.
        quick_stop_ends: True for a drive that leaves QUICK_STOP_ACTIVE by itself with any 605Ah, as some families do.
    """

    quick_stop: int = QuickStopOption.QUICK_STOP_RAMP
    shutdown: int = ShutdownOption.DISABLE
    disable_operation: int = DisableOperationOption.DISABLE
    fault_reaction: int = FaultReactionOption.QUICK_STOP_RAMP
    quick_stop_ends: bool = False


DEFAULT_OPTIONS = Options()


class Power(NamedTuple):
    """The memory of the state machine.

    Args:
        control_word: The last one: the fault reset is an edge.
        leaving: State after transition 5 or 8, or after the quick stop of a reset, as soon as the motor is at rest.
    """

    state: State = State.NOT_READY_TO_SWITCH_ON
    control_word: int = 0
    leaving: State | None = None


class Step(NamedTuple):
    """One step: what to remember, and what to do."""

    power: Power
    action: Action = Action.NONE
    stop: Stop = Stop.AT_ONCE


POWERED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
"""States in which the motor is, or may be, under torque."""

_STOP_OF_HALT: dict[int, Stop] = {
    HaltOption.SLOW_DOWN_RAMP: Stop.SLOW_DOWN_RAMP,
    HaltOption.QUICK_STOP_RAMP: Stop.QUICK_STOP_RAMP,
    HaltOption.CURRENT_LIMIT: Stop.FULL_TORQUE,
    HaltOption.VOLTAGE_LIMIT: Stop.FULL_TORQUE,
}
"""Codes that 605Ah, 605Dh and 605Eh have in common."""
_STOP_OF_FAULT_REACTION = {int(FaultReactionOption.DISABLE): Stop.AT_ONCE, **_STOP_OF_HALT}
_STAYING = {code + QuickStopOption.VOLTAGE_LIMIT: stop for code, stop in _STOP_OF_HALT.items()}
"""Codes 5 to 8 of 605Ah: those of 1 to 4, after which the drive stays in QUICK_STOP_ACTIVE."""
_STOP_OF_QUICK_STOP = _STOP_OF_FAULT_REACTION | _STAYING


def stop_of_quick_stop(option: int) -> Stop:
    """Return 605Ah's stop; a family's own code means the quick-stop ramp."""
    return _STOP_OF_QUICK_STOP.get(option, Stop.QUICK_STOP_RAMP)


def stop_of_fault_reaction(option: int) -> Stop:
    """Return 605Eh's stop; a family's own code means the quick-stop ramp."""
    return _STOP_OF_FAULT_REACTION.get(option, Stop.QUICK_STOP_RAMP)


def stop_of_halt(option: int) -> Stop:
    """Return 605Dh's stop; a family's own code means the slow-down ramp."""
    return _STOP_OF_HALT.get(option, Stop.SLOW_DOWN_RAMP)


def commanded(power: Power, control_word: int, options: Options = DEFAULT_OPTIONS) -> Step:
    """Process a control word: at most one transition.

    A drive calls it until nothing changes any more: switch on and enable in one word is transition 3, then 4. A caller that
    must not energise now keeps the state of before.
    """
    quick_stop_option = QuickStopOption.DISABLE if options.quick_stop_ends else options.quick_stop
    before = power.state
    after = next_state(before, control_word, power.control_word, quick_stop_option)
    if after is before:
        return Step(Power(before, control_word, power.leaving))
    if before is State.FAULT:
        return Step(Power(after, control_word), Action.CLEAR)
    if after is State.OPERATION_ENABLED:
        return Step(Power(after, control_word), Action.ENERGISE)
    if after is State.QUICK_STOP_ACTIVE:
        return Step(Power(after, control_word), Action.STOP, stop_of_quick_stop(options.quick_stop))
    if before is State.OPERATION_ENABLED and after is not State.SWITCH_ON_DISABLED:
        option = options.shutdown if after is State.READY_TO_SWITCH_ON else options.disable_operation
        if option == ShutdownOption.SLOW_DOWN_RAMP:
            action = Action.STOP if power.leaving is None else Action.NONE
            return Step(Power(before, control_word, after), action, Stop.SLOW_DOWN_RAMP)
    return Step(Power(after, control_word), Action.RELEASE)


def initialised(power: Power) -> Step:
    """Return transitions 0 and 1 after power-on or reset, without control word."""
    return Step(Power(state_after(state_after(power.state, Event.POWERED), Event.INITIALISED)), Action.RELEASE)


def stopped(power: Power, options: Options = DEFAULT_OPTIONS) -> Step:
    """Return the step at the end of a stop.

    It is transition 12 (or none, 605Ah from 5 to 8), 14, or the end of 5, 8 or a reset's stop.
    """
    word = power.control_word
    if power.state is State.FAULT_REACTION_ACTIVE:
        return Step(Power(state_after(power.state, Event.FAULT_REACTION_COMPLETED), word), Action.RELEASE)
    if power.state is State.QUICK_STOP_ACTIVE and power.leaving is None:
        option = QuickStopOption.DISABLE if options.quick_stop_ends else options.quick_stop
        after = state_after(power.state, Event.QUICK_STOP_COMPLETED, option)
        return Step(power) if after is power.state else Step(Power(after, word), Action.RELEASE)
    return Step(power) if power.leaving is None else Step(Power(power.leaving, word), Action.RELEASE)


def failed(power: Power, options: Options = DEFAULT_OPTIONS) -> Step:
    """Return the step after a fault: transition 13.

    Without a motor to stop, 14 follows at once. In a fault state nothing changes.
    """
    word, after = power.control_word, state_after(power.state, Event.FAULT_DETECTED)
    if after is power.state:
        return Step(power)
    if power.state in POWERED:
        return Step(Power(after, word), Action.STOP, stop_of_fault_reaction(options.fault_reaction))
    return Step(Power(state_after(after, Event.FAULT_REACTION_COMPLETED), word), Action.RELEASE)


def torque_lost(power: Power) -> Step:
    """Return the step for safe torque off, without a ramp.

    Under torque it is a fault (13 and 14 at once); else transition 7 or 10.
    """
    if power.state in POWERED:
        return Step(Power(State.FAULT, power.control_word), Action.RELEASE)
    if power.state in {State.READY_TO_SWITCH_ON, State.SWITCHED_ON}:
        return Step(Power(State.SWITCH_ON_DISABLED, power.control_word), Action.RELEASE)
    return Step(power)


def disconnected(power: Power, option: int, options: Options = DEFAULT_OPTIONS) -> Step:
    """Return the step that 6007h demands for a lost master.

    It concerns a drive that moves, or brakes but not for a fault; other states are unchanged.

    With option 1 the caller reports the fault, too.
    """
    if power.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}:
        return Step(power)
    if option == AbortConnectionOption.FAULT:
        return failed(power, options)
    if option == AbortConnectionOption.DISABLE_VOLTAGE:
        return Step(Power(State.SWITCH_ON_DISABLED, power.control_word), Action.RELEASE)
    if option == AbortConnectionOption.QUICK_STOP and power.state is State.OPERATION_ENABLED:
        stop = stop_of_quick_stop(options.quick_stop)
        return Step(Power(State.QUICK_STOP_ACTIVE, power.control_word), Action.STOP, stop)
    return Step(power)


def restarted(power: Power, option: int, options: Options = DEFAULT_OPTIONS) -> Step:
    """Return the step after a reset of communication.

    6007h decides; without an action there it is a quick stop that ends in SWITCH_ON_DISABLED.

    A master that has reset a node no longer knows its state, so torque must not outlast the reset, even with 605Ah from 5 to
    8.
    """
    if option != AbortConnectionOption.NO_ACTION or power.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}:
        return disconnected(power, option, options)
    after = Power(State.QUICK_STOP_ACTIVE, power.control_word, State.SWITCH_ON_DISABLED)
    if power.state is State.QUICK_STOP_ACTIVE:
        return Step(after)
    return Step(after, Action.STOP, stop_of_quick_stop(options.quick_stop))


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """A state of the power drive system with its consequences.

    Attributes:
        is_powered: True if the motor is, or may be, under torque.
        is_stopping: True if the motor is being brought to rest, after which the state changes or the motor is held.
        is_following: True if the drive is enabled and not being brought to rest.
        plain_word: The status word without the bits that the mode and the motion add.
    """

    power: Power
    is_powered: bool
    is_enabled: bool
    is_stopping: bool
    is_following: bool
    plain_word: int

    @classmethod
    def of(cls, power: Power, *, torque_off: bool = False, lack: bool = False) -> "DriveStatus":
        """Derive everything from the state machine.

        Args:
            torque_off: True if safe torque off is active: then the voltage is not enabled.
            lack: True if a mode has been kept from acting: the status word shows it as a warning.
        """
        is_powered = power.state in POWERED
        is_enabled = power.state is State.OPERATION_ENABLED
        is_stopping = is_powered and (not is_enabled or power.leaving is not None)
        word = status_bits(power.state) | REMOTE | (0 if torque_off else VOLTAGE_ENABLED) | (WARNING if lack else 0)
        return cls(power, is_powered, is_enabled, is_stopping, is_enabled and not is_stopping, word)
