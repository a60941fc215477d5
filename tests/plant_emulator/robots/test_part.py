"""Part of a robot on a bench of its own, and drives that hold their gains from the start."""

import pytest

from plant_emulator.robots.robot import load_robot, part_of, with_drives
from plant_emulator.robots.tuning import load_tuning, tuned

ROBOT = load_robot("reference")


def test_an_axis_alone_has_no_line_motion_and_all_axes_keep_it():
    alone = part_of(ROBOT, [2])
    assert (list(alone.axis), alone.geometry, alone.line_motion) == ([2], None, None)
    assert part_of(ROBOT, ROBOT.axis) == ROBOT


def test_an_arm_whose_links_couple_its_axes_is_not_taken_apart():
    with pytest.raises(ValueError, match="links of this robot couple all axes"):
        part_of(load_robot("reference-arm"), [2])


def test_drives_hold_the_gains_of_a_tuning_file_from_the_start():
    tuning = load_tuning("reference")
    robot = tuned(with_drives(part_of(ROBOT, [2]), {2: "maxon_epos4"}), tuning.gains([2]))
    assert robot.axis[2].control == tuning.axis[2].control
    assert ROBOT.axis[2].control is None


def test_a_tuning_file_has_every_axis_that_a_robot_can_have(tmp_path):
    path = tmp_path / "tuning.toml"
    gains = {"position_gain_per_s": 25.0, "velocity_gain_nm_s_rad": 0.5, "velocity_integral_gain_nm_rad": 5.0}
    path.write_text("[axis.126.control]\n" + "".join(f"{key} = {value}\n" for key, value in gains.items()))
    assert load_tuning(path).gains([126])[126].position_gain_per_s == 25.0


def test_an_axis_without_gains_in_the_tuning_is_named():
    tuning = load_tuning("reference")
    without = tuning.model_copy(update={"axis": {2: tuning.axis[2]}})
    with pytest.raises(ValueError, match=r"no gains for axis 3; add axis\.3\.control"):
        without.gains(ROBOT.axis)
