"""The fast margins against the slow ones, their speeds, plants and filters mixed; and stability against the poles."""

import dataclasses

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, Notch
from hil.design.frequency import Loop, margins
from hil.design.speed_margins import LoopFamily, widened

BENCH = load_bench("reference")
SPEEDS = np.array([0.5, 3.9, 5.0, 5.9, 7.4, 9.1])
FILTERS = {
    "table 3": (BENCH.axis[2].notch[0].notch(),),
    "trapezoid": (Notch(mode=NOTCH_TRAPEZOID, start_rps=3.0, end_rps=9.2, offset_hz=2.3, zeta_rn=0.08, zeta_rdth=0.33),),
    "two": (
        BENCH.axis[2].notch[0].notch(),
        Notch(order=4, start_rps=1.6, end_rps=4.8, offset_hz=0.4, zeta_rn=0.05, zeta_rdth=0.15),
    ),
}


def loops(period_s=250e-6, delay=0):
    base = BENCH.axis[2].loop(period_s, delay, with_notch=False)
    soft = dataclasses.replace(base.plant, gear_stiffness_nm_rad=0.9 * base.plant.gear_stiffness_nm_rad)
    return [base, dataclasses.replace(base, plant=soft)]


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(("period_s", "delay"), [(250e-6, 0), (250e-6, 2), (500e-6, 0)])
def test_they_are_those_of_the_slow_way(name, period_s, delay):
    family, fine = (LoopFamily(loops(period_s, delay), step) for step in (1.0 / 320.0, 1.0 / 1280.0))
    quick, found = family.margins(FILTERS[name], SPEEDS), fine.margins(FILTERS[name], SPEEDS)
    for p, loop in enumerate(loops(period_s, delay)):
        filtered = dataclasses.replace(loop, notches=tuple(widened(notch) for notch in FILTERS[name]))
        for s, speed in enumerate(SPEEDS):
            slow = margins(filtered, float(speed), points=40_000)
            assert 1.0 / found.sensitivity_peak[p, s] == pytest.approx(1.0 / slow.sensitivity_peak, abs=0.002)
            assert found.gain_margin_db[p, s] == pytest.approx(slow.gain_margin_db, abs=0.05)
            assert found.phase_margin_deg[p, s] == pytest.approx(slow.phase_margin_deg, abs=0.35)
            assert (found.turns[p, s] == 0.0) == slow.stable
    np.testing.assert_allclose(1.0 / quick.sensitivity_peak, 1.0 / found.sensitivity_peak, atol=0.003)
    np.testing.assert_allclose(quick.gain_margin_db, found.gain_margin_db, atol=0.1)
    np.testing.assert_allclose(quick.phase_margin_deg, found.phase_margin_deg, atol=0.6)
    assert np.array_equal(quick.turns, found.turns)


def test_a_filter_that_makes_the_loop_unstable_turns_the_nyquist_curve():
    """Table 3's filter at 1 ms with a sample of delay, where half the gains stand it and all of them do not."""
    loop = BENCH.axis[2].loop(1e-3, 1, with_notch=False)
    weak = dataclasses.replace(loop.cascade, velocity_gain_nm_s_rad=0.09, velocity_integral_gain_nm_rad=1.8)
    for cascade, is_stable in ((weak, True), (loop.cascade, False)):
        base = dataclasses.replace(loop, cascade=cascade)
        found = LoopFamily([base]).margins(FILTERS["table 3"], np.array([5.9]))
        filtered = dataclasses.replace(base, notches=FILTERS["table 3"])
        assert margins(base).stable
        assert (np.abs(filtered.closed_loop_poles(5.9)).max() < 1.0) == is_stable
        assert (found.turns[0, 0] == 0.0) == is_stable


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("order", [2, 4])
def test_the_gain_on_the_line_is_that_of_each_loop_at_its_speed(name, order):
    gains = LoopFamily(loops()).gain_on_the_line(FILTERS[name], order, SPEEDS)
    for p, loop in enumerate(loops()):
        filtered = dataclasses.replace(loop, notches=tuple(widened(notch) for notch in FILTERS[name]))
        for s, speed in enumerate(SPEEDS):
            expected = abs(filtered.arm_per_transmission_error(np.array([order * speed]), float(speed))[0])
            assert gains[p, s] == pytest.approx(expected, rel=1e-9)


def test_a_switched_filter_counts_as_in_within_its_hysteresis_and_a_trapezoid_ends_where_it_ends():
    switched = Notch(mode=NOTCH_SWITCHED, start_rps=4.0, end_rps=9.0, hysteresis_rps=0.2)
    assert (widened(switched).start_rps, widened(switched).end_rps) == (3.8, 9.2)
    sloped = dataclasses.replace(switched, mode=NOTCH_TRAPEZOID)
    assert widened(sloped) is sloped


def test_loops_of_different_periods_are_refused():
    base = loops()[0]
    for wrong in ([], [base, Loop(base.plant, base.cascade, period_s=1e-3)]):
        with pytest.raises(ValueError, match="one common sampling period"):
            LoopFamily(wrong)
