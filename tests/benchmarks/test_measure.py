"""Whether contenders have found the same: a bound, and what breaks it."""

import math

import numpy as np
import pytest

from benchmarks.measure import DisagreementError, agreed, apart


def test_a_difference_within_its_bound_is_handed_on():
    assert agreed("C", 1e-9, 1e-9) == 1e-9


@pytest.mark.parametrize("difference", [1.1e-9, math.inf, math.nan])
def test_a_difference_that_is_not_within_its_bound_is_an_error(difference):
    with pytest.raises(DisagreementError) as caught:
        agreed("C, 3 axes", difference, 1e-9)
    assert (caught.value.contender, caught.value.bound) == ("C, 3 axes", 1e-9)
    assert str(caught.value) == f"C, 3 axes: its result differs by {difference:.3g}, the bound is 1e-09"


def test_apart_is_the_largest_difference():
    assert apart([1.0, 2.0, 3.0], [1.0, 2.5, 2.9]) == 0.5
    assert apart([], []) == 0.0


def test_equal_infinities_are_not_apart_and_others_are():
    assert apart([math.inf, -math.inf], [math.inf, -math.inf]) == 0.0
    assert apart([math.inf], [1.0]) == math.inf


def test_what_is_not_a_number_is_never_equal():
    assert math.isnan(apart([1.0, math.nan], [1.0, math.nan]))
    assert math.isnan(apart([1.0, 2.0], [1.0, math.nan]))


def test_results_of_another_shape_are_infinitely_far_apart():
    assert apart(np.zeros(3), np.zeros(4)) == math.inf
