"""The robot file's tables of a gear that changes: what is contradictory is refused with its values."""

import pytest

from drive_profiles.errors import FileError
from plant_emulator.robots.robot import load_robot
from tests.plant_emulator.many_axes import robot_file

REFUSED = {
    "phase_step_deg = 30.0": "phase_step_deg or phase_step_s is missing",
    "phase_step_s = 3.0": "phase_step_deg or phase_step_s is missing",
    "order = 3\nphase_drift_deg_min = 1.0": "order 3 changes, but ate has no such order; it has 2",
    "phase_drift_deg_min = 1.0\n[[axis.2.ate_change]]\nload_deg_nm = 1.0": "the line without order is given twice",
    "order = 2\n[[axis.2.ate_change]]\norder = 2.0": "order 2 is given twice",
    "load_percent_nm = 1.0\ndirection_percent = -5": "at the gear's 380 N·m and direction_percent -5 make 385 %",
    "growth_percent_h = -1.0": "growth_percent_h",
    "phase_drift_deg_min = nan": "phase_drift_deg_min",
}


@pytest.mark.parametrize("lines", REFUSED)
def test_changes_that_contradict_are_refused_with_their_values(tmp_path, lines):
    (tmp_path / "robot.toml").write_text(robot_file([2], more=f"[[axis.2.ate_change]]\n{lines}\n"))
    with pytest.raises(FileError) as refused:
        load_robot(tmp_path / "robot.toml")
    assert REFUSED[lines] in str(refused.value)


def test_an_order_of_more_changes_as_well(tmp_path):
    text = robot_file([2], more="[[axis.2.ate_change]]\norder = 3\nphase_drift_deg_min = 1.0\n")
    text = text.replace("ate = { ", "ate = { more = [{ order = 3, a_arcsec = 2.0 }], ")
    (tmp_path / "robot.toml").write_text(text)
    assert load_robot(tmp_path / "robot.toml").axis[2].ate_change[0].order == 3
