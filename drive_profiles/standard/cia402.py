"""CiA 402 as data.

Both sides of the bus use this module: the drive calls `next_state`, the master `state_of` and `control_word_towards`.

Source: CiA 402-2 (IEC 61800-7-201), device control: state machine, 6040h, 6041h and the option codes.
"""

from collections.abc import Iterable
from enum import Enum, IntEnum
from typing import NamedTuple


class State(Enum):
    """States of the power drive system, with the standard's names."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"


class Command(Enum):
    """Commands of the control word; see `control_word` for the bits."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    SWITCH_ON_AND_ENABLE = "switch on and enable operation"
    ENABLE_OPERATION = "enable operation"
    DISABLE_OPERATION = "disable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"


class Event(Enum):
    """Events that change the state without a command."""

    POWERED = "power applied or reset"
    INITIALISED = "initialisation and self test done"
    QUICK_STOP_COMPLETED = "quick stop function completed"
    FAULT_DETECTED = "fault detected"
    FAULT_REACTION_COMPLETED = "fault reaction completed"


class Transition(NamedTuple):
    """One arrow of the state machine; any one of its causes suffices."""

    origins: tuple[State, ...]
    target: State
    causes: tuple[Command | Event, ...]


_WORKING = tuple(state for state in State if state not in {State.FAULT_REACTION_ACTIVE, State.FAULT})

# CiA 402, state machine: the numbers are the standard's. Switch on and enable in one word is 3, then 4.
TRANSITIONS: dict[int, Transition] = {
    0: Transition((), State.NOT_READY_TO_SWITCH_ON, (Event.POWERED,)),
    1: Transition((State.NOT_READY_TO_SWITCH_ON,), State.SWITCH_ON_DISABLED, (Event.INITIALISED,)),
    2: Transition((State.SWITCH_ON_DISABLED,), State.READY_TO_SWITCH_ON, (Command.SHUTDOWN,)),
    3: Transition((State.READY_TO_SWITCH_ON,), State.SWITCHED_ON, (Command.SWITCH_ON, Command.SWITCH_ON_AND_ENABLE)),
    4: Transition((State.SWITCHED_ON,), State.OPERATION_ENABLED, (Command.ENABLE_OPERATION,)),
    5: Transition((State.OPERATION_ENABLED,), State.SWITCHED_ON, (Command.DISABLE_OPERATION,)),
    6: Transition((State.SWITCHED_ON,), State.READY_TO_SWITCH_ON, (Command.SHUTDOWN,)),
    7: Transition((State.READY_TO_SWITCH_ON,), State.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, Command.QUICK_STOP)),
    8: Transition((State.OPERATION_ENABLED,), State.READY_TO_SWITCH_ON, (Command.SHUTDOWN,)),
    9: Transition((State.OPERATION_ENABLED,), State.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE,)),
    10: Transition((State.SWITCHED_ON,), State.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, Command.QUICK_STOP)),
    11: Transition((State.OPERATION_ENABLED,), State.QUICK_STOP_ACTIVE, (Command.QUICK_STOP,)),
    12: Transition((State.QUICK_STOP_ACTIVE,), State.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, Event.QUICK_STOP_COMPLETED)),
    13: Transition(_WORKING, State.FAULT_REACTION_ACTIVE, (Event.FAULT_DETECTED,)),
    14: Transition((State.FAULT_REACTION_ACTIVE,), State.FAULT, (Event.FAULT_REACTION_COMPLETED,)),
    15: Transition((State.FAULT,), State.SWITCH_ON_DISABLED, (Command.FAULT_RESET,)),
    16: Transition((State.QUICK_STOP_ACTIVE,), State.OPERATION_ENABLED, (Command.ENABLE_OPERATION,)),
}


class Mode(IntEnum):
    """Modes of operation, 6060h and 6061h."""

    PP = 1
    PV = 3
    TQ = 4
    HM = 6
    IP = 7
    CSP = 8
    CSV = 9
    CST = 10


class QuickStopOption(IntEnum):
    """Quick stop option code, 605Ah: the way of braking.

    With 5 to 8 the drive stays in QUICK_STOP_ACTIVE afterwards.
    """

    DISABLE = 0
    SLOW_DOWN_RAMP = 1
    QUICK_STOP_RAMP = 2
    CURRENT_LIMIT = 3
    VOLTAGE_LIMIT = 4
    SLOW_DOWN_RAMP_AND_STAY = 5
    QUICK_STOP_RAMP_AND_STAY = 6
    CURRENT_LIMIT_AND_STAY = 7
    VOLTAGE_LIMIT_AND_STAY = 8


class ShutdownOption(IntEnum):
    """Shutdown option code, 605Bh: the action of transition 8."""

    DISABLE = 0
    SLOW_DOWN_RAMP = 1


class DisableOperationOption(IntEnum):
    """Disable operation option code, 605Ch: the action of transition 5."""

    DISABLE = 0
    SLOW_DOWN_RAMP = 1


class HaltOption(IntEnum):
    """Halt option code, 605Dh: the braking at the halt bit.

    The state stays OPERATION_ENABLED.
    """

    SLOW_DOWN_RAMP = 1
    QUICK_STOP_RAMP = 2
    CURRENT_LIMIT = 3
    VOLTAGE_LIMIT = 4


class FaultReactionOption(IntEnum):
    """Fault reaction option code, 605Eh: the action in FAULT_REACTION_ACTIVE."""

    DISABLE = 0
    SLOW_DOWN_RAMP = 1
    QUICK_STOP_RAMP = 2
    CURRENT_LIMIT = 3
    VOLTAGE_LIMIT = 4


class AbortConnectionOption(IntEnum):
    """Abort connection option code, 6007h: reaction to a lost master."""

    NO_ACTION = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


# Status word 6041h, the bits beside those of the state (CiA 402, 6041h). Bits 12 and 13 belong to the mode.
VOLTAGE_ENABLED = 1 << 4
WARNING = 1 << 7
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT = 1 << 11
SET_POINT_ACKNOWLEDGE = 1 << 12  # PP
SPEED_IS_ZERO = 1 << 12  # PV
INTERPOLATION_ACTIVE = 1 << 12  # IP
FOLLOWS_COMMAND = 1 << 12  # CSP, CSV, CST: "drive follows the command value"
HOMING_ATTAINED = 1 << 12  # HM
FOLLOWING_ERROR = 1 << 13  # PP, CSP
MAX_SLIPPAGE_ERROR = 1 << 13  # PV
HOMING_ERROR = 1 << 13  # HM

# Control word 6040h, the bits beside those of the commands.
NEW_SET_POINT = 1 << 4  # PP
HOMING_START = 1 << 4  # HM
ENABLE_INTERPOLATION = 1 << 4  # IP
CHANGE_SET_IMMEDIATELY = 1 << 5  # PP
RELATIVE = 1 << 6  # PP
HALT = 1 << 8
CHANGE_ON_SET_POINT = 1 << 9  # PP

_ENABLE_MASK = 0x6F  # with the quick stop bit 5
_PLAIN_MASK = 0x4F
_STATUS: dict[State, tuple[int, int]] = {  # (mask, bits), CiA 402, 6041h
    State.NOT_READY_TO_SWITCH_ON: (_PLAIN_MASK, 0x00),
    State.SWITCH_ON_DISABLED: (_PLAIN_MASK, 0x40),
    State.READY_TO_SWITCH_ON: (_ENABLE_MASK, 0x21),
    State.SWITCHED_ON: (_ENABLE_MASK, 0x23),
    State.OPERATION_ENABLED: (_ENABLE_MASK, 0x27),
    State.QUICK_STOP_ACTIVE: (_ENABLE_MASK, 0x07),
    State.FAULT_REACTION_ACTIVE: (_PLAIN_MASK, 0x0F),
    State.FAULT: (_PLAIN_MASK, 0x08),
}
# The masks split on bits 0 to 3, 5 and 6 only, so that one table of 128 answers every status word.
_STATE_OF = tuple(next((state for state, (mask, bits) in _STATUS.items() if word & mask == bits), None) for word in range(0x80))

_FAULT_RESET_BIT = 1 << 7
# (mask, bits) of each command, CiA 402, 6040h. SWITCH_ON has the bits of DISABLE_OPERATION, and ENABLE_OPERATION
# those of SWITCH_ON_AND_ENABLE: the state decides which of the two is meant.
PATTERNS: dict[Command, tuple[int, int]] = {
    Command.SHUTDOWN: (0x87, 0x06),
    Command.SWITCH_ON: (0x8F, 0x07),
    Command.SWITCH_ON_AND_ENABLE: (0x8F, 0x0F),
    Command.ENABLE_OPERATION: (0x8F, 0x0F),
    Command.DISABLE_OPERATION: (0x8F, 0x07),
    Command.DISABLE_VOLTAGE: (0x82, 0x00),
    Command.QUICK_STOP: (0x86, 0x02),
    Command.FAULT_RESET: (0x80, 0x80),
}
_TOWARDS: dict[State, Command] = {
    State.SWITCH_ON_DISABLED: Command.SHUTDOWN,
    State.READY_TO_SWITCH_ON: Command.SWITCH_ON,
    State.SWITCHED_ON: Command.ENABLE_OPERATION,
    State.OPERATION_ENABLED: Command.ENABLE_OPERATION,
}
_STEPS: dict[tuple[State, Command | Event], tuple[int, State]] = {
    (origin, cause): (number, transition.target)
    for number, transition in TRANSITIONS.items()
    for origin in transition.origins
    for cause in transition.causes
}


def state_of(status_word: int) -> State | None:
    """Return the state that a status word shows, or None.

    Source: CiA 402, 6041h: masks 4Fh and 6Fh.
    """
    return _STATE_OF[status_word & 0x7F]


def status_bits(state: State) -> int:
    """Return bits 0 to 3, 5 and 6 of the status word."""
    return _STATUS[state][1]


def control_word(command: Command) -> int:
    """Return the control word of a command, all other bits 0.

    The edge of FAULT_RESET needs a word with bit 7 clear before it.
    """
    return PATTERNS[command][1]


def commands(control_word: int, previous_control_word: int, state: State | None = None) -> Command | None:
    """Return the command in a control word (6040h), or None.

    All commands but the fault reset are levels with bit 7 clear. Fault reset is the rising edge of bit 7: held high it commands
    nothing, and blocks the other commands, as the standard's table has 0 there in each of them. The state distinguishes commands
    with equal bits; None reads them as SWITCH_ON and ENABLE_OPERATION.

    Source: CiA 402, 6040h.
    """
    if control_word & _FAULT_RESET_BIT:
        return None if previous_control_word & _FAULT_RESET_BIT else Command.FAULT_RESET
    if not control_word & 0x02:
        return Command.DISABLE_VOLTAGE
    if not control_word & 0x04:
        return Command.QUICK_STOP
    if not control_word & 0x01:
        return Command.SHUTDOWN
    if control_word & 0x08:
        return Command.SWITCH_ON_AND_ENABLE if state is State.READY_TO_SWITCH_ON else Command.ENABLE_OPERATION
    return Command.DISABLE_OPERATION if state is State.OPERATION_ENABLED else Command.SWITCH_ON


def next_state(
    state: State, control_word: int, previous_control_word: int, quick_stop_option: int = QuickStopOption.QUICK_STOP_RAMP
) -> State:
    """Return the state after one control word (6040h): at most one transition.

    A drive calls this in each of its cycles with the word in force and the one before it; "switch on and enable" then takes two
    of them (3, then 4). Transitions 0, 1, 13 and 14 are events, see `state_after`; transition 16 exists for the quick stop
    options (605Ah) 5 to 8 only. Fault reset ends in SWITCH_ON_DISABLED, whatever else the word holds.
    """
    command = commands(control_word, previous_control_word, state)
    if command is None:
        return state
    number, target = _STEPS.get((state, command), (None, state))
    if number == 16 and not _stays(quick_stop_option):
        return state
    return target


def state_after(state: State, event: Event, quick_stop_option: int = QuickStopOption.QUICK_STOP_RAMP) -> State:
    """Return the state after an internal event, which may change nothing.

    A completed quick stop leads to SWITCH_ON_DISABLED with 605Ah from 0 to 4, and to nothing with 5 to 8.
    """
    if event is Event.POWERED:
        return State.NOT_READY_TO_SWITCH_ON
    if event is Event.QUICK_STOP_COMPLETED and _stays(quick_stop_option):
        return state
    return _STEPS.get((state, event), (None, state))[1]


def control_word_towards(state: State) -> int | None:
    """Return the next control word on the way to OPERATION_ENABLED.

    The result is None if the master has to wait or to decide.

    None in NOT_READY_TO_SWITCH_ON and FAULT_REACTION_ACTIVE (the drive moves by itself), in FAULT (a reset is a
    decision) and in QUICK_STOP_ACTIVE (transition 16 would run on, disable voltage would end the braking).
    """
    command = _TOWARDS.get(state)
    return None if command is None else control_word(command)


def supported_modes_bits(modes: Iterable[Mode]) -> int:
    """Return 6502h for a set of modes: bit n-1 is mode n."""
    return sum(1 << (mode - 1) for mode in set(modes))


def supported_modes(bits: int) -> frozenset[Mode]:
    """Return the modes in a value of 6502h; unknown bits are ignored."""
    return frozenset(mode for mode in Mode if bits >> (mode - 1) & 1)


def _stays(quick_stop_option: int) -> bool:
    # Manufacturer-specific codes are negative: they do not promise to stay, so they do not allow transition 16.
    return QuickStopOption.SLOW_DOWN_RAMP_AND_STAY <= quick_stop_option <= QuickStopOption.VOLTAGE_LIMIT_AND_STAY


class Object(IntEnum):
    """Indices of objects of CiA 402 and related ones of CiA 301."""

    ABORT_CONNECTION_OPTION = 0x6007
    ERROR_CODE = 0x603F
    CONTROL_WORD = 0x6040
    STATUS_WORD = 0x6041
    QUICK_STOP_OPTION = 0x605A
    SHUTDOWN_OPTION = 0x605B
    DISABLE_OPERATION_OPTION = 0x605C
    HALT_OPTION = 0x605D
    FAULT_REACTION_OPTION = 0x605E
    MODES_OF_OPERATION = 0x6060
    MODES_OF_OPERATION_DISPLAY = 0x6061
    POSITION_DEMAND = 0x6062
    POSITION_ACTUAL_INTERNAL = 0x6063
    POSITION_ACTUAL = 0x6064
    FOLLOWING_ERROR_WINDOW = 0x6065
    FOLLOWING_ERROR_TIMEOUT = 0x6066
    POSITION_WINDOW = 0x6067
    POSITION_WINDOW_TIME = 0x6068
    VELOCITY_SENSOR_ACTUAL = 0x6069
    VELOCITY_DEMAND = 0x606B
    VELOCITY_ACTUAL = 0x606C
    VELOCITY_WINDOW = 0x606D
    VELOCITY_WINDOW_TIME = 0x606E
    VELOCITY_THRESHOLD = 0x606F
    VELOCITY_THRESHOLD_TIME = 0x6070
    TARGET_TORQUE = 0x6071
    MAX_TORQUE = 0x6072
    MAX_CURRENT = 0x6073
    TORQUE_DEMAND = 0x6074
    MOTOR_RATED_CURRENT = 0x6075
    MOTOR_RATED_TORQUE = 0x6076
    TORQUE_ACTUAL = 0x6077
    CURRENT_ACTUAL = 0x6078
    DC_LINK_VOLTAGE = 0x6079
    TARGET_POSITION = 0x607A
    POSITION_RANGE_LIMIT = 0x607B
    HOME_OFFSET = 0x607C
    SOFTWARE_POSITION_LIMIT = 0x607D
    POLARITY = 0x607E
    MAX_PROFILE_VELOCITY = 0x607F
    MAX_MOTOR_SPEED = 0x6080
    PROFILE_VELOCITY = 0x6081
    END_VELOCITY = 0x6082
    PROFILE_ACCELERATION = 0x6083
    PROFILE_DECELERATION = 0x6084
    QUICK_STOP_DECELERATION = 0x6085
    MOTION_PROFILE_TYPE = 0x6086
    TORQUE_SLOPE = 0x6087
    TORQUE_PROFILE_TYPE = 0x6088
    ENCODER_RESOLUTION = 0x608F
    VELOCITY_ENCODER_RESOLUTION = 0x6090
    GEAR_RATIO = 0x6091
    FEED_CONSTANT = 0x6092
    HOMING_METHOD = 0x6098
    HOMING_SPEEDS = 0x6099
    HOMING_ACCELERATION = 0x609A
    SI_UNIT_POSITION = 0x60A8
    SI_UNIT_VELOCITY = 0x60A9
    SI_UNIT_ACCELERATION = 0x60AA
    POSITION_OFFSET = 0x60B0
    VELOCITY_OFFSET = 0x60B1
    TORQUE_OFFSET = 0x60B2
    TOUCH_PROBE_FUNCTION = 0x60B8
    TOUCH_PROBE_STATUS = 0x60B9
    TOUCH_PROBE_1_POSITIVE = 0x60BA
    TOUCH_PROBE_1_NEGATIVE = 0x60BB
    TOUCH_PROBE_2_POSITIVE = 0x60BC
    TOUCH_PROBE_2_NEGATIVE = 0x60BD
    INTERPOLATION_SUB_MODE = 0x60C0
    INTERPOLATION_DATA = 0x60C1
    INTERPOLATION_PERIOD = 0x60C2
    MAX_ACCELERATION = 0x60C5
    MAX_DECELERATION = 0x60C6
    TOUCH_PROBE_SOURCE = 0x60D0
    POSITIVE_TORQUE_LIMIT = 0x60E0
    NEGATIVE_TORQUE_LIMIT = 0x60E1
    SUPPORTED_HOMING_METHODS = 0x60E3
    ADDITIONAL_POSITION_ACTUAL = 0x60E4
    ADDITIONAL_VELOCITY_ACTUAL = 0x60E5
    ADDITIONAL_ENCODER_INCREMENTS = 0x60E6
    ADDITIONAL_ENCODER_REVOLUTIONS = 0x60EB
    POSITIONING_OPTION = 0x60F2
    FOLLOWING_ERROR_ACTUAL = 0x60F4
    MAX_SLIPPAGE = 0x60F8
    CONTROL_EFFORT = 0x60FA
    POSITION_DEMAND_INTERNAL = 0x60FC
    DIGITAL_INPUTS = 0x60FD
    DIGITAL_OUTPUTS = 0x60FE
    TARGET_VELOCITY = 0x60FF
    MOTOR_TYPE = 0x6402
    MOTOR_CATALOGUE_NUMBER = 0x6403
    MOTOR_MANUFACTURER = 0x6404
    SUPPORTED_MODES = 0x6502
