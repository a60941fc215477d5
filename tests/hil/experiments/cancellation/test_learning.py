"""What a learning states: nothing of an order that is left out; and whether a cancellation has been seen to act."""

from dataclasses import replace

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


def learnt(*verdicts):
    passes = [LearntPass(0.0, 1.0, estimate(18.0, 8.0), 0.0, None)]
    return AxisLearning(2, [*passes, LearntPass(0.5, 0.5, estimate(18.2, 8.0), 0.0, None, verdicts)])


def test_a_cancellation_that_acted_in_any_pass_is_known_to_have():
    assert learnt(replace(SEEN, verdict="not judged"), SEEN).has_acted
    assert not learnt(replace(SEEN, verdict="not judged"), replace(SEEN, verdict="refused")).has_acted
    assert not learnt().has_acted


def test_of_an_order_that_is_left_out_nothing_is_stated():
    passes = [LearntPass(0.0, 1.0, estimate(18.0, 0.2), 0.0, None)]
    part = AxisLearning(2, passes, left_out={4.0: replace(SEEN, part=Part(2, 4.0), verdict="not judged")}).part()
    assert part.values.amplitudes_arcsec() == {2: 18.0}
    assert {"a2_arcsec", "phi2_deg"} <= set(part.standard_error)
    assert not {"a4_arcsec", "phi4_deg"} & set(part.standard_error)
