"""Peaks of the tip with a cancellation against those without."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.bench.model import with_identified
from hil.experiments.cancellation.cancellation import cancellation_on
from hil.experiments.cancellation.effect import Part, Sighting
from hil.experiments.cancellation.rise import Look, PeakChange, Windows
from hil.experiments.cancellation.trial import choose
from hil.experiments.motions import constant_acceleration
from hil.experiments.treatment import Knowledge
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.rehearsal.survey import Survey, session_on

TWO, FOUR = Part(2, 2), Part(2, 4)
TURNS = np.linspace(0.0, 40.0 * math.pi, 400)
EARLY = np.arange(400) < 200
WINDOWS = Windows({4: EARLY, 2: ~EARLY}, 1.0, 0.001)


def look(gains: dict[Part, float], left: dict[Part, complex], jolt: float = 0.0) -> Look:
    """A run in which order 4 rings early and order 2 late, over a jolt of the ramp's own that is early too."""
    waves = {
        part: np.stack([np.cos(TURNS) * rows, -np.sin(TURNS) * rows], axis=1) for part, rows in ((FOUR, EARLY), (TWO, ~EARLY))
    }
    vibration: NDArray[np.float64] = jolt * np.cos(TURNS) * EARLY
    for part, size in left.items():
        vibration = vibration + waves[part] @ np.array([size.real, size.imag])
    return Look(gains, Sighting(left, dict.fromkeys(left, 1.0), np.zeros(400), vibration, waves))


def test_the_order_without_which_the_peak_would_be_lower_is_taken_out() -> None:
    """The ramp's own jolt is 0.1 mm, of which order 4 takes away a half: cancelled, the tip has the whole of it."""
    without = look({TWO: 0.0, FOUR: 0.0}, {TWO: 0.5, FOUR: -0.05}, jolt=0.1)
    with_both = look({TWO: 1.0, FOUR: 1.0}, {TWO: 0.01, FOUR: 0.0}, jolt=0.1)
    rise = WINDOWS.rise([without, with_both], (TWO, FOUR))
    assert rise is not None
    assert rise.order == 4
    assert rise.exceeds(3.0)
    assert WINDOWS.riser([without, with_both], (TWO, FOUR), rise) == FOUR


def test_an_order_that_does_more_good_elsewhere_stays() -> None:
    without = look({TWO: 0.0}, {TWO: 0.5, FOUR: -0.05}, jolt=0.1)
    with_it = look({TWO: 1.0}, {TWO: 0.01, FOUR: 0.0}, jolt=0.1)
    rise = WINDOWS.rise([without, with_it], (TWO,))
    assert rise is not None
    assert rise.exceeds(3.0)
    assert WINDOWS.riser([without, with_it], (TWO,), rise) is None


@pytest.mark.parametrize(("after", "exceeds"), [(0.104, False), (0.107, True), (0.05, False)])
def test_a_rise_counts_beyond_a_twentieth(after: float, *, exceeds: bool) -> None:
    assert PeakChange(4, 0.1, after, 0.0001).exceeds(3.0) is exceeds


def test_a_rise_that_the_noise_may_hide_is_looked_at_again() -> None:
    assert PeakChange(4, 0.1, 0.12, 0.01).is_open
    assert not PeakChange(4, 0.1, 0.12, 0.001).is_open


@pytest.mark.slow
def test_an_order_that_lessens_the_ramps_own_jolt_is_not_cancelled() -> None:
    """A drawn arm of 3.9 Hz: order 4's window lies in the ramp's own start, and its true cancellation raises the tip in it."""
    robot, text = drawn(110, "both")
    bench, axis = loads(text, Bench, "bench"), min(robot.axis)
    model = model_of(robot, bench, axis, robot.axis[axis].ate)
    known = model.axis[axis].ate
    assert known is not None
    model = model.with_part(axis, known.model_copy(update={"gear_reaction": 0.0}))
    with session_on(robot, bench) as session:
        session.adopt(with_identified(bench, model))
        motion = constant_acceleration(bench, axis, bench.bus.sync_period_s)
        choice = choose(session, cancellation_on(session, model, motion), motion, shows_filter=False)
    refused = {verdict.part.order: verdict.words for verdict in choice.verification.verdicts if verdict.verdict == "refused"}
    assert list(refused) == [4]
    assert "the tip's peak in the window of order 4 rises" in refused[4]
    survey = Survey(robot, bench, axis)
    before = survey.tip("none", Knowledge()).peak_mm
    whole, used = (survey.cancelled(model, left_out).peak_mm for left_out in ((), choice.verification.left_out))
    assert whole[4] > 1.2 * before[4]
    assert used[4] < 1.05 * before[4]
    assert max(used.values()) < max(whole.values())
