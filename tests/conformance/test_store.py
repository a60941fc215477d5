"""Store and restore: the signature, what survives, and when a restore takes effect (CiA 301, 7.5.2.13 and 7.5.2.14)."""

import pytest

from tests.conformance.device import RESET_COMMUNICATION, RESET_NODE
from tests.conformance.sdo_client import DEVICE_STATE, GENERAL, INVALID, LOCAL_CONTROL, NOT_STORED, Abort

STORE, RESTORE = 0x1010, 0x1011
SIGNATURES = {STORE: b"save", RESTORE: b"load"}
WRONG = (b"load", b"SAVE", b"evas", bytes(4), b"\xff\xff\xff\xff")
REFUSED = (NOT_STORED, LOCAL_CONTROL, DEVICE_STATE, INVALID, GENERAL)
PRODUCER, VALUE = 0x1017, 0x3456


@pytest.fixture
def kept(device, permit, needs):
    """A device that may store; at the end it has stored what it held before."""
    permit("store")
    needs((STORE, 1), (RESTORE, 1), PRODUCER)
    device.is_touched = True
    device.reset()
    before = device.read(PRODUCER)
    yield device
    device.reset()
    device.set(PRODUCER, 0, before)
    if device.is_emulated:
        command(device, RESTORE)
    else:
        command(device, STORE)
    device.reset()
    if device.read(PRODUCER) != before:
        device.not_restored_words.append(f"1017h: {before} before the tests of 1010h")


def command(device, index, sub=1, signature=None):
    device.is_touched = True
    return device.sdo.download(index, sub, SIGNATURES[index] if signature is None else signature)


@pytest.mark.parametrize("index", [STORE, RESTORE])
def test_a_read_says_how_the_device_stores(device, needs, index):
    needs((index, 1))
    how = device.read(index, 1)
    assert how & ~0x03 == 0, "bits 2 to 31 are reserved"
    assert how & 0x01 or index == STORE, "an object that cannot be commanded need not be there"


@pytest.mark.parametrize("index", [STORE, RESTORE])
@pytest.mark.parametrize("signature", WRONG)
def test_a_wrong_signature_is_refused_and_does_nothing(kept, index, signature):
    if signature == SIGNATURES[index]:
        signature = b"save" if index == RESTORE else b"load"
    kept.set(PRODUCER, 0, VALUE)
    assert kept.refused(command(kept, index, 1, signature), *REFUSED)
    assert kept.read(PRODUCER) == VALUE
    before = kept.read(index, 1)
    kept.reset()
    assert kept.read(PRODUCER) != VALUE
    assert kept.read(index, 1) == before


@pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
def test_what_is_stored_survives_a_reset(kept, reset):
    kept.set(PRODUCER, 0, VALUE)
    assert command(kept, STORE) is None
    kept.set(PRODUCER, 0, 0)
    kept.reset(reset)
    assert kept.read(PRODUCER) == VALUE


def test_what_is_not_stored_does_not_survive_a_reset(kept):
    kept.set(PRODUCER, 0, VALUE)
    kept.reset()
    assert kept.read(PRODUCER) != VALUE


def test_what_is_stored_survives_a_loss_of_power(kept):
    if kept.world is None:
        pytest.skip("nobody switches the supply of a real device")
    kept.set(PRODUCER, 0, VALUE)
    assert command(kept, STORE) is None
    kept.world.power_cycle(kept.node_id)
    assert kept.read(PRODUCER) == VALUE


def test_a_restore_takes_effect_with_the_next_reset(kept):
    kept.set(PRODUCER, 0, VALUE)
    assert command(kept, STORE) is None
    kept.reset()
    assert command(kept, RESTORE) is None
    assert kept.read(PRODUCER) == VALUE, "until the reset nothing changes"
    kept.reset()
    assert kept.read(PRODUCER) != VALUE


def test_communication_parameters_are_stored_by_their_own_sub_index(kept, needs):
    needs((STORE, 2))
    kept.set(PRODUCER, 0, VALUE)
    assert command(kept, STORE, 2) is None
    kept.reset()
    assert kept.read(PRODUCER) == VALUE


def test_a_store_does_not_keep_what_is_of_the_moment(kept, needs):
    needs(0x6040)
    kept.set(0x6040, 0, 0)
    assert command(kept, STORE) is None
    kept.reset()
    assert not isinstance(kept.sdo.upload(0x6041), Abort)
    assert kept.read(0x6040) == 0


def test_the_stored_configuration_date_goes_when_a_parameter_changes(kept, needs):
    needs((0x1020, 1), (0x1020, 2))
    kept.set(0x1020, 1, 15000)
    kept.set(0x1020, 2, 1000)
    assert (kept.read(0x1020, 1), kept.read(0x1020, 2)) == (15000, 1000)
    kept.set(PRODUCER, 0, VALUE)
    assert (kept.read(0x1020, 1), kept.read(0x1020, 2)) == (0, 0)
