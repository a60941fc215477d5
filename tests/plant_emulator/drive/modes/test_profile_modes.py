"""Profile position's handshake, profile velocity, profile torque, interpolated position and cyclic velocity.

All through frames, judged by the plant.
"""

import numpy as np
import pytest

from drive_profiles.standard.cia402 import Mode, Object, State
from tests.plant_emulator.drive.modes.test_mode_change import behaving, follow
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, revolutions

PP, PV, TQ, HM, IP, CSP, CSV, CST = Mode
ENABLED = State.OPERATION_ENABLED
RATED_NM = round(1000 * ONE_AXIS.axis[AXIS].rated_torque) / 1000
TARGET_REACHED, INTERNAL_LIMIT, BIT_12, BIT_13 = 1 << 10, 1 << 11, 1 << 12, 1 << 13


def go(rig, turns, word=0x1F):
    """One set-point, with the whole handshake."""
    rig.set(Object.TARGET_POSITION, 0, revolutions(turns))
    rig.word(word)
    assert rig.status & BIT_12
    rig.word(word & ~0x10)


def places(rig, milliseconds):
    """Position and speed of the plant, and the status word, every millisecond."""
    seen = []
    for _ in range(milliseconds):
        rig.wait(1)
        seen.append((rig.position_rev, rig.speed_rps, rig.status))
    return [np.array(column) for column in zip(*seen, strict=True)]


# -- profile position --------------------------------------------------------------------------------------------------


def test_a_second_set_point_waits_and_bit_12_stays_until_it_is_in_execution(rig):
    rig.enable(PP)
    go(rig, 1.0)
    assert not rig.status & BIT_12  # one in execution: there is room for one more
    go(rig, 2.0)
    assert rig.status & BIT_12  # one is waiting: there is none
    where, speeds, words = places(rig, 1500)
    taken = int(np.flatnonzero(words & BIT_12 == 0)[0])
    assert where[taken] == pytest.approx(1.0, abs=0.01)
    assert abs(speeds[taken]) < 0.2  # it came to rest between the two
    assert where[-1] == pytest.approx(2.0, abs=0.002)
    assert words[-1] & TARGET_REACHED


def test_a_third_set_point_is_not_taken(rig):
    rig.enable(PP)
    for turns in (0.5, 1.0):
        go(rig, turns)
    rig.set(Object.TARGET_POSITION, 0, revolutions(3.0))
    rig.word(0x1F)
    rig.wait(1500)
    assert rig.position_rev == pytest.approx(1.0, abs=0.002)


def test_with_bit_5_a_set_point_takes_the_place_of_both(rig):
    rig.enable(PP)
    for turns in (4.0, 6.0):
        go(rig, turns)
    rig.wait(200)
    go(rig, -0.5, word=0x3F)
    assert not rig.status & BIT_12
    rig.wait(1500)
    assert rig.position_rev == pytest.approx(-0.5, abs=0.002)


def test_with_bit_9_the_motor_passes_the_first_set_point_at_speed(rig):
    rig.enable(PP)
    go(rig, 2.0)
    go(rig, 4.0, word=0x21F)
    assert rig.status & BIT_12
    where, speeds, words = places(rig, 1400)
    taken = int(np.flatnonzero(words & BIT_12 == 0)[0])
    assert where[taken] == pytest.approx(2.0, abs=0.25)
    assert speeds[taken] == pytest.approx(5.0, rel=0.1)
    assert where[-1] == pytest.approx(4.0, abs=0.002)


def test_with_bit_9_it_stops_where_the_way_goes_back(rig):
    rig.enable(PP)
    go(rig, 1.0)
    go(rig, 0.5, word=0x21F)
    where, _, _ = places(rig, 1400)
    assert where.max() == pytest.approx(1.0, abs=0.01)
    assert where[-1] == pytest.approx(0.5, abs=0.002)


@pytest.mark.parametrize(("option", "place"), [(0, 5.0), (1, None), (2, None)])
def test_60f2h_says_what_a_relative_set_point_counts_from(rig, option, place):
    rig.set(Object.POSITIONING_OPTION, 0, option)
    rig.enable(PP)
    go(rig, 4.0)
    rig.wait(400)
    demand, actual = float(rig.motion["demand_rad"]) / (2.0 * np.pi), rig.position_rev
    go(rig, 1.0, word=0x7F)
    rig.wait(2500)
    assert rig.position_rev == pytest.approx({0: 5.0, 1: demand + 1.0, 2: actual + 1.0}[option], abs=0.003)


def test_target_reached_needs_6067h_for_6068h(rig):
    rig.set(Object.POSITION_WINDOW_TIME, 0, 100)
    rig.enable(PP)
    go(rig, 0.5)
    where, _, words = places(rig, 1000)
    arrived = int(np.flatnonzero(abs(where - 0.5) < 0.0015)[0])
    reached = int(np.flatnonzero(words & TARGET_REACHED)[0])
    assert reached >= arrived + 98
    assert words[-1] & TARGET_REACHED


def test_a_waiting_set_point_stays_through_a_halt(rig):
    rig.enable(PP)
    go(rig, 1.0)
    go(rig, 2.0)
    rig.wait(100)
    rig.word(0x10F)
    rig.wait(500)
    assert rig.status & BIT_12
    rig.word(0x0F)
    rig.wait(1500)
    assert rig.position_rev == pytest.approx(2.0, abs=0.002)


def test_a_drive_with_a_slow_handshake_acknowledges_after_so_many_syncs():
    rig = behaving(pp_handshake_cycles=3)
    rig.enable(PP)
    rig.set(Object.TARGET_POSITION, 0, revolutions(1.0))
    rig.word(0x1F)
    acknowledged = []
    for _ in range(5):
        acknowledged.append(bool(rig.status & BIT_12))
        rig.sync()
    assert acknowledged == [False, False, False, True, True]
    rig.word(0x0F)
    assert not rig.status & BIT_12


# -- profile velocity --------------------------------------------------------------------------------------------------


def test_profile_velocity_goes_to_60ffh_on_6083h_and_back_on_6084h(rig):
    rig.set(Object.PROFILE_DECELERATION, 0, revolutions(10.0))
    rig.enable(PV)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(5.0))
    assert not rig.status & TARGET_REACHED
    _, speeds, words = places(rig, 600)
    rising = np.flatnonzero((speeds > 1.0) & (speeds < 4.0))
    assert np.polyfit(1e-3 * rising, speeds[rising], 1)[0] == pytest.approx(20.0, rel=0.1)
    assert np.median(speeds[400:]) == pytest.approx(5.0, rel=0.01)
    assert words[-1] & TARGET_REACHED
    assert not words[-1] & BIT_12  # the speed is not zero
    assert rig.read(Object.VELOCITY_DEMAND) == pytest.approx(revolutions(5.0), abs=1)
    rig.set(Object.TARGET_VELOCITY, 0, 0)
    _, speeds, words = places(rig, 900)
    falling = np.flatnonzero((speeds < 4.0) & (speeds > 1.0))
    assert -np.polyfit(1e-3 * falling, speeds[falling], 1)[0] == pytest.approx(10.0, rel=0.1)
    assert words[-1] & TARGET_REACHED
    assert words[-1] & BIT_12


def test_a_velocity_that_was_written_before_acts_with_enabling(rig):
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(-3.0))
    rig.enable(PV)
    rig.wait(500)
    assert rig.speed_rps == pytest.approx(-3.0, rel=0.05)


@pytest.mark.parametrize("limit", [(Object.MAX_PROFILE_VELOCITY, 2 * COUNTS_PER_REV), (Object.MAX_MOTOR_SPEED, 120)])
def test_607fh_and_6080h_limit_it_and_bit_11_says_so(rig, limit):
    rig.set(limit[0], 0, limit[1])
    rig.enable(PV)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(5.0))
    _, speeds, words = places(rig, 500)
    assert np.median(speeds[300:]) == pytest.approx(2.0, rel=0.02)
    assert words[-1] & INTERNAL_LIMIT
    assert rig.state is ENABLED


def test_slippage_above_60f8h_is_bit_13(rig):
    rig.enable(PV)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(5.0))
    rig.wait(100)
    assert not rig.status & BIT_13
    rig.set(Object.MAX_SLIPPAGE, 0, 10)
    assert any(word & BIT_13 for word in places(rig, 50)[2])


# -- profile torque ----------------------------------------------------------------------------------------------------


def test_profile_torque_goes_to_6071h_on_the_slope_of_6087h(rig):
    rig.set(Object.TORQUE_SLOPE, 0, 1000)  # per mille of the rated torque per second
    rig.enable(TQ)
    rig.set(Object.TARGET_TORQUE, 0, 50)
    assert not rig.status & TARGET_REACHED
    torques, _ = follow(rig, 400)
    steps = np.diff(torques[:190]) / ONE_AXIS.control_period_s
    assert steps == pytest.approx(RATED_NM, rel=1e-6)
    assert torques[-1] == pytest.approx(0.05 * RATED_NM)
    assert rig.status & TARGET_REACHED
    assert rig.read(Object.TORQUE_DEMAND) == 50


# -- interpolated position ---------------------------------------------------------------------------------------------


def interpolating(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.INTERPOLATION_DATA, 1, 32)))
    rig.enable(IP)
    return rig


def lead(rig, word, speed_rps, seconds):
    target = rig.read(Object.INTERPOLATION_DATA, 1)
    for step in range(round(seconds / 0.002)):
        target += speed_rps * min(1.0, step / 100) * 0.002 * COUNTS_PER_REV
        rig.command(word, round(target))
        rig.sync()
    return target / COUNTS_PER_REV


def test_set_points_of_60c1h_are_followed_with_bit_4_only(rig):
    interpolating(rig)
    assert not rig.status & BIT_12
    lead(rig, 0x0F, 1.0, 0.3)
    assert abs(rig.position_rev) < 0.02
    rig.command(0x0F, rig.read(Object.POSITION_ACTUAL))
    rig.sync()
    target = lead(rig, 0x1F, 3.0, 0.6)
    assert rig.status & BIT_12
    assert rig.speed_rps == pytest.approx(3.0, rel=0.05)
    assert target - rig.position_rev == pytest.approx(3.0 / 25.0, rel=0.1)
    rig.word(0x0F)
    assert not rig.status & BIT_12
    rig.wait(500)
    assert abs(rig.speed_rps) < 0.02
    assert rig.state is ENABLED


def test_interpolation_goes_on_where_the_motor_stands_when_bit_4_or_the_halt_comes_back(rig):
    interpolating(rig)
    for stopped in (0x0F, 0x11F):
        lead(rig, 0x1F, 3.0, 0.5)
        rig.word(stopped)
        rig.wait(500)
        assert abs(rig.speed_rps) < 0.02
        assert not rig.status & BIT_12
        held = rig.read(Object.POSITION_ACTUAL)
        rig.set(Object.INTERPOLATION_DATA, 1, held)
        rig.word(0x1F)
        assert rig.status & BIT_12
        rig.sync(100)
        assert rig.state is ENABLED
        assert rig.status & TARGET_REACHED
        assert rig.read(Object.POSITION_ACTUAL) == pytest.approx(held, abs=300)


def test_bit_4_does_not_end_a_halt_of_interpolation(rig):
    interpolating(rig)
    rig.word(0x10F, 0x11F, 0x10F)
    assert not rig.status & BIT_12
    rig.sync(10)
    assert rig.state is ENABLED


def test_a_set_point_of_60c1h_far_away_is_a_fault_and_is_not_gone(rig):
    interpolating(rig)
    rig.command(0x1F, revolutions(30.0))
    rig.sync()
    rig.wait(300)
    assert rig.state is State.FAULT
    assert abs(rig.position_rev) < 0.02


# -- cyclic velocity ---------------------------------------------------------------------------------------------------


def test_cyclic_velocity_reaches_each_set_point_in_one_interpolation_period(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.TARGET_VELOCITY, 0, 32)))
    rig.enable(CSV)
    assert rig.status & BIT_12
    for speed in np.linspace(0.0, 4.0, 120):
        rig.command(0x0F, revolutions(speed))
        rig.sync()
    rig.sync(100)
    assert rig.speed_rps == pytest.approx(4.0, rel=0.02)
    assert rig.read(Object.VELOCITY_DEMAND) == pytest.approx(revolutions(4.0), abs=1)
    rig.set(Object.VELOCITY_OFFSET, 0, revolutions(1.0))
    rig.sync(200)
    assert rig.speed_rps == pytest.approx(5.0, rel=0.02)


def test_cyclic_velocity_that_is_halted_follows_no_set_point(rig):
    rig.enable(CSV)
    rig.word(0x10F)
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(0.5))
    rig.sync(100)
    assert abs(rig.speed_rps) < 0.05
    assert not rig.status & BIT_12
    assert rig.status & TARGET_REACHED  # with halt it says: stands


def test_cyclic_velocity_starts_at_rest_whatever_was_written_before(rig):
    rig.set(Object.TARGET_VELOCITY, 0, revolutions(5.0))
    rig.enable(CSV)
    rig.sync(100)
    assert abs(rig.speed_rps) < 0.05
