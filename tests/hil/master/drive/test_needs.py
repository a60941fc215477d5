"""What a profile lacks is known before a bus is opened, all at once, each with its use."""

import pytest

from drive_profiles.family.profile import Profile, available
from hil.bench.bench import AS_FOUND, load_bench
from hil.master.drive.needs import objects_needed, profile_gaps, scale_gaps
from hil.robot_tables import Control

TABLE = load_bench("reference").axis[2]
OWN = Profile.load("emulated_drive")
GAINS = tuple(Control.model_fields)


def without(profile: Profile, *names: str) -> Profile:
    """The profile without these parameters."""
    kept = {name: entry for name, entry in profile.parameters.items() if name not in names}
    return profile.model_copy(update={"parameters": kept})


def changed(**changes: object):
    return TABLE.model_copy(update=changes)


@pytest.mark.parametrize("loop", ["drive", "host"])
def test_the_emulated_drive_lacks_nothing(loop):
    assert profile_gaps(2, TABLE, OWN, loop, with_notch=True) == []


def test_every_gap_is_listed_once_with_its_use():
    gaps = profile_gaps(2, TABLE, without(OWN, "position_gain_per_s", "lowpass_hz", "notch_1.mode"), "drive", with_notch=True)
    assert len(gaps) == 2
    gains, notch = gaps
    assert "no position_gain_per_s, lowpass_hz for the gains of control" in gains
    assert f'gains_are_set = true if the drive has these gains already, else control = "{AS_FOUND}"' in gains
    assert "no notch_1.mode, the filter that axis.2.notch describes" in notch


def test_gains_as_found_are_neither_asked_nor_looked_for():
    profile, table = without(OWN, *GAINS), changed(control=AS_FOUND)
    assert len(profile_gaps(2, TABLE, profile, "drive")) == 1
    assert profile_gaps(2, table, profile, "drive") == []
    assert profile_gaps(2, changed(gains_are_set=True), profile, "drive") == []
    gains = {OWN.parameters[name].address for name in GAINS}
    assert not gains & {need.address for need in objects_needed(table, OWN, "drive")}
    assert not gains & {need.address for need in objects_needed(changed(gains_are_set=True), OWN, "drive")}
    assert gains <= {need.address for need in objects_needed(TABLE, OWN, "drive")}


def test_a_loop_that_the_host_closes_asks_no_gains_of_the_drive():
    assert profile_gaps(2, TABLE, without(OWN, *GAINS), "host") == []


def test_a_limit_that_a_drive_does_not_hold_is_no_gap():
    limits = [name for name, entry in OWN.parameters.items() if entry.parameter_class == "limits"]
    assert profile_gaps(2, TABLE, without(OWN, *limits), "drive") == []


def test_a_scale_that_the_profile_does_not_know_the_bench_file_may_state():
    torque = OWN.torque.model_copy(update={"rated_torque": None})
    encoder = OWN.encoder.model_copy(update={"increments": None, "revolutions": None})
    profile = OWN.model_copy(update={"torque": torque, "encoder": encoder})
    gaps = profile_gaps(2, TABLE, profile, "drive")
    assert [gap.rpartition("; ")[2] for gap in gaps] == [
        "state axis.2.encoder_counts_per_rev in the bench file",
        "state axis.2.rated_torque_nm in the bench file",
    ]
    assert profile_gaps(2, changed(encoder_counts_per_rev=4096, rated_torque_nm=1.27), profile, "drive") == []


def test_a_mode_that_the_drive_does_not_have_is_a_gap():
    gaps = profile_gaps(2, TABLE, Profile.load("novanta_eve"), "host")
    assert "axis 2: profile novanta_eve has no mode CST, in which the host closes the loop" in gaps


@pytest.mark.parametrize("name", [name for name in available() if Profile.load(name).kind == "drive"])
def test_of_every_profile_it_can_be_said_what_it_lacks(name):
    profile = Profile.load(name)
    for loop in (None, "drive", "host"):
        for gap in profile_gaps(2, TABLE, profile, loop, with_notch=True):
            assert gap.startswith(f"axis 2: profile {name} has no ")
    assert len(scale_gaps(2, TABLE, profile)) <= 2
