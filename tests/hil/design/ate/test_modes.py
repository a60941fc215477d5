"""Ramps of an arm that rings with several modes: fitted with what the plant says of the others."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.control.trajectory import ConstantAcceleration, sample_times
from hil.design.ate.identification import JointEstimate, identify
from hil.design.ate.model import Arm, OtherMode, Sensing, Sweep
from hil.design.transmission_error import acceleration_spectrum

RATIO, LEVER_M, PERIOD_S = 120.0, 0.466, 0.002
TRUE = Arm(10.44, 0.033, 0.001, 1.0, 0.0, (OtherMode(14.73, 0.043, 0.13), OtherMode(36.0, 0.048, -0.06)))
A2, PHI2, A4, PHI4 = 5.0, 222.0, 3.0, 126.0


def sweep(noise: float = 0.03, seed: int = 3) -> Sweep:
    """Two short ramps, up to 7 rev/s and back, seen by a tip that the modes move."""
    up = ConstantAcceleration(4.5, 7.1, 20.0, 0.3, 0.5)
    times = sample_times(up.duration_s, PERIOD_S)
    one = up.motor_angle(times)
    angle = np.concatenate([one, one[-1] - one])
    count = len(angle)
    full = 4 * count
    arc = math.radians(1.0 / 3600.0)
    error = sum(a * arc * np.cos(k * angle + math.radians(p)) for k, a, p in ((2, A2, PHI2), (4, A4, PHI4)))
    frequency, spectra = acceleration_spectrum(np.stack([angle / RATIO, error]), PERIOD_S, full)
    seen = LEVER_M * np.fft.irfft((spectra[0] + spectra[1]) * TRUE.response(frequency), full)[:count]
    seen = seen + noise * np.random.default_rng(seed).normal(size=count)
    speed = np.gradient(angle, PERIOD_S)
    rising = (np.arange(len(one)) * PERIOD_S - 0.3 >= 0.0) & (np.arange(len(one)) * PERIOD_S - 0.3 <= up.ramp_s)
    direction = np.concatenate([rising, -1 * rising]).astype(np.int8)
    assert np.max(np.abs(speed)) > 40.0
    return Sweep(angle, seen, PERIOD_S, direction)


def found(start: Arm | None) -> JointEstimate:
    return identify([sweep()], RATIO, Sensing(LEVER_M), start, (2, 4))


def test_gains_of_all_modes_add_up_to_the_lever() -> None:
    low = TRUE.response(np.array([0.05]))[0]
    assert abs(low) == pytest.approx(1.0, abs=1e-4)
    assert replace(TRUE, others=()).response(np.array([14.73]))[0] != TRUE.response(np.array([14.73]))[0]


@pytest.mark.ci
def test_with_the_modes_of_the_plant_the_error_is_right_where_a_single_one_makes_it_wrong() -> None:
    start = replace(TRUE, resonance_hz=10.5, damping=0.03, delay_s=0.0)
    several, one = found(start), found(replace(start, others=()))
    assert several.error.amplitude_arcsec[2] == pytest.approx(A2, abs=0.1)
    assert several.error.amplitude_arcsec[4] == pytest.approx(A4, abs=0.1)
    assert several.error.phase_deg[2] == pytest.approx(PHI2, abs=1.5)
    assert several.error.phase_deg[4] == pytest.approx(PHI4, abs=3.0)
    assert several.residual < 0.7 * one.residual
    assert abs(one.error.amplitude_arcsec[2] - A2) > 3.0 * abs(several.error.amplitude_arcsec[2] - A2)
