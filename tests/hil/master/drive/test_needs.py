"""What a profile lacks is known before a bus is opened, all at once, each with its use."""

import pytest

from drive_profiles.family.profile import Profile, available
from drive_profiles.standard.cia402 import Mode
from hil.bench.bench import AS_FOUND, load_bench
from hil.master.drive.needs import LIMITS, objects_needed, profile_gaps, scale_gaps
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


@pytest.mark.parametrize("mode", [Mode.CSP, Mode.CST])
def test_the_emulated_drive_lacks_nothing(mode):
    assert profile_gaps(2, TABLE, OWN, mode, with_notch=True) == []


def test_every_gap_is_listed_with_its_use():
    gaps = profile_gaps(2, TABLE, without(OWN, "torque_limit_nm", "lowpass_hz", "notch_1.mode"), Mode.CSP, with_notch=True)
    assert len(gaps) == 3
    torque, lowpass, notch = gaps
    assert torque == "axis 2: profile emulated_drive has no torque_limit_nm, by which the drive holds limits.torque_nm"
    assert "no lowpass_hz, to which control.lowpass_hz is written" in lowpass
    assert f'control = "{AS_FOUND}"' in lowpass
    assert "no notch_1.mode, the filter that axis.2.notch describes" in notch


def test_gains_as_found_are_neither_asked_nor_looked_for():
    profile, table = without(OWN, *GAINS), changed(control=AS_FOUND)
    assert len(profile_gaps(2, TABLE, profile, Mode.CSP)) == len(GAINS)
    assert profile_gaps(2, table, profile, Mode.CSP) == []
    gains = {OWN.parameters[name].address for name in GAINS}
    assert not gains & {need.address for need in objects_needed(table, OWN, Mode.CSP)}
    assert gains <= {need.address for need in objects_needed(TABLE, OWN, Mode.CSP)}


def test_a_loop_that_the_host_closes_asks_no_gains_of_the_drive():
    assert profile_gaps(2, TABLE, without(OWN, *GAINS), Mode.CST) == []


def test_a_limit_without_a_parameter_is_a_gap_whatever_the_gains():
    for limit in LIMITS:
        assert limit.parameter in str(profile_gaps(2, changed(control=AS_FOUND), without(OWN, limit.parameter), Mode.CSP))


def test_a_scale_that_the_profile_does_not_know_the_bench_file_may_state():
    torque = OWN.torque.model_copy(update={"rated_torque": None})
    encoder = OWN.encoder.model_copy(update={"increments": None, "revolutions": None})
    profile = OWN.model_copy(update={"torque": torque, "encoder": encoder})
    gaps = profile_gaps(2, TABLE, profile, Mode.CSP)
    assert [gap.rpartition(": ")[2] for gap in gaps] == [
        "state axis.2.encoder_counts_per_rev in the bench file",
        "state axis.2.rated_torque_nm in the bench file",
    ]
    assert profile_gaps(2, changed(encoder_counts_per_rev=4096, rated_torque_nm=1.27), profile, Mode.CSP) == []


def test_a_mode_that_the_drive_does_not_have_is_a_gap():
    gaps = profile_gaps(2, TABLE, Profile.load("novanta_eve"), Mode.CST)
    assert "axis 2: profile novanta_eve has no mode CST, in which the host closes the loop" in gaps


@pytest.mark.parametrize("name", [name for name in available() if Profile.load(name).kind == "drive"])
def test_of_every_profile_it_can_be_said_what_it_lacks(name):
    profile = Profile.load(name)
    for mode in (None, Mode.CSP, Mode.CST):
        for gap in profile_gaps(2, TABLE, profile, mode, with_notch=True):
            assert gap.startswith(f"axis 2: profile {name} has no ")
    assert len(scale_gaps(2, TABLE, profile)) <= 2
