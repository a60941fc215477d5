"""Sums of waves near a grid angle, against numpy's cosine in extended precision."""

import math

import numpy as np
import pytest

from hil.core.library import CORE

LEFT_OUT = 0.5**13 / math.factorial(13)
"""What the polynomials leave out of an amplitude: 2.0e-14."""
DIGIT = 2.0**-53


@pytest.mark.ci
@pytest.mark.parametrize("orders", [(1, 2, 4), (1.0 / 120.0, 2), (0.5, 2, 3.25, 8), (math.sqrt(2.0), 72), (1e-9,)])
@pytest.mark.parametrize("away", [0.0, 0.3, 0.5, 0.999, 1.0, 40.0])
def test_sum_and_slope_are_those_of_cosine_and_sine_within_the_stated_bound(orders, away):
    """At any distance from the grid angle: within its reach, at its end, and beyond it, where another takes over."""
    source = np.random.default_rng(7)
    rows, near, found = np.zeros(len(orders), CORE.dtype("harmonic")), np.zeros(1, CORE.dtype("waves")), np.empty(2)
    given, waves, sums = (CORE.pointer(rows, "harmonic"), len(rows)), CORE.pointer(near, "waves"), CORE.pointer(found)
    for start in source.uniform(-400.0, 400.0, 200):
        rows["order"] = orders
        rows["cosine"], rows["sine"] = source.uniform(-1.0, 1.0, (2, len(orders)))
        CORE.call.begin_waves(*given, waves)
        assert near["spacing"][0] * max(orders) <= 0.5
        CORE.call.wave_sums(*given, start, waves, sums)
        angle = float(near["angle"][0] + away * near["spacing"][0])
        CORE.call.wave_sums(*given, angle, waves, sums)
        turned = np.longdouble(rows["order"]) * np.longdouble(angle)
        expected = np.sum(rows["cosine"] * np.cos(turned) - rows["sine"] * np.sin(turned))
        slope = -np.sum(rows["order"] * (rows["cosine"] * np.sin(turned) + rows["sine"] * np.cos(turned)))
        # the product of an order and the grid angle is rounded, and so is each of a few sums
        bounds = np.hypot(rows["cosine"], rows["sine"]) * (LEFT_OUT + DIGIT * (np.abs(np.float64(turned)) + 8.0))
        assert abs(found[0] - expected) <= np.sum(bounds)
        assert abs(found[1] - slope) <= np.sum(rows["order"] * bounds)


def test_an_angle_that_is_no_number_gives_none():
    rows, near, found = np.ones(1, CORE.dtype("harmonic")), np.zeros(1, CORE.dtype("waves")), np.empty(2)
    given, waves, sums = (CORE.pointer(rows, "harmonic"), 1), CORE.pointer(near, "waves"), CORE.pointer(found)
    CORE.call.begin_waves(*given, waves)
    for angle in (math.nan, math.inf, 1.0):
        CORE.call.wave_sums(*given, angle, waves, sums)
        assert bool(np.all(np.isfinite(found))) is (angle == 1.0)
