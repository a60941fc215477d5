"""Switches and safe torque off of a drive, over CAN: what 60FDh shows, and what limit switches do to the motion."""

import pytest

from drive_profiles.standard.cia402 import FOLLOWS_COMMAND, INTERNAL_LIMIT, TARGET_REACHED, VOLTAGE_ENABLED, Mode, Object, State
from plant_emulator.drive.inputs import INTERLOCK, PROBE_1_INPUT, PROBE_2_INPUT, SAFE_TORQUE_OFF
from plant_emulator.motion.record import HOME_SWITCH, NEGATIVE_SWITCH, POSITIVE_SWITCH, PROBE_1
from plant_emulator.robots.behaviour import Switches
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, POSITION, STATUS, TORQUE, Rig

RATIO = ONE_AXIS.axis[AXIS].reduction_ratio


def degrees(revolutions):
    """The joint's angle where the motor has turned so far."""
    return revolutions / RATIO * 360.0


SWITCHES = Switches(
    negative_limit_deg=degrees(-2.0),
    positive_limit_deg=degrees(2.0),
    home_deg=(degrees(0.5), degrees(1.0)),
    probe_1_deg=(degrees(-1.0), degrees(-0.5)),
    probe_2_deg=(degrees(-0.75), degrees(-0.25)),
)


def robot_with(switches=SWITCHES, **behaviour):
    axis = ONE_AXIS.axis[AXIS]
    changed = axis.model_copy(update={"switches": switches, "behaviour": axis.behaviour.model_copy(update=behaviour)})
    return ONE_AXIS.model_copy(update={"axis": {AXIS: changed}})


@pytest.fixture
def rig():
    return Rig(robot_with())


def go(rig, revolutions):
    """A profile position move, and the time that it takes."""
    rig.set(Object.TARGET_POSITION, 0, round(revolutions * COUNTS_PER_REV))
    rig.word(0x0F, 0x3F)
    for _ in range(100):
        rig.wait(20)
        if rig.status & TARGET_REACHED:
            break
    rig.word(0x0F)


def test_60fd_shows_where_the_axis_stands(rig):
    rig.enable(Mode.PP)
    for place, inputs in (
        (0.0, 0),
        (0.7, HOME_SWITCH),
        (1.2, 0),
        (-0.4, PROBE_2_INPUT),
        (-0.6, PROBE_1_INPUT | PROBE_2_INPUT),
        (-0.9, PROBE_1_INPUT),
    ):
        go(rig, place)
        assert rig.read(Object.DIGITAL_INPUTS) == inputs, place


def test_an_axis_without_switches_shows_none_and_looks_at_none():
    rig = Rig()
    assert rig.read(Object.DIGITAL_INPUTS) == 0
    assert rig.motion["input_mask"] == 0


def test_an_input_can_be_held_active_from_outside():
    rig = Rig()
    rig.drive.inputs.force(HOME_SWITCH | PROBE_1)
    rig.wait(2)
    assert rig.read(Object.DIGITAL_INPUTS) == HOME_SWITCH | PROBE_1_INPUT
    rig.drive.inputs.force(HOME_SWITCH, active=False)
    rig.wait(2)
    assert rig.read(Object.DIGITAL_INPUTS) == PROBE_1_INPUT
    for unknown in (0, 32, -1):
        with pytest.raises(ValueError, match="inputs"):
            rig.drive.inputs.force(unknown)


def test_a_limit_that_is_forced_under_way_stops_an_axis_without_switches_at_once():
    rig = Rig(robot_with(None))
    rig.set(Object.TARGET_VELOCITY, 0, 2 * COUNTS_PER_REV)
    rig.enable(Mode.PV)
    rig.wait(300)
    rig.drive.inputs.force(POSITIVE_SWITCH)
    rig.wait(300)
    assert abs(rig.speed_rps) < 0.02
    assert rig.status & INTERNAL_LIMIT


def test_outputs_hold_what_is_written():
    rig = Rig()
    rig.set(Object.DIGITAL_OUTPUTS, 1, 0xA5A50001)
    rig.set(Object.DIGITAL_OUTPUTS, 2, 0xFFFFFFFF)
    assert (rig.read(Object.DIGITAL_OUTPUTS, 1), rig.read(Object.DIGITAL_OUTPUTS, 2)) == (0xA5A50001, 0xFFFFFFFF)


# -- safe torque off ---------------------------------------------------------------------------------------------------


def test_safe_torque_off_takes_the_torque_at_once_and_nothing_comes_back_by_itself(rig):
    rig.enable(Mode.PP)
    assert rig.read(Object.DIGITAL_INPUTS) == 0
    rig.drive.inputs.set_sto(True)
    rig.drive.inputs.set_sto(True)
    assert rig.motion["torque_nm"] == 0.0
    assert rig.read(Object.DIGITAL_INPUTS) == INTERLOCK | SAFE_TORQUE_OFF
    assert rig.state is not State.OPERATION_ENABLED
    assert not rig.status & VOLTAGE_ENABLED
    rig.drive.inputs.set_sto(False)
    rig.wait(10)
    assert rig.read(Object.DIGITAL_INPUTS) == 0
    assert rig.state is not State.OPERATION_ENABLED
    rig.word(0x00, 0x80)
    assert rig.word(0x06, 0x07, 0x0F) is State.OPERATION_ENABLED


# -- limit switches ----------------------------------------------------------------------------------------------------


def test_a_profile_into_a_limit_switch_is_stopped_on_the_quick_stop_ramp_and_led_out_again(rig):
    rig.enable(Mode.PP)
    rig.set(Object.PROFILE_VELOCITY, 0, 4 * COUNTS_PER_REV)
    rig.set(Object.TARGET_POSITION, 0, 10 * COUNTS_PER_REV)
    rig.word(0x0F, 0x1F)
    rig.wait(2000)
    # 4 rev/s on a ramp of 50 rev/s², behind the lag of the position loop (25/s), and a few ms pass before it begins
    assert 2.0 < rig.position_rev < 2.0 + 4.0**2 / 2.0 / 50.0 + 4.0 / 25.0 + 0.02
    assert rig.state is State.OPERATION_ENABLED
    assert rig.read(Object.DIGITAL_INPUTS) == POSITIVE_SWITCH
    at = rig.position_rev
    rig.word(0x0F)
    rig.set(Object.TARGET_POSITION, 0, 5 * COUNTS_PER_REV)
    rig.word(0x1F)
    rig.wait(300)
    assert abs(rig.position_rev - at) < 0.01
    rig.word(0x0F)
    go(rig, 1.2)
    assert abs(rig.position_rev - 1.2) < 0.01
    assert not rig.status & INTERNAL_LIMIT


def test_a_velocity_into_a_limit_switch_ends_there_and_one_out_of_it_is_followed(rig):
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, -3 * COUNTS_PER_REV)
    rig.wait(1500)
    assert -2.0 - 3.0**2 / 2.0 / 50.0 - 3.0 / 25.0 - 0.02 < rig.position_rev < -2.0
    assert abs(rig.speed_rps) < 0.02
    assert rig.status & INTERNAL_LIMIT
    assert rig.emergencies() == []
    rig.set(Object.TARGET_VELOCITY, 0, 1 * COUNTS_PER_REV)
    rig.wait(800)
    assert rig.position_rev > -1.7
    assert rig.speed_rps == pytest.approx(1.0, abs=0.1)
    assert not rig.status & INTERNAL_LIMIT


def test_cyclic_set_points_into_a_limit_switch_are_not_followed_until_they_lead_out_of_it(rig):
    rig.cyclic(Mode.CSP)
    target = rig.turn(2.0, 1.3)
    assert 2.0 < rig.position_rev < 2.2
    at = rig.position_rev
    status = 0
    for _ in range(50):
        target += 500
        status, _, _ = rig.cycle(target)
    assert abs(rig.position_rev - at) < 0.03
    assert status & INTERNAL_LIMIT
    assert not status & FOLLOWS_COMMAND
    stand = rig.read(Object.POSITION_ACTUAL)
    for step in range(200):
        status, _, _ = rig.cycle(stand - 600 * (step + 1) // 2)
    assert rig.state is State.OPERATION_ENABLED
    assert status & FOLLOWS_COMMAND
    assert not status & INTERNAL_LIMIT
    assert rig.position_rev < at - 0.3


def test_a_torque_into_a_limit_switch_ends_there_and_one_out_of_it_acts(rig):
    rig.cyclic(Mode.CST, torque=True)
    for _ in range(2000):
        status, _, _ = rig.cycle(250, layout="<Hh")
        if status & INTERNAL_LIMIT:
            break
    for _ in range(200):
        rig.cycle(250, layout="<Hh")
    assert rig.position_rev > 2.0
    assert abs(rig.speed_rps) < 0.1
    at = rig.position_rev
    for _ in range(100):
        status, _, _ = rig.cycle(-300, layout="<Hh")
    assert rig.position_rev < at - 0.1
    assert not status & INTERNAL_LIMIT


def test_cyclic_velocity_into_a_limit_switch_ends_there_and_out_of_it_is_followed(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.TARGET_VELOCITY, 0, 32)))
    rig.map_pdo(0x1800, (STATUS, POSITION, TORQUE))
    rig.enable(Mode.CSV)
    for speed in range(0, 2 * COUNTS_PER_REV, 2000):
        rig.cycle(speed)
    for _ in range(700):
        status, _, _ = rig.cycle(2 * COUNTS_PER_REV)
    assert 2.0 < rig.position_rev < 2.2
    assert status & INTERNAL_LIMIT
    at = rig.position_rev
    for _ in range(200):
        status, _, _ = rig.cycle(-COUNTS_PER_REV)
    assert rig.position_rev < at - 0.2
    assert not status & INTERNAL_LIMIT


def test_profile_torque_into_a_limit_switch_ends_there_and_out_of_it_acts(rig):
    rig.enable(Mode.TQ)
    rig.set(Object.TARGET_TORQUE, 0, 250)
    rig.wait(2500)
    assert rig.position_rev > 2.0
    assert abs(rig.speed_rps) < 0.1
    assert rig.status & INTERNAL_LIMIT
    at = rig.position_rev
    rig.set(Object.TARGET_TORQUE, 0, -300)
    rig.wait(200)
    assert rig.position_rev < at - 0.1


def test_interpolated_position_into_a_limit_switch_is_not_followed(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.INTERPOLATION_DATA, 1, 32)))
    rig.map_pdo(0x1800, (STATUS, POSITION, TORQUE))
    rig.enable(Mode.IP)
    target = 0
    for _ in range(700):
        target += 500
        status, _, _ = rig.cycle(target, word=0x1F)
    assert 2.0 < rig.position_rev < 2.2
    assert status & INTERNAL_LIMIT
    target = rig.read(Object.POSITION_ACTUAL)
    for _ in range(200):
        target -= 300
        status, _, _ = rig.cycle(target, word=0x1F)
    assert rig.position_rev < 1.8
    assert not status & INTERNAL_LIMIT


def test_a_set_point_that_leads_out_while_the_motor_is_still_being_stopped_is_not_lost(rig):
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, 10 * COUNTS_PER_REV)
    rig.word(0x0F, 0x1F)
    while not rig.status & INTERNAL_LIMIT:
        rig.wait(1)
    assert rig.speed_rps > 1.0
    rig.word(0x0F)
    rig.set(Object.TARGET_POSITION, 0, COUNTS_PER_REV)
    rig.word(0x3F)
    rig.wait(2000)
    assert abs(rig.position_rev - 1.0) < 0.01


def test_a_halt_and_its_end_do_not_lead_past_a_limit_switch(rig):
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, 2 * COUNTS_PER_REV)
    rig.wait(1600)
    at = rig.position_rev
    for _ in range(3):
        rig.word(0x10F)
        rig.wait(50)
        rig.word(0x0F)
        rig.wait(200)
    assert 2.0 < rig.position_rev < at + 0.05
    assert rig.status & INTERNAL_LIMIT


def test_a_limit_that_is_held_active_from_outside_stops_a_motion_anywhere(rig):
    rig.enable(Mode.PV)
    rig.set(Object.TARGET_VELOCITY, 0, COUNTS_PER_REV)
    rig.wait(500)
    rig.drive.inputs.force(POSITIVE_SWITCH)
    rig.wait(300)
    assert abs(rig.speed_rps) < 0.02
    assert rig.position_rev < 1.0
    rig.drive.inputs.force(NEGATIVE_SWITCH)
    rig.set(Object.TARGET_VELOCITY, 0, -COUNTS_PER_REV)
    rig.wait(300)
    assert abs(rig.speed_rps) < 0.02
    rig.drive.inputs.force(NEGATIVE_SWITCH | POSITIVE_SWITCH, active=False)
    rig.set(Object.TARGET_VELOCITY, 0, 0)
    rig.wait(10)
    rig.set(Object.TARGET_VELOCITY, 0, COUNTS_PER_REV)
    rig.wait(300)
    assert rig.speed_rps > 0.9


def test_a_set_point_that_a_limit_switch_has_ended_does_not_look_reached_until_the_next_one(rig):
    rig.enable(Mode.PP)
    rig.set(Object.TARGET_POSITION, 0, 10 * COUNTS_PER_REV)
    rig.word(0x1F, 0x0F)
    rig.wait(2500)
    assert abs(rig.speed_rps) < 0.01
    assert rig.status & (INTERNAL_LIMIT | TARGET_REACHED) == INTERNAL_LIMIT
    assert rig.read(Object.TARGET_POSITION) == 10 * COUNTS_PER_REV
    rig.word(0x10F)  # a halt is at rest, and its end brings nothing back
    rig.wait(20)
    assert rig.status & TARGET_REACHED
    rig.word(0x0F)
    rig.wait(100)
    assert rig.status & (INTERNAL_LIMIT | TARGET_REACHED) == INTERNAL_LIMIT
    go(rig, 1.0)
    assert rig.status & (INTERNAL_LIMIT | TARGET_REACHED) == TARGET_REACHED
