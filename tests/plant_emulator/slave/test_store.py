"""Store and restore: what survives, when it acts, what is refused, and how long the node is silent (CiA 301, 1010h and 1011h)."""

import struct

import canopen
import pytest

from drive_profiles.standard.cia301 import DataType, NmtCommand, SdoAbortCode
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.eds import DeviceInfo, write_eds
from plant_emulator.slave.store import (
    COMMUNICATION,
    LOAD,
    RESTORE,
    SAVE,
    STORE,
    VOLATILE,
    ParameterStore,
    StoreCommand,
    command_entry,
    standard_commands,
    store_entries,
)
from tests.plant_emulator.slave.conftest import NODE, PumpedNetwork

STORE_MS = 400
ALL, COMMUNICATION_GROUP, APPLICATION_GROUP, MANUFACTURER_GROUP = 1, 2, 3, 4
SAVE_BYTES, LOAD_BYTES = b"save", b"load"
LIMITED, HEARTBEAT, OPTION = (0x2000, 0), (0x1017, 0), (0x6083, 0)


@pytest.fixture
def bench(make_bench, make_entries, synchronous):
    return storing(make_bench, make_entries, synchronous)


def storing(make_bench, make_entries, synchronous, **slave):
    option = Entry(*OPTION, "Profile acceleration", DataType.UNSIGNED32, Access.RW, 100)
    entries = [*make_entries(**synchronous), *store_entries(), option]
    return make_bench(entries=entries, slave={"store_time_ns": STORE_MS * 1_000_000, **slave})


def save(bench, subindex=ALL, data=SAVE_BYTES, index=STORE):
    """The abort code or None, and after how many milliseconds it was told."""
    begin = bench.now
    answer = bench.request(0x23, *struct.pack("<HB", index, subindex), *data)
    while answer is None:
        frames = [frame.data for _, frame in bench.wait(1) if frame.can_id == 0x585]
        answer = frames[0] if frames else None
        assert bench.now - begin < 10_000_000_000
    code = SdoAbortCode(int.from_bytes(answer[4:], "little")) if answer[0] == 0x80 else None
    return code, (bench.now - begin) / 1e6


def write(bench, address, value):
    assert bench.write_value(*address, value) is None


def values(bench, *addresses):
    return [bench.dictionary.get(*address) for address in addresses]


def change_all(bench):
    write(bench, LIMITED, 55)
    write(bench, HEARTBEAT, 700)
    write(bench, OPTION, 999)


CHANGED, FACTORY = [55, 700, 999], [10, 0, 100]
ADDRESSES = LIMITED, HEARTBEAT, OPTION


# -- what it says ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [STORE, RESTORE])
@pytest.mark.parametrize("subindex", [1, 2, 3, 4])
def test_a_read_says_that_the_node_stores_on_command(bench, index, subindex):
    assert bench.read(index, subindex) == struct.pack("<I", 1)
    assert bench.read(index, 0) == b"\4"


def test_the_signatures_are_the_words_least_significant_byte_first():
    assert struct.pack("<I", SAVE) == SAVE_BYTES
    assert struct.pack("<I", LOAD) == LOAD_BYTES


# -- what it does ------------------------------------------------------------------------------------------------------


def test_without_a_store_a_loss_of_power_brings_the_factorys_values_back(bench):
    change_all(bench)
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == FACTORY


def test_what_is_stored_survives_a_loss_of_power_and_what_is_written_later_does_not(bench):
    change_all(bench)
    assert save(bench) == (None, STORE_MS)
    write(bench, LIMITED, 66)
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == CHANGED


@pytest.mark.parametrize(
    ("subindex", "expected"),
    [
        (ALL, CHANGED),
        (COMMUNICATION_GROUP, [10, 700, 100]),
        (APPLICATION_GROUP, [10, 0, 999]),
        (MANUFACTURER_GROUP, [55, 0, 100]),
    ],
)
def test_a_group_is_stored_without_the_others(bench, subindex, expected):
    change_all(bench)
    assert save(bench, subindex)[0] is None
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == expected


def test_a_second_store_of_one_group_leaves_what_the_others_hold(bench):
    change_all(bench)
    save(bench)
    write(bench, LIMITED, 77)
    write(bench, OPTION, 1)
    save(bench, MANUFACTURER_GROUP)
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == [77, 700, 999]


def test_a_reset_of_communication_puts_back_the_communication_part_only(bench):
    change_all(bench)
    save(bench)
    write(bench, LIMITED, 1)
    write(bench, HEARTBEAT, 2)
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert values(bench, LIMITED, HEARTBEAT) == [1, 700]
    bench.nmt(NmtCommand.RESET_NODE)
    assert values(bench, LIMITED, HEARTBEAT) == [55, 700]


def test_a_stored_heartbeat_is_sent_after_the_next_start(bench):
    write(bench, HEARTBEAT, 100)
    save(bench)
    bench.slave.power_on(bench.now)
    beats = [at for at, frame in bench.wait(1000) if frame.can_id == 0x705]
    assert len(beats) == 10


def test_a_stored_mapping_is_in_force_after_the_next_start(bench):
    cob_id = 0x205
    write(bench, (0x1400, 1), cob_id | 1 << 31)
    write(bench, (0x1600, 0), 0)
    write(bench, (0x1600, 1), 0x2000_0010)
    write(bench, (0x1600, 0), 1)
    write(bench, (0x1400, 2), 255)
    write(bench, (0x1400, 1), cob_id)
    save(bench)
    bench.slave.power_on(bench.now)
    bench.start()
    bench.send(cob_id, struct.pack("<h", -42))
    assert bench.dictionary.get(*LIMITED) == -42


def test_restoring_acts_after_the_next_reset_and_not_before(bench):
    change_all(bench)
    save(bench)
    assert save(bench, ALL, LOAD_BYTES, RESTORE) == (None, 0)
    assert values(bench, *ADDRESSES) == CHANGED
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    assert values(bench, *ADDRESSES) == [55, 0, 999]
    bench.nmt(NmtCommand.RESET_NODE)
    assert values(bench, *ADDRESSES) == FACTORY


def test_a_group_is_restored_without_the_others(bench):
    change_all(bench)
    save(bench)
    save(bench, MANUFACTURER_GROUP, LOAD_BYTES, RESTORE)
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == [10, 700, 999]


def test_commands_and_set_points_are_never_kept(bench):
    for address, value in (((0x6040, 0), 0x0F), ((0x6060, 0), 8), ((0x607A, 0), 12345)):
        write(bench, address, value)
    save(bench)
    assert not {index for index, _ in bench.slave.store.stored} & VOLATILE
    bench.slave.power_on(bench.now)
    assert values(bench, (0x6040, 0), (0x6060, 0), (0x607A, 0)) == [0, 0, 0]


def test_every_other_entry_that_can_be_written_is_kept(bench):
    save(bench)
    writable = {(e.index, e.subindex) for e in bench.dictionary if e.access.is_writable and e.index not in VOLATILE}
    assert set(bench.slave.store.stored) == writable
    assert {(0x2001, 0), (0x2002, 0), (0x2003, 2), (0x1014, 0), (0x1A00, 1)} <= writable


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("index", "word"), [(STORE, b"load"), (STORE, b"evas"), (STORE, b"\0\0\0\0"), (RESTORE, b"save")])
def test_another_signature_is_refused_at_once_and_nothing_is_stored(bench, index, word):
    change_all(bench)
    assert save(bench, ALL, word, index) == (SdoAbortCode.NOT_STORED, 0)
    bench.slave.power_on(bench.now)
    assert values(bench, *ADDRESSES) == FACTORY


def test_a_signature_of_the_wrong_length_or_to_a_missing_group_is_refused(bench):
    assert bench.write(STORE, 1, b"sav") is SdoAbortCode.TOO_SHORT
    assert bench.write(STORE, 5, b"save") is SdoAbortCode.NO_SUBINDEX
    assert bench.write(STORE, 0, b"\1") is SdoAbortCode.READ_ONLY


def test_an_owner_who_cannot_store_now_says_so_at_once(bench):
    bench.slave.store.may_store = lambda: SdoAbortCode.DEVICE_STATE
    assert save(bench) == (SdoAbortCode.DEVICE_STATE, 0)
    assert save(bench, ALL, LOAD_BYTES, RESTORE) == (SdoAbortCode.DEVICE_STATE, 0)


def test_a_memory_that_fails_says_so_after_its_time_and_keeps_what_it_had(bench):
    write(bench, LIMITED, 1)
    save(bench)
    write(bench, LIMITED, 2)
    bench.slave.store.fails = True
    assert save(bench) == (SdoAbortCode.HARDWARE, STORE_MS)
    bench.slave.power_on(bench.now)
    assert values(bench, LIMITED) == [1]


# -- is the node as it was configured? (CiA 301, 7.5.2.23) ------------------------------------------------------------

DATE, TIME = (0x1020, 1), (0x1020, 2)


def date(bench):
    write(bench, DATE, 15_000)
    write(bench, TIME, 3_600_000)


def test_the_date_of_the_configuration_survives_with_it(bench):
    change_all(bench)
    date(bench)
    save(bench)
    bench.slave.power_on(bench.now)
    assert values(bench, DATE, TIME) == [15_000, 3_600_000]


@pytest.mark.parametrize("address", [LIMITED, HEARTBEAT, OPTION, (0x1029, 1)])
def test_a_change_of_anything_that_would_be_kept_takes_the_date_away(bench, address):
    date(bench)
    write(bench, address, 1)
    assert values(bench, DATE, TIME) == [0, 0]


@pytest.mark.parametrize(("address", "value"), [(LIMITED, 10), ((0x6040, 0), 15), ((0x607A, 0), 1000), (DATE, 15_000)])
def test_what_changes_nothing_or_is_never_kept_leaves_the_date(bench, address, value):
    date(bench)
    write(bench, address, value)
    assert values(bench, DATE, TIME) == [15_000, 3_600_000]


def test_a_write_that_is_refused_leaves_the_date(bench):
    date(bench)
    assert bench.write_value(*LIMITED, 101) is SdoAbortCode.VALUE_TOO_HIGH
    assert values(bench, DATE, TIME) == [15_000, 3_600_000]


def test_a_pdo_leaves_the_date(bench):
    date(bench)
    bench.start()
    bench.send(0x205, struct.pack("<Hi", 15, 77))
    bench.sync()
    assert values(bench, (0x607A, 0), DATE) == [77, 15_000]


def test_a_change_that_was_not_stored_leaves_the_stored_date(bench):
    date(bench)
    save(bench)
    write(bench, LIMITED, 1)
    bench.slave.power_on(bench.now)
    assert values(bench, LIMITED, DATE, TIME) == [10, 15_000, 3_600_000]


@pytest.mark.parametrize("group", [ALL, COMMUNICATION_GROUP, APPLICATION_GROUP, MANUFACTURER_GROUP])
def test_a_stored_change_leaves_no_date_of_the_configuration_before_it(bench, group):
    date(bench)
    save(bench)
    change_all(bench)
    save(bench, group)
    bench.slave.power_on(bench.now)
    assert values(bench, DATE, TIME) == [0, 0]


@pytest.mark.parametrize("group", [ALL, COMMUNICATION_GROUP, APPLICATION_GROUP, MANUFACTURER_GROUP])
def test_a_restored_group_takes_the_date_away(bench, group):
    change_all(bench)
    date(bench)
    save(bench)
    save(bench, group, LOAD_BYTES, RESTORE)
    assert values(bench, DATE, TIME) == [0, 0]
    bench.slave.power_on(bench.now)
    assert values(bench, DATE, TIME) == [0, 0]


def test_a_group_without_the_date_is_stored_without_it(bench):
    date(bench)
    save(bench, APPLICATION_GROUP)
    bench.slave.power_on(bench.now)
    assert values(bench, DATE, TIME) == [0, 0]


# -- how long it takes -------------------------------------------------------------------------------------------------


def test_the_node_is_silent_on_sdo_and_alive_otherwise_while_it_stores(bench):
    write(bench, HEARTBEAT, 100)
    bench.start()
    assert bench.request(0x23, 0x10, 0x10, 1, *SAVE_BYTES) is None
    assert bench.request(0x40, 0x00, 0x10, 0) is None  # a read, and
    assert bench.request(0x80, 0x10, 0x10, 1, *struct.pack("<I", 0x0504_0000)) is None  # the client's abort
    assert [frame.can_id for frame in bench.sync()] == [0x185]
    sent = bench.wait(STORE_MS)
    assert sorted(frame.can_id for _, frame in sent) == [0x585] + [0x705] * 4
    answers = [(at, frame.data) for at, frame in sent if frame.can_id == 0x585]
    assert answers == [(STORE_MS * 1_000_000, b"\x60\x10\x10\x01\0\0\0\0")]
    assert bench.read(0x1000) == struct.pack("<I", 0x00020192)


def test_a_store_by_segments_is_answered_late_too(bench):
    assert bench.request(0x21, 0x10, 0x10, 1, 4, 0, 0, 0)[0] == 0x60
    assert bench.request(0x07, *SAVE_BYTES) is None
    assert [frame.data[0] for _, frame in bench.wait(STORE_MS) if frame.can_id == 0x585] == [0x20]
    assert bench.slave.store.stored


def test_a_slow_store_answers_when_it_is_over(bench):
    bench.slave.store.time_ns = 8_000_000_000
    assert save(bench) == (None, 8000)


def test_a_store_that_takes_no_time_answers_at_once(bench):
    bench.slave.store.time_ns = 0
    assert save(bench) == (None, 0)


def test_what_is_stored_are_the_values_of_the_moment_of_the_command(bench):
    bench.start()
    write(bench, LIMITED, 5)
    bench.request(0x23, 0x10, 0x10, 1, *SAVE_BYTES)
    bench.dictionary.set(*LIMITED, 6)
    bench.wait(STORE_MS)
    assert bench.slave.store.stored[LIMITED] == 5


@pytest.mark.parametrize("ending", ["power", "node", "communication", "stop"])
def test_a_loss_of_power_or_a_reset_in_the_middle_leaves_the_old_store_untouched(bench, ending):
    write(bench, LIMITED, 1)
    save(bench)
    write(bench, LIMITED, 2)
    bench.request(0x23, 0x10, 0x10, 1, *SAVE_BYTES)
    bench.wait(STORE_MS - 1)
    match ending:
        case "power":
            bench.slave.power_on(bench.now)
        case "node":
            bench.nmt(NmtCommand.RESET_NODE)
        case "communication":
            bench.nmt(NmtCommand.RESET_COMMUNICATION)
        case "stop":
            bench.nmt(NmtCommand.STOP)
    assert not [frame for _, frame in bench.wait(2 * STORE_MS) if frame.can_id == 0x585]
    assert bench.slave.store.stored[LIMITED] == 1
    bench.slave.power_on(bench.now)
    assert values(bench, LIMITED) == [1]


# -- other drives' commands --------------------------------------------------------------------------------------------


def test_a_vendors_own_store_object_takes_the_vendors_signature():
    address = 0x2F00, 3
    dictionary = Dictionary([command_entry(address, "Save"), Entry(0x2000, 0, "Gain", DataType.UNSIGNED32, Access.RW, 7)])
    store = ParameterStore(dictionary, (StoreCommand(address, 0x1234),))
    assert dictionary.cell(*address).assign(SAVE) is SdoAbortCode.NOT_STORED
    assert dictionary.get(*address) == 1
    assert not store.is_storable(dictionary.cell(*address).entry)


def test_a_node_without_the_objects_stores_nothing(make_bench, synchronous):
    bench = make_bench(**synchronous)
    assert bench.read(STORE, 1) is SdoAbortCode.NO_OBJECT
    assert bench.slave.store.stored == {}


def test_a_time_that_goes_back_is_the_callers_mistake():
    with pytest.raises(ValueError, match="-1 ns"):
        ParameterStore(Dictionary([]), standard_commands(), -1)
    assert 0x1FFF in COMMUNICATION
    assert 0x2000 not in COMMUNICATION


def test_the_canopen_package_stores_and_restores(bench, tmp_path):
    bench.slave.store.time_ns = 0
    path = tmp_path / "device.eds"
    path.write_text(write_eds(bench.dictionary, DeviceInfo("device.eds", "Vendor", "Product")))
    network, node = PumpedNetwork(bench), canopen.RemoteNode(NODE, str(path))
    network[NODE] = node
    node.sdo[0x2000].raw = 33
    node.store()
    bench.slave.power_on(bench.now)
    assert node.sdo[0x2000].raw == 33
    node.restore()
    bench.slave.power_on(bench.now)
    assert node.sdo[0x2000].raw == 10
    network.disconnect()


class Index(int):
    """An index as the members of our enumerations are: more than a plain number to a range, which compares it one by one."""

    compared = 0
    __hash__ = int.__hash__

    def __eq__(self, other):
        Index.compared += 1
        return int(self) == other


@pytest.mark.parametrize("command", [(STORE, SAVE_BYTES), (RESTORE, LOAD_BYTES)])
def test_a_group_is_told_by_its_ends_and_not_searched(make_bench, make_entries, synchronous, command):
    """Every millisecond of it would silence the whole bus."""
    option = Entry(Index(OPTION[0]), OPTION[1], "Profile acceleration", DataType.UNSIGNED32, Access.RW, 100)
    bench = make_bench(entries=[*make_entries(**synchronous), *store_entries(), option], slave={"store_time_ns": 0})
    write(bench, OPTION, 999)
    save(bench)
    Index.compared = 0
    assert save(bench, data=command[1], index=command[0]) == (None, 0.0)
    assert Index.compared < 100
