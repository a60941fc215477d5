"""The communication objects that every node brings."""

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.emulation import HARDWARE_VERSION
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries


@pytest.mark.parametrize(
    "index",
    [
        *(0x1000, 0x1001, 0x1003, 0x1005, 0x1007, 0x1008, 0x1009, 0x100A, 0x100C, 0x100D, 0x1012),
        *(0x1014, 0x1015, 0x1016, 0x1017, 0x1018, 0x1019, 0x1020, 0x1029, 0x1200, 0x1201),
    ],
)
def test_the_objects_are_there(index):
    assert (index, 0) in Dictionary(communication_entries(device_type=0, name="x"))


def test_the_arguments_are_the_defaults():
    dictionary = Dictionary(
        communication_entries(
            device_type=0x00020192,
            name="Drive",
            vendor_id=1,
            product_code=2,
            revision=3,
            serial_number=4,
        ),
        node_id=5,
    )
    addresses = [(0x1000, 0), (0x1008, 0), (0x1009, 0), (0x100A, 0), (0x1014, 0), (0x1017, 0), (0x1029, 1)]
    assert [dictionary.get(*address) for address in addresses] == [0x00020192, "Drive", HARDWARE_VERSION, "1.0", 0x85, 0, 0]
    assert [dictionary.get(0x1018, subindex) for subindex in range(5)] == [4, 1, 2, 3, 4]


def test_read_only_objects_cannot_be_written(bench):
    for index, subindex, data in (
        (0x1000, 0, bytes(4)),
        (0x1001, 0, b"\0"),
        (0x1008, 0, b"name"),
        (0x1018, 1, bytes(4)),
    ):
        assert bench.write(index, subindex, data) is SdoAbortCode.READ_ONLY


def test_there_are_four_pdos_of_each_kind_and_no_more():
    indices = {entry.index for entry in pdo_entries()}
    assert indices == {base + number for base in (0x1400, 0x1600, 0x1800, 0x1A00) for number in range(4)}
    with pytest.raises(ValueError, match="5 RPDOs"):
        pdo_entries(rpdos=[PdoDefault()] * 5)


def test_validity_can_be_chosen():
    entries = pdo_entries(tpdos=[PdoDefault(is_valid=False), PdoDefault(), PdoDefault(is_valid=True)])
    cob_ids = [entry.default for entry in entries if 0x1800 <= entry.index <= 0x1803 and entry.subindex == 1]
    assert cob_ids == [0x80000180, 0x280, 0x380, 0x80000480]


def test_the_defaults_are_those_of_the_standard_where_it_has_some():
    """CiA 301, 7.5.2: error control and inhibit times off, TIME heard at 100h, nothing verified."""
    dictionary = Dictionary(communication_entries(device_type=0, name="x"), node_id=5)
    expected = {(0x100C, 0): 0, (0x100D, 0): 0, (0x1012, 0): 0x8000_0100, (0x1015, 0): 0, (0x1020, 1): 0, (0x1020, 2): 0}
    assert {address: dictionary.get(*address) for address in expected} == expected
    assert dictionary.get(0x1020, 0) == 2
