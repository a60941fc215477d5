"""Frames that leave a node later than their cause: when, in which order, and what never waits."""

import struct

import pytest

from drive_profiles.standard.cia402 import Mode, Object
from hil.can.frame import Frame
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.slave import delays
from plant_emulator.slave.delays import DelayedSlave, slave_with
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.node import Slave
from plant_emulator.world import World
from tests.plant_emulator.drive.test_inputs import robot_with
from tests.plant_emulator.rig import MS, ONE_AXIS, POSITION, STATUS, Rig

US = 1000
TPDO, SDO = 0x183, 0x583


def rig_with(**behaviour):
    return Rig(robot_with(None, **behaviour))


def tpdo_times(rig, count=20):
    """By how much each TPDO comes after its SYNC."""
    late = []
    for _ in range(count):
        now = rig.world.now
        assert not [f for f in rig.send(0x080) if f.can_id == TPDO]
        rig.world._pending_ns = 0
        while not late or late[-1][0] != now:
            due = rig.world.due
            assert due is not None
            late += [(now, rig.world.now - now) for _, f in rig.world.move(due) if f.can_id == TPDO]
        rig.world.advance(now + 2 * MS)
    return [delay for _, delay in late]


def mapped(rig):
    rig.map_pdo(0x1800, (STATUS, POSITION))
    rig.start()
    return rig


def test_a_drive_without_delays_is_an_ordinary_one(make_entries):
    assert type(slave_with(Behaviour(), 1, 3, Dictionary(make_entries()))) is Slave
    assert type(Rig().drive.slave) is Slave


def test_tpdos_leave_so_much_after_their_sync():
    assert tpdo_times(mapped(rig_with(tpdo_delay_us=300.0))) == [300 * US] * 20


def test_jitter_is_added_within_its_range_and_repeats_with_the_seed():
    first, second = (tpdo_times(mapped(rig_with(tpdo_delay_us=200.0, tpdo_jitter_us=500.0))) for _ in range(2))
    assert first == second
    assert len(set(first)) > 10
    assert all(200 * US <= delay <= 700 * US for delay in first)


def test_a_slow_sdo_answer_comes_late_and_carries_what_was_read_at_once():
    rig = rig_with(sdo_delay_ms=20.0)
    now = rig.world.now
    assert rig.send(0x600 + rig.node, b"\x40\x41\x60\x00\0\0\0\0") == []
    frames = []
    while not frames:
        frames = rig.world.advance(rig.world.now + MS)
    assert rig.world.now - now == 20 * MS
    assert [f.can_id for f in frames] == [SDO]


def test_heartbeats_and_emergencies_do_not_wait():
    rig = rig_with(sdo_delay_ms=50.0, tpdo_delay_us=50_000.0)
    assert 0x703 in [f.can_id for f in rig.seen]
    rig.drive.slave.emergencies.raise_cause("test", 0x1000)
    assert 0x083 in [f.can_id for f in rig.wait(2)]


def write_late(rig, index, subindex, value):
    """A download whose answer is late; its frames."""
    rig.send(0x600 + rig.node, b"\x23" + struct.pack("<HBI", index, subindex, value))
    return rig.wait(25)


def test_an_answer_of_a_second_sdo_channel_is_an_answer():
    rig = rig_with(sdo_delay_ms=20.0)
    for subindex, cob_id in ((1, 0x6A0), (2, 0x6A1)):
        write_late(rig, 0x1201, subindex, cob_id)
    assert rig.send(0x6A0, b"\x40\x41\x60\x00\0\0\0\0") == []
    assert 0x6A1 not in [f.can_id for f in rig.wait(15)]
    assert 0x6A1 in [f.can_id for f in rig.wait(10)]
    # the last answer of a channel that this very request closes
    assert rig.send(0x6A0, b"\x23" + struct.pack("<HBI", 0x1201, 1, 0x800006A0)) == []
    assert 0x6A1 not in [f.can_id for f in rig.wait(15)]
    assert 0x6A1 in [f.can_id for f in rig.wait(10)]


def test_an_emergency_whose_identifier_was_moved_does_not_wait():
    rig = rig_with(sdo_delay_ms=20.0, tpdo_delay_us=50_000.0)
    write_late(rig, 0x1014, 0, 1 << 31 | 0x083)
    write_late(rig, 0x1014, 0, 0x090)
    rig.drive.slave.emergencies.raise_cause("test", 0x1000)
    assert 0x090 in [f.can_id for f in rig.wait(2)]


def test_lss_answers_do_not_wait():
    rig = rig_with(sdo_delay_ms=20.0, tpdo_delay_us=50_000.0)
    rig.send(0x7E5, bytes((4, 1)).ljust(8, b"\0"))
    assert 0x7E4 in [f.can_id for f in rig.send(0x7E5, bytes((0x5E,)).ljust(8, b"\0"))]


def test_frames_of_a_kind_keep_their_order():
    slave = rig_with(tpdo_delay_us=100.0, tpdo_jitter_us=5000.0).drive.slave
    slave.advance(10 * MS)
    sent = [Frame(TPDO, bytes((n,))) for n in range(50)]
    out = []
    for n, frame in enumerate(sent):
        out += slave._pass([frame], 10 * MS + n * 100 * US)
    out += slave._pass([], 100 * MS)
    assert out == sent


def test_what_a_node_cannot_hold_is_lost(monkeypatch):
    monkeypatch.setattr(delays, "MOST_HELD", 4)
    slave = rig_with(tpdo_delay_us=1000.0).drive.slave
    assert isinstance(slave, DelayedSlave)
    slave._pass([Frame(TPDO, b"")] * 10, slave._now)
    assert len(slave._pass([], slave._now + MS)) == 4


def test_what_was_held_is_lost_with_the_power():
    rig = rig_with(sdo_delay_ms=50.0)
    rig.send(0x600 + rig.node, b"\x40\x41\x60\x00\0\0\0\0")
    rig.power_cycle()
    assert SDO not in [f.can_id for f in rig.wait(200)]


@pytest.mark.parametrize("command", [2, 129, 130])
def test_what_was_held_is_lost_when_the_node_is_stopped_or_reset(command):
    rig = mapped(rig_with(tpdo_delay_us=1000.0))
    rig.send(0x080)
    rig.nmt(command)
    assert not [f for f in rig.wait(100) if f.can_id == TPDO]
    rig = rig_with(sdo_delay_ms=20.0)
    rig.send(0x603, b"\x40\x41\x60".ljust(8, b"\0"))
    rig.nmt(command)
    assert not [f for f in rig.wait(100) if f.can_id == SDO]


def test_a_run_in_lock_step_gets_every_tpdo_though_late():
    rig = mapped(rig_with(tpdo_delay_us=500.0))
    frames = []
    for _ in range(10):
        frames += rig.send(0x080) + rig.world.finish_period()
    assert len([f for f in frames if f.can_id == TPDO]) == 10


def test_a_drive_that_is_late_can_be_enabled_all_the_same():
    rig = rig_with(tpdo_delay_us=500.0, tpdo_jitter_us=100.0)
    rig.enable(Mode.PP)
    assert rig.read(Object.MODES_OF_OPERATION_DISPLAY) == Mode.PP


def test_a_world_of_delayed_and_ordinary_drives_stands_still_until_something_is_due():
    world = World(ONE_AXIS)
    world.power_on()
    assert world.due is None
