"""The factor of the motor's own motion, and what its standard error rests on."""

import math

import numpy as np
import pytest

from hil.design.ate.model import Arm, Sensing, Sweep
from hil.design.ate.motion import BELOW_RESONANCE, BLOCK_PERIODS, motion_factor

ARM, RATIO, LEVER, PERIOD_S = Arm(4.0, 0.03, 0.0, 0.9), 100.0, 0.7, 0.002
BLOCK_S = BLOCK_PERIODS / (BELOW_RESONANCE[0] * ARM.resonance_hz)


def swung(seconds: float, factor: float, noise: float = 0.01) -> Sweep:
    """A motor that swings at 0.8 Hz, far below the arm's resonance, and a tip that follows it by a factor."""
    time_s = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    omega = math.tau * 0.8
    angle = 5.0 * (1.0 - np.cos(omega * time_s))
    ahead = 1.0 / (1.0 - (0.8 / ARM.resonance_hz) ** 2)
    tip = factor * ahead * LEVER / RATIO * 5.0 * omega**2 * np.cos(omega * time_s)
    tip += noise * np.random.default_rng(1).standard_normal(len(time_s))
    return Sweep(angle, tip, PERIOD_S, np.ones(len(time_s), dtype=np.int8))


@pytest.mark.parametrize("factor", [1.0, 0.6])
def test_a_long_recording_tells_the_factor_and_its_error(factor: float) -> None:
    found, error = motion_factor([swung(8.0 * BLOCK_S, factor)], RATIO, Sensing(LEVER), (), ARM)
    assert found == pytest.approx(factor, rel=0.03)
    assert 0.0 < error < 0.05


def test_one_block_alone_tells_nothing_of_the_error() -> None:
    """Its slope is 0 by itself: a recording of 5 s on an arm of 4 Hz was refused for a factor of 0.704 ± 0.000."""
    _, error = motion_factor([swung(0.8 * BLOCK_S, 1.0)], RATIO, Sensing(LEVER), (), ARM)
    assert error == 1.0
