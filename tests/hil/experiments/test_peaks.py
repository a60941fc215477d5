"""Peaks of the tip with a cancellation against those without."""

import math
from collections.abc import Mapping

import numpy as np
import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.bench.model import Identified, with_identified
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.trial import Choice, choose
from hil.experiments.motions import constant_acceleration
from hil.experiments.peaks import PeakChange, Windows
from hil.experiments.treatment import Knowledge
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.rehearsal.survey import Survey, session_on


@pytest.mark.parametrize(("after", "rises"), [(0.104, False), (0.107, True), (0.05, False)])
def test_a_rise_counts_beyond_a_twentieth(after: float, *, rises: bool) -> None:
    assert PeakChange(4, 0.1, after, 0.0001).rises.holds is rises


def test_a_change_that_the_noise_may_hide_is_open() -> None:
    assert PeakChange(4, 0.1, 0.12, 0.01).rises.is_open
    assert PeakChange(4, 0.1, 0.12, 0.001).rises.holds
    assert PeakChange(4, 0.1, 0.12, 0.001).falls.fails
    assert PeakChange(4, 0.1, 0.08, 0.001).falls.holds


def test_the_largest_peaks_of_all_windows_are_compared() -> None:
    """Order 4 rings early and order 2 late: the first rises, and stays below what the second was."""
    early = np.arange(400) < 200
    windows = Windows({4: early, 2: ~early}, 1.0, 0.001)
    without, with_it = np.where(early, 0.1, 0.5), np.where(early, 0.2, 0.05)
    assert [change.order for change in windows.compared([without], [with_it])] == [4, 2]
    largest = windows.largest([without], [with_it])
    assert (largest.order, largest.before_mm, largest.after_mm) == (None, 0.5, 0.2)
    assert largest.error_mm == pytest.approx(0.001 * math.sqrt(2.0))


def chosen(seed: int, turned_deg: Mapping[float, float]) -> tuple[Survey, Identified, Choice]:
    """The trial of a drawn robot's true cancellation, with the phases of some orders turned."""
    robot, text = drawn(seed, "both")
    bench, axis = loads(text, Bench, "bench"), min(robot.axis)
    true = robot.axis[axis].apparent_ate
    phases = {order: phase + turned_deg.get(order, 0.0) for order, phase in true.phases_deg().items()}
    model = model_of(robot, bench, axis, TransmissionErrorTable.of(true.amplitudes_arcsec(), phases))
    with session_on(robot, bench) as session:
        session.adopt(with_identified(bench, model))
        motion = constant_acceleration(bench, axis, bench.bus.sync_period_s)
        choice = choose(session, cancellation_on(session, model, motion), motion, shows_filter=False)
    return Survey(robot, bench, axis), model, choice


def test_no_order_is_cancelled_if_the_tips_largest_peak_rises() -> None:
    """An arm of 5 Hz with φ_2 off by 60°: order 2 is left out, and what it shakes was lessened by orders 1 and 4 by chance."""
    _, _, choice = chosen(10313, {2: 60.0})
    assert choice.refusal is not None
    words = {verdict.part.order: verdict.words for verdict in choice.verification.verdicts}
    assert "turned by −60°" in words[2]
    assert all("with its cancellation the tip's peak rises" in words[order] for order in (1, 4))


@pytest.mark.slow
def test_an_order_that_lessens_the_ramps_own_jolt_by_chance_is_cancelled() -> None:
    """A drawn arm of 3.9 Hz: the window of order 4 lies in the ramp's own start, which order 4 lessens.

    With it cancelled the tip is that of a perfect gear.
    """
    survey, model, choice = chosen(110, {})
    assert {verdict.part.order for verdict in choice.verification.verdicts if verdict.verdict == "accepted"} >= {1, 4}
    before, floor = survey.tip("none", Knowledge()), survey.floor()
    used = survey.cancelled(model, choice.verification.left_out)
    assert used[4] > 1.2 * before[4]
    assert all(used[order] < 1.05 * floor[order] + 0.002 for order in used)
    assert max(used.values()) < max(before.values())


def test_a_rise_just_behind_a_window_counts_for_it() -> None:
    """The tip grows towards the next order's speeds; a sensor that is late by some rows has the window's last peak behind it."""
    at = np.arange(100)
    window, other = (at >= 20) & (at < 60), at >= 80
    without = np.where(at < 60, 0.2, np.where(at < 65, 0.5, 0.1))
    with_it = np.where((at >= 60) & (at < 65), 1.2, 1.0) * without
    windows = Windows({4: window, 2: other}, 1.0, 0.001, 10)
    worst = windows.compared([without], [with_it])[0]
    assert (worst.order, worst.before_mm, worst.after_mm) == (4, 0.5, pytest.approx(0.6))
    near = Windows({4: window, 2: at >= 60}, 1.0, 0.001, 10).compared([without], [with_it])
    assert [change.order for change in near] == [2, 4], "what is another window's is not this one's"
    assert near[1].after_mm == 0.2
