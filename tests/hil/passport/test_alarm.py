"""Alarms on change: how often they are wrong, over thousands of histories, and how soon they are right."""

import math

import numpy as np
import pytest
from scipy import stats

from hil.passport.alarm import AlarmLimits, cumulative, unwound_deg, watched
from hil.passport.conditions import RunCondition, design_of, no_design
from hil.passport.regression import FEWEST_BEFORE, expected

RATE, SERIES, RUNS, HISTORIES = 1e-3, 6, 40, 2000


def scores(values, errors, design=None):
    """Normal scores of runs against those before them; shape (..., n)."""
    return expected(values, errors, no_design(values.shape[-1]) if design is None else design).scores(values)


def first_alarms(values, errors, limits, design=None):
    """Index of the first alarm of each history; the number of runs where there is none."""
    score = scores(values, errors, design)
    score[..., :FEWEST_BEFORE] = 0.0
    beyond = (np.abs(np.nan_to_num(score)) > limits.jump) | (cumulative(score) > limits.creep)
    return np.where(beyond.any(axis=-1), beyond.argmax(axis=-1), values.shape[-1])


def false_rate(values, errors, limits, design=None):
    """Alarms over watched runs, of histories in which nothing changes."""
    first = first_alarms(values, errors, limits, design)
    watched_runs = np.minimum(first + 1, values.shape[-1]) - FEWEST_BEFORE
    return np.count_nonzero(first < values.shape[-1]) / watched_runs.sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spread", "own"),
    [
        ("scatter from run to run", 0.04, 0.004),
        ("own errors alone", 0.0, 0.02),
        ("both", 0.02, 0.02),
        ("too small errors", 0.03, 0.0),
    ],
)
def test_false_alarms_are_below_one_in_a_thousand_runs_of_a_gear(name, spread, own):
    """2000 histories of 40 runs, six series a gear: the bound holds for a gear, so a sixth of it for each series."""
    rng = np.random.default_rng(len(name))
    errors = np.full((HISTORIES, RUNS), own)
    values = 1.0 + rng.normal(0.0, math.hypot(spread, own), errors.shape)
    assert SERIES * false_rate(values, errors, AlarmLimits.of(RATE, SERIES)) < RATE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "spread", "too_small"),
    [((0.01, 0.03), 0.01, 1.0), ((0.001, 0.1), 0.003, 1.0), ((0.01, 0.03), 0.03, 1.0), ((0.01, 0.03), 0.01, 1.5)],
)
def test_runs_that_are_less_sure_than_others_raise_no_more_false_alarms(own, spread, too_small):
    """Also where all standard errors are too small by half."""
    rng = np.random.default_rng(3)
    errors = rng.choice(own, (HISTORIES, RUNS))
    values = 1.0 + rng.normal(0.0, np.hypot(too_small * errors, spread))
    assert SERIES * false_rate(values, errors, AlarmLimits.of(RATE, SERIES)) < RATE


def conditions(rng, runs):
    """Runs of different warmth, loads and directions, as they come; and what these do to an amplitude."""
    warmth, load, way = rng.uniform(15.0, 35.0, runs), rng.choice([0.0, 3.0, 6.0], runs), rng.choice([-1, 1], runs)
    made = [RunCondition(t, kg, None, int(side)) for t, kg, side in zip(warmth, load, way, strict=True)]
    return design_of(made), 0.003 * (warmth - 20.0) + 0.03 * load + 0.05 * way


@pytest.mark.slow
def test_changes_that_temperature_load_and_direction_explain_are_no_alarms_and_the_same_unexplained_are():
    rng, limits = np.random.default_rng(4), AlarmLimits.of(RATE, SERIES)
    design, effect = conditions(rng, RUNS)
    errors = np.full((500, RUNS), 0.004)
    values = 1.0 + effect + rng.normal(0.0, 0.01, errors.shape)
    assert SERIES * false_rate(values, errors, limits, design) < 2.0 * RATE, "no more than 3 in 17,500 runs of a series"
    values[:, -1] *= 1.2
    assert np.mean(first_alarms(values, errors, limits, design) == RUNS - 1) > 0.95
    assert np.mean(first_alarms(values, errors, limits) == RUNS - 1) < 0.5, "without the conditions it is lost in their scatter"


def test_a_page_can_say_how_much_of_the_scatter_a_condition_explains():
    rng = np.random.default_rng(6)
    design, effect = conditions(rng, RUNS)
    found = watched(5.0 * (1.0 + effect) + rng.normal(0.0, 0.02, RUNS), np.full(RUNS, 0.02), AlarmLimits.of(RATE, SERIES), design)
    assert found.first is None
    assert found.explained["load"] > 0.4
    assert found.scatter < 0.04
    assert sum(found.explained.values()) < 1.3


def test_a_run_beyond_all_conditions_of_those_before_is_expected_with_less_certainty():
    """10 K more than ever may change an amplitude by a tenth: 5 % are no alarm there, and one where they were all the time."""
    values = np.array([5.0, 5.01, 4.99, 5.0, 5.01, 5.0, 4.99, 5.25])
    errors, limits = np.full(8, 0.01), AlarmLimits.of(RATE, 1)
    warm = design_of([RunCondition(22.0)] * 7 + [RunCondition(32.0)])
    assert watched(values, errors, limits, warm).first is None
    assert watched(values, errors, limits, design_of([RunCondition(22.0)] * 8)).first == 7


def test_a_run_added_later_changes_no_score_before_it():
    rng = np.random.default_rng(8)
    made = [RunCondition(t, kg) for t, kg in zip(rng.uniform(15.0, 35.0, 12), rng.choice([0.0, 3.0, 6.0], 12), strict=True)]
    values, errors = rng.normal(5.0, 0.1, 12), np.full(12, 0.05)
    whole = scores(values, errors, design_of(made))
    part = scores(values[:9], errors[:9], design_of(made[:9]))
    assert whole[FEWEST_BEFORE:9] == pytest.approx(part[FEWEST_BEFORE:], abs=1e-6)


@pytest.mark.slow
def test_without_a_change_scores_are_normal_and_independent():
    score = scores(np.random.default_rng(5).normal(2.0, 0.3, (4000, 12)), np.zeros((4000, 12)))[:, FEWEST_BEFORE:]
    assert stats.kstest(score.ravel(), "norm").pvalue > 1e-3
    together = np.corrcoef(score.T) - np.eye(score.shape[1])
    assert np.max(np.abs(together)) < 5.0 / math.sqrt(len(score))


@pytest.mark.slow
def test_a_jump_beyond_the_scatter_is_alarmed_at_once():
    rng, limits = np.random.default_rng(9), AlarmLimits.of(RATE, SERIES)
    values = rng.normal(10.0, 0.2, (2000, 20))
    values[:, 19] *= 1.2
    assert np.mean(first_alarms(values, np.full(values.shape, 0.05), limits) == 19) > 0.95


def test_errors_that_are_the_same_in_every_run_hide_no_wear():
    """Standard errors of 5 %, runs that are alike to 0.6 %, and a growth of 0.5 % from run to run: told before it is a tenth."""
    rng = np.random.default_rng(8)
    grown = []
    for _ in range(20):
        values = 5.0 * (1.0 + 0.006 * rng.standard_normal(30))
        values[10:] *= 1.0 + 0.005 * np.arange(1, 21)
        first = watched(values, np.full(30, 0.25), AlarmLimits.of(1e-3, series=6)).first
        assert first is not None
        grown.append(0.005 * (first - 9))
    assert min(grown) > 0.0
    assert max(grown) < 0.1


@pytest.mark.slow
def test_wear_of_a_fifth_is_alarmed_on_its_way_where_runs_scatter_by_four_per_cent():
    """As a real robot's do; A grows by 1 % a run after 20 runs."""
    rng, limits = np.random.default_rng(11), AlarmLimits.of(RATE, SERIES)
    wear = 1.0 + 0.01 * np.maximum(0.0, np.arange(41) - 20)
    values = wear * rng.normal(7.2, 0.04 * 7.2, (2000, 41))
    assert np.mean(first_alarms(values, np.full(values.shape, 0.2), limits) <= 40) > 0.9


def test_an_alarm_stands_from_its_first_run_on_and_tells_the_mean_before():
    values = np.array([5.0, 5.1, 4.9, 5.0, 5.05, 4.95, 5.0, 6.4, 5.0, 5.0])
    found = watched(values, np.full(10, 0.1), AlarmLimits.of(RATE, SERIES))
    assert found.first == 7
    assert found.expected == pytest.approx(5.0, abs=0.01)
    assert found.scatter == pytest.approx(np.std(values[:7], ddof=1))


def test_too_few_runs_are_not_watched():
    found = watched(np.array([5.0, 5.0, 5.0, 5.0, 50.0]), np.full(5, 0.1), AlarmLimits.of(RATE, 1))
    assert found.first is None
    assert np.isnan(found.score).all()


def test_equal_runs_without_errors_are_no_alarm_and_another_is():
    assert watched(np.full(12, 5.0), np.zeros(12), AlarmLimits.of(RATE, 1)).first is None
    assert watched(np.array([5.0] * 8 + [5.1]), np.zeros(9), AlarmLimits.of(RATE, 1)).first == 8


def test_a_limit_of_many_series_is_wider():
    one, many = AlarmLimits.of(RATE, 1), AlarmLimits.of(RATE, 40)
    assert many.jump > one.jump
    assert many.creep > one.creep
    with pytest.raises(ValueError, match="a rate above 0"):
        AlarmLimits.of(0.5, 1)


def test_phases_do_not_jump_by_a_turn():
    assert unwound_deg(np.array([359.0, 1.0, 358.0, 3.0])) == pytest.approx([-1.0, 1.0, -2.0, 3.0])
    assert unwound_deg(np.array([])).shape == (0,)
