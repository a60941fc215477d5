"""What `hil learn` writes: corrections that were accepted or known, with their standard errors, and nothing of those left out."""

import datetime
import math
from dataclasses import replace

import numpy as np
import pytest

from hil.bench.model import significant
from hil.experiments.cancellation.correction import MADE_ALIKE, MADE_ALONG, Correction
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.learning import AxisLearning, LearntPass
from hil.experiments.cancellation.verdict import PartVerdict, Seen
from tests.hil.estimates import apart
from tests.hil.experiments.ate.test_checks import GOOD

ACCEPTED = PartVerdict(Part(2, 2.0), 0.5, 0.47, 0.01, 0.06, 0.02, 0.0, 1.05, 0.04, 2.0, 2.0, "accepted")
"""Half of the cancellation took away what half of it should."""


def estimate(error_arcsec):
    values = apart((2.0, 4.0), np.array([18.0, 198.0, 2.0, 292.0]), np.array([error_arcsec, 1.0, 1.0, 1.0]))
    return replace(GOOD, values=values)


def learnt(*verdicts, error_arcsec=8.0, left=None):
    """A learning of two orders after the verdicts of a pass, and what it leaves of order 2."""
    correction, made = Correction(), estimate(error_arcsec)
    correction.begin(made, {2.0, 4.0})
    correction.acted = correction.values()
    if left is not None:
        correction.take({2.0: [Seen(way, 1.0, left, 0.1**2) for way in (1, -1)]}, 12.0)
    passes = [LearntPass(1.0, 0.5, made, 0.0, correction.values(), verdicts)]
    learning = AxisLearning(2, passes, correction=correction)
    learning.left_out |= correction.judged(verdicts, is_last=True)
    return learning


def test_an_order_is_known_by_what_its_cancellation_leaves_however_badly_the_fit_knew_it():
    part = learnt(ACCEPTED, left=0.0).part()
    assert part.values.a2_arcsec == pytest.approx(18.0)
    # 0.07″ by the noise of two directions, and the two for what the motor makes of it
    assert part.standard_error["a2_arcsec"] == pytest.approx(math.hypot(0.07, MADE_ALIKE * 18.0, MADE_ALONG * 18.0), rel=0.01)
    assert significant(part).amplitudes_arcsec() == {2: pytest.approx(18.0)}


def test_of_an_order_whose_cancellation_was_refused_nothing_is_known():
    part = learnt(replace(ACCEPTED, verdict="refused"), left=0.0).part()
    assert part.values.a2_arcsec == 0.0
    assert not {"a2_arcsec", "phi2_deg"} & set(part.standard_error)


def test_an_order_of_which_no_pass_has_shown_the_rest_stays_as_uncertain_as_the_fit_says():
    part = learnt(ACCEPTED).part()
    assert part.standard_error["a2_arcsec"] == 8.0
    assert significant(part).amplitudes_arcsec() == {}


def test_an_order_that_could_not_be_judged_is_left_out_and_nothing_is_stated_of_it():
    learning = learnt(ACCEPTED, replace(ACCEPTED, part=Part(2, 4.0), verdict="not judged"), left=0.0)
    part = learning.part(on=datetime.date(2026, 11, 27))
    assert part.values.amplitudes_arcsec() == {2: pytest.approx(18.0)}
    assert not {"a4_arcsec", "phi4_deg"} & set(part.standard_error)
    assert part.note == "2026-11-27; 1 passes"
