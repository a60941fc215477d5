"""What is known of orders of axes, and what another pace adds to it."""

import numpy as np

from hil.design.probing import ProbedStep
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.probing.pace import KnownSettings

FIRST, SECOND, THIRD = Part(2, 2), Part(2, 4), Part(3, 2)


def known() -> KnownSettings:
    return KnownSettings((FIRST, SECOND), np.array([1.0, 2.0, 3.0, 4.0]), np.diag([1.0, 2.0, 3.0, 4.0]), np.full(4, 0.9))


def test_an_order_that_only_another_pace_shows_is_spread_as_any() -> None:
    more = known().with_others((SECOND, THIRD), 30.0)
    assert more.parts == (FIRST, SECOND, THIRD)
    np.testing.assert_array_equal(more.vector, [1.0, 2.0, 3.0, 4.0, 0.0, 0.0])
    np.testing.assert_array_equal(np.diag(more.covariance), [1.0, 2.0, 3.0, 4.0, 900.0, 900.0])
    np.testing.assert_array_equal(more.seen, [0.9, 0.9, 0.9, 0.9, 0.0, 0.0])


def test_a_step_changes_the_orders_that_the_pace_shows_and_no_other() -> None:
    covariance = np.array([[0.5, 0.1], [0.1, 0.6]])
    step = ProbedStep(np.array([0.5, -0.5]), covariance, np.array([1.0, 0.2]), np.zeros((3, 9)), 2)
    after = known().changed((SECOND,), step, covariance)
    np.testing.assert_array_equal(after.vector, [1.0, 2.0, 3.5, 3.5])
    np.testing.assert_array_equal(after.covariance[:2, :2], np.diag([1.0, 2.0]))
    np.testing.assert_array_equal(after.covariance[2:, 2:], covariance)
    np.testing.assert_array_equal(after.seen, [0.9, 0.9, 1.0, 0.9])
    np.testing.assert_array_equal(known().vector, [1.0, 2.0, 3.0, 4.0])
