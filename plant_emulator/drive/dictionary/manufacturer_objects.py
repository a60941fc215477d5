"""The emulated drive's object dictionary, one table for node and EDS."""

from collections.abc import Iterator

from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Mode, Object
from plant_emulator.drive.dictionary.cia402_objects import cia402_entries
from plant_emulator.slave.dictionary import Access, Entry
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries
from plant_emulator.slave.store import store_entries

VENDOR_ID = 0x48494C01
PRODUCT_CODE = 0x00000402
REVISION = 0x00000001
DEVICE_TYPE = 0x00020192
"""1000h: profile 402, servo drive."""

POSITION_LOOP, VELOCITY_LOOP, CONTROL_PERIOD, TORQUE_COMMAND = 0x2100, 0x2101, 0x2120, 0x2130
SET_POINT_TIMEOUT = 0x2131
"""Interpolation periods for which a missing set-point is extrapolated before it is a fault; 0 waits for ever."""
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

MODES = tuple(Mode)

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
    ("cancel_a1_rad", "Amplitude of order 1 at the motor in rad", DataType.REAL32, 0.0, 0.0, 0.05),
    ("cancel_phi1_rad", "Phase of order 1 in rad", DataType.REAL32, 0.0, -7.0, 7.0),
)
"""Field of `MOTION`, name in the EDS, type, default, limits; sub-indices count from 1 in this order."""


def drive_entries(
    *,
    encoder_counts_per_rev: int = 131072,
    rated_torque_mnm: int = 1000,
    max_torque_per_mille: int = 3000,
    control_period_ns: int = 250_000,
    gains: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 300.0),
    serial_number: int = 1,
    rated_current_ma: int = 1000,
) -> list[Entry]:
    """Return all entries of a drive with this motor, at factory settings.

    Args:
        gains: K_pp in 1/s, K_vp in N·m·s/rad, K_vi in N·m/rad, and the low-pass in Hz.
    """
    identity = {"vendor_id": VENDOR_ID, "product_code": PRODUCT_CODE, "revision": REVISION, "serial_number": serial_number}
    entries = communication_entries(device_type=DEVICE_TYPE, name="Emulated servo drive", **identity)
    entries += store_entries()
    entries += cycle_entries()
    entries += _manufacturer(control_period_ns, gains)
    entries += cia402_entries(encoder_counts_per_rev, rated_torque_mnm, max_torque_per_mille, MODES, rated_current_ma)
    return entries


def cycle_entries() -> Iterator[Entry]:
    """Return 1006h and the PDOs, the first with control and status word."""
    yield cycle_period_entry()
    yield from pdo_entries(
        rpdos=(PdoDefault(((Object.CONTROL_WORD, 0, 16),)),),
        tpdos=(PdoDefault(((Object.STATUS_WORD, 0, 16),)),),
    )


def cycle_period_entry() -> Entry:
    """Return 1006h, the communication cycle period in µs, 0 until written."""
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
    yield Entry(SET_POINT_TIMEOUT, 0, "Set-point time-out in interpolation periods", DataType.UNSIGNED8, rw, 0)
