"""Trial of a cancellation on an arm's line as a whole: what makes the tip's peak larger in any direction is not used."""

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.experiments.cancellation.effect import Part
from hil.experiments.cancellation.line_trial import refused_by_vector, verify_on_line
from hil.experiments.cancellation.verdict import PartVerdict
from hil.experiments.cancellation.verification import CancellationRefusedError, Trial, Verification
from hil.recording import TIP, Recording
from hil.reporter import SILENT

BENCH, PARTS = load_bench("reference-arm"), (Part(2, 2), Part(3, 2))
HZ, PERIOD_S, ROWS = 11.0, 0.002, 1500


class Arm:
    """A tip that shakes along x, y and z by certain amplitudes in mm, without and with the whole of a cancellation."""

    def __init__(self, without: tuple[float, ...], whole: tuple[float, ...], noise_m_s2: float = 0.0) -> None:
        self.without, self.whole, self.noise = np.array(without), np.array(whole), noise_m_s2
        self.rng, self.gains = np.random.default_rng(1), []

    def __call__(self, gain: float, only: int | None, without: frozenset[Part]) -> Recording:
        self.gains.append(gain)
        time = PERIOD_S * np.arange(ROWS)
        mm = self.without + gain * (self.whole - self.without)
        waves = 1e-3 * (2.0 * np.pi * HZ) ** 2 * mm[:, None] * np.sin(2.0 * np.pi * HZ * time)
        waves = waves + self.noise * self.rng.normal(size=waves.shape)
        return Recording({"time_s": time, **dict(zip(TIP, waves, strict=True))})


def test_what_makes_the_tip_quieter_is_accepted_as_a_whole() -> None:
    arm = Arm((0.06, 0.0, 0.05), (0.004, 0.0, 0.003), noise_m_s2=0.02)
    found = verify_on_line(BENCH, PARTS, 0.3, arm, SILENT)
    assert found.is_good
    assert not found.left_out
    assert arm.gains == [0.0, 0.3, 1.0]
    assert found.remainder is not None
    assert found.remainder.left_mm == pytest.approx(0.005, abs=0.004)
    entry = found.entry()
    assert entry.trials[0].reduction_fraction == pytest.approx(0.28, abs=0.03)
    assert entry.trials[1].reduction_fraction > 0.9


@pytest.mark.parametrize("whole", [(0.02, 0.03, 0.02), (0.02, 0.001, 0.058), (0.001, 0.006, 0.001)])
def test_a_peak_that_rises_in_one_direction_refuses_all_of_it(whole: tuple[float, ...]) -> None:
    """However much the others fall, and though the worst direction does."""
    found = verify_on_line(BENCH, PARTS, 0.3, Arm((0.06, 0.001, 0.05), whole), SILENT)
    assert not found.is_good
    assert set(found.left_out) == set(PARTS)
    with pytest.raises(CancellationRefusedError, match=r"peak along [yz] rises from"):
        found.demand()


def test_a_wrong_one_is_not_run_as_a_whole() -> None:
    arm = Arm((0.06, 0.0, 0.05), (0.18, 0.0, 0.05))
    assert not verify_on_line(BENCH, PARTS, 0.3, arm, SILENT).is_good
    assert arm.gains == [0.0, 0.3]


def test_one_that_does_nothing_is_refused() -> None:
    found = verify_on_line(BENCH, PARTS, 0.3, Arm((0.06, 0.0, 0.05), (0.06, 0.0, 0.05)), SILENT)
    assert not found.is_good
    assert "does not become quieter" in found.verdicts[0].words


def test_what_was_judged_order_by_order_is_held_against_the_vector_as_well() -> None:
    """Order by order the vertical was read: it fell; along y the tip shakes more."""

    def judged(whole: tuple[float, ...]) -> Verification:
        arm = Arm((0.06, 0.01, 0.05), whole)
        trials = tuple(
            Trial(f"{gain}", arm(gain, None, frozenset()), dict.fromkeys(PARTS, gain), 1.0) for gain in (0.0, 0.3, 1.0)
        )
        verdicts = tuple(PartVerdict(part, 0.3, 0.3, 0.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, "accepted") for part in PARTS)
        return refused_by_vector(BENCH, Verification(0.3, trials, verdicts))

    assert judged((0.01, 0.01, 0.01)).is_good
    bad = judged((0.01, 0.02, 0.01))
    assert not bad.is_good
    assert "peak along y rises" in bad.verdicts[0].words
