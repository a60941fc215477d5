"""The drive's modes of operation; all through frames, judged by the plant."""

import math

import numpy as np
import pytest

from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import Frame
from plant_emulator.robots.robot import Robot
from tests.plant_emulator.rig import (
    AXIS,
    COUNTS_PER_REV,
    ONE_AXIS,
    TURN,
    Rig,
    revolutions,
)

CSP, CST, PP = Mode.CSP, Mode.CST, Mode.PP
ENABLED = State.OPERATION_ENABLED
RATED_NM = round(1000 * ONE_AXIS.axis[AXIS].rated_torque) / 1000
MOTOR_LIMIT_NM = ONE_AXIS.axis[AXIS].torque_limit_nm
TARGET_REACHED, INTERNAL_LIMIT, BIT_12 = 1 << 10, 1 << 11, 1 << 12

SAG_REV = 0.015  # gravity pulls the arm down that far until the integrator holds it

# No friction, no gravity, no ripple: what the loop itself does
IDEAL = Robot(
    axis={
        AXIS: ONE_AXIS.axis[AXIS].model_copy(
            update={
                "coulomb_friction_nm": 0.0,
                "static_friction_nm": 0.0,
                "gravity_moment_nm": 0.0,
                "ate": ONE_AXIS.axis[AXIS].ate.model_copy(update={"a2_arcsec": 0.0, "a4_arcsec": 0.0}),
            }
        )
    }
)


@pytest.fixture
def ideal():
    return Rig(IDEAL)


def track(rig, milliseconds, each=lambda: None):
    """Speed and position of the plant every millisecond."""
    speeds, places = [], []
    for _ in range(milliseconds):
        rig.wait(1)
        each()
        speeds.append(rig.speed_rps)
        places.append(rig.position_rev)
    return np.array(speeds), np.array(places)


# -- profile position --------------------------------------------------------------------------------------------------


@pytest.fixture
def profile(rig):
    """Enabled in profile position: 5 rev/s, 20 rev/s²."""
    rig.enable(PP)
    return rig


def go(rig, turns, relative=False, at_once=False):
    rig.set(Object.TARGET_POSITION, 0, revolutions(turns))
    rig.word(0x1F | relative << 6 | at_once << 5)


def test_a_profile_goes_where_it_is_told_at_its_speed_and_acceleration(profile):
    go(profile, 4.0)
    speeds, places = track(profile, 1600)
    assert places[-1] == pytest.approx(4.0, abs=0.001)
    assert speeds.max() == pytest.approx(5.0, rel=0.06)
    assert np.median(speeds[400:700]) == pytest.approx(5.0, rel=0.02)
    rising = np.flatnonzero((speeds > 1.0) & (speeds < 4.0) & (np.arange(1600) < 400))
    assert np.polyfit(1e-3 * rising, speeds[rising], 1)[0] == pytest.approx(20.0, rel=0.15)


def test_a_set_point_is_taken_on_the_rising_edge_of_bit_4_and_acknowledged_with_bit_12(profile):
    profile.set(Object.TARGET_POSITION, 0, revolutions(1.0))
    profile.wait(300)
    assert profile.position_rev == pytest.approx(0.0, abs=SAG_REV)
    assert not profile.status & BIT_12
    profile.word(0x1F)
    assert profile.status & BIT_12
    profile.set(Object.TARGET_POSITION, 0, revolutions(2.0))
    profile.word(0x3F)  # bit 4 is still high: no new set-point
    profile.wait(1500)
    assert profile.position_rev == pytest.approx(1.0, abs=0.001)
    profile.word(0x0F)
    assert not profile.status & BIT_12
    profile.word(0x1F)
    profile.wait(1500)
    assert profile.position_rev == pytest.approx(2.0, abs=0.001)


def test_a_set_point_that_enables_the_drive_moves_nothing(rig):
    rig.set(Object.MODES_OF_OPERATION, 0, PP)
    rig.set(Object.TARGET_POSITION, 0, revolutions(3.0))
    rig.start()
    assert rig.word(0x06, 0x07, 0x1F) is ENABLED
    rig.wait(300)
    assert rig.position_rev == pytest.approx(0.0, abs=SAG_REV)


def test_a_relative_set_point_counts_from_the_last_target(profile):
    for _ in range(2):
        go(profile, 0.75, relative=True)
        profile.word(0x0F)
    profile.wait(1500)
    assert profile.position_rev == pytest.approx(1.5, abs=0.001)


def test_target_reached_means_the_motor_and_not_its_reference(profile):
    assert profile.status & TARGET_REACHED
    go(profile, 1.0)
    assert not profile.status & TARGET_REACHED
    seen = []
    track(profile, 1500, lambda: seen.append((bool(profile.status & TARGET_REACHED), profile.position_rev)))
    first = next(place for reached, place in seen if reached)
    assert first == pytest.approx(1.0, abs=0.0012)
    assert seen[-1][0]


def test_halt_stops_on_the_profiles_ramp_and_its_end_goes_on(profile):
    go(profile, 8.0)
    profile.wait(600)
    profile.word(0x11F)
    assert not profile.status & TARGET_REACHED
    speeds, places = track(profile, 600)
    falling = np.flatnonzero((speeds < 4.0) & (speeds > 1.0))
    assert -np.polyfit(1e-3 * falling, speeds[falling], 1)[0] == pytest.approx(20.0, rel=0.15)
    assert places[-1] < 5.0
    assert abs(speeds[-1]) < 0.01
    assert profile.state is ENABLED
    assert profile.status & TARGET_REACHED  # with halt it says: stands
    profile.word(0x1F)
    assert not profile.status & TARGET_REACHED
    profile.wait(2000)
    assert profile.position_rev == pytest.approx(8.0, abs=0.001)


def test_a_limit_written_during_a_halt_does_not_end_it(profile):
    go(profile, 8.0)
    profile.wait(300)
    profile.word(0x11F)
    profile.wait(500)
    held = profile.position_rev
    profile.set(Object.PROFILE_VELOCITY, 0, revolutions(2.0))
    profile.set(Object.MAX_TORQUE, 0, 2000)
    profile.wait(300)
    assert profile.position_rev == pytest.approx(held, abs=0.001)
    profile.word(0x1F)
    speeds, _ = track(profile, 700)
    assert np.median(speeds[300:]) == pytest.approx(2.0, rel=0.05)  # and what was written then holds


@pytest.mark.parametrize("ahead_rev", [0.02, -0.5], ids=["too close to stop", "behind"])
def test_a_new_target_within_the_braking_distance_is_passed_and_come_back_to(profile, ahead_rev):
    """No step in speed: the reference cannot stop at once either."""
    go(profile, 20.0)
    profile.wait(800)
    target = float(profile.motion["reference_rad"]) / TURN + ahead_rev
    profile.word(0x0F)
    references = []
    go(profile, target, at_once=True)
    for _ in range(1600):
        profile.world.axes.advance(1)
        references.append(float(profile.motion["reference_speed_rad_s"]) / TURN)
    steps = np.abs(np.diff(references)) / ONE_AXIS.control_period_s
    assert steps.max() <= 20.0 * 1.51
    profile.wait(1500)
    assert profile.position_rev == pytest.approx(target, abs=0.001)


def test_a_profile_outside_the_position_limits_is_a_fault_and_is_not_gone(profile):
    profile.set(Object.SOFTWARE_POSITION_LIMIT, 2, revolutions(2.0))
    go(profile, 2.5)
    profile.wait(500)
    assert profile.state is State.FAULT
    assert profile.read(Object.ERROR_CODE) == 0x8612
    assert abs(profile.position_rev) < SAG_REV


# -- cyclic position ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "index", "periods"), [(1, -3, 4), (2, -3, 8), (25, -4, 10), (1, -2, 40)])
def test_the_way_to_a_set_point_takes_the_interpolation_period(value, index, periods):
    rig = Rig(IDEAL)
    rig.set(Object.INTERPOLATION_PERIOD, 1, value)
    rig.set(Object.INTERPOLATION_PERIOD, 2, index)
    rig.cyclic(CSP)
    rig.command(0x0F, 400)
    rig.world.receive(_sync())
    shown = []
    for _ in range(periods + 4):
        angle = rig.world.axes.counts(0)
        rig.world.axes.advance(1)
        shown.append(angle + rig.motion["following_error_rad"] * rig.motion["counts_per_rad"])
    straight = [min(400.0, 400.0 * (i + 1) / periods) for i in range(periods + 4)]
    assert shown == pytest.approx(straight, abs=1e-6)


def _sync():
    return Frame(0x080, b"")


def test_set_points_come_into_force_with_sync_only(ideal):
    ideal.cyclic(CSP)
    ideal.command(0x0F, 500)
    ideal.wait(500)
    assert ideal.read(Object.TARGET_POSITION) == 0
    assert abs(ideal.read(Object.POSITION_ACTUAL)) <= 1
    ideal.sync(500)
    assert ideal.read(Object.POSITION_ACTUAL) == pytest.approx(500, abs=2)


def test_the_axis_follows_cyclic_set_points_with_the_lag_of_its_loop(rig):
    rig.cyclic(CSP)
    target = rig.turn(5.0, 0.8)
    lag = target / COUNTS_PER_REV - rig.position_rev
    assert lag == pytest.approx(5.0 / 25.0, rel=0.05)  # v / K_pp
    assert rig.read(Object.FOLLOWING_ERROR_ACTUAL) / COUNTS_PER_REV == pytest.approx(lag, rel=0.05)


@pytest.mark.parametrize("with_sync", [True, False])
def test_without_new_set_points_the_axis_goes_to_the_last_and_holds_it(rig, with_sync):
    rig.cyclic(CSP)
    target = rig.turn(5.0, 0.5)
    if with_sync:
        rig.sync(400)
    else:
        rig.wait(800)
    assert rig.state is ENABLED
    assert rig.position_rev == pytest.approx(target / COUNTS_PER_REV, abs=0.001)


@pytest.mark.parametrize("offset", [3000, -3000])
def test_60b0_is_added_to_the_target(ideal, offset):
    ideal.cyclic(CSP)
    ideal.set(Object.POSITION_OFFSET, 0, offset)
    for _ in range(600):
        ideal.cycle(1000)
    assert ideal.read(Object.POSITION_ACTUAL) == pytest.approx(1000 + offset, abs=2)


def test_60b0_is_held_to_the_limits_like_a_set_point(rig):
    rig.cyclic(CSP)
    rig.set(Object.POSITION_OFFSET, 0, revolutions(100.0))
    rig.sync()
    rig.wait(300)
    assert rig.state is State.FAULT
    assert abs(rig.position_rev) < SAG_REV


def test_60b1_takes_the_lag_away(rig):
    """With the speed given beside the position, the axis follows without v / K_pp."""
    rig.cyclic(CSP)
    rig.turn(5.0, 0.8)
    rig.set(Object.VELOCITY_OFFSET, 0, revolutions(5.0))
    target = rig.turn(5.0, 0.8)
    assert abs(target / COUNTS_PER_REV - rig.position_rev) < 0.01


def test_60b2_acts_as_torque_behind_the_loop(ideal):
    ideal.enable(CSP)
    ideal.set(Object.TORQUE_OFFSET, 0, 100)
    ideal.world.axes.advance(1)
    assert ideal.read(0x2130) == pytest.approx(0.1 * RATED_NM)  # at once; then the loop works against it
    ideal.wait(1000)
    assert ideal.read(0x2130) == pytest.approx(0.0, abs=0.01 * RATED_NM)


def test_a_stop_takes_60b2_over_without_a_jump_and_once(ideal):
    """A broken limit begins its ramp in the control period, and the state machine begins it again when it sees the trip."""
    ideal.cyclic(CSP)
    ideal.set(Object.TORQUE_OFFSET, 0, 200)
    ideal.sync(1000)
    ideal.command(0x0F, revolutions(50.0))
    ideal.world.receive(_sync())
    torques = [ideal.read(0x2130)]
    ideal.world.finish_period()
    torques.append(ideal.read(0x2130))
    assert ideal.state is State.FAULT_REACTION_ACTIVE
    ideal.world.axes.advance(1)
    torques.append(ideal.read(0x2130))
    assert np.abs(np.diff(torques)).max() < 0.02 * RATED_NM


def test_a_set_point_far_away_that_comes_with_the_enabling_word_is_not_followed(rig):
    rig.map_pdo(0x1400, ((Object.CONTROL_WORD, 0, 16), (Object.TARGET_POSITION, 0, 32)))
    rig.set(Object.MODES_OF_OPERATION, 0, CSP)
    rig.start()
    for word in (0x06, 0x07, 0x0F):
        rig.command(word, revolutions(30.0))
        rig.sync()
    rig.wait(300)
    assert rig.state is State.FAULT
    assert abs(rig.position_rev) < SAG_REV


# -- cyclic torque -----------------------------------------------------------------------------------------------------


def test_cyclic_torque_is_the_motors_torque():
    rig = Rig(IDEAL)
    rig.cyclic(CST, torque=True)
    rig.cycle(100, layout="<Hh")
    assert rig.read(0x2130) == pytest.approx(0.1 * RATED_NM)
    assert rig.plant["torque_nm"] == pytest.approx(0.1 * RATED_NM)
    before = rig.speed_rps
    for _ in range(100):
        _, _, torque = rig.cycle(100, layout="<Hh")
    assert torque == 100
    axis = IDEAL.axis[AXIS]
    inertia = axis.motor_inertia_kg_m2 + axis.arm_inertia_kg_m2 / axis.reduction_ratio**2
    damping = axis.motor_damping_nm_s_rad + axis.arm_damping_nm_s_rad / axis.reduction_ratio**2
    rise = (0.1 * RATED_NM / damping) * (1.0 - math.exp(-0.2 * damping / inertia)) / TURN
    assert rig.speed_rps - before == pytest.approx(rise, rel=0.03)


@pytest.mark.parametrize("per_mille", [32767, -32768])
def test_cyclic_torque_stays_within_6072(rig, per_mille):
    rig.set(Object.MAX_TORQUE, 0, 150)
    rig.cyclic(CST, torque=True)
    _, _, _ = rig.cycle(per_mille, layout="<Hh")
    status, _, torque = rig.cycle(per_mille, layout="<Hh")
    assert torque == math.copysign(150, per_mille)
    assert status & INTERNAL_LIMIT


def test_the_motors_own_limit_stands_above_6072(rig):
    rig.set(Object.MAX_TORQUE, 0, 65535)
    rig.cyclic(CST, torque=True)
    rig.cycle(32767, layout="<Hh")
    assert rig.plant["torque_nm"] == MOTOR_LIMIT_NM


@pytest.mark.parametrize("offset", [100, -100])
def test_60b2_is_added_to_the_torque(rig, offset):
    rig.cyclic(CST, torque=True)
    rig.set(Object.TORQUE_OFFSET, 0, offset)
    rig.cycle(50, layout="<Hh")
    _, _, torque = rig.cycle(50, layout="<Hh")
    assert torque == 50 + offset


def test_6072_acts_at_once_in_position_mode_too(rig):
    rig.cyclic(CSP)
    rig.set(Object.MAX_TORQUE, 0, 20)
    for target in (100, 300, 700, 1500, 3000):
        status, _, torque = rig.cycle(target)
        assert abs(torque) <= 20
        assert abs(rig.plant["torque_nm"]) <= 0.02 * RATED_NM * (1 + 1e-9)
    assert status & INTERNAL_LIMIT
    assert torque == 20
