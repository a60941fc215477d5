"""A Gaussian estimate: Bayes' rule against weighted least squares."""

import numpy as np
import pytest

from hil.design.estimate import Estimate

PRIOR = Estimate.independent({"x": (1.0, 2.0), "y": (-3.0, 0.5), "z": (0.0, 1e3)})


def test_an_observation_is_weighed_as_least_squares_weighs_it() -> None:
    rng = np.random.default_rng(5)
    rows, values, variances = rng.normal(size=(7, 3)), rng.normal(size=7), rng.uniform(0.1, 2.0, 7)
    # the prior as three more observations
    all_rows = np.concatenate([rows, np.eye(3)])
    weight = 1.0 / np.sqrt(np.concatenate([variances, np.diag(PRIOR.covariance)]))
    wanted, *_ = np.linalg.lstsq(all_rows * weight[:, None], np.concatenate([values, PRIOR.mean]) * weight, rcond=None)
    found = PRIOR.observed(rows, values, variances)
    assert found.mean == pytest.approx(wanted)
    information = all_rows.T @ np.diag(weight**2) @ all_rows
    assert found.covariance @ information == pytest.approx(np.eye(3), abs=1e-9)
    assert found.standard_error("y") == pytest.approx(np.sqrt(np.linalg.inv(information)[1, 1]))


def test_observations_one_by_one_are_the_same_as_together() -> None:
    rows, values, variances = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, -2.0]]), np.array([0.3, 7.0]), np.array([0.2, 0.4])
    one_by_one = PRIOR
    for row, value, variance in zip(rows, values, variances, strict=True):
        one_by_one = one_by_one.observed(row[None], np.array([value]), np.array([variance]))
    together = PRIOR.observed(rows, values, variances)
    assert one_by_one.mean == pytest.approx(together.mean)
    assert one_by_one.covariance == pytest.approx(together.covariance, rel=1e-6, abs=1e-9)


def test_what_an_observation_does_not_concern_is_known_as_before() -> None:
    rng = np.random.default_rng(6)
    square = rng.normal(size=(3, 3))
    prior = Estimate(PRIOR.names, PRIOR.mean, square @ square.T)
    row, value, variance = np.array([[1.0, 1.0, 0.0]]), np.array([2.0]), np.array([0.1])
    found = prior.observed(row, value, variance, only=("x", "y"))
    assert found.value("z") == prior.value("z")
    assert found.standard_error("z") == pytest.approx(prior.standard_error("z"))
    whole = prior.observed(row, value, variance)
    assert found.mean[:2] == pytest.approx(whole.mean[:2])
    assert found.covariance[:2, :2] == pytest.approx(whole.covariance[:2, :2])
    # drawn from the prior, the errors scatter as stated
    truth = rng.multivariate_normal(prior.mean, prior.covariance, 200_000)
    seen = truth @ row[0] + rng.normal(0.0, np.sqrt(0.1), len(truth))
    gain = (found.mean - prior.mean) / (value[0] - row[0] @ prior.mean)
    errors = prior.mean + np.outer(seen - row[0] @ prior.mean, gain) - truth
    assert np.cov(errors.T) == pytest.approx(found.covariance, abs=0.02 * np.max(found.covariance))


def test_a_replaced_quantity_is_independent_of_the_others() -> None:
    observed = PRIOR.observed(np.array([[1.0, 1.0, 1.0]]), np.array([2.0]), np.array([0.1]))
    replaced = observed.replaced("y", 4.0, 0.25)
    assert (replaced.value("y"), replaced.standard_error("y")) == (4.0, 0.25)
    assert not replaced.covariance[1, [0, 2]].any()
    assert replaced.value("x") == observed.value("x")
    assert observed.covariance[1, 0] != 0.0, "the first one is as it was"


def test_another_marginal_of_one_quantity_is_that_of_another_prior_of_it() -> None:
    """x is 0 or 1, one as likely as the other: the mixture of the two posteriors, by Bayes' rule for each."""
    rows, values, variances = np.array([[1.0, 1.0, 0.0], [0.3, -1.0, 1.0]]), np.array([-2.2, 2.6]), np.array([0.1, 0.2])
    either = [PRIOR.replaced("x", at, 1e-6).observed(rows, values, variances) for at in (0.0, 1.0)]
    off = [values - rows @ PRIOR.replaced("x", at, 1e-6).mean for at in (0.0, 1.0)]
    spread = rows @ PRIOR.replaced("x", 0.0, 1e-6).covariance @ rows.T + np.diag(variances)
    odds = np.exp([-0.5 * each @ np.linalg.solve(spread, each) for each in off])
    share = odds / odds.sum()
    assert 0.05 < share[0] < 0.95
    mean = sum(part * each.mean for part, each in zip(share, either, strict=True))
    square = sum(part * (each.covariance + np.outer(each.mean, each.mean)) for part, each in zip(share, either, strict=True))
    found = PRIOR.observed(rows, values, variances).with_marginal("x", share[1], np.sqrt(share[0] * share[1]))
    assert found.mean == pytest.approx(mean, rel=1e-5)
    assert found.covariance == pytest.approx(square - np.outer(mean, mean), rel=1e-4, abs=1e-6)


def test_what_is_known_of_one_quantity_tells_those_whose_errors_correlate_with_its_own() -> None:
    joined = PRIOR.correlated(["z", "x"], np.array([[7.0, 0.8 * 2.0 * 1e3], [0.8 * 2.0 * 1e3, 7.0]]))
    assert np.diag(joined.covariance) == pytest.approx(np.diag(PRIOR.covariance)), "the variances stay"
    assert joined.correlation == pytest.approx(np.array([[1.0, 0.0, 0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 1.0]]))
    found = joined.observed(np.array([[0.0, 0.0, 1.0]]), np.array([500.0]), np.array([1e-9]))
    assert found.value("x") == pytest.approx(1.0 + 0.8 * 2.0 * 0.5)
    assert found.standard_error("x") == pytest.approx(2.0 * 0.6)
    assert found.value("y") == PRIOR.value("y")


def test_a_part_of_an_estimate_has_its_quantities_in_the_order_that_is_asked_for() -> None:
    joined = PRIOR.correlated(["x", "y"], np.full((2, 2), 0.3)).part(["y", "x"])
    assert joined.names == ("y", "x")
    assert joined.mean.tolist() == [-3.0, 1.0]
    assert joined.covariance.tolist() == [[0.25, 0.3], [0.3, 4.0]]


def test_a_quantity_without_an_error_correlates_with_none() -> None:
    assert Estimate.independent({"x": (1.0, 0.0), "y": (2.0, 1.0)}).correlation == pytest.approx(np.eye(2))


def test_a_correlation_of_quantities_that_are_nearly_the_same_stays_one() -> None:
    """Three quantities that are one, whose covariance rounding has left with an eigenvalue below 0."""
    covariance = np.ones((3, 3)) + 1e-3 * np.array([[0.0, 1.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
    assert np.linalg.eigvalsh(covariance).min() < -1e-4
    found = Estimate(("x", "y", "z"), np.zeros(3), covariance).correlation
    assert np.linalg.eigvalsh(found).min() > -1e-12
    assert np.diag(found) == pytest.approx(np.ones(3))
    assert found == pytest.approx(covariance, abs=3e-3)
