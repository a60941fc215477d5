"""The space of filters, the score and the search, on an axis of the reference robot with little effort."""

import dataclasses

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.design.notch_design import Judge, RequirementCheck, Requirements, verdict
from hil.design.notch_search import Effort, Space, search, workers
from hil.experiments.notch_design import NotchDesignRequest, problem_of

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
    assert space.dimensions == (6 if shape == "trapezoid" else 5)
    low, high = problem.windows_rps[2]
    for place in np.random.default_rng(1).random((20, space.dimensions)):
        notch = space.notch(place)
        assert notch.start_rps <= low
        assert notch.end_rps >= high
        np.testing.assert_allclose(space.point(notch), place, atol=0.02)
    if shape == "switched":
        assert space.notch(space.point(table_3(2))) == table_3(2)


def test_a_window_that_the_motion_does_not_pass_is_refused(axis_2):
    problem, f_al = axis_2
    slow = dataclasses.replace(problem, reference_rad=problem.reference_rad * 0.7)
    with pytest.raises(ValueError, match="the motion reaches 7"):
        Space.around(slow, 2, "switched", f_al, Notch())


def test_what_breaks_a_limit_is_worse_than_anything_that_keeps_all(axis_2):
    problem, _ = axis_2
    judge = Judge(problem, 2)
    assert judge.score(table_3(2)) == pytest.approx(0.0463, abs=0.001)
    deep = dataclasses.replace(table_3(2), zeta_rn=0.005, zeta_rdth=0.9)
    assert judge.score(deep) > 10.0
    strict = dataclasses.replace(problem, requirements=Requirements(max_sensitivity=1.4))
    assert 10.0 < Judge(strict, 2).score(table_3(2)) < 11.0


def test_the_verdict_agrees_with_the_score_and_names_what_binds(axis_2):
    problem, _ = axis_2
    found = verdict(problem, (table_3(2),), (2,))
    assert found.holds
    assert found.missed == ()
    assert found.peak(2).worst_mm == pytest.approx(Judge(problem, 2).score(table_3(2)), rel=1e-9)
    assert min(found.margins) == 0.0
    assert max(found.margins) == 12.0
    strict = dataclasses.replace(problem, requirements=Requirements(max_sensitivity=1.45, tip_mm=0.04))
    missed = verdict(strict, (table_3(2),), (2,)).missed
    assert {check.name for check in missed} == {"M_s", "tip peak on the ramp, k = 2,"}
    assert str(missed[0]) == "tip peak on the ramp, k = 2, 0.04628 mm (nominal), at most 0.04 mm asked"


def test_a_search_starts_from_what_is_given_and_never_ends_with_less(axis_2):
    problem, f_al = axis_2
    shares = []
    found = search(problem, 2, ("switched",), f_al, effort=TINY, given=(table_3(2),), progress=shares.append)
    assert found.best.holds
    assert found.best.peak(2).worst_mm <= verdict(problem, (table_3(2),), (2,)).peak(2).worst_mm
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0, abs=0.25)


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
    assert str(ceiling) == "M_s 1.87 at 5.25 rev/s (nominal), at most 1.7 asked"
    assert RequirementCheck("phase margin", 35.0, 35.0, "°", False, 5.0, "x").holds
    assert not RequirementCheck("phase margin", float("nan"), 35.0, "°", False, 5.0, "x").holds
