"""What is learnt: an order whose cancellation was seen to act is known by that, however far the gear is from a spring."""

from dataclasses import replace

import pytest

from hil.bench.model import significant
from hil.design.transmission_error import TransmissionError
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.learning import AxisLearning, LearntPass
from hil.experiments.cancellation.verdict import PartVerdict
from tests.hil.experiments.ate.test_checks import GOOD

SEEN = PartVerdict(Part(2, 2.0), 0.5, 0.47, 0.01, 0.06, 0.02, 1.05, 0.04, 2.0, 2.0, "accepted")
"""Half of the cancellation took away what half of it should."""


def estimate(a2_arcsec, error_arcsec):
    found = TransmissionError({2.0: a2_arcsec, 4.0: 2.0}, {2.0: 198.0, 4.0: 292.0})
    errors = {2.0: error_arcsec, 4.0: 1.0}
    return replace(GOOD, error=found, amplitude_error_arcsec=errors, phase_error_deg={2.0: 1.0, 4.0: 1.0}, widened=20.0)


def learnt(*verdicts, error_arcsec=8.0):
    passes = [LearntPass(0.0, 1.0, estimate(18.0, error_arcsec), 0.0, None)]
    passes.append(LearntPass(0.5, 0.5, estimate(18.2, error_arcsec), 0.0, None, verdicts))
    learning = AxisLearning(2, passes)
    learning.known.acted = learning.known.choices(passes[0].estimate, {2.0, 4.0})
    learning.left_out |= learning.known.judged(verdicts, learning.estimate, learning.passed, is_last=False)
    return learning.part()


def test_an_order_whose_cancellation_acted_is_no_noise_though_both_directions_differ():
    part = learnt(SEEN)
    # 1.05 × 18″ ∠ 2°, which is 6.1 % off; 4 % of 18″, and a fifth of what it is off
    assert part.values.a2_arcsec == pytest.approx(18.9)
    assert part.values.phi2_deg == pytest.approx(200.0)
    assert part.standard_error["a2_arcsec"] == pytest.approx(18.0 * (0.04**2 + (0.2 * 0.0614) ** 2) ** 0.5, rel=0.01)
    assert significant(part).amplitudes_arcsec() == {2: pytest.approx(18.9)}


def test_of_an_order_whose_cancellation_was_refused_nothing_is_known():
    part = learnt(replace(SEEN, verdict="refused"))
    assert part.values.a2_arcsec == 0.0
    assert "a2_arcsec" not in part.standard_error


@pytest.mark.parametrize("verdict", [replace(SEEN, verdict="not judged"), replace(SEEN, factor=None)])
def test_an_order_whose_cancellation_was_not_seen_to_act_stays_as_uncertain_as_the_fit_says(verdict):
    part = learnt(verdict)
    assert part.standard_error["a2_arcsec"] == 8.0
    assert significant(part).amplitudes_arcsec() == {}


def test_what_the_fit_knows_better_stays():
    assert learnt(SEEN, error_arcsec=0.2).standard_error["a2_arcsec"] == 0.2


def test_of_an_order_that_is_left_out_nothing_is_stated():
    passes = [LearntPass(0.0, 1.0, estimate(18.0, 0.2), 0.0, None)]
    part = AxisLearning(2, passes, left_out={4.0: replace(SEEN, part=Part(2, 4.0), verdict="not judged")}).part()
    assert part.values.amplitudes_arcsec() == {2: 18.0}
    assert {"a2_arcsec", "phi2_deg"} <= set(part.standard_error)
    assert not {"a4_arcsec", "phi4_deg"} & set(part.standard_error)


def test_a_cancellation_that_acted_in_any_pass_is_known_to_have():
    def learning(*verdicts):
        return AxisLearning(2, [LearntPass(0.5, 0.5, estimate(18.0, 8.0), 0.0, None, verdicts)])

    assert learning(replace(SEEN, verdict="not judged"), SEEN).has_acted
    assert not learning(replace(SEEN, verdict="not judged"), replace(SEEN, verdict="refused")).has_acted
    assert not learning().has_acted
