"""What goes wrong after the first write: the way back, the store, restarts, interrupts, journals; and what is then said."""

import errno

import pytest

from drive_profiles.cli.transact import exit_status
from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.object_address import object_address
from drive_profiles.upload import fleet, journal
from drive_profiles.upload.interrupt import InterruptWindow
from drive_profiles.upload.result import UploadOptions, UploadResult
from drive_profiles.upload.upload import Upload
from tests.drive_profiles import upload_rig as rig
from tests.drive_profiles.world_bus import WorldBus, robot_with

REFUSED = 0x0609_0030
LAST = (0x2000 + 50, 1)
"""The parameter that is written last: order 2, and the highest number."""


def gain(value):
    return ParameterSet(tuning={"position_gain_per_s": Item(value=value, unit="1/s")})


def prepared(bus, nodes, tmp_path, value=20.0, **options):
    made = [
        Upload(bus.device(n, "emulated_drive"), gain(value), UploadOptions(journals=tmp_path / "j", **options)) for n in nodes
    ]
    fleet.prepare(made)
    return made


@pytest.fixture
def bus():
    return WorldBus(robot_with())


# -- the way back --------------------------------------------------------------------------------------------------------


def test_the_way_back_passes_through_states_that_were_valid_on_the_way_there(tmp_path):
    """p3 must not be above p0: there p0 goes first, and back it goes last."""
    slave = rig.node()
    cell = slave.dictionary.cell
    cell(0x2000, 1).value, cell(0x2003, 1).value = 20, 10
    slave.dictionary.on_write(0x2000, 1, lambda v: 0x0604_0043 if v < cell(0x2003, 1).value else None)
    slave.dictionary.on_write(0x2003, 1, lambda v: 0x0604_0043 if v > cell(0x2000, 1).value else None)
    slave.dictionary.on_write(0x2006, 1, lambda v: REFUSED)
    wanted = ParameterSet(tuning={"p0": Item(value=50), "p3": Item(value=40), "p6": Item(value=100)})
    [outcome] = fleet.run([rig.upload(slave, tmp_path, wanted)])
    assert (outcome.kind, outcome.others) == ("rolled back", "old"), outcome
    assert [slave.dictionary.get(0x2000 + n, 1) for n in (0, 3)] == [20, 10]


def test_where_writing_one_object_changes_another_the_way_back_takes_several_passes(tmp_path):
    slave = rig.node()
    cell = slave.dictionary.cell

    def resets_p3(value):
        cell(0x2003, 1).value = 1

    slave.dictionary.on_write(0x2000, 1, resets_p3)  # on the way back p3 comes before p0
    slave.dictionary.on_write(0x2006, 1, lambda v: REFUSED)
    before = rig.contents(slave)
    wanted = ParameterSet(tuning={"p0": Item(value=50), "p3": Item(value=40), "p6": Item(value=100)})
    [outcome] = fleet.run([rig.upload(slave, tmp_path, wanted)])
    assert outcome.kind == "rolled back", outcome
    assert rig.contents(slave) == before


def test_a_drive_that_is_enabled_meanwhile_is_not_written_to_on_the_way_back(tmp_path):
    slave = rig.node()
    made = rig.upload(slave, tmp_path, rig.wanted())

    def enable(value):
        slave.dictionary.cell(0x6041, 0).value = rig.OPERATION_ENABLED
        for n in range(rig.PARAMETERS - 1):
            slave.dictionary.on_write(0x2000 + n, 1, lambda v: pytest.fail("written to an enabled drive"))
        return REFUSED

    slave.dictionary.on_write(*LAST, enable)
    before = rig.contents(rig.node())
    [outcome] = fleet.run([made])
    assert (outcome.kind, outcome.others) == ("unknown", "old")
    unknown = {object_address(text.split(" ")[0]) for text in outcome.unknown}
    held = rig.contents(slave)
    assert (0x2000, 1) in unknown
    assert all(held[place] == before[place] for place in held if place not in unknown)


def test_a_mistake_on_the_way_back_does_not_lose_the_other_outcomes(bus, tmp_path):
    uploads = prepared(bus, (2, 3, 5), tmp_path)
    bus.world.drives[5].slave.dictionary.wrap_write(0x2100, 1, lambda own: lambda v: REFUSED)
    broken = uploads[0]

    def mistake():
        raise ZeroDivisionError("a bug")

    broken._put_back = mistake
    first, second, third = fleet.run(uploads)
    assert (first.kind, second.kind, third.kind) == ("unknown", "rolled back", "rolled back")
    assert "2100:1" in first.unknown[0]
    assert "ZeroDivisionError" in first.reason
    assert exit_status([first, second, third]) == 8


# -- restarts ------------------------------------------------------------------------------------------------------------


def small(count=20):
    """One object that is written, and others that are only looked at."""
    return ParameterSet(tuning={"p0": Item(value=100), **{f"p{n}": Item(value=rig.old_value(n)) for n in range(1, count)}})


@pytest.mark.parametrize("store", [False, True])
@pytest.mark.parametrize("after", range(2, 40, 4))
def test_a_node_that_restarts_during_the_read_back_is_not_done(after, store, tmp_path):
    slave = rig.node()
    line = rig.Line(slave)
    made = rig.upload(slave, tmp_path, small(), line, store=store)
    announced = []

    def restart(number):
        if slave.dictionary.get(0x2000, 1) == 100 and not announced:
            announced.append(number)
        if announced and number == announced[0] + after:
            line._take(slave.power_on(line.now))

    line.on_frame = restart
    [outcome] = fleet.run([made])
    assert announced
    assert outcome.kind == "rolled back", outcome
    assert "restarted" in outcome.reason or "holds" in outcome.reason
    assert slave.dictionary.get(0x2000, 1) == rig.old_value(0)
    assert not slave.store.stored


def test_a_node_that_restarts_while_it_stores_is_not_said_to_have_stored(tmp_path):
    slave = rig.node()
    line = rig.Line(slave)
    made = rig.upload(slave, tmp_path, small(), line, store=True)
    line.on_frame = lambda number: None
    give = slave.receive

    def restarts(frame, now):
        answers = give(frame, now)
        if frame.data[:4] == b"\x23\x10\x10\x01":
            answers = [*answers, *slave.power_on(now)]
        return answers

    slave.receive = restarts
    [outcome] = fleet.run([made])
    assert outcome.kind == "unknown"
    assert outcome.stored == "unknown"
    assert not slave.store.stored


def test_a_reset_is_said_also_where_there_was_nothing_to_write(bus, tmp_path):
    for count in ("1 written and read back", "nothing to write: the drive has all values"):
        [outcome] = fleet.run(prepared(bus, [3], tmp_path, store=True, reset=True))
        assert str(outcome) == f"node 3: done, {count}, stored, reset, and read back once more"


def test_a_reset_without_a_boot_up_message_proves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(fleet, "RESTART_S", 0.2)
    slave = rig.node()
    device = Device(SdoPort(rig.NODE, rig.Line(slave), 0.5), Catalogue(rig.PROFILE), lambda command, node: None)
    made = Upload(device, rig.wanted(), UploadOptions(journals=tmp_path, store=True, reset=True))
    fleet.prepare([made])
    [outcome] = fleet.run([made])
    assert (outcome.kind, outcome.stored, outcome.others) == ("unknown", "yes", "new")
    assert "no boot-up message" in outcome.reason


# -- storing -------------------------------------------------------------------------------------------------------------


def test_a_memory_that_fails_leaves_the_old_values_and_a_silent_one_the_new(bus, tmp_path):
    uploads = prepared(bus, (2,), tmp_path, store=True)
    store = bus.world.drives[2].slave.store
    before = bus.world.drives[2].slave.dictionary.get(0x2100, 1)
    store.fails = True
    [outcome] = fleet.run(uploads)
    assert (outcome.kind, outcome.others) == ("unknown", "old")
    assert bus.world.drives[2].slave.dictionary.get(0x2100, 1) == before
    assert "all others hold the old values" in str(outcome)
    store.fails, store.time_ns = False, 30_000_000_000
    [outcome] = fleet.run(prepared(bus, (2,), tmp_path, store=True))
    assert (outcome.kind, outcome.others, outcome.stored) == ("unknown", "new", "unknown")
    assert bus.world.drives[2].slave.dictionary.get(0x2100, 1) == 20.0
    assert "all others hold the new values" in str(outcome)


def test_stored_again_is_said_with_all_that_it_means(bus, tmp_path):
    """What the drive held unsaved before is kept now, too: the kept value is not the one of before."""
    [outcome] = fleet.run(prepared(bus, (2,), tmp_path, value=10.0, store=True))
    [outcome] = fleet.run(prepared(bus, (2,), tmp_path, value=15.0))
    assert outcome.stored == "no"
    uploads = prepared(bus, (2, 3), tmp_path, store=True)
    bus.world.drives[3].slave.store.may_store = lambda: 0x0800_0022
    first, second = fleet.run(uploads)
    assert (first.kind, first.stored) == ("rolled back", "again")
    assert "stored again" in str(first)
    assert (second.kind, second.stored) == ("rolled back", "no")
    assert bus.world.drives[2].slave.store.stored[0x2100, 1] == 15.0
    assert journal.read(first.journal).stored == "yes"


# -- interrupts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("store", [False, True])
def test_an_interrupt_at_the_last_read_back_still_puts_everything_back(store, tmp_path):
    slave = rig.node()
    before = rig.contents(slave)
    made = rig.upload(slave, tmp_path, rig.wanted(), store=store)
    window, steps = InterruptWindow(), []
    total = len(made._steps) + len(made._goal)

    def progress(node, count):
        steps.append(count)
        if len(steps) == total:
            assert window.interrupt()

    [outcome] = fleet.run([made], fleet.UploadControl(window, progress))
    assert len(steps) == total
    assert (outcome.kind, outcome.exit_code) == ("rolled back", 130)
    assert rig.contents(slave) == before
    assert not slave.store.stored


def test_of_two_drives_one_put_back_after_an_interrupt_and_one_unknown_the_unknown_is_the_exit_status():
    back = UploadResult(2, "rolled back", reason="interrupted", exit_code=130)
    lost = UploadResult(3, "unknown", unknown=("2100:1",), reason="x", exit_code=5)
    assert exit_status([back, lost]) == exit_status([lost, back]) == exit_status([lost]) == 8
    assert exit_status([back]) == 130
    assert exit_status([UploadResult(2, "done"), UploadResult(3, "rolled back", exit_code=6)]) == 6
    assert exit_status([]) == 0


# -- journals ------------------------------------------------------------------------------------------------------------


def full_after(made, count, monkeypatch):
    """The disk is full after so many lines."""
    opened = made.open_journal

    def open_journal():
        opened()
        note, lines = made._journal.note, []

        def full(*arguments, **more):
            lines.append(arguments)
            if len(lines) > count:
                raise OSError(errno.ENOSPC, "No space left on device")
            note(*arguments, **more)

        monkeypatch.setattr(made._journal, "note", full)

    made.open_journal = open_journal


@pytest.mark.parametrize("count", [0, 1, 2, 7, 50])
def test_a_journal_that_cannot_be_written_ends_the_upload_and_all_is_put_back(count, tmp_path, monkeypatch):
    slave = rig.node()
    before = rig.contents(slave)
    made = rig.upload(slave, tmp_path, rig.wanted())
    full_after(made, count, monkeypatch)
    writes = []
    send = made.device.write
    made.device.write = lambda place, data, *more: (writes.append(made._going_back), send(place, data, *more))
    [outcome] = fleet.run([made])
    assert (outcome.kind, outcome.exit_code) == ("rolled back", 3), outcome
    assert "cannot be written" in outcome.reason
    assert writes.count(False) == (count + 1) // 2  # announced, written, confirmed; what is not announced is not written
    assert rig.contents(slave) == before


def test_a_journal_that_cannot_be_written_on_the_way_back_stops_nothing(tmp_path, monkeypatch):
    slave = rig.node()
    before = rig.contents(slave)
    made = rig.upload(slave, tmp_path, rig.wanted())
    slave.dictionary.on_write(*LAST, lambda v: REFUSED)
    full_after(made, 2 * len(made._steps) - 1, monkeypatch)
    [outcome] = fleet.run([made])
    assert (outcome.kind, outcome.exit_code) == ("rolled back", 6), outcome
    assert rig.contents(slave) == before
