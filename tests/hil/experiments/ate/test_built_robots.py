"""Robots that nobody tuned for: each is identified, or refused with the cause that is the true one, before a second motion."""

from dataclasses import replace

import pytest

from hil.design.ate.model import Arm
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import AteNotIdentifiedError
from hil.experiments.ate.identify import Identification, as_part, identify_on
from hil.experiments.ate.request import AteRequest, AxisKnowledge
from tests.hil.experiments.ate.ate_rig import AXIS, RigSession, blank_bench, built


def identified(session: RigSession, arm_hz: float | None = None, **request: object) -> Identification:
    known = AxisKnowledge() if arm_hz is None else AxisKnowledge(Arm(arm_hz, 0.04))
    return identify_on(session, AteRequest(AXIS, **request), known)  # type: ignore[arg-type]


def off(session: RigSession, found: Identification) -> dict[float, tuple[float, float, float]]:
    """A_k off by so much of it, φ_k by so many degrees, and the larger of both in standard errors, by order."""
    table, estimate = session.robot.axis[AXIS].ate, found.estimate
    phases, away = table.phases_deg(), {}
    for order, size in table.amplitudes_arcsec().items():
        part = estimate.error.amplitude_arcsec[order] / size - 1.0
        turn = (estimate.error.phase_deg[order] - phases[order] + 180.0) % 360.0 - 180.0
        sigmas = (part * size / estimate.amplitude_error_arcsec[order], turn / estimate.phase_error_deg[order])
        away[order] = (part, turn, max(map(abs, sigmas)))
    return away


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "amplitude", "turn_deg"),
    [
        ("low, strong order 4", 0.02, 2.0),
        ("high, 13 bits, 4 ms", 0.06, 2.0),
        ("noise, 15 bits", 0.03, 2.0),
        ("order 1, noise", 0.03, 2.0),
        ("hysteresis of 0.5 N m, lag", 0.10, 3.0),
        ("hysteresis, 8 ms", 0.10, 3.0),
    ],
)
def test_a_robot_nobody_tuned_for_is_identified(name: str, amplitude: float, turn_deg: float) -> None:
    session = RigSession(built(name))
    found = identified(session, passes=3)
    for order, (part, turn, sigmas) in off(session, found).items():
        assert abs(part) < amplitude, order
        assert abs(turn) < turn_deg, order
        assert sigmas < 5.0, order
    assert found.estimate.motion_scale == pytest.approx(1.0, abs=0.05), "below the resonance no gear bends the motion"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["soft wind-up, reaction", "all of it, mildly"])
def test_a_gear_that_is_no_spring_is_a_result_with_a_note(name: str) -> None:
    session = RigSession(built(name))
    found = identified(session)
    assert found.is_good
    assert any("the gear is nonlinear" in note for note in found.notes)
    assert len(session.motions) < 6, "more passes would not make it better"
    assert all(abs(part) < 0.01 and abs(turn) < 1.0 for part, turn, _ in off(session, found).values()), (
        "the fit simulates the gear"
    )


@pytest.mark.slow
def test_a_sensor_with_delay_low_pass_and_mounting_changes_no_phase() -> None:
    session = RigSession(built("", f_a=16.0), delay_s=0.006, lowpass_hz=150.0, mount_hz=120.0)
    found = identified(session, passes=2)
    assert found.estimate.arm.delay_s > 0.006
    for part, turn, sigmas in off(session, found).values():
        assert abs(part) < 0.02
        assert abs(turn) < 1.5
        assert sigmas < 4.0


@pytest.mark.slow
def test_a_slow_pass_says_the_same_of_the_motion_as_a_fast_one() -> None:
    session = RigSession(built("noise, 15 bits"))
    found = identified(session, passes=4)
    factors = [(each.estimate.motion_scale, each.estimate.motion_scale_error) for each in found.passes]
    assert all(abs(factor - 1.0) < 0.05 and error < 0.05 for factor, error in factors)


@pytest.mark.slow
def test_order_1_is_followed_to_its_resonance_where_limits_allow_and_said_where_they_do_not() -> None:
    free = RigSession(built("order 1, noise"))
    found = identified(free, passes=3)
    assert max(each.ramps.trajectory.end_rps for each in found.passes) > 10.5
    assert as_part(found.estimate, AteRequest(AXIS)).values.a1_arcsec == pytest.approx(40.0, rel=0.02)
    robot = built("order 1, noise")
    held = identified(RigSession(robot, blank_bench(robot, speed_rps=9.0)), passes=2)
    assert any("order 1 meets the arm at 10.0" in note and "its limit speed_rps is 9" in note for note in held.notes)


@pytest.mark.slow
def test_ramps_follow_the_arm_and_not_the_bench_files_other_motion() -> None:
    low, high = RigSession(built("low, strong order 4")), RigSession(built("", f_a=25.0))
    slow, fast = (identified(each, hz, passes=1).passes[0].ramps.trajectory for each, hz in ((low, 5.0), (high, 25.0)))
    assert slow.acceleration_rps_s < 1.0
    assert 10.0 < fast.acceleration_rps_s <= fast.deceleration_rps_s
    assert slow.end_rps == pytest.approx(1.35 * 2.5, rel=0.01)
    assert fast.end_rps == pytest.approx(1.35 * 12.5, rel=0.01)
    unknown = RigSession(built("", f_a=22.0, a1=0.0))
    found = identified(unknown, passes=3)
    ends = [each.ramps.trajectory.end_rps for each in found.passes]
    assert ends[0] == 10.0
    assert ends[1] > 1.15 * 11.0, "the second pass goes where the first did not reach"


@pytest.mark.ci
def test_a_blind_pass_that_ends_before_the_resonance_asks_for_another() -> None:
    with pytest.raises(AteNotIdentifiedError, match=r"to pass f_a/2 = 1\d\.\d+ rev/s: 9\.\d+ rev/s .*; allow another pass"):
        identified(RigSession(built("", f_a=22.0, a1=0.0)), passes=1)


# -- what is refused, with its cause, before the second motion ----------------------------------------------------------


def refusal(session: RigSession) -> str:
    with pytest.raises((AteNotIdentifiedError, NotPossibleError)) as error:
        identified(session)
    assert len(session.motions) == 1, "named before the second motion"
    return str(error.value)


@pytest.mark.slow
def test_a_robot_without_an_error_is_told_that_it_has_none() -> None:
    assert "no A_k is significant, and none is above" in refusal(RigSession(built("no error")))


@pytest.mark.ci
def test_a_sensor_that_does_not_sit_on_the_arm_is_named() -> None:
    assert "the sensor does not respond to this axis" in refusal(RigSession(built("", bits=15), tip_gain=0.0))


def test_a_tip_that_moves_against_its_motor_is_named() -> None:
    assert "the encoder counts backwards (607Eh), or the accelerometer sits upside down" in refusal(
        RigSession(built(""), tip_gain=-1.0)
    )


@pytest.mark.ci
def test_a_wrong_lever_is_named() -> None:
    assert "check its reduction ratio and lever" in refusal(RigSession(built(""), tip_gain=0.6))


def test_a_dead_sensor_is_named() -> None:
    robot = built("", noise=0.0)
    assert "check that it is powered, sits on the arm" in refusal(RigSession(robot, tip_gain=0.0))


def test_an_arm_that_is_held_is_named() -> None:
    assert "check that the brake is open and the arm free" in refusal(RigSession(built(""), is_held=True))


@pytest.mark.ci
def test_limits_below_every_resonance_are_named() -> None:
    robot = built("", f_a=16.0)
    assert "its limit speed_rps is 8;" in refusal(RigSession(robot, blank_bench(robot, speed_rps=8.0)))


def test_a_known_arm_beyond_the_limits_is_named_before_any_motion() -> None:
    robot = built("", f_a=16.0)
    session = RigSession(robot, blank_bench(robot, speed_rps=8.0))
    with pytest.raises(NotPossibleError, match=r"its limit speed_rps is 8; at least 9\.68 is needed"):
        identify_on(session, AteRequest(AXIS), replace(AxisKnowledge(), start=Arm(16.0, 0.04)))
    assert not session.motions
