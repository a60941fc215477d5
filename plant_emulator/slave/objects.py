"""The entries 1000h to 1FFFh of every node, by the predefined connections."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from drive_profiles.standard.cia301 import RPDO_BASES, TPDO_BASES, CobIdBit, DataType, FunctionCode
from drive_profiles.standard.emulation import HARDWARE_VERSION
from plant_emulator.slave import emergency, guarding, nmt, store, sync, time_of_day
from plant_emulator.slave.dictionary import Access, Entry, ObjectType
from plant_emulator.slave.pdo.setup import (
    MAX_MAPPED,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    PdoObject,
)
from plant_emulator.slave.sdo.channels import channel_entries

ERROR_BEHAVIOUR = 0x1029
HISTORY_LENGTH = 8
WATCHED_NODES = 4

U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32


def communication_entries(
    *,
    device_type: int,
    name: str,
    vendor_id: int = 0,
    product_code: int = 0,
    revision: int = 0,
    serial_number: int = 0,
) -> list[Entry]:
    """Return the communication objects of a node, without its PDOs.

    The arguments are 1000h, 1008h, and 1018h:01h to 04h.
    """
    ro, rw, const, text = Access.RO, Access.RW, Access.CONST, DataType.VISIBLE_STRING
    emcy = int(FunctionCode.EMERGENCY)
    return [
        Entry(0x1000, 0, "Device type", U32, ro, device_type),
        Entry(emergency.ERROR_REGISTER, 0, "Error register", U8, ro, 0, mappable=True),
        *_history(),
        Entry(sync.COB_ID, 0, "COB-ID SYNC", U32, rw, int(FunctionCode.SYNC)),
        Entry(sync.WINDOW, 0, "Synchronous window length", U32, rw, 0),
        Entry(0x1008, 0, "Manufacturer device name", text, const, name),
        Entry(0x1009, 0, "Manufacturer hardware version", text, const, HARDWARE_VERSION),  # by which a master knows the node
        Entry(0x100A, 0, "Manufacturer software version", text, const, "1.0"),
        Entry(guarding.GUARD_TIME, 0, "Guard time", U16, rw, 0),
        Entry(guarding.LIFE_TIME_FACTOR, 0, "Life time factor", U8, rw, 0),
        Entry(time_of_day.COB_ID, 0, "COB-ID TIME", U32, rw, CobIdBit.CONSUME | int(FunctionCode.TIME)),
        Entry(emergency.COB_ID, 0, "COB-ID EMCY", U32, rw, emcy, node_relative=True),
        Entry(emergency.INHIBIT_TIME, 0, "Inhibit time EMCY", U16, rw, 0),
        *_array(nmt.CONSUMER_TIME, "Consumer heartbeat time", rw, WATCHED_NODES),
        Entry(nmt.PRODUCER_TIME, 0, "Producer heartbeat time", U16, rw, 0),
        *_identity(vendor_id, product_code, revision, serial_number),
        Entry(sync.COUNTER_OVERFLOW, 0, "Synchronous counter overflow value", U8, rw, 0),
        *_verify_configuration(),
        Entry(  # what a lost heartbeat does: 0 pre-operational, 1 nothing, 2 stopped
            ERROR_BEHAVIOUR, 1, "Communication error", U8, rw, 0, 0, 2,
            record_name="Error behaviour", object_type=ObjectType.ARRAY,
        ),
        *channel_entries(),
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class PdoDefault:
    """A PDO before anyone has configured it.

    Attributes:
        mapped: The objects that it carries: index, sub-index, length in bits.
        transmission_type: 255 is event-driven, 1 each SYNC.
        event_timer_ms: Longest silence of a TPDO, or deadline of an RPDO; 0 is none.
        is_valid: True if the PDO exists; left out, PDO 1 and 2 do.
    """

    mapped: tuple[tuple[int, int, int], ...] = ()
    transmission_type: int = 255
    inhibit_time: int = 0
    event_timer_ms: int = 0
    is_valid: bool | None = None


def pdo_entries(rpdos: Sequence[PdoDefault] = (), tpdos: Sequence[PdoDefault] = ()) -> list[Entry]:
    """Return four RPDOs' and TPDOs' records; without a description they are empty.

    Raises:
        ValueError: More than four of a kind.
    """
    if max(len(rpdos), len(tpdos)) > len(RPDO_BASES):
        raise ValueError(f"{len(rpdos)} RPDOs and {len(tpdos)} TPDOs are too many; expected at most {len(RPDO_BASES)} each")
    entries: list[Entry] = []
    for number, (rpdo_base, tpdo_base) in enumerate(zip(RPDO_BASES, TPDO_BASES, strict=True)):
        rpdo = rpdos[number] if number < len(rpdos) else PdoDefault()
        tpdo = tpdos[number] if number < len(tpdos) else PdoDefault()
        entries += _pdo("RPDO", RPDO_COMMUNICATION + number, RPDO_MAPPING + number, rpdo, rpdo_base)
        entries += _pdo("TPDO", TPDO_COMMUNICATION + number, TPDO_MAPPING + number, tpdo, tpdo_base)
    return entries


def _pdo(kind: str, index: int, mapping: int, pdo: PdoDefault, base: FunctionCode) -> Iterator[Entry]:
    """Yield communication and mapping record of a PDO."""
    is_default_valid = base in RPDO_BASES[:2] + TPDO_BASES[:2]
    is_valid = is_default_valid if pdo.is_valid is None else pdo.is_valid
    cob_id = int(base) if is_valid else base | int(CobIdBit.INVALID)
    name, rw = f"{kind} communication parameter", Access.RW
    yield Entry(index, 1, "COB-ID used by PDO", U32, rw, cob_id, record_name=name, node_relative=True)
    yield Entry(index, 2, "Transmission type", U8, rw, pdo.transmission_type, record_name=name)
    yield Entry(index, 5, "Event timer", U16, rw, pdo.event_timer_ms, record_name=name)
    if kind == "TPDO":
        yield Entry(index, 3, "Inhibit time", U16, rw, pdo.inhibit_time, record_name=name)
        yield Entry(index, 6, "SYNC start value", U8, rw, 0, record_name=name)
    name = f"{kind} mapping parameter"
    yield Entry(mapping, 0, "Number of mapped objects", U8, rw, len(pdo.mapped), record_name=name)
    values = [PdoObject(*address).value for address in pdo.mapped] + [0] * (MAX_MAPPED - len(pdo.mapped))
    for position, value in enumerate(values, 1):
        yield Entry(mapping, position, f"Mapped object {position}", U32, rw, value, record_name=name)


def _history() -> Iterator[Entry]:
    name = "Pre-defined error field"
    array = ObjectType.ARRAY
    yield Entry(emergency.HISTORY, 0, "Number of errors", U8, Access.RW, 0, record_name=name, object_type=array)
    yield from _array(emergency.HISTORY, name, Access.RO, HISTORY_LENGTH)


def _verify_configuration() -> Iterator[Entry]:
    for subindex, name in enumerate(("Configuration date", "Configuration time"), 1):
        yield Entry(
            store.VERIFY, subindex, name, U32, Access.RW, 0, record_name="Verify configuration", object_type=ObjectType.ARRAY
        )


def _array(index: int, name: str, access: Access, length: int) -> Iterator[Entry]:
    for i in range(1, length + 1):
        yield Entry(index, i, f"{name} {i}", U32, access, 0, record_name=name, object_type=ObjectType.ARRAY)


def _identity(*values: int) -> Iterator[Entry]:
    names = ("Vendor-ID", "Product code", "Revision number", "Serial number")
    for subindex, (name, value) in enumerate(zip(names, values, strict=True), 1):
        yield Entry(0x1018, subindex, name, U32, Access.RO, value, record_name="Identity object")
