"""Objects of CiA 301 and CiA 402 by name and type.

They serve devices without a profile or an EDS.
"""

from typing import TYPE_CHECKING

from drive_profiles.standard.cia301 import DataType

if TYPE_CHECKING:  # completion must not wait for pydantic
    from drive_profiles.standard.object_address import ObjectAddress

_B, _W, _L = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_SB, _SW, _SL, _S = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32, DataType.VISIBLE_STRING

OBJECTS: "dict[ObjectAddress, tuple[str, DataType, str]]" = {
    (0x1000, 0): ("device_type", _L, "ro"),
    (0x1001, 0): ("error_register", _B, "ro"),
    (0x1005, 0): ("cob_id_sync", _L, "rw"),
    (0x1006, 0): ("communication_cycle_period", _L, "rw"),
    (0x1008, 0): ("manufacturer_device_name", _S, "const"),
    (0x1009, 0): ("manufacturer_hardware_version", _S, "const"),
    (0x100A, 0): ("manufacturer_software_version", _S, "const"),
    (0x1014, 0): ("cob_id_emcy", _L, "rw"),
    (0x1016, 1): ("consumer_heartbeat_time_1", _L, "rw"),
    (0x1017, 0): ("producer_heartbeat_time", _W, "rw"),
    (0x1018, 1): ("vendor_id", _L, "ro"),
    (0x1018, 2): ("product_code", _L, "ro"),
    (0x1018, 3): ("revision_number", _L, "ro"),
    (0x1018, 4): ("serial_number", _L, "ro"),
    (0x6007, 0): ("abort_connection_option_code", _SW, "rw"),
    (0x603F, 0): ("error_code", _W, "ro"),
    (0x6040, 0): ("control_word", _W, "rww"),
    (0x6041, 0): ("status_word", _W, "ro"),
    (0x605A, 0): ("quick_stop_option_code", _SW, "rw"),
    (0x605B, 0): ("shutdown_option_code", _SW, "rw"),
    (0x605C, 0): ("disable_operation_option_code", _SW, "rw"),
    (0x605D, 0): ("halt_option_code", _SW, "rw"),
    (0x605E, 0): ("fault_reaction_option_code", _SW, "rw"),
    (0x6060, 0): ("modes_of_operation", _SB, "rww"),
    (0x6061, 0): ("modes_of_operation_display", _SB, "ro"),
    (0x6064, 0): ("position_actual_value", _SL, "ro"),
    (0x606C, 0): ("velocity_actual_value", _SL, "ro"),
    (0x6071, 0): ("target_torque", _SW, "rww"),
    (0x6075, 0): ("motor_rated_current", _L, "rw"),
    (0x6076, 0): ("motor_rated_torque", _L, "rw"),
    (0x6077, 0): ("torque_actual_value", _SW, "ro"),
    (0x607A, 0): ("target_position", _SL, "rww"),
    (0x607E, 0): ("polarity", _B, "rw"),
    (0x608F, 1): ("encoder_increments", _L, "rw"),
    (0x608F, 2): ("encoder_motor_revolutions", _L, "rw"),
    (0x6091, 1): ("gear_motor_revolutions", _L, "rw"),
    (0x6091, 2): ("gear_shaft_revolutions", _L, "rw"),
    (0x60C2, 1): ("interpolation_time_period_value", _B, "rw"),
    (0x60C2, 2): ("interpolation_time_index", _SB, "rw"),
    (0x6502, 0): ("supported_drive_modes", _L, "ro"),
}
"""Name, type and access of each object, by address. Source: CiA 301, 7.5.2; CiA 402-2."""
