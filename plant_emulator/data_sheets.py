"""The EDS files of the emulated nodes, as committed in `drive_profiles/vendors`."""

from plant_emulator.drive.dictionary.manufacturer_objects import drive_entries
from plant_emulator.drive.family.choice import family_of
from plant_emulator.robots.robot import Robot
from plant_emulator.sensor.accelerometer import accelerometer_entries
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.eds import DeviceInfo, write_eds

VENDOR = "hil-bench"


def data_sheets() -> dict[str, str]:
    """Return the name and text of each EDS file.

    A data sheet is of a kind of device, not of one: its serial number is 0, and what depends on the motor (encoder, torques,
    and the speeds that count in encoder counts) is that of the default drive.
    """
    return {
        name: data_sheet_of(Dictionary(entries), name, product)
        for name, product, entries in (
            ("emulated_drive.eds", "Emulated servo drive", drive_entries(serial_number=0)),
            ("emulated_accelerometer.eds", "Emulated accelerometer", accelerometer_entries(serial_number=0)),
        )
    }


def data_sheets_of(robot: Robot) -> dict[str, str]:
    """Return file name and text of each node's EDS.

    Raises:
        DriveProfileError: There is no such profile, or its file or the EDS file has errors.
        ValueError: A profile is not a drive's, or a default or a name does not fit into an INI file.
    """
    sheets = {}
    for number in sorted(robot.axis):
        family, name = family_of(robot, number), f"axis{number}.eds"
        product = f"Emulated {family.profile}, axis {number}"
        sheets[name] = data_sheet_of(family.dictionary, name, product, family.profile)
    name = "accelerometer.eds"
    accelerometer = Dictionary(accelerometer_entries(robot.accelerometer.node_id))
    return sheets | {name: data_sheet_of(accelerometer, name, "Emulated accelerometer")}


def data_sheet_of(dictionary: Dictionary, file_name: str, product: str, order_code: str | None = None) -> str:
    """Return one node's EDS, with its dictionary's serial number and motor.

    Args:
        dictionary: Object dictionary of any emulated node, also of a described drive.
        order_code: By which it is ordered; left out, the product's name.

    Raises:
        ValueError: A default or a name does not fit into an INI file.
    """
    order_code = product.replace(" ", "-").lower() if order_code is None else order_code
    description = f"{product}, written by plant-emulator eds"
    return write_eds(dictionary, DeviceInfo(file_name, VENDOR, product, order_code, description))
