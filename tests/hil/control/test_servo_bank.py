"""The bank of laws gives the very bits that each law gives by itself."""

import math

import pytest

from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import Servo, ServoConfig
from hil.control.servo_bank import ServoBank

PERIOD_S = 250e-6
CONFIGS = [
    ServoConfig(Cascade(25.0, 0.196, 3.92), 7.1, (Notch(),)),
    ServoConfig(Cascade(25.0, 0.0905, 1.81), 0.4),
    ServoConfig(
        Cascade(10.0, 0.02, 0.3, 200.0), 1.0, (Notch(start_rps=2.0, end_rps=5.0), Notch(order=4, start_rps=1.0, end_rps=3.0))
    ),
]


def test_every_axis_of_the_bank_computes_the_bits_of_its_own_law() -> None:
    bank, laws = ServoBank(CONFIGS, PERIOD_S), [Servo(config, PERIOD_S) for config in CONFIGS]
    for row, law in enumerate(laws):
        bank.start(row, 0.1 * row, 30.0, 0.2)
        law.start(0.1 * row, 30.0, 0.2)
    acted = set()
    for i in range(4000):
        angles = [0.1 * row + 30.0 * i * PERIOD_S * (1 + 0.1 * row) + 1e-4 * math.sin(0.3 * i + row) for row in range(3)]
        references = [angle + 1e-3 * math.cos(0.01 * i) for angle in angles]
        torques = bank.step(references, angles)
        assert torques == [law.step(r, a) for law, r, a in zip(laws, references, angles, strict=True)]
        shown = [float(s["frequency_hz"]) if s["active"] else 0.0 for s in (law.notch_state[0, 0] for law in laws)]
        assert bank.notch_hz == shown
        acted |= {row for row, value in enumerate(shown) if value}
    assert acted == {0, 2}


def test_one_axis_steps_alone_and_the_others_stay() -> None:
    bank, law = ServoBank(CONFIGS, PERIOD_S), Servo(CONFIGS[0], PERIOD_S)
    for i in range(100):
        assert bank.step_one(0, 0.01, 1e-4 * i) == law.step(0.01, 1e-4 * i)
    fresh = ServoBank(CONFIGS, PERIOD_S)
    assert bank.step([0.0, 0.5, 0.5], [0.0, 0.1, 0.1])[1:] == fresh.step([0.0, 0.5, 0.5], [0.0, 0.1, 0.1])[1:]


def test_a_period_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"period_s = 0\.0"):
        ServoBank(CONFIGS, 0.0)
