"""In which mode a drive takes its set-points, and what its PDOs carry."""

import pytest

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from hil.master.drive.mapping import FEEDBACK, command, feedback, length, mode_of


@pytest.mark.parametrize(
    ("family", "loop", "name"),
    [
        ("emulated_drive", "drive", "CSP"),
        ("emulated_drive", "host", "CST"),
        ("technosoft_ipos", "drive", "CSP"),
        ("harmonic_drive_yukondrive", "drive", "IP"),
        ("maxon_epos2", "drive", "position mode (2062h)"),
        ("maxon_epos2", "host", None),
        ("novanta_eve", "host", None),
    ],
)
def test_a_drive_runs_in_the_best_mode_that_it_has(family, loop, name):
    mode = mode_of(loop, Profile.load(family))
    assert (None if mode is None else mode.name) == name


@pytest.mark.parametrize("family", ["harmonic_drive_yukondrive", "maxon_epos2"])
def test_a_mode_that_does_less_than_csp_says_what_it_loses(family):
    mode = mode_of("drive", Profile.load(family))
    assert mode.loss
    assert mode.target.kind is DataType.INTEGER32
    assert command(mode, with_torque_offset=True) == command(mode), "no torque offset but in CSP"


def test_a_drive_that_reports_no_torque_sends_its_current_in_the_same_place():
    sent = feedback(Profile.load("maxon_epos2"))
    assert (sent[2].index, length(sent)) == (0x6078, length(FEEDBACK))
    assert feedback(Profile.load("emulated_drive")) == FEEDBACK
