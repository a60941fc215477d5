"""Trial of designed filters: what raises the tip's peak in a window, or lowers it in none, is not used."""

import itertools
import math
import re
from collections.abc import Sequence

import numpy as np
import pytest

from hil.analysis import tip_scale
from hil.bench.bench import load_bench
from hil.experiments.decision import MOST_RUNS, RISK
from hil.experiments.filter_trial import at_rest, start_angles_rad, starting_at, try_filters
from hil.experiments.motions import constant_acceleration
from hil.experiments.peaks import PeakChange
from hil.recording import Recording
from hil.results.runs import FilterTrial
from hil.robot_tables import ORDERS

PERIOD_S, F_AL_HZ = 0.002, 11.8


def ramp(sizes: dict[float, float], noise: float, seed: int) -> Recording:
    """A ramp on which each order rings at its resonance, in m/s², and the sensor's noise."""
    time = np.arange(1500) * PERIOD_S
    angle = 2.0 * np.pi * 0.5 * 4.0 * time**2
    tip = noise * np.random.default_rng(seed).standard_normal(len(time))
    for order, size in sizes.items():
        tip += size * np.exp(-((4.0 * time - F_AL_HZ / order) ** 2)) * np.cos(order * angle)
    return Recording({"time_s": time, "axis2_position_rad": angle, "tip_z_m_s2": tip})


def tried(
    without: dict[float, float],
    with_it: dict[float, float],
    noise: float = 0.001,
    first_seed: int = 0,
    orders: tuple[float, ...] = (),
) -> FilterTrial:
    runs = itertools.count(first_seed)
    scale = tip_scale(F_AL_HZ)

    def run(acts: bool) -> Recording:
        return ramp(with_it if acts else without, noise, next(runs))

    return try_filters(load_bench("reference"), scale, [run], orders)


Sizes = dict[float, float]


def tried_from(starts: list[tuple[Sizes, Sizes]], noise: float = 0.001) -> FilterTrial:
    """A trial from several start angles: the orders' sizes without and with the filters from each."""
    seeds = itertools.count()
    runs = [lambda acts, pair=pair: ramp(pair[acts], noise, next(seeds)) for pair in starts]
    return try_filters(load_bench("reference"), tip_scale(F_AL_HZ), runs)


GOOD: tuple[Sizes, Sizes] = ({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.3})
RAISED: tuple[Sizes, Sizes] = ({2: 1.0, 4: 0.2}, {2: 0.5, 4: 0.22})


def test_filters_that_raise_an_order_from_one_start_alone_are_refused() -> None:
    assert tried_from([GOOD, GOOD, GOOD]).is_good
    trial = tried_from([GOOD, RAISED, GOOD])
    assert not trial.is_good
    assert trial.runs == 2, "the start that has decided is the last"
    assert "in the window of order 4 rises" in trial.words
    assert [peak.order for peak in trial.peaks].count(4) == 1, "each window once, from its worst start"
    peak = next(peak for peak in trial.peaks if peak.order == 4)
    assert peak.after_mm / peak.before_mm == pytest.approx(1.1, abs=0.02)


def test_what_noise_hides_is_run_again_from_each_start() -> None:
    assert tried_from([({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.28})] * 4, noise=0.05).runs > 4


def test_from_start_to_start_every_order_turns_and_the_highest_by_quarters() -> None:
    turned = {order: sorted(round(math.degrees(order * each) % 360.0, 1) for each in start_angles_rad()) for order in ORDERS}
    assert turned[max(ORDERS)] == [0.0, 90.0, 180.0, 270.0]
    for order, phases in turned.items():
        gaps = np.diff([*phases, phases[0] + 360.0])
        assert max(gaps) <= 135.0, f"order {order:g}: {phases}"


def test_runs_that_are_compared_start_at_one_angle_wherever_the_axis_stands() -> None:
    motion = constant_acceleration(load_bench("reference"), 2, PERIOD_S)
    for stands_rad in (0.0, 0.0275, -1.0):
        assert stands_rad + starting_at(motion, 2.0, stands_rad).motor_angle_rad[0, 0] == pytest.approx(2.0)


def test_a_trial_waits_until_the_ringing_of_a_soft_arm_has_decayed() -> None:
    bench = load_bench("reference")
    model = bench.axis[2].model
    assert model is not None
    soft = model.model_copy(update={"gear_stiffness_nm_rad": 0.1 * model.gear_stiffness_nm_rad})
    axes = {2: bench.axis[2].model_copy(update={"model": soft}), 3: bench.axis[3].model_copy(update={"model": None})}
    on_soft = at_rest(bench.model_copy(update={"axis": axes}), (2, 3)).settle_s
    assert on_soft > 2.0 * bench.settle_s
    assert at_rest(bench, (2,)).settle_s == bench.settle_s, "an arm of 11.8 Hz is at rest by then"
    assert at_rest(bench.model_copy(update={"axis": axes}), (3,)).settle_s == bench.settle_s, "nothing is known of it"


def test_filters_that_lower_an_order_are_used() -> None:
    trial = tried({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.3})
    assert (trial.is_good, trial.words, trial.runs) == (True, "", 1)


def test_filters_that_raise_an_order_are_refused_though_another_falls() -> None:
    trial = tried({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.4})
    assert not trial.is_good
    assert "in the window of order 4 rises" in trial.words
    assert trial.peaks[0].order == 4


def test_filters_that_do_nothing_are_refused() -> None:
    trial = tried({2: 1.0, 4: 0.3}, {2: 0.99, 4: 0.3})
    assert not trial.is_good
    assert "in any window" in trial.words


def test_what_the_noise_may_hide_is_run_again_for_the_mean() -> None:
    assert 1 < tried({2: 1.0, 4: 0.3}, {2: 1.0, 4: 0.33}, noise=0.1).runs <= MOST_RUNS


@pytest.mark.parametrize("raised", [1.0, 1.04])
def test_a_rise_of_less_than_a_twentieth_is_no_harm(raised: float) -> None:
    assert tried({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.3 * raised}).is_good


def test_a_rise_at_the_foot_of_an_order_that_the_ramp_does_not_pass_is_a_harm_only_above_all_that_was_there() -> None:
    # a ramp to 10 rev/s, where order 1 would meet f_al at 11.8: its window begins at 9, where order 2 has long been through
    low, high = ({2: 1.0, 4: 0.3, 1.25: foot} for foot in (0.2, 0.3))
    assert tried(low, {**high, 2: 0.5}).is_good
    refused = tried(low, {**low, 2: 0.5, 1.25: 1.4})
    assert not refused.is_good
    assert "in the window of order 1 rises" in refused.words


@pytest.mark.ci
def test_a_rise_that_the_noise_hides_in_one_run_is_not_accepted() -> None:
    """The standard error of one pair of runs is as large as the rise beyond what is no harm."""
    trials = [tried({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.37}, noise=0.13, first_seed=10 * seed) for seed in range(40)]
    errors = [trial.peaks[0].error_mm * np.sqrt(trial.runs) * (2.0 * np.pi * F_AL_HZ) ** 2 / 1e3 for trial in trials]
    assert np.median(errors) == pytest.approx(0.055, rel=0.2), "m/s²: a rise of 0.07, of which 0.015 would be no harm"
    assert sum(trial.is_good for trial in trials) <= 2


@pytest.mark.parametrize("order", [3.0, 2.9])
def test_every_order_that_the_gear_has_is_looked_at_where_it_meets_f_al(order: float) -> None:
    without, with_it = {2: 0.3, order: 1.0, 4: 0.1}, {2: 0.15, order: 1.5, 4: 0.1}
    trial = tried(without, with_it, orders=(2.0, order, 4.0))
    assert not trial.is_good
    found = re.search(rf"window of order {order:g} rises from (\S+) to (\S+) ± \S+ mm", trial.words)
    assert found is not None
    to_mm = 1e3 / (2.0 * np.pi * F_AL_HZ) ** 2
    assert [float(each) for each in found.groups()] == pytest.approx([1.0 * to_mm, 1.5 * to_mm], rel=0.1)


def test_a_rise_that_no_run_decides_is_not_risked() -> None:
    """Measured as 3 % after the last run, where 5 % would be a harm: 0.005 beyond is two standard errors away, or one."""
    trials = [tried({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.31}, noise=0.1, first_seed=20 * seed) for seed in range(40)]
    for trial in trials:
        peak = next(each for each in trial.peaks if each.order == 4)
        change = PeakChange(peak.order, peak.before_mm, peak.after_mm, peak.error_mm)
        assert trial.is_good == (change.rises.probability < RISK)
    undecided = [trial.words for trial in trials if "has a probability of" in trial.words]
    wanted = re.compile(r"a rise by more than 0\.00\d+ mm has a probability of [1-5]\d %; the motion")
    assert undecided
    assert all(wanted.search(words) for words in undecided)


@pytest.mark.parametrize(("rises", "is_good"), [((-0.08, -0.03, 0.0, 0.04), False), ((-0.01, 0.0, 0.0, 0.01), True)])
def test_filters_are_refused_if_another_start_would_too_probably_raise_an_order(rises: Sequence[float], *, is_good: bool) -> None:
    """The first are those of order 4 of a drawn robot, 51370: at a fifth angle its tip rose by 5.6 %."""
    trial = tried_from([({2: 1.0, 4: 0.3}, {2: 0.5, 4: 0.3 * (1.0 + each)}) for each in rises])
    assert trial.is_good is is_good
    if not is_good:
        assert re.search(r"the tip's peak in the window of order 4 changes by -8 to \+4 % with the motor angle", trial.words)
        assert re.search(r"from another one a rise by more than 0\.00\d+ mm has a probability of 1\d %", trial.words)
