"""Facts of CiA 301 that both sides of the bus share.

Source: CiA 301, version 4.2.0; the table or clause is named at each item.
"""

import struct
from enum import IntEnum, IntFlag

Value = bool | int | float | str | bytes
"""Value of an entry of an object dictionary, in Python."""

BROADCAST = 0
"""Node-ID of an NMT command that addresses every node."""
MAX_NODE_ID = 127


class FunctionCode(IntEnum):
    """Base of the COB-IDs of the predefined connection set.

    The node-ID is added to it (CiA 301, 7.3.3).

    EMERGENCY is another name of SYNC: they share function code 1, and node-ID 0 makes it SYNC.
    """

    NMT = 0x000
    SYNC = 0x080
    EMERGENCY = 0x080
    TIME = 0x100
    TPDO1 = 0x180
    RPDO1 = 0x200
    TPDO2 = 0x280
    RPDO2 = 0x300
    TPDO3 = 0x380
    RPDO3 = 0x400
    TPDO4 = 0x480
    RPDO4 = 0x500
    SDO_RESPONSE = 0x580
    SDO_REQUEST = 0x600
    HEARTBEAT = 0x700


RPDO_BASES = (FunctionCode.RPDO1, FunctionCode.RPDO2, FunctionCode.RPDO3, FunctionCode.RPDO4)
TPDO_BASES = (FunctionCode.TPDO1, FunctionCode.TPDO2, FunctionCode.TPDO3, FunctionCode.TPDO4)

_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def identifier_refusal(can_id: int, *, is_valid: bool = True, in_use: int | None = None) -> "SdoAbortCode | None":
    """Return the reason why a node refuses the identifier of a COB-ID, or None.

    29-bit identifiers are not supported. No configurable object (SYNC, TIME, EMCY, PDO, further SDO) that is valid may use a
    restricted one, nor change the one that is in use.

    Source: CiA 301, 7.3.5, table of the restricted CAN-IDs, and 7.5.2: bits 0 to 29 do not change while the object exists.
    """
    is_restricted = any(low <= can_id <= high for low, high in _RESTRICTED)
    is_free = not is_valid or (not is_restricted and in_use in {None, can_id})
    return None if can_id <= 0x7FF and is_free else SdoAbortCode.INVALID_VALUE


class CobIdBit(IntEnum):
    """Bits above the identifier in the COB-ID objects.

    Source: CiA 301, 7.5.2.5, 7.5.2.15, 7.5.2.17, 7.5.2.35 and 7.5.2.37.
    """

    INVALID = 1 << 31
    """PDO and EMCY: the object does not exist."""
    NO_RTR = 1 << 30
    """TPDO: remote requests are not answered."""
    GENERATE = 1 << 30
    """SYNC and TIME: this node sends it."""
    DYNAMIC = 1 << 30
    """SDO: assigned for the time being."""
    CONSUME = 1 << 31
    """TIME: this node listens to it."""
    EXTENDED = 1 << 29
    """29-bit identifier."""


class NmtCommand(IntEnum):
    """Command specifiers of the NMT master (CiA 301, 7.2.8.2.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class NmtState(IntEnum):
    """States of a node, with their values in the heartbeat.

    0 is the boot-up message (CiA 301, 7.2.8.3.2).
    """

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class DataType(IntEnum):
    """Index of a data type in the object dictionary.

    Source: CiA 301, 7.4.7, table of the data types.
    """

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    DOMAIN = 0x0F
    REAL64 = 0x11
    INTEGER64 = 0x15
    UNSIGNED64 = 0x1B

    __hash__ = int.__hash__  # Enum's is of the name, in Python: every encoding looks its packer up

    @property
    def struct_format(self) -> str | None:
        """Format character for `struct`, or None for strings and domains."""
        return _FORMATS.get(self)

    @property
    def size(self) -> int | None:
        """Length in bytes, or None if the value decides."""
        packer = PACKERS.get(self)
        return None if packer is None else packer.size

    @property
    def is_integer(self) -> bool:
        """True if the values are whole numbers."""
        return self.size is not None and not self.is_real and self is not DataType.BOOLEAN

    @property
    def is_real(self) -> bool:
        """True if the values are floating-point numbers."""
        return self in _REAL


_REAL = frozenset({DataType.REAL32, DataType.REAL64})
_FORMATS = {
    DataType.BOOLEAN: "?",
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.INTEGER64: "q",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.UNSIGNED64: "Q",
    DataType.REAL32: "f",
    DataType.REAL64: "d",
}
PACKERS = {data_type: struct.Struct("<" + character) for data_type, character in _FORMATS.items()}
"""The packer of every data type of fixed size."""


def encode(data_type: DataType, value: Value) -> bytes:
    """Encode a value as bytes for the bus (CiA 301, 7.1.4: little-endian).

    A VISIBLE_STRING is written in ISO 8859-1, of which the standard's ISO 646 is a part, so that `decode` and `encode` are
    inverse for any bytes that a device sends.

    Raises:
        ValueError: The value is not of this type, or outside its range.
    """
    packer = PACKERS.get(data_type)
    try:
        if packer is not None:
            return packer.pack(value)
        if isinstance(value, str) and data_type is DataType.VISIBLE_STRING:
            return value.encode("latin-1")
        if isinstance(value, bytes) and data_type is not DataType.VISIBLE_STRING:
            return value
    except (struct.error, OverflowError, UnicodeEncodeError) as error:
        raise ValueError(f"{value!r} is not a value of {data_type.name}: {error}") from error
    raise ValueError(f"{value!r} is not a value of {data_type.name}")


def decode(data_type: DataType, data: bytes) -> Value:
    """Decode a value from bytes of the bus; the inverse of `encode`.

    Raises:
        ValueError: The length is not that of the type.
    """
    packer = PACKERS.get(data_type)
    if packer is not None:
        if len(data) != packer.size:
            raise ValueError(f"{data_type.name} takes {packer.size} bytes, not {len(data)}")
        value: Value = packer.unpack(data)[0]
        return value
    return data.decode("latin-1") if data_type is DataType.VISIBLE_STRING else bytes(data)


def type_of_length(size: int) -> DataType:
    """Return the data type for bytes of unknown type."""
    unsigned = (DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.UNSIGNED64)
    return next((data_type for data_type in unsigned if data_type.size == size), DataType.DOMAIN)


class SdoAbortCode(IntEnum):
    """Reasons for aborted SDO transfers, with the standard's text.

    Source: CiA 301, 7.2.4.3.17.
    """

    text: str

    def __new__(cls, code: int, text: str) -> "SdoAbortCode":
        """Make a member from its code and its text."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    TOGGLE_BIT = 0x0503_0000, "Toggle bit not alternated"
    TIMED_OUT = 0x0504_0000, "SDO protocol timed out"
    UNKNOWN_COMMAND = 0x0504_0001, "Client/server command specifier not valid or unknown"
    INVALID_BLOCK_SIZE = 0x0504_0002, "Invalid block size"
    INVALID_SEQUENCE_NUMBER = 0x0504_0003, "Invalid sequence number"
    CRC = 0x0504_0004, "CRC error"
    OUT_OF_MEMORY = 0x0504_0005, "Out of memory"
    UNSUPPORTED_ACCESS = 0x0601_0000, "Unsupported access to an object"
    WRITE_ONLY = 0x0601_0001, "Attempt to read a write only object"
    READ_ONLY = 0x0601_0002, "Attempt to write a read only object"
    NO_OBJECT = 0x0602_0000, "Object does not exist in the object dictionary"
    NOT_MAPPABLE = 0x0604_0041, "Object cannot be mapped to the PDO"
    PDO_LENGTH = 0x0604_0042, "The number and length of the objects to be mapped would exceed PDO length"
    PARAMETER_INCOMPATIBLE = 0x0604_0043, "General parameter incompatibility reason"
    DEVICE_INCOMPATIBLE = 0x0604_0047, "General internal incompatibility in the device"
    HARDWARE = 0x0606_0000, "Access failed due to an hardware error"
    LENGTH_MISMATCH = 0x0607_0010, "Data type does not match, length of service parameter does not match"
    TOO_LONG = 0x0607_0012, "Data type does not match, length of service parameter too high"
    TOO_SHORT = 0x0607_0013, "Data type does not match, length of service parameter too low"
    NO_SUBINDEX = 0x0609_0011, "Sub-index does not exist"
    INVALID_VALUE = 0x0609_0030, "Invalid value for parameter"
    VALUE_TOO_HIGH = 0x0609_0031, "Value of parameter written too high"
    VALUE_TOO_LOW = 0x0609_0032, "Value of parameter written too low"
    MAXIMUM_BELOW_MINIMUM = 0x0609_0036, "Maximum value is less than minimum value"
    NO_RESOURCE = 0x060A_0023, "Resource not available: SDO connection"
    GENERAL = 0x0800_0000, "General error"
    NOT_STORED = 0x0800_0020, "Data cannot be transferred or stored to the application"
    LOCAL_CONTROL = 0x0800_0021, "Data cannot be transferred or stored to the application because of local control"
    DEVICE_STATE = (0x0800_0022, "Data cannot be transferred or stored to the application because of the present device state")
    NO_DICTIONARY = 0x0800_0023, "Object dictionary dynamic generation fails or no object dictionary is present"
    NO_DATA = 0x0800_0024, "No data available"


def abort_text(code: int) -> str:
    """Return the standard's text for an abort code."""
    try:
        return SdoAbortCode(code).text  # type: ignore[call-arg]  # looks a member up; mypy sees __new__ of the members
    except ValueError:
        return f"Unknown abort code {code:08X}h"


class EmergencyCode(IntEnum):
    """Error codes of the emergency object, generic and of communication.

    Source: CiA 301, 7.2.7.1.
    """

    NO_ERROR = 0x0000
    GENERIC = 0x1000
    CURRENT = 0x2000
    VOLTAGE = 0x3000
    TEMPERATURE = 0x4000
    HARDWARE = 0x5000
    SOFTWARE = 0x6000
    ADDITIONAL_MODULES = 0x7000
    MONITORING = 0x8000
    COMMUNICATION = 0x8100
    CAN_OVERRUN = 0x8110
    CAN_ERROR_PASSIVE = 0x8120
    HEARTBEAT = 0x8130
    BUS_OFF_RECOVERED = 0x8140
    COB_ID_COLLISION = 0x8150
    PROTOCOL = 0x8200
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIME_OUT = 0x8250
    EXTERNAL = 0x9000
    ADDITIONAL_FUNCTIONS = 0xF000
    DEVICE_SPECIFIC = 0xFF00


class ErrorRegister(IntFlag):
    """Bits of object 1001h (CiA 301, 7.5.2.2)."""

    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    PROFILE = 0x20
    MANUFACTURER = 0x80
