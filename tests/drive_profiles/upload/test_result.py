"""The words of an outcome count what there is, and say of no object more than is known."""

import pytest

from drive_profiles.errors import BusError
from drive_profiles.standard.object_address import object_address
from drive_profiles.upload.result import UploadResult
from tests.drive_profiles import upload_rig as rig


class Cut(rig.Line):
    """After the first `writes` writes the bus is lost."""

    def __init__(self, slave, writes):
        super().__init__(slave)
        self.left, self.lost = writes, False

    def send(self, can_id, data):
        if self.lost:
            raise BusError("bus lost")
        super().send(can_id, data)
        if data[0] & 0xE0 == 0x20 and data[1:3] != b"\x00\x00":
            self.left -= 1
            self.lost = self.left == 0


@pytest.mark.parametrize("writes", [1, 9])
def test_after_the_loss_of_a_bus_only_what_was_written_is_unknown(writes, tmp_path):
    slave = rig.node()
    wanted = rig.wanted()
    made = rig.upload(slave, tmp_path, wanted, Cut(slave, writes))
    [outcome] = rig.fleet.run([made])
    unknown = {object_address(text.split(" ")[0]) for text in outcome.unknown}
    assert outcome.kind == "unknown"
    assert len(unknown) == writes + 1  # the next one was tried
    assert outcome.unread == len(made.addresses) - writes - 1
    assert outcome.other_count == 0
    said = str(outcome)
    assert "all others" not in said
    assert f"; {outcome.unread} more were not written, and could not be read: bus lost" in said
    before = rig.contents(rig.node())
    after = rig.contents(slave)
    assert {place for place in before if before[place] != after[place]} <= unknown


def test_what_holds_its_former_value_by_a_read_is_called_the_others(tmp_path):
    slave = rig.node()
    cell = slave.dictionary.cell(0x2007, 1)
    line = rig.Line(slave)
    made = rig.upload(slave, tmp_path, rig.wanted(), line)

    def stubborn(number):
        if number > 400:
            cell.value = 55  # whatever is written to it

    line.on_frame = stubborn
    [outcome] = rig.fleet.run([made])
    assert outcome.kind == "unknown"
    assert outcome.unknown == ("2007:1 (p7)",)
    assert outcome.other_count == len(made.addresses) - 1
    assert "; all others hold the old values: " in str(outcome)


def test_one_object_alone_has_no_others():
    assert str(UploadResult(3, "unknown", 1, ("2000:1",), "old", reason="gone", other_count=0)) == "node 3: unknown: 2000:1: gone"
