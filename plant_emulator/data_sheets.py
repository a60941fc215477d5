"""The EDS files of the emulated nodes, as they are committed beside the profiles in `drive_profiles/vendors`."""

from plant_emulator.accelerometer import accelerometer_entries
from plant_emulator.drive_objects import drive_entries
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.eds import DeviceInfo, write_eds

VENDOR = "hil-bench"


def data_sheets() -> dict[str, str]:
    """File name and text of each.

    A data sheet is of a kind of device, not of one: its serial number is 0, and what depends on the motor (encoder, torques,
    and the speeds that count in encoder counts) is that of the default drive.
    """
    sheets = {}
    for name, product, entries in (
        ("emulated_drive.eds", "Emulated servo drive", drive_entries(serial_number=0)),
        ("emulated_accelerometer.eds", "Emulated accelerometer", accelerometer_entries(serial_number=0)),
    ):
        info = DeviceInfo(name, VENDOR, product, product.replace(" ", "-").lower(), f"{product}, written by plant-emulator eds")
        sheets[name] = write_eds(Dictionary(entries), info)
    return sheets
