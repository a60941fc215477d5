"""Store and restore: a drive that says that it does not store on command is not told to; one that is told answers again after."""

import pytest

from drive_profiles.device.device import Device
from drive_profiles.device.memory import restore_command, store_command
from drive_profiles.device.sdo import SdoPort
from drive_profiles.errors import NoAnswerError, RefusedError
from drive_profiles.family.catalogue import Catalogue
from plant_emulator.slave.dictionary import SdoAbort
from plant_emulator.slave.store import RESTORE, STORE
from tests.drive_profiles import upload_rig as rig
from tests.drive_profiles.device.test_pull import Silent


def device(slave, line=None):
    return Device(SdoPort(rig.NODE, rig.Line(slave) if line is None else line, 0.5), Catalogue(rig.PROFILE))


@pytest.mark.parametrize(
    ("held", "words"), [(0, r"holds 0x0; bit 0 is 0, so the drive does not store on command$"), (2, "it stores by itself")]
)
def test_a_drive_that_does_not_store_on_command_is_refused_before_anything_is_written(held, words, tmp_path):
    slave = rig.node()
    slave.dictionary.on_read(STORE, 1, lambda: held)
    with pytest.raises(RefusedError, match=words):
        store_command(device(slave)).check(device(slave))
    before = rig.contents(slave)
    with pytest.raises(RefusedError, match=words):
        rig.upload(slave, tmp_path, rig.wanted(), store=True)
    assert rig.contents(slave) == before
    assert not list(tmp_path.glob("*.jsonl"))
    assert rig.upload(slave, tmp_path, rig.wanted()).changes  # without --store nothing speaks against it


def test_restoring_is_checked_likewise():
    slave = rig.node()
    slave.dictionary.on_read(RESTORE, 1, lambda: 0)
    known = Device(SdoPort(rig.NODE, rig.Line(slave), 0.5), Catalogue())
    with pytest.raises(RefusedError, match="the drive does not restore on command"):
        restore_command(known).check(known)


def test_an_object_that_is_only_written_says_nothing_against_it():
    def refuse():
        raise SdoAbort(0x0601_0001)

    slave = rig.node()
    slave.dictionary.on_read(STORE, 1, refuse)
    drive = device(slave)
    command = store_command(drive)
    command.check(drive)
    command.give(drive)
    assert slave.store.stored


class Busy(Silent):
    """The node is silent for some requests after it has confirmed the store command."""

    def __init__(self, slave, count):
        super().__init__(slave)
        self.left, self.stored = count, False

    def send(self, can_id, data):
        if self.stored and self.left > 0:
            self.left -= 1
            return
        super().send(can_id, data)
        self.stored = self.stored or (data[0] & 0xE0 == 0x20 and data[1:4] == b"\x10\x10\x01")


def test_a_drive_that_is_busy_after_its_answer_is_waited_for_and_one_that_is_gone_is_told():
    slave = rig.node()
    line = Busy(slave, 5)
    drive = device(slave, line)
    store_command(drive).give(drive)
    assert line.left == 0
    other = rig.node()
    gone = device(other, Busy(other, 10_000))
    with pytest.raises(NoAnswerError, match="1010h:1"):
        store_command(gone).give(gone)
