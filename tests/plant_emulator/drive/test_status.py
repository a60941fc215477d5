"""What follows from a state, derived whole: no flag can be left over from another state."""

import itertools
from dataclasses import FrozenInstanceError

import pytest

from drive_profiles.standard.cia402 import REMOTE, VOLTAGE_ENABLED, WARNING, State, state_of
from plant_emulator.drive.faults import LACKS
from plant_emulator.drive.state_machine import DriveStatus, Power
from tests.plant_emulator.rig import Rig

UNDER_TORQUE = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}


@pytest.mark.parametrize("state", State)
def test_the_plain_word_shows_the_state_and_that_the_drive_is_remote(state):
    for torque_off, lack in itertools.product((False, True), repeat=2):
        word = DriveStatus.of(Power(state), torque_off=torque_off, lack=lack).plain_word
        assert state_of(word) is state
        assert word & REMOTE
        assert bool(word & VOLTAGE_ENABLED) is not torque_off
        assert bool(word & WARNING) is lack


@pytest.mark.parametrize("state", State)
def test_the_motor_is_under_torque_in_three_states_and_follows_in_one(state):
    status = DriveStatus.of(Power(state))
    assert status.is_powered is (state in UNDER_TORQUE)
    assert status.is_enabled is status.is_following is (state is State.OPERATION_ENABLED)
    assert status.is_stopping is (state in UNDER_TORQUE - {State.OPERATION_ENABLED})


def test_a_drive_that_leaves_operation_enabled_is_stopping_and_follows_no_more():
    status = DriveStatus.of(Power(State.OPERATION_ENABLED, 0x07, State.SWITCHED_ON))
    assert status.is_powered
    assert status.is_enabled
    assert status.is_stopping
    assert not status.is_following


def test_it_is_replaced_never_patched():
    with pytest.raises(FrozenInstanceError):
        DriveStatus.of(Power()).is_powered = True


def test_a_drive_stands_after_everything_as_its_state_and_inputs_say():
    rig = Rig()
    drive = rig.drive

    def derived():
        lacks = bool(set(LACKS) & set(drive.slave.emergencies.causes))
        return DriveStatus.of(drive._status.power, torque_off=drive.inputs.is_sto_active, lack=lacks)

    for act in (
        lambda: rig.word(0x06, 0x07, 0x0F),  # the node is not started: it lacks that
        lambda: rig.enable(8),
        lambda: rig.word(0x02),
        lambda: rig.wait(500),
        lambda: rig.enable(8),
        lambda: drive.inputs.set_sto(True),
        lambda: drive.inputs.set_sto(False),
        lambda: rig.word(0x80),
        lambda: rig.nmt(0x82),
        lambda: rig.nmt(0x81),
        rig.power_cycle,
    ):
        act()
        assert drive._status == derived()
