"""Each limit of the bench file is held by the drive, or somebody else who is named; none is dropped."""

import math

import pytest

from drive_profiles.family.profile import Profile, available
from drive_profiles.standard.units import Scaling
from hil.bench.bench import load_bench
from hil.master.drive.limits import LIMITS, limit_of, limit_words, value_in

SCALING = Scaling(4096, 2.0)
STATED = load_bench("reference").axis[2].limits
DRIVES = [name for name in available() if Profile.load(name).kind == "drive"]


def test_our_own_drive_holds_all_of_them():
    own = Profile.load("emulated_drive")
    assert {limit.holder(own) for limit in LIMITS} == {"drive"}
    assert list(limit_words(2, own, STATED)) == []


@pytest.mark.parametrize("name", DRIVES)
def test_no_limit_is_dropped_in_silence(name):
    profile = Profile.load(name)
    said = " ".join(limit_words(2, profile, STATED))
    for key in {limit.key for limit in LIMITS}:
        is_held = all(limit.holder(profile) == "drive" for limit in LIMITS if limit.key == key)
        assert is_held != (f"limits.{key}" in said)


@pytest.mark.parametrize(
    ("name", "key", "parameter", "raw"),
    [
        ("elmo_gold", "position_max_rev", "position_limit_max_counts", 8192),
        ("elmo_gold", "following_error_rev", "following_error_window_counts", 8192),
        ("yiyou_euservo", "torque_nm", "torque_limit_per_mille", 500),
        ("novanta_eve", "speed_rps", "velocity_limit_rps", 2.0),
        ("copley_plus", "following_error_rev", "following_error_limit_rad", 8192),
        ("schunk_pilz_prbt", "position_min_rev", "position_limit_min_deg", 8192),
        ("emulated_drive", "acceleration_rps_s", "max_acceleration_rad_s2", 8192),
        ("maxon_epos4", "quick_stop_rps_s", "quick_stop_deceleration_rad_s2", 120),
    ],
)
def test_a_limit_is_written_in_the_unit_of_the_drive(name, key, parameter, raw):
    """Two revolutions, two revolutions per second (and second), 1 N·m at a rated torque of 2 N·m and 4096 steps."""
    profile = Profile.load(name)
    assert limit_of(key).held_by(profile) == parameter
    held = profile.parameters[parameter]
    si = 1.0 if key == "torque_nm" else 4.0 * math.pi
    assert held.raw(value_in(held, si, SCALING), SCALING) == raw


def test_a_time_that_a_drive_has_fixed_is_not_set_there():
    assert limit_of("following_error_timeout_s").holder(Profile.load("maxon_epos4")) == "master alone"


def test_a_torque_that_nobody_sees_and_nobody_limits_is_held_by_nobody():
    profile = Profile.load("maxon_epos2")
    torque = profile.torque.model_copy(update={"current": None, "current_step_a": None})
    assert limit_of("torque_nm").holder(profile) == "master alone"
    blind = profile.model_copy(update={"torque": torque})
    assert limit_of("torque_nm").holder(blind) == "nobody"
    assert "axis 2: neither master nor drive holds limits.torque_nm" in " ".join(limit_words(2, blind, STATED))


def test_a_ramp_of_unknown_scale_is_the_drives_own():
    said = list(limit_words(2, Profile.load("kollmorgen_akd"), STATED))
    assert "axis 2: the drive keeps its own value for limits.quick_stop_rps_s" in said


def test_a_limit_that_nobody_states_is_neither_written_nor_spoken_of():
    unstated = STATED.model_copy(update={"acceleration_rps_s": None})
    assert [limit.si(unstated) for limit in LIMITS if limit.key == "acceleration_rps_s"] == [None, None]
    assert "acceleration" not in " ".join(limit_words(2, Profile.load("elmo_gold"), unstated))
    assert "limits.acceleration_rps_s" in " ".join(limit_words(2, Profile.load("elmo_gold"), STATED))


def test_a_gentle_acceleration_limit_does_not_lengthen_the_quick_stop():
    """60C6h bounds the ramp of 6085h as well, so it never lies below it."""
    gentle = STATED.model_copy(update={"acceleration_rps_s": 10.0, "quick_stop_rps_s": 50.0})
    up, down = (limit.si(gentle) for limit in LIMITS if limit.key == "acceleration_rps_s")
    assert (up, down) == (pytest.approx(20.0 * math.pi), pytest.approx(100.0 * math.pi))
