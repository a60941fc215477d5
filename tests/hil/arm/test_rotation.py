"""Rotations against scipy's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.arm.rotation import roll_pitch_yaw, rotation, turn


@pytest.mark.parametrize("angles", np.random.default_rng(1).uniform(-3.1, 3.1, (20, 3)))
def test_roll_pitch_and_yaw_turn_about_fixed_axes_in_this_order(angles):
    np.testing.assert_allclose(rotation(*angles), Rotation.from_euler("xyz", angles).as_matrix(), atol=1e-15)


@pytest.mark.parametrize("pitch", [0.3, 0.5 * np.pi, -0.5 * np.pi, 0.5 * np.pi - 1e-10, 2.8])
def test_a_rotation_has_roll_pitch_and_yaw_even_where_two_of_them_are_one(pitch):
    matrix = rotation(0.7, pitch, -1.2)
    np.testing.assert_allclose(rotation(*roll_pitch_yaw(matrix)), matrix, atol=1e-9)


@pytest.mark.parametrize("vector", np.random.default_rng(2).standard_normal((10, 3)))
def test_a_turn_about_an_axis_is_right_handed(vector):
    angle = float(np.linalg.norm(vector))
    np.testing.assert_allclose(turn(vector / angle, angle), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
