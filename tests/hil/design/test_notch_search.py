"""The space of filters, the score and the search, on an axis of the reference robot with little effort."""

import dataclasses
import math

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.design import notch_problem
from hil.design.notch_design import Judge, RequirementCheck, verdict
from hil.design.notch_problem import DesignRamp, Requirements, rises, speed_ranges
from hil.design.notch_search import PAPER_FILTERS, Effort, Space, search, workers
from hil.experiments.notch_problem import NotchDesignRequest, problem_of

BENCH = load_bench("reference")
TINY = Effort(population=8, generations=1, robust_population=5, robust_generations=1)


@pytest.fixture(scope="module")
def axis_2():
    return problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=0.0))


def table_3(axis):
    return BENCH.axis[axis].notch[0].notch()


@pytest.mark.parametrize("shape", ["switched", "trapezoid"])
def test_a_place_of_the_cube_and_its_filter_are_each_others(axis_2, shape):
    problem, f_al = axis_2
    space = Space.around(problem, 2, shape, f_al, Notch())
    assert space.dimensions == (7 if shape == "trapezoid" else 6)
    low, high = problem.window_rps(2)
    for place in np.random.default_rng(1).random((20, space.dimensions)):
        notch = space.notch(place)
        assert notch.start_rps <= low
        assert notch.end_rps >= high
        np.testing.assert_allclose(space.point(notch), place, atol=0.02)
    if shape == "switched":
        assert space.notch(space.point(table_3(2))) == table_3(2)


@pytest.mark.parametrize("f_al", [4.0, 11.84, 30.0])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_filters_that_are_tried_scale_with_the_robots_resonance(axis_2, f_al, order):
    windows = {order: (0.76 * f_al / order, 1.27 * f_al / order)}
    problem = dataclasses.replace(axis_2[0], ranges=speed_ranges(windows, 0.1 * f_al, 2.0 * f_al))
    template = Notch(hysteresis_rps=0.15, speed_lowpass_hz=4.2 * f_al)
    for shape in ("switched", "trapezoid"):
        space = Space.around(problem, order, shape, f_al, template)
        made = [space.notch(place) for place in (np.zeros(space.dimensions), np.ones(space.dimensions))]
        for notch in (*made, *space.starts(f_al)):
            assert 0.4 <= notch.start_rps * order / f_al <= 0.8
            assert 1.25 <= notch.end_rps * order / f_al <= 1.76
            assert notch.hysteresis_rps <= 0.05 * f_al / order + 1e-9
            assert notch.offset_hz <= 0.4 * f_al


def test_a_ramp_keeps_the_speed_limit_and_turns_without_a_jolt():
    ramp = DesignRamp.of(4.0, 2.0, 9.0, 12.0, 5.0, 250e-6, 1.0)
    speed = np.diff(ramp.reference_rad) / 250e-6 / (2.0 * np.pi)
    rate = np.diff(speed) / 250e-6
    assert speed.max() <= 9.0
    assert speed.max() == pytest.approx(9.0, abs=1e-3)
    assert ramp.top_rps < 9.0
    assert speed[-1] < 2.0
    turning = rate[round(ramp.rise_end_s / 250e-6) + 2 : round(ramp.fall_begin_s / 250e-6) - 2]
    assert turning[0] == pytest.approx(4.0, abs=0.01)
    assert turning[-1] == pytest.approx(-4.0, abs=0.01)
    assert np.abs(np.diff(turning)).max() < 0.01, "no step of the acceleration, which would ring at f_al"


@pytest.mark.ci
def test_what_breaks_a_limit_is_worse_than_anything_that_keeps_all(axis_2):
    problem, _ = axis_2
    judge = Judge(problem, 2)
    bare, paper = (problem.peaks_mm(problem.members[0], notches) for notches in ((), (table_3(2),)))
    expected = problem.weighted_mm(paper, 2) / problem.weighted_mm(bare, 2)
    assert judge.score(table_3(2)) == pytest.approx(expected, rel=1e-12)
    assert 0.5 < expected < 0.7
    deep = dataclasses.replace(table_3(2), zeta_rn=0.005, zeta_rdth=0.9)
    assert judge.score(deep) > 10.0
    strict = dataclasses.replace(problem, requirements=Requirements(max_sensitivity=1.4))
    assert 10.0 < Judge(strict, 2).score(table_3(2)) < 11.0


@pytest.mark.ci
def test_a_filter_of_one_order_that_raises_the_peak_of_another_is_seen(axis_2):
    """In the speeds of k = 2 it is the best that was found; on the way down it leaves k = 4 with twice its peak."""
    problem, _ = axis_2
    harmful = Notch(
        mode=NOTCH_TRAPEZOID, start_rps=3.565, end_rps=10.82, offset_hz=3.42, zeta_rn=0.027, zeta_rdth=0.2115,
        speed_lowpass_hz=7.93, ramp_rps=0.389,
    )  # fmt: skip
    bare, with_it = (problem.peaks_mm(problem.members[0], notches) for notches in ((), (harmful,)))
    assert with_it[1, problem.row(2)].max() < 0.5 * bare[1, problem.row(2)].max()
    fourth = next(rise for rise in rises(problem, bare, with_it) if rise.order == 4)
    assert fourth.ratio > 1.5
    loose = dataclasses.replace(problem, requirements=Requirements(1.75, 34.0))
    assert 2.0 < Judge(loose, 2).score(harmful) < 10.0
    missed = verdict(loose, (harmful,), (2,)).missed
    assert missed[0].name == "tip peak of k = 4 relative to that without a filter"
    assert not verdict(loose, (harmful,), (2,)).is_harmless


def test_the_verdict_agrees_with_the_score_and_names_what_binds(axis_2):
    problem, _ = axis_2
    found = verdict(problem, (table_3(2),), (2,))
    assert found.holds
    assert found.is_harmless
    assert found.missed == ()
    assert found.peak(2).worst_mm == problem.peaks_mm(problem.members[0], (table_3(2),))[0, problem.row(2)].max()
    assert [rate for rate, _ in found.peak(2).other_mm] == [2.0, 8.0]
    assert min(found.margins) == 0.0
    assert max(found.margins) == 12.0
    strict = dataclasses.replace(problem, requirements=Requirements(max_sensitivity=1.45, tip_mm=0.04))
    missed = verdict(strict, (table_3(2),), (2,)).missed
    assert {check.name for check in missed} == {"M_s", "tip peak on the ramp, k = 2,"}
    assert str(missed[0]) == "tip peak on the ramp, k = 2, 0.04605 mm (nominal), at most 0.04 mm required"
    assert verdict(dataclasses.replace(strict, requirements=Requirements(tip_mm=0.04)), (table_3(2),), (2,)).is_harmless


def test_a_search_starts_from_what_is_given_and_never_ends_with_less(axis_2):
    problem, f_al = axis_2
    shares = []
    found = search(problem, 2, ("switched",), f_al, effort=TINY, given=(table_3(2),), progress=shares.append)
    assert found.best.holds
    assert found.ratio <= Judge(problem, 2).score(table_3(2))
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0, abs=0.25)


def test_the_papers_filters_are_candidates_though_nobody_gives_them(axis_2):
    problem, f_al = axis_2
    assert table_3(2) in PAPER_FILTERS
    found = search(problem, 2, ("switched",), f_al, effort=Effort(5, 1, 5, 1))
    assert found.ratio <= Judge(problem, 2).score(table_3(2))


SOME = Effort(population=8, generations=4, robust_population=5, robust_generations=2)


@pytest.mark.ci
def test_scores_that_end_early_change_no_filter_and_spare_simulations(monkeypatch):
    problem, f_al = problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=5.0))
    simulated, follow_alike = [], notch_problem.follow_alike

    def counted(loops, *given, **named):
        simulated.extend(loops)
        return follow_alike(loops, *given, **named)

    monkeypatch.setattr(notch_problem, "follow_alike", counted)
    early, spared = search(problem, 2, ("switched",), f_al, effort=SOME), len(simulated)
    simulated.clear()
    scores = Judge.scores
    monkeypatch.setattr(
        Judge,
        "scores",
        lambda judge, notches, members=None: scores(judge, [(notch, math.inf) for notch, _ in notches], members),
    )
    whole = search(problem, 2, ("switched",), f_al, effort=SOME)
    assert early.best.notches == whole.best.notches
    assert early.scores == whole.scores
    assert spared < len(simulated)


@pytest.mark.ci
def test_a_score_that_ends_early_lies_between_its_limit_and_the_whole_one(axis_2):
    problem, f_al = axis_2
    judge, space = Judge(problem, 2), Space.around(problem, 2, "switched", f_al, Notch())
    for place in np.random.default_rng(3).random((6, space.dimensions)):
        notch = space.notch(place)
        whole = judge.score(notch)
        for at_most in (0.3, 0.6, 0.9, 1.5):
            found = judge.score(notch, at_most=at_most)
            assert found == whole or at_most < found <= whole


@pytest.mark.slow  # two more interpreters have to be started
def test_equal_seeds_give_equal_filters_in_this_process_and_in_two_others(axis_2):
    problem, f_al = axis_2
    alone = search(problem, 2, ("trapezoid",), f_al, effort=TINY)
    with workers(2) as pool:
        together = search(problem, 2, ("trapezoid",), f_al, effort=TINY, pool=pool)
    assert alone.best.notches == together.best.notches
    assert alone.best.notches[0].mode == NOTCH_TRAPEZOID


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"max_sensitivity": 1.0}, "max_sensitivity"),
        ({"phase_margin_deg": 90.0}, "phase_margin_deg"),
        ({"gain_margin_db": -1.0}, "gain_margin_db"),
        ({"tip_mm": float("nan")}, "tip_mm"),
    ],
)
def test_limits_that_make_no_sense_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        Requirements(**changes)


def test_a_check_knows_by_how_much_it_is_missed():
    ceiling = RequirementCheck("M_s", 1.87, 1.7, "", True, 5.25, "nominal")
    assert ceiling.violation == pytest.approx(0.1)
    assert str(ceiling) == "M_s 1.87 at 5.25 rev/s (nominal), at most 1.7 required"
    assert RequirementCheck("phase margin", 35.0, 35.0, "°", False, 5.0, "x").holds
    assert not RequirementCheck("phase margin", float("nan"), 35.0, "°", False, 5.0, "x").holds
