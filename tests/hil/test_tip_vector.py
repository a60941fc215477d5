"""The tip as a vector: displacement by integration within the band, the worst direction, areas above the motion and gravity."""

import math

import numpy as np
import pytest

from hil.analysis import tip_displacement_mm, tip_scale
from hil.tip_vector import displacement_mm, noise_rms_mm, steady_window_s, vector_metrics

PERIOD_S = 0.002
SCALE = tip_scale(11.84)
TIME = np.arange(0.0, 4.0, PERIOD_S)
ALL = np.ones(len(TIME), dtype=np.bool_)
MIDDLE = (TIME > 0.8) & (TIME < 3.2)


def swinging(frequency_hz: float, amplitude_mm: float) -> np.ndarray:
    """Acceleration of a displacement that swells, stays, and fades."""
    swell = np.clip((TIME - 0.3) / 0.3, 0.0, 1.0) * np.clip((3.7 - TIME) / 0.3, 0.0, 1.0)
    moved = 1e-3 * amplitude_mm * swell * np.sin(2.0 * math.pi * frequency_hz * TIME)
    omega = 2.0 * math.pi * np.fft.rfftfreq(len(TIME), PERIOD_S)
    return np.fft.irfft(-(omega**2) * np.fft.rfft(moved), len(TIME))


@pytest.mark.parametrize("frequency_hz", [8.7, 10.4, 11.84, 14.7])
def test_a_vibration_has_its_true_size_wherever_the_arm_swings(frequency_hz):
    acceleration = swinging(frequency_hz, 0.05)
    moved = displacement_mm(acceleration[:, np.newaxis], PERIOD_S, SCALE.band_hz)[:, 0]
    assert math.isclose(float(np.max(np.abs(moved[MIDDLE]))), 0.05, rel_tol=0.02)
    by_f_al = float(np.max(np.abs(tip_displacement_mm(acceleration, PERIOD_S, SCALE)[MIDDLE])))
    assert math.isclose(by_f_al, 0.05 * (frequency_hz / 11.84) ** 2, rel_tol=0.06)  # why it is not divided by (2 π f_al)²


def test_gravity_and_slow_motion_are_no_displacement():
    slow = 9.81 + 2.0 * np.sin(2.0 * math.pi * 0.4 * TIME)
    moved = displacement_mm(np.stack([slow, slow, slow], axis=1), PERIOD_S, SCALE.band_hz)
    assert float(np.max(np.abs(moved[MIDDLE]))) < 0.002


def test_the_worst_direction_is_where_the_tip_swings():
    unit = np.array([0.6, 0.0, -0.8])
    acceleration = np.outer(swinging(10.4, 0.07), unit)
    found = vector_metrics(acceleration, PERIOD_S, MIDDLE, ALL, "boxcar", SCALE)
    worst = found["worst"]
    assert worst.unit is not None
    assert math.isclose(abs(float(np.dot(worst.unit, unit))), 1.0, rel_tol=1e-9)
    assert worst.tip_peak_mm is not None
    assert math.isclose(worst.tip_peak_mm, 0.07, rel_tol=0.02)
    for name, part in (("x", 0.6), ("y", 0.0), ("z", 0.8)):
        peak_mm, along = found[name].tip_peak_mm, found[name].spectrum_area
        assert math.isclose(peak_mm or 0.0, part * worst.tip_peak_mm, rel_tol=1e-9, abs_tol=1e-12)
        assert math.isclose(along, part * worst.spectrum_area, rel_tol=1e-9, abs_tol=1e-12)


def test_no_direction_has_more_than_the_worst():
    generator = np.random.default_rng(4)
    acceleration = np.stack([swinging(f, 0.05) for f in (9.0, 11.0, 16.0)], axis=1) @ generator.standard_normal((3, 3))
    worst = vector_metrics(acceleration, PERIOD_S, MIDDLE, ALL, "boxcar", SCALE)["worst"]
    moved = displacement_mm(acceleration, PERIOD_S, SCALE.band_hz)[MIDDLE]
    directions = generator.standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    peaks = np.max(np.abs(moved @ directions.T), axis=0)
    assert worst.tip_peak_mm is not None
    assert float(np.max(peaks)) <= worst.tip_peak_mm
    assert worst.tip_peak_mm < 1.02 * float(np.max(peaks))


def test_the_area_leaves_out_the_motion_and_gravity():
    swing = swinging(10.4, 0.05)
    none = np.zeros_like(swing)
    clean = vector_metrics(np.stack([none, none, swing], axis=1), PERIOD_S, MIDDLE, ALL, "boxcar", SCALE)
    heavy = vector_metrics(np.stack([none + 4.0, none, swing - 9.0], axis=1), PERIOD_S, MIDDLE, ALL, "boxcar", SCALE)
    assert math.isclose(clean["worst"].spectrum_area, heavy["worst"].spectrum_area, rel_tol=1e-6)


def test_without_an_f_al_there_are_areas_and_no_millimetres():
    found = vector_metrics(np.zeros((len(TIME), 3)), PERIOD_S, MIDDLE, ALL, "boxcar", None)
    assert {each.tip_peak_mm for each in found.values()} == {None}
    assert {each.spectrum_area for each in found.values()} == {0.0}


def test_noise_shows_as_much_as_is_said():
    noise = 0.02 * np.random.default_rng(2).standard_normal((20000, 3))
    moved = displacement_mm(noise, PERIOD_S, SCALE.band_hz)
    said = noise_rms_mm([0.02**2] * 3, PERIOD_S, SCALE.band_hz)
    assert math.isclose(float(np.sqrt(np.mean(moved**2))), said, rel_tol=0.1)


def test_a_line_is_judged_while_it_goes_at_one_speed():
    assert steady_window_s(2.2, 0.3) == (0.5, pytest.approx(1.85))
    assert steady_window_s(1.0, 0.4) == (0.25, 0.9)  # it hardly does: as every line
