"""Views are parallel projections without distortion, seen from where they say."""

import numpy as np
import pytest

from hil.report.projection import ABOVE, ANGLE, FRONT, SIDE, fullest

TOWARDS = {"side": (SIDE, [0, -1, 0]), "front": (FRONT, [1, 0, 0]), "above": (ABOVE, [0, 0, 1])}


@pytest.mark.parametrize("name", TOWARDS)
def test_a_view_along_an_axis_shows_the_two_others_with_the_viewer_where_its_title_says(name):
    view, viewer = TOWARDS[name]
    np.testing.assert_allclose(np.cross(view.right, view.up), viewer, atol=1e-12)
    right, up = view.flat(np.array([[1.0, 2.0, 3.0]]))
    shown = dict(zip("xyz", (1.0, 2.0, 3.0), strict=True))
    assert (right[0], up[0]) == (shown[view.names[0]], shown[view.names[1]])


def test_the_view_at_an_angle_distorts_nothing_and_looks_from_the_front_on_the_right_and_above():
    assert np.linalg.norm(ANGLE.right) == pytest.approx(np.linalg.norm(ANGLE.up)) == pytest.approx(1.0)
    assert ANGLE.right @ ANGLE.up == pytest.approx(0.0, abs=1e-12)
    x, y, z = np.cross(ANGLE.right, ANGLE.up)
    assert x > 0.0 > y
    assert z > 0.0
    assert ANGLE.up[2] > 0.0 == ANGLE.right[2]  # what is upright stays upright


@pytest.mark.parametrize(("vector", "view"), [((1.0, 0.1, 1.0), SIDE), ((0.1, 1.0, 1.0), FRONT), ((1.0, 1.0, 0.1), ABOVE)])
def test_the_fullest_view_hides_the_least_direction(vector, view):
    assert fullest(np.array([vector])) is view


def test_what_is_seen_from_several_sides_is_shown_from_the_side_or_from_above():
    assert fullest(np.array([[1.0, 0.0, 0.0]])) is SIDE
    assert fullest(np.array([[0.0, 1.0, 0.0]])) is ABOVE
    assert fullest(np.array([[0.5, 1.0, 0.6]])) is FRONT
