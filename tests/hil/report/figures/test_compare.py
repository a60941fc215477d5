"""Figures of a comparison: labels that can be read, and colours that mean one thing."""

import pytest

from hil.report import style
from hil.report.pages import compare


@pytest.mark.parametrize(
    ("peak", "side"), [(0.002, "left"), (0.03, "center"), (0.046, "right"), (0.05, "right"), (0.052, "left")]
)
def test_a_label_lies_on_neither_the_axis_nor_the_limit(peak, side):
    assert compare._side(peak, 0.05, 0.006)[0] == side


def test_no_treatment_has_the_colour_of_outside():
    assert all(look["color"] != style.VERMILLION for look in style.OVERLAY_LINES)
    assert len({look["color"] for look in style.OVERLAY_LINES}) == len(style.OVERLAY_LINES)
