"""A drive in its world: what is stored survives a loss of power, an enabled drive does not store, the world goes on."""

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object, State
from plant_emulator.motion import record
from plant_emulator.robots.robot import load_robot, with_drives
from plant_emulator.world import World
from tests.plant_emulator.rig import NO_GAINS, ONE_AXIS, Rig

STORE_NS = 400_000_000
GAIN, NOTCH_START = (0x2101, 1), (0x2110, 3)


def test_stored_gains_and_filters_act_after_a_loss_of_power():
    rig = Rig(NO_GAINS)
    for (index, sub), value in (((0x2100, 1), 20.0), (GAIN, 0.1), (NOTCH_START, 3.5), ((0x2110, 1), 1)):
        rig.set(index, sub, value)
    assert rig.save() is None
    rig.set(*GAIN, 9.0)
    frames = rig.power_cycle()
    assert [(f.can_id, f.data) for f in frames] == [(0x700 + rig.node, b"\0")]
    row = rig.drive.row
    assert rig.world.axes.cascade_config[row]["velocity_gain_nm_s_rad"] == pytest.approx(0.1)
    assert rig.world.axes.notch_config[row, 0]["start_rps"] == 3.5
    assert rig.world.axes.notch_config[row, 0]["mode"] == 1
    rig.enable(Mode.CSP)
    assert rig.state is State.OPERATION_ENABLED


def test_storing_takes_the_time_that_the_robot_file_says(rig):
    began = rig.world.now
    assert rig.save() is None
    assert STORE_NS <= rig.world.now - began <= STORE_NS + 10_000_000
    quick = Rig(with_drives(ONE_AXIS, store_time_s=0.0))
    assert quick.write_raw(0x1010, 1, b"save") is None


def test_an_enabled_drive_does_not_store(rig):
    rig.enable(Mode.CSP)
    for index, word in ((0x1010, b"save"), (0x1011, b"load")):
        assert rig.save(index, 1, word) == SdoAbortCode.DEVICE_STATE
    rig.word(0x06)
    assert rig.save() is None


def test_a_drive_that_stores_takes_its_set_points_and_answers_sync(rig):
    rig.cyclic(Mode.CSP)
    rig.word(0x06)
    rig.send(0x600 + rig.node, b"\x23\x10\x10\x01save")
    assert any(frame.can_id == 0x180 + rig.node for frame in rig.sync(5))
    answers = [frame for frame in rig.wait(500) if frame.can_id == 0x580 + rig.node]
    assert len(answers) == 1


def test_a_loss_of_power_in_the_middle_of_storing_leaves_the_old_store(rig):
    rig.set(*GAIN, 0.2)
    assert rig.save() is None
    rig.set(*GAIN, 0.3)
    rig.send(0x600 + rig.node, b"\x23\x10\x10\x01save")
    rig.wait(399)
    rig.power_cycle()
    assert not [frame for frame in rig.wait(1000) if frame.can_id == 0x580 + rig.node]
    assert rig.read(*GAIN) == pytest.approx(0.2)


def test_a_loss_of_power_closes_the_brake_of_a_moving_axis(rig):
    rig.cyclic(Mode.CSP)
    rig.turn(2.0, 0.5)
    rig.power_cycle()
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    assert rig.motion["mode"] == record.BRAKED
    assert rig.read(Object.MODES_OF_OPERATION) == 0


def test_a_store_can_be_made_to_fail_and_to_be_slow(rig):
    rig.drive.slave.store.fails = True
    assert rig.save() == SdoAbortCode.HARDWARE
    rig.drive.slave.store.fails = False
    rig.drive.slave.store.time_ns = 3_000_000_000
    began = rig.world.now
    assert rig.save() is None
    assert rig.world.now - began >= 3_000_000_000


def test_a_power_cycle_concerns_one_node_and_one_that_is_there():
    world = World(load_robot("reference"))
    world.power_on()
    world.drives[3].slave.dictionary.cell(*GAIN).value = 5.0
    assert [frame.can_id for frame in world.power_cycle(2)] == [0x702]
    assert world.drives[3].slave.dictionary.get(*GAIN) == 5.0
    assert [frame.can_id for frame in world.power_cycle(16)] == [0x710]
    with pytest.raises(ValueError, match="no node 4"):
        world.power_cycle(4)
