"""The emulated drive's object dictionary, as one table: the node and its EDS are both made from it."""

from collections.abc import Iterator, Sequence

from drive_profiles.cia301 import DataType
from drive_profiles.cia402 import Mode, Object, supported_modes_bits
from plant_emulator.slave.dictionary import Access, Entry
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries
from plant_emulator.slave.store import store_entries

VENDOR_ID = 0x48494C01
PRODUCT_CODE = 0x00000402
REVISION = 0x00000001
DEVICE_TYPE = 0x00020192
"""1000h: profile 402, servo drive."""

POSITION_LOOP, VELOCITY_LOOP, CONTROL_PERIOD, TORQUE_COMMAND = 0x2100, 0x2101, 0x2120, 0x2130
NOTCH_OBJECTS = (0x2110, 0x2111)
NOTCH_STATE_OBJECTS = (0x2112, 0x2113)
CANCELLATION = 0x2114
USER_TEXT = 0x2FF0

GAINS = {
    (POSITION_LOOP, 1): "position_gain_per_s",
    (VELOCITY_LOOP, 1): "velocity_gain_nm_s_rad",
    (VELOCITY_LOOP, 2): "velocity_integral_gain_nm_rad",
    (VELOCITY_LOOP, 3): "lowpass_hz",
}
"""Field of `Cascade` that each of these entries holds."""

MODES = (Mode.PP, Mode.CSP, Mode.CST)

NOTCH_PARAMETERS: tuple[tuple[str, str, DataType, float, float, float], ...] = (
    ("mode", "Mode (0 off, 1 switched, 2 trapezoid)", DataType.UNSIGNED8, 0, 0, 2),
    ("order", "Harmonic order k", DataType.UNSIGNED8, 2, 1, 8),
    ("start_rps", "Start speed f_s in rev/s", DataType.REAL32, 4.0, 0.01, 1000.0),
    ("end_rps", "End speed f_e in rev/s", DataType.REAL32, 9.0, 0.01, 1000.0),
    ("offset_hz", "Pole offset in Hz", DataType.REAL32, 0.5, 0.0, 100.0),
    ("zeta_rn", "Damping of the zeros", DataType.REAL32, 0.028, 1e-4, 10.0),
    ("zeta_rdth", "Damping of the poles", DataType.REAL32, 0.1, 1e-4, 10.0),
    ("hysteresis_rps", "Switching hysteresis in rev/s", DataType.REAL32, 0.15, 0.0, 10.0),
    ("speed_lowpass_hz", "Corner of the speed low-pass in Hz", DataType.REAL32, 50.0, 1.0, 1000.0),
    ("ramp_rps", "Slope of the trapezoid in rev/s", DataType.REAL32, 1.0, 0.01, 100.0),
)
"""Field of `Notch`, name in the EDS, type, default, limits; sub-indices count from 1 in this order."""

CANCELLATION_PARAMETERS: tuple[tuple[str, str, DataType, float, float, float], ...] = (
    ("cancel_mode", "Mode (0 off, 1 on)", DataType.UNSIGNED8, 0, 0, 1),
    ("cancel_a2_rad", "Amplitude of order 2 at the motor in rad", DataType.REAL32, 0.0, 0.0, 0.05),
    ("cancel_phi2_rad", "Phase of order 2 in rad", DataType.REAL32, 0.0, -7.0, 7.0),
    ("cancel_a4_rad", "Amplitude of order 4 at the motor in rad", DataType.REAL32, 0.0, 0.0, 0.05),
    ("cancel_phi4_rad", "Phase of order 4 in rad", DataType.REAL32, 0.0, -7.0, 7.0),
    ("cancel_inertia_kg_m2", "Motor inertia in kg m2", DataType.REAL32, 0.0, 0.0, 1.0),
    ("cancel_damping_nm_s_rad", "Motor damping in N m s/rad", DataType.REAL32, 0.0, 0.0, 1.0),
)
"""Field of `MOTION`, name in the EDS, type, default, limits; sub-indices count from 1 in this order."""

_I32 = (-(2**31), 2**31 - 1)


def drive_entries(
    *,
    encoder_counts_per_rev: int = 131072,
    rated_torque_mnm: int = 1000,
    max_torque_per_mille: int = 3000,
    control_period_ns: int = 250_000,
    gains: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 300.0),
    serial_number: int = 1,
) -> list[Entry]:
    """All entries of a drive with this motor; the defaults are what it leaves the factory with."""
    entries = list(
        communication_entries(
            device_type=DEVICE_TYPE,
            name="Emulated servo drive",
            hardware_version="1",
            software_version="1.0",
            vendor_id=VENDOR_ID,
            product_code=PRODUCT_CODE,
            revision=REVISION,
            serial_number=serial_number,
        )
    )
    entries += store_entries()
    entries += cycle_entries()
    entries += _manufacturer(control_period_ns, gains)
    entries += cia402_entries(encoder_counts_per_rev, rated_torque_mnm, max_torque_per_mille)
    return entries


def cycle_entries() -> Iterator[Entry]:
    """What a drive's cyclic exchange needs: 1006h and the PDOs, the first of which carry control word and status word."""
    yield cycle_period_entry()
    yield from pdo_entries(
        rpdos=(PdoDefault(((Object.CONTROL_WORD, 0, 16),)),),
        tpdos=(PdoDefault(((Object.STATUS_WORD, 0, 16),)),),
    )


def cycle_period_entry() -> Entry:
    """1006h, the communication cycle period in µs; 0 where the node has not been told."""
    return Entry(0x1006, 0, "Communication cycle period", DataType.UNSIGNED32, Access.RW, 0, high=1_000_000)


def _manufacturer(control_period_ns: int, gains: tuple[float, float, float, float]) -> Iterator[Entry]:
    rw, ro, real = Access.RW, Access.RO, DataType.REAL32
    loop = "Position controller"
    yield Entry(POSITION_LOOP, 1, "K_pp in 1/s", real, rw, gains[0], 0.0, 1e4, record_name=loop)
    loop = "Velocity controller"
    yield Entry(VELOCITY_LOOP, 1, "K_vp in N m s/rad", real, rw, gains[1], 0.0, 1e4, record_name=loop)
    yield Entry(VELOCITY_LOOP, 2, "K_vi in N m/rad", real, rw, gains[2], 0.0, 1e6, record_name=loop)
    yield Entry(VELOCITY_LOOP, 3, "Low-pass in Hz", real, rw, gains[3], 1.0, 1900.0, record_name=loop)
    for number, index in enumerate(NOTCH_OBJECTS, start=1):
        for sub, (_, name, kind, default, low, high) in enumerate(NOTCH_PARAMETERS, start=1):
            value = int(default) if kind is DataType.UNSIGNED8 else default
            yield Entry(index, sub, name, kind, rw, value, low, high, record_name=f"Notch filter {number}")
    for number, index in enumerate(NOTCH_STATE_OBJECTS, start=1):
        state = f"Notch filter {number} state"
        yield Entry(index, 1, "Active", DataType.UNSIGNED8, ro, 0, mappable=True, record_name=state)
        yield Entry(index, 2, "Zero frequency in Hz", real, ro, 0.0, mappable=True, record_name=state)
        yield Entry(index, 3, "Damping of the poles now", real, ro, 0.0, mappable=True, record_name=state)
    for sub, (_, name, kind, default, low, high) in enumerate(CANCELLATION_PARAMETERS, start=1):
        value = int(default) if kind is DataType.UNSIGNED8 else default
        yield Entry(CANCELLATION, sub, name, kind, rw, value, low, high, record_name="Cancellation of the transmission error")
    yield Entry(CONTROL_PERIOD, 0, "Control period in ns", DataType.UNSIGNED32, Access.CONST, control_period_ns)
    yield Entry(TORQUE_COMMAND, 0, "Torque command in N m", real, ro, 0.0, mappable=True)
    yield Entry(USER_TEXT, 0, "User text", DataType.VISIBLE_STRING, rw, "")


def cia402_entries(
    encoder_counts_per_rev: int, rated_torque_mnm: int, max_torque_per_mille: int, modes: Sequence[Mode] = MODES
) -> Iterator[Entry]:
    """The objects of CiA 402 without which an emulated drive does not move."""
    rw, ro, rww, const = Access.RW, Access.RO, Access.RWW, Access.CONST
    u8, u16, u32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
    i8, i16, i32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
    yield Entry(Object.ABORT_CONNECTION_OPTION, 0, "Abort connection option code", i16, rw, 3, 0, 3)
    yield Entry(Object.ERROR_CODE, 0, "Error code", u16, ro, 0, mappable=True)
    yield Entry(Object.CONTROL_WORD, 0, "Control word", u16, rww, 0, mappable=True)
    yield Entry(Object.STATUS_WORD, 0, "Status word", u16, ro, 0, mappable=True)
    yield Entry(Object.QUICK_STOP_OPTION, 0, "Quick stop option code", i16, rw, 2, 0, 6)
    yield Entry(Object.FAULT_REACTION_OPTION, 0, "Fault reaction option code", i16, rw, 2, 0, 2)
    yield Entry(Object.MODES_OF_OPERATION, 0, "Modes of operation", i8, rww, 0, mappable=True)
    yield Entry(Object.MODES_OF_OPERATION_DISPLAY, 0, "Modes of operation display", i8, ro, 0, mappable=True)
    yield Entry(Object.POSITION_ACTUAL, 0, "Position actual value", i32, ro, 0, mappable=True)
    yield Entry(Object.FOLLOWING_ERROR_WINDOW, 0, "Following error window", u32, rw, 4 * encoder_counts_per_rev)
    yield Entry(Object.FOLLOWING_ERROR_TIMEOUT, 0, "Following error time out", u16, rw, 50)
    yield Entry(Object.VELOCITY_ACTUAL, 0, "Velocity actual value", i32, ro, 0, mappable=True)
    yield Entry(Object.TARGET_TORQUE, 0, "Target torque", i16, rww, 0, mappable=True)
    yield Entry(Object.MAX_TORQUE, 0, "Max torque", u16, rww, max_torque_per_mille, mappable=True)
    yield Entry(Object.MOTOR_RATED_TORQUE, 0, "Motor rated torque", u32, const, rated_torque_mnm)
    yield Entry(Object.TORQUE_ACTUAL, 0, "Torque actual value", i16, ro, 0, mappable=True)
    yield Entry(Object.TARGET_POSITION, 0, "Target position", i32, rww, 0, mappable=True)
    limit = "Software position limit"
    yield Entry(Object.SOFTWARE_POSITION_LIMIT, 1, "Min position limit", i32, rw, _I32[0], record_name=limit)
    yield Entry(Object.SOFTWARE_POSITION_LIMIT, 2, "Max position limit", i32, rw, _I32[1], record_name=limit)
    yield Entry(Object.MAX_MOTOR_SPEED, 0, "Max motor speed", u32, rw, 1200)
    yield Entry(Object.PROFILE_VELOCITY, 0, "Profile velocity", u32, rww, 5 * encoder_counts_per_rev, mappable=True)
    yield Entry(Object.PROFILE_ACCELERATION, 0, "Profile acceleration", u32, rw, 20 * encoder_counts_per_rev, low=1)
    yield Entry(Object.PROFILE_DECELERATION, 0, "Profile deceleration", u32, rw, 20 * encoder_counts_per_rev, low=1)
    yield Entry(Object.QUICK_STOP_DECELERATION, 0, "Quick stop deceleration", u32, rw, 50 * encoder_counts_per_rev, low=1)
    resolution = "Position encoder resolution"
    yield Entry(Object.ENCODER_RESOLUTION, 1, "Encoder increments", u32, const, encoder_counts_per_rev, record_name=resolution)
    yield Entry(Object.ENCODER_RESOLUTION, 2, "Motor revolutions", u32, const, 1, record_name=resolution)
    yield Entry(Object.GEAR_RATIO, 1, "Motor revolutions", u32, const, 1, record_name="Gear ratio")
    yield Entry(Object.GEAR_RATIO, 2, "Shaft revolutions", u32, const, 1, record_name="Gear ratio")
    yield Entry(Object.POSITION_OFFSET, 0, "Position offset", i32, rww, 0, mappable=True)
    yield Entry(Object.VELOCITY_OFFSET, 0, "Velocity offset", i32, rww, 0, mappable=True)
    yield Entry(Object.TORQUE_OFFSET, 0, "Torque offset", i16, rww, 0, mappable=True)
    period = "Interpolation time period"
    yield Entry(Object.INTERPOLATION_PERIOD, 1, "Interpolation time period value", u8, rw, 2, 1, record_name=period)
    yield Entry(Object.INTERPOLATION_PERIOD, 2, "Interpolation time index", i8, rw, -3, -9, 0, record_name=period)
    yield Entry(Object.FOLLOWING_ERROR_ACTUAL, 0, "Following error actual value", i32, ro, 0, mappable=True)
    yield Entry(Object.SUPPORTED_MODES, 0, "Supported drive modes", u32, const, supported_modes_bits(modes))
