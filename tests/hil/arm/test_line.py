"""The line motion of an arm's tables: which axes it moves, and how the tool is to point."""

import math

import numpy as np
import pytest

from drive_profiles.files.toml import loads
from hil.arm.kinematics import Kinematics
from hil.arm.line import arm_line
from hil.arm.rotation import rotation
from hil.arm.straight_line import LineError
from hil.arm.tables import ArmTable
from hil.robot_tables import LineMotion
from tests.hil.arm.reference import ARM

BASE = "[[link]]\naxis = 1\ndirection = [0.0, 0.0, 1.0]\n"
TEXT = ARM.replace("[arm]\n", "").replace("arm.link", "link").replace("home_deg = [", "home_deg = [0.0, ")
FOUR = loads(TEXT.replace("[[link]]", BASE + "[[link]]", 1), ArmTable)


def motion(text: str) -> LineMotion:
    return loads(f"start_m = {{ x = 0.5, z = 0.45 }}\n{text}\nduration_s = 2.2\n", LineMotion)


@pytest.mark.ci
def test_axes_that_a_line_does_not_turn_are_no_part_of_it():
    assert arm_line(FOUR, motion("end_m = { x = 0.7, z = 0.45 }")).axes == (2, 3, 5)
    line = arm_line(FOUR, motion('end_m = { x = 0.5, y = 0.2, z = 0.45 }\norientation = "free"'))
    assert line.axes == (1, 2, 3, 5)
    assert line.turned(np.array([0.0, 3.0])).shape == (2, 4)


def test_a_line_that_turns_the_base_cannot_keep_the_tools_direction_with_four_axes():
    with pytest.raises(LineError, match="in the required direction"):
        arm_line(FOUR, motion("end_m = { x = 0.5, y = 0.2, z = 0.45 }")).turned(np.zeros(1))


def test_the_tools_direction_is_given_by_roll_pitch_and_yaw():
    kinematics = Kinematics.of(FOUR)
    _, home = kinematics.pose(FOUR.home_rad())
    assert np.allclose(home, rotation(0.0, 0.5 * math.pi, 0.0), rtol=0.0, atol=1e-12)  # the tool's x points down
    line = arm_line(FOUR, motion("end_m = { x = 0.6, z = 0.5 }\nend_rpy_deg = [0.0, 60.0, 0.0]")).line
    _, frames = kinematics.pose(line.angles(np.array([0.0, 0.5, 1.0])))
    for frame, pitch_deg in zip(frames, (90.0, 75.0, 60.0), strict=True):
        assert np.allclose(frame, rotation(0.0, math.radians(pitch_deg), 0.0), rtol=0.0, atol=1e-7)


def test_a_line_without_length_is_refused():
    with pytest.raises(LineError, match="start_m and end_m are equal"):
        arm_line(FOUR, motion("end_m = { x = 0.5, z = 0.45 }"))
