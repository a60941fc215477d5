"""Reading of the orders: against an arm that is integrated in time, which knows nothing of transforms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.control.angles import ARCSEC
from hil.design.ate.model import Arm
from hil.experiments.cancellation.effect import AxisWaves, Part, Response, refined, sight
from hil.recording import Recording

PERIOD_S, LEVER_M, RATIO, ARM_HZ, DAMPING = 0.002, 0.7, 120.0, 12.0, 0.03
TRUE = {2: (5.0, 222.0), 4: (3.0, 126.0)}


def ramp(seconds: float = 2.5) -> NDArray[np.float64]:
    time = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    return np.asarray(2.0 * math.pi * 0.5 * 4.0 * time**2)


def shaken(angle: NDArray[np.float64], noise: float, seed: int = 1) -> Recording:
    """Tip acceleration of an arm on its gear, by fine steps of its equation of motion."""
    fine, per = 40, np.arange(len(angle) * 40) / 40.0
    theta = np.interp(per, np.arange(len(angle)), angle)
    error = sum(a * ARCSEC * np.cos(k * theta + math.radians(phi)) for k, (a, phi) in TRUE.items())
    step, omega = PERIOD_S / fine, 2.0 * math.pi * ARM_HZ
    rate = np.gradient(np.asarray(error), step)
    position, speed, out = float(np.asarray(error)[0]), 0.0, np.zeros(len(angle))
    for i, (drive, drive_rate) in enumerate(zip(np.asarray(error).tolist(), rate.tolist(), strict=True)):
        # all of the damping acts between gear and arm
        change = omega**2 * (drive - position) + 2.0 * DAMPING * omega * (drive_rate - speed)
        if i % fine == 0:
            out[i // fine] = LEVER_M * change
        speed += step * change
        position += step * speed
    generator = np.random.default_rng(seed)
    columns = {"time_s": np.arange(len(angle)) * PERIOD_S, "axis2_position_rad": angle}
    return Recording(columns | {"tip_z_m_s2": out + noise * generator.standard_normal(len(out))})


def axis(arm_hz: float = ARM_HZ, damping: float = DAMPING, orders: tuple[float, ...] = (1, 2, 4)) -> AxisWaves:
    response = Response(Arm(arm_hz, damping, gear_fraction=1.0))
    return AxisWaves(2, orders, np.asarray(LEVER_M), response, np.zeros(len(ramp())))


def rows(recording: Recording) -> NDArray[np.bool_]:
    return np.asarray((recording.time_s > 0.2) & (recording.time_s < 2.4))


def test_amplitude_and_phase_of_each_order_come_out() -> None:
    recording = shaken(ramp(), 0.02)
    found = sight(recording, [axis()], rows(recording), (6.0, 25.0))
    for order, (amplitude, phase_deg) in TRUE.items():
        part = Part(2, order)
        assert abs(found.amplitude[part]) == pytest.approx(amplitude, rel=0.03)
        assert math.degrees(np.angle(found.amplitude[part])) % 360.0 == pytest.approx(phase_deg, abs=2.0)
    assert abs(found.amplitude[Part(2, 1)]) < 4.0 * math.sqrt(found.variance(Part(2, 1)))


def test_a_model_that_is_off_is_refined() -> None:
    recording = shaken(ramp(), 0.02)
    off = axis(1.08 * ARM_HZ, 2.0 * DAMPING)
    (found,) = refined([recording], [off], [rows(recording)], (6.0, 25.0), [None])
    assert found.response.stretch * 1.08 == pytest.approx(1.0, abs=0.005)
    before, after = (sight(recording, [each], rows(recording), (6.0, 25.0)) for each in (off, found))
    assert np.std(after.residual) < 0.5 * np.std(before.residual)
    assert abs(after.amplitude[Part(2, 2)]) == pytest.approx(5.0, rel=0.1)  # ω and ζ are held to what was believed


def test_the_standard_errors_are_those_of_the_noise() -> None:
    z = []
    for seed in range(8):
        recording = shaken(ramp(), 0.2, seed)
        found = sight(recording, [axis()], rows(recording), (6.0, 25.0))
        for order, (amplitude, phase_deg) in TRUE.items():
            true = amplitude * np.exp(1j * math.radians(phase_deg))
            away = found.amplitude[Part(2, order)] - true
            z += [part / math.sqrt(found.variance(Part(2, order))) for part in (away.real, away.imag)]
    assert 0.5 < float(np.sqrt(np.mean(np.square(z)))) < 1.6


@pytest.mark.parametrize("until_s", [0.6, 0.8, 2.4])
def test_standard_errors_hold_however_short_the_recording(until_s: float) -> None:
    """Waves take a part of the noise for their own, and of a short recording a large one; their band's ends are quieter."""
    quiet, z = shaken(ramp(), 0.0), []
    counted = np.asarray((quiet.time_s > 0.2) & (quiet.time_s < until_s))
    true = sight(quiet, [axis()], counted, (6.0, 25.0)).amplitude
    for seed in range(150):
        noise = 0.2 * np.random.default_rng(seed).standard_normal(len(quiet.time_s))
        noisy = Recording({**quiet.columns, "tip_z_m_s2": quiet.felt_m_s2 + noise})
        found = sight(noisy, [axis()], counted, (6.0, 25.0))
        for part in (Part(2, order) for order in TRUE):
            away, error = found.amplitude[part] - true[part], math.sqrt(found.variance(part))
            z += [away.real / error, away.imag / error]
    assert float(np.sqrt(np.mean(np.square(z)))) == pytest.approx(1.0, abs=0.12)


def test_what_no_row_shows_has_a_huge_standard_error() -> None:
    """An order far below the band has no column to speak of: nothing is known of it, and it is not exactly zero."""
    recording = shaken(ramp(), 0.02)
    found = sight(recording, [axis(orders=(0.001, 2, 4))], rows(recording), (6.0, 25.0))
    assert math.sqrt(found.variance(Part(2, 0.001))) > 1e4


def test_a_planned_motion_does_not_explain_what_it_hardly_shows() -> None:
    """Late in a ramp its start rings no more: a wave that nobody knows stays in the residual."""
    recording = shaken(ramp(), 0.02)
    time, unknown_m_s2 = recording.time_s, 0.1
    columns = {**recording.columns, "tip_z_m_s2": recording.felt_m_s2 + unknown_m_s2 * np.cos(2.0 * math.pi * 11.0 * time)}
    known = replace(axis(), planned_rad=ramp() / RATIO)
    found = sight(Recording(columns), [known], np.asarray((time > 2.0) & (time < 2.3)), (6.0, 25.0))
    own = found.vibration - found.residual - sum(found.wave(part, size) for part, size in found.amplitude.items())
    assert np.max(np.abs(own)) < 0.05 * unknown_m_s2
