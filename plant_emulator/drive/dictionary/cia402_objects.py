"""Objects of CiA 402 that every emulated drive has.

The units of the defaults are increments of the encoder: 6092h holds as many per revolution as the encoder has.

Source: CiA 402-2 (IEC 61800-7-201), object dictionary.
"""

from collections.abc import Iterator, Sequence
from enum import IntEnum

from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import (
    AbortConnectionOption,
    DisableOperationOption,
    FaultReactionOption,
    HaltOption,
    Mode,
    Object,
    QuickStopOption,
    ShutdownOption,
    supported_modes_bits,
)
from plant_emulator.slave.dictionary import Access, Entry, ObjectType

HOMING_METHODS = (*range(1, 15), *range(17, 31), 33, 34, 35, 37)
"""Homing methods that 6098h accepts besides 0, no method; 60E3h lists them."""

MAX_RELATIVE_OPTION = 2
"""60F2h takes 0, 1 and 2, what a relative set-point counts from; its other fields are not supported."""

SINUSOIDAL_PM_MOTOR = 10
"""6402h: permanent-magnet synchronous motor with sinusoidal current."""

_RW, _RO, _RWW, _CONST = Access.RW, Access.RO, Access.RWW, Access.CONST
_U8, _U16, _U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_I8, _I16, _I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
_LOWEST, _HIGHEST = -(2**31), 2**31 - 1
_NO_LIMIT = 2**32 - 1


def cia402_entries(
    encoder_counts_per_rev: int,
    rated_torque_mnm: int,
    max_torque_per_mille: int,
    modes: Sequence[Mode],
    rated_current_ma: int = 1000,
) -> Iterator[Entry]:
    """Return all CiA 402 entries for this motor and these modes.

    Args:
        rated_torque_mnm: Rated torque in mN·m (6076h).
        max_torque_per_mille: Largest torque in thousandths of the rated torque (6072h, 60E0h, 60E1h).
        modes: Modes of operation of the drive (6502h).
        rated_current_ma: Rated current in mA (6075h).
    """
    yield from _device_control(modes)
    yield from _position(encoder_counts_per_rev)
    yield from _velocity(encoder_counts_per_rev)
    yield from _torque(rated_torque_mnm, max_torque_per_mille, rated_current_ma)
    yield from _profile(encoder_counts_per_rev)
    yield from _cyclic()
    yield from _homing(encoder_counts_per_rev)
    yield from _units(encoder_counts_per_rev)
    yield from _inputs_and_outputs()


def _option(index: Object, name: str, options: type[IntEnum], default: int) -> Entry:
    return Entry(index, 0, f"{name} option code", _I16, _RW, default, min(options), max(options))


def _device_control(modes: Sequence[Mode]) -> Iterator[Entry]:
    yield _option(Object.ABORT_CONNECTION_OPTION, "Abort connection", AbortConnectionOption, 3)
    yield Entry(Object.ERROR_CODE, 0, "Error code", _U16, _RO, 0, mappable=True)
    yield Entry(Object.CONTROL_WORD, 0, "Control word", _U16, _RWW, 0, mappable=True)
    yield Entry(Object.STATUS_WORD, 0, "Status word", _U16, _RO, 0, mappable=True)
    yield _option(Object.QUICK_STOP_OPTION, "Quick stop", QuickStopOption, 2)
    yield _option(Object.SHUTDOWN_OPTION, "Shutdown", ShutdownOption, 0)
    yield _option(Object.DISABLE_OPERATION_OPTION, "Disable operation", DisableOperationOption, 1)
    yield _option(Object.HALT_OPTION, "Halt", HaltOption, 1)
    yield _option(Object.FAULT_REACTION_OPTION, "Fault reaction", FaultReactionOption, 2)
    yield Entry(Object.MODES_OF_OPERATION, 0, "Modes of operation", _I8, _RWW, 0, mappable=True)
    yield Entry(Object.MODES_OF_OPERATION_DISPLAY, 0, "Modes of operation display", _I8, _RO, 0, mappable=True)
    yield Entry(Object.SUPPORTED_MODES, 0, "Supported drive modes", _U32, _CONST, supported_modes_bits(modes))


def _position(counts: int) -> Iterator[Entry]:
    yield Entry(Object.POSITION_DEMAND, 0, "Position demand value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.POSITION_ACTUAL_INTERNAL, 0, "Position actual internal value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.POSITION_ACTUAL, 0, "Position actual value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.FOLLOWING_ERROR_WINDOW, 0, "Following error window", _U32, _RW, 4 * counts)
    yield Entry(Object.FOLLOWING_ERROR_TIMEOUT, 0, "Following error time out", _U16, _RW, 50)
    yield Entry(Object.POSITION_WINDOW, 0, "Position window", _U32, _RW, max(1, round(counts / 1000)))
    yield Entry(Object.POSITION_WINDOW_TIME, 0, "Position window time", _U16, _RW, 0)
    yield Entry(Object.TARGET_POSITION, 0, "Target position", _I32, _RWW, 0, mappable=True)
    wrap = "Position range limit"
    yield Entry(Object.POSITION_RANGE_LIMIT, 1, "Min position range limit", _I32, _RW, _LOWEST, record_name=wrap)
    yield Entry(Object.POSITION_RANGE_LIMIT, 2, "Max position range limit", _I32, _RW, _HIGHEST, record_name=wrap)
    limit = "Software position limit"
    yield Entry(Object.SOFTWARE_POSITION_LIMIT, 1, "Min position limit", _I32, _RW, _LOWEST, record_name=limit)
    yield Entry(Object.SOFTWARE_POSITION_LIMIT, 2, "Max position limit", _I32, _RW, _HIGHEST, record_name=limit)
    yield Entry(Object.POSITIONING_OPTION, 0, "Positioning option code", _U16, _RW, 0, 0, MAX_RELATIVE_OPTION)
    yield Entry(Object.FOLLOWING_ERROR_ACTUAL, 0, "Following error actual value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.CONTROL_EFFORT, 0, "Control effort", _I32, _RO, 0, mappable=True)
    yield Entry(Object.POSITION_DEMAND_INTERNAL, 0, "Position demand internal value", _I32, _RO, 0, mappable=True)


def _velocity(counts: int) -> Iterator[Entry]:
    slow = min(2**16 - 1, round(0.1 * counts))
    yield Entry(Object.VELOCITY_SENSOR_ACTUAL, 0, "Velocity sensor actual value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.VELOCITY_DEMAND, 0, "Velocity demand value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.VELOCITY_ACTUAL, 0, "Velocity actual value", _I32, _RO, 0, mappable=True)
    yield Entry(Object.VELOCITY_WINDOW, 0, "Velocity window", _U16, _RW, slow)
    yield Entry(Object.VELOCITY_WINDOW_TIME, 0, "Velocity window time", _U16, _RW, 0)
    yield Entry(Object.VELOCITY_THRESHOLD, 0, "Velocity threshold", _U16, _RW, slow)
    yield Entry(Object.VELOCITY_THRESHOLD_TIME, 0, "Velocity threshold time", _U16, _RW, 0)
    yield Entry(Object.MAX_MOTOR_SPEED, 0, "Max motor speed", _U32, _RW, 1200)
    yield Entry(Object.MAX_SLIPPAGE, 0, "Max slippage", _I32, _RW, _HIGHEST, 0)
    yield Entry(Object.TARGET_VELOCITY, 0, "Target velocity", _I32, _RWW, 0, mappable=True)


def _torque(rated_mnm: int, max_per_mille: int, rated_current_ma: int) -> Iterator[Entry]:
    yield Entry(Object.TARGET_TORQUE, 0, "Target torque", _I16, _RWW, 0, mappable=True)
    yield Entry(Object.MAX_TORQUE, 0, "Max torque", _U16, _RWW, max_per_mille, mappable=True)
    yield Entry(Object.MAX_CURRENT, 0, "Max current", _U16, _RW, 2**16 - 1)
    yield Entry(Object.TORQUE_DEMAND, 0, "Torque demand value", _I16, _RO, 0, mappable=True)
    yield Entry(Object.MOTOR_RATED_CURRENT, 0, "Motor rated current", _U32, _CONST, rated_current_ma)
    yield Entry(Object.MOTOR_RATED_TORQUE, 0, "Motor rated torque", _U32, _CONST, rated_mnm)
    yield Entry(Object.TORQUE_ACTUAL, 0, "Torque actual value", _I16, _RO, 0, mappable=True)
    yield Entry(Object.CURRENT_ACTUAL, 0, "Current actual value", _I16, _RO, 0, mappable=True)
    yield Entry(Object.DC_LINK_VOLTAGE, 0, "DC link circuit voltage", _U32, _RO, 0, mappable=True)
    yield Entry(Object.TORQUE_SLOPE, 0, "Torque slope", _U32, _RWW, 10_000, low=1, mappable=True)
    yield Entry(Object.TORQUE_PROFILE_TYPE, 0, "Torque profile type", _I16, _RW, 0, 0, 0)
    yield Entry(Object.POSITIVE_TORQUE_LIMIT, 0, "Positive torque limit value", _U16, _RWW, 2**16 - 1, mappable=True)
    yield Entry(Object.NEGATIVE_TORQUE_LIMIT, 0, "Negative torque limit value", _U16, _RWW, 2**16 - 1, mappable=True)
    yield Entry(Object.MOTOR_TYPE, 0, "Motor type", _U16, _CONST, SINUSOIDAL_PM_MOTOR)
    yield Entry(Object.MOTOR_CATALOGUE_NUMBER, 0, "Motor catalogue number", DataType.VISIBLE_STRING, _CONST, "emulated")
    yield Entry(Object.MOTOR_MANUFACTURER, 0, "Motor manufacturer", DataType.VISIBLE_STRING, _CONST, "none: emulated")


def _profile(counts: int) -> Iterator[Entry]:
    yield Entry(Object.MAX_PROFILE_VELOCITY, 0, "Max profile velocity", _U32, _RW, _NO_LIMIT)
    yield Entry(Object.PROFILE_VELOCITY, 0, "Profile velocity", _U32, _RWW, 5 * counts, mappable=True)
    yield Entry(Object.END_VELOCITY, 0, "End velocity", _U32, _RW, 0, 0, 0)
    yield Entry(Object.PROFILE_ACCELERATION, 0, "Profile acceleration", _U32, _RW, 20 * counts, low=1)
    yield Entry(Object.PROFILE_DECELERATION, 0, "Profile deceleration", _U32, _RW, 20 * counts, low=1)
    yield Entry(Object.QUICK_STOP_DECELERATION, 0, "Quick stop deceleration", _U32, _RW, 50 * counts, low=1)
    yield Entry(Object.MOTION_PROFILE_TYPE, 0, "Motion profile type", _I16, _RW, 0, 0, 0)
    yield Entry(Object.MAX_ACCELERATION, 0, "Max acceleration", _U32, _RW, _NO_LIMIT, low=1)
    yield Entry(Object.MAX_DECELERATION, 0, "Max deceleration", _U32, _RW, _NO_LIMIT, low=1)


def _cyclic() -> Iterator[Entry]:
    yield Entry(Object.POSITION_OFFSET, 0, "Position offset", _I32, _RWW, 0, mappable=True)
    yield Entry(Object.VELOCITY_OFFSET, 0, "Velocity offset", _I32, _RWW, 0, mappable=True)
    yield Entry(Object.TORQUE_OFFSET, 0, "Torque offset", _I16, _RWW, 0, mappable=True)
    yield Entry(Object.INTERPOLATION_SUB_MODE, 0, "Interpolation sub mode select", _I16, _RW, 0, 0, 0)
    data, array = "Interpolation data record", ObjectType.ARRAY
    yield Entry(
        Object.INTERPOLATION_DATA, 1, "First set-point", _I32, _RWW, 0, mappable=True, record_name=data, object_type=array
    )
    period = "Interpolation time period"
    yield Entry(Object.INTERPOLATION_PERIOD, 1, "Interpolation time period value", _U8, _RW, 2, 1, record_name=period)
    yield Entry(Object.INTERPOLATION_PERIOD, 2, "Interpolation time index", _I8, _RW, -3, -9, 0, record_name=period)


def _homing(counts: int) -> Iterator[Entry]:
    yield Entry(Object.HOME_OFFSET, 0, "Home offset", _I32, _RW, 0)
    yield Entry(Object.HOMING_METHOD, 0, "Homing method", _I8, _RW, 0)
    speeds, array = "Homing speeds", ObjectType.ARRAY
    name = "Speed during search for switch"
    yield Entry(Object.HOMING_SPEEDS, 1, name, _U32, _RW, counts, low=1, record_name=speeds, object_type=array)
    name = "Speed during search for zero"
    yield Entry(Object.HOMING_SPEEDS, 2, name, _U32, _RW, max(1, counts // 10), low=1, record_name=speeds, object_type=array)
    yield Entry(Object.HOMING_ACCELERATION, 0, "Homing acceleration", _U32, _RW, 20 * counts, low=1)
    methods = "Supported homing methods"
    for sub, method in enumerate(HOMING_METHODS, start=1):
        name = f"Supported homing method {sub}"
        yield Entry(
            Object.SUPPORTED_HOMING_METHODS, sub, name, _I16, _CONST, method, record_name=methods, object_type=ObjectType.ARRAY
        )


def _units(counts: int) -> Iterator[Entry]:
    yield Entry(Object.POLARITY, 0, "Polarity", _U8, _RW, 0)
    for index, name, first, second, value in (
        (Object.ENCODER_RESOLUTION, "Position encoder resolution", "Encoder increments", "Motor revolutions", counts),
        (
            Object.VELOCITY_ENCODER_RESOLUTION,
            "Velocity encoder resolution",
            "Encoder increments per second",
            "Motor revolutions per second",
            counts,
        ),
        (Object.GEAR_RATIO, "Gear ratio", "Motor revolutions", "Shaft revolutions", 1),
        (Object.FEED_CONSTANT, "Feed constant", "Feed", "Shaft revolutions", counts),
    ):
        yield Entry(index, 1, first, _U32, _RW, value, low=1, record_name=name, object_type=ObjectType.ARRAY)
        yield Entry(index, 2, second, _U32, _RW, 1, low=1, record_name=name, object_type=ObjectType.ARRAY)
    yield Entry(Object.SI_UNIT_POSITION, 0, "SI unit position", _U32, _RW, 0)
    yield Entry(Object.SI_UNIT_VELOCITY, 0, "SI unit velocity", _U32, _RW, 0)
    yield Entry(Object.SI_UNIT_ACCELERATION, 0, "SI unit acceleration", _U32, _RW, 0)


def _inputs_and_outputs() -> Iterator[Entry]:
    yield Entry(Object.TOUCH_PROBE_FUNCTION, 0, "Touch probe function", _U16, _RWW, 0, mappable=True)
    yield Entry(Object.TOUCH_PROBE_STATUS, 0, "Touch probe status", _U16, _RO, 0, mappable=True)
    for index, number, edge in (
        (Object.TOUCH_PROBE_1_POSITIVE, 1, "positive"),
        (Object.TOUCH_PROBE_1_NEGATIVE, 1, "negative"),
        (Object.TOUCH_PROBE_2_POSITIVE, 2, "positive"),
        (Object.TOUCH_PROBE_2_NEGATIVE, 2, "negative"),
    ):
        yield Entry(index, 0, f"Touch probe {number} {edge} edge", _I32, _RO, 0, mappable=True)
    source = "Touch probe source"
    for sub in (1, 2):
        name = f"Touch probe {sub} source"
        yield Entry(Object.TOUCH_PROBE_SOURCE, sub, name, _I16, _RW, sub, record_name=source, object_type=ObjectType.ARRAY)
    yield Entry(Object.DIGITAL_INPUTS, 0, "Digital inputs", _U32, _RO, 0, mappable=True)
    outputs, array = "Digital outputs", ObjectType.ARRAY
    name = "Physical outputs"
    yield Entry(Object.DIGITAL_OUTPUTS, 1, name, _U32, _RWW, 0, mappable=True, record_name=outputs, object_type=array)
    yield Entry(Object.DIGITAL_OUTPUTS, 2, "Bit mask", _U32, _RW, 0, record_name=outputs, object_type=array)
