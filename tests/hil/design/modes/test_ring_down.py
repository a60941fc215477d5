"""What rings after a stop: poles of the closed loop, and the amplitudes of what is left of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.design.modes.problem import ArmMode
from hil.design.modes.ring_down import closed_loop_rates, modes_of, ring_down

LOOP = load_bench("reference").axis[2].loop(250e-6, with_notch=False)
PLANT = LOOP.plant
PERIOD = 0.002


def waves(time, *parts):
    return sum((np.real(b * np.exp(rate * time)) for b, rate in parts), np.zeros(len(time)))


def test_the_mode_that_rings_is_neither_the_dip_nor_as_little_damped():
    """The loop gives way, and takes energy: the arm rings lower than with its motor held, and for a shorter time."""
    [mode] = modes_of(closed_loop_rates(LOOP))
    free = PLANT.gear_damping_nm_s_rad + PLANT.arm_damping_nm_s_rad
    held = free / (2.0 * math.sqrt(PLANT.gear_stiffness_nm_rad * PLANT.arm_inertia_kg_m2))
    assert mode.frequency_hz == pytest.approx(11.63, abs=0.01)
    assert mode.frequency_hz < PLANT.antiresonance_hz
    assert mode.damping > 3.0 * held


def test_the_poles_of_one_mode_are_those_of_the_same_arm_as_a_list_of_modes():
    bare = replace(LOOP, plant=replace(PLANT, arm_damping_nm_s_rad=0.0))  # of an arm in modes all damping is the gear's
    zeta = PLANT.gear_damping_nm_s_rad / (2.0 * math.sqrt(PLANT.gear_stiffness_nm_rad * PLANT.arm_inertia_kg_m2))
    one = ArmMode(PLANT.arm_inertia_kg_m2, PLANT.antiresonance_hz, zeta)
    assert closed_loop_rates(bare, [one]) == pytest.approx(closed_loop_rates(bare), rel=1e-6)


def test_an_arm_with_two_modes_rings_with_both():
    found = modes_of(closed_loop_rates(LOOP, [ArmMode(4.8, 10.5, 0.031), ArmMode(3.2, 14.7, 0.043)]))
    assert [round(mode.frequency_hz) for mode in found] == [10, 14]


def test_amplitudes_are_told_from_the_following_that_lies_in_the_same_band():
    time = PERIOD * np.arange(450)
    rates = closed_loop_rates(LOOP)
    *decays, ring = rates.tolist()
    made = 0.3 + waves(time, (0.8 - 0.2j, ring), (-1.1, decays[0]), (0.6, decays[1]))
    found = ring_down(made, PERIOD, rates)
    assert found.amplitude_mm[0] == pytest.approx(1e3 * abs(0.8 - 0.2j) / abs(ring) ** 2, rel=1e-6)
    assert found.largest_mm == found.amplitude_mm[0]
    assert found.wave_m_s2 == pytest.approx(waves(time, (0.8 - 0.2j, ring)), abs=1e-6)
    assert found.error_mm[0] < 1e-9 * found.amplitude_mm[0], "no pole is missing"


def test_the_standard_error_is_that_of_the_noise():
    rates = closed_loop_rates(LOOP)
    time, rng = PERIOD * np.arange(450), np.random.default_rng(7)
    truth = 0.9 * 1e3 / abs(rates[-1]) ** 2
    misses = []
    for _ in range(200):
        phase = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))
        found = ring_down(waves(time, (0.9 * phase, rates[-1])) + rng.normal(0.0, 0.02, len(time)), PERIOD, rates)
        misses.append((found.amplitude_mm[0] - truth) / found.error_mm[0])
    assert 0.8 < math.sqrt(np.mean(np.square(misses))) < 1.2
    assert max(map(abs, misses)) < 4.5


def test_too_little_after_the_stop_and_nothing_that_rings_are_said():
    rates = closed_loop_rates(LOOP)
    with pytest.raises(ValueError, match=r"12 samples after the stop; at least 64 are needed; raise tail_s"):
        ring_down(np.zeros(12), PERIOD, rates)
    with pytest.raises(ValueError, match="no mode that rings"):
        ring_down(np.zeros(500), PERIOD, rates[:-1])


def test_a_pole_that_is_damped_away_does_not_ring():
    kept, gone = 2.0 * math.pi * complex(-1.0, 9.95), 2.0 * math.pi * complex(-5.0, 8.7)
    [mode] = modes_of(np.array([gone, kept]))
    assert (mode.frequency_hz, mode.damping) == pytest.approx((10.0, 0.1), rel=1e-3)
