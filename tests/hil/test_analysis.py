"""The metrics on signals whose answers are known."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.analysis import (
    LINE_BAND_HZ,
    PAPER_BAND_HZ,
    PAPER_WINDOWS_RPS,
    amplitude_spectrum,
    area,
    constant_acceleration_metrics,
    joint_scale,
    line_motion_metrics,
    line_window_s,
    motor_speed_rps,
    paper_scale,
    shown_band,
    speed_window,
    tip_displacement_mm,
    tip_scale,
    without_phase,
)
from hil.recording import Recording

T = 0.002
F_AL = 11.84
PAPER = paper_scale(F_AL)


def recording(acceleration, revolutions=None, axis=2):
    """A recording of the tip and of one axis."""
    acceleration = np.asarray(acceleration)
    turns = np.zeros_like(acceleration) if revolutions is None else revolutions
    return Recording(
        {
            "time_s": np.arange(len(acceleration)) * T,
            f"axis{axis}_position_rad": 2.0 * math.pi * turns,
            "tip_z_m_s2": acceleration,
        }
    )


def band_gain(f_hz):
    """What the band-pass, forward and backward, leaves of a sine."""
    _, h = signal.sosfreqz(signal.butter(2, (6.0, 25.0), "bandpass", fs=1.0 / T, output="sos"), [f_hz], fs=1.0 / T)
    return float(abs(h[0]) ** 2)


@pytest.mark.parametrize(("period_s", "shown"), [(0.001, (15.0, 64.0)), (0.0078, (15.0, 64.0)), (0.008, (15.0, 56.25))])
def test_a_band_is_judged_as_far_as_samples_show_it(period_s, shown):
    assert shown_band(period_s, (15.0, 64.0)) == pytest.approx(shown)


def test_samples_that_show_too_little_of_a_band_are_refused_with_the_period_that_is_needed():
    with pytest.raises(ValueError, match=r"samples every 12 ms show vibrations up to 37.5 Hz only; 44.8 Hz need .* every 10 ms"):
        shown_band(0.012, (15.0, 64.0))


@pytest.mark.parametrize("kind", ["lowpass", "highpass", "bandpass"])
def test_a_filter_without_phase_is_scipys_to_the_last_bit(kind):
    source = np.random.default_rng(3)
    for period_s in (250e-6, 1e-3, 2e-3):
        for _ in range(30):
            corners = np.sort(np.exp(source.uniform(math.log(0.1), math.log(0.48 / period_s), 2 if kind == "bandpass" else 1)))
            values = source.standard_normal(200)
            sections = signal.butter(2, np.squeeze(corners), kind, fs=1.0 / period_s, output="sos")
            wanted = signal.sosfiltfilt(sections, values)
            assert np.array_equal(without_phase(values, period_s, kind, *corners), wanted)
            several = without_phase(np.stack([values[::-1], values, 2.0 * values]), period_s, kind, *corners)
            assert np.array_equal(several, [signal.sosfiltfilt(sections, values[::-1]), wanted, 2.0 * wanted])


@pytest.mark.parametrize("f_hz", [8.0, 11.84, 20.0])
def test_the_tip_displacement_of_a_sine_is_its_acceleration_over_the_resonance_squared(f_hz):
    t = np.arange(5000) * T
    middle = tip_displacement_mm(0.5 * np.sin(2.0 * math.pi * f_hz * t), T, PAPER)[1000:4000]
    want = 1e3 * 0.5 * band_gain(f_hz) / (2.0 * math.pi * F_AL) ** 2
    assert np.max(np.abs(middle)) == pytest.approx(want, rel=1e-2)
    # without phase: the crests stay where they were
    assert np.corrcoef(middle, np.sin(2.0 * math.pi * f_hz * t)[1000:4000])[0, 1] > 0.9999


def test_at_the_resonance_itself_the_displacement_is_nearly_the_true_one():
    assert band_gain(F_AL) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("f_hz", [0.5, 120.0])
def test_motion_and_noise_outside_the_band_do_not_count_as_vibration(f_hz):
    t = np.arange(8000) * T
    # half a cosine period at either end would be a transient of the filter, so only the middle is read
    middle = tip_displacement_mm(np.cos(2.0 * math.pi * f_hz * t), T, PAPER)[2000:6000]
    assert np.max(np.abs(middle)) < 1e3 * 0.01 / (2.0 * math.pi * F_AL) ** 2


@pytest.mark.parametrize("window", ["hann", "boxcar"])
@pytest.mark.parametrize("count", [1000, 1001])
def test_the_spectrum_shows_a_sine_of_amplitude_1_as_1_and_the_mean_as_it_is(window, count):
    cycles = 40
    n = np.arange(count)
    f, amplitude = amplitude_spectrum(0.3 + np.sin(2.0 * math.pi * cycles * n / count), T, window)
    assert amplitude[cycles] == pytest.approx(1.0, abs=1e-9)
    assert f[cycles] == pytest.approx(cycles / (count * T))
    assert amplitude[0] == pytest.approx(0.3, abs=1e-9)


def test_the_spectrums_last_line_is_not_counted_twice():
    alternating = np.where(np.arange(200) % 2 == 0, 1.0, -1.0)
    _, amplitude = amplitude_spectrum(alternating, T, "boxcar")
    assert amplitude[-1] == pytest.approx(1.0)


def test_the_power_of_the_rectangular_spectrum_is_that_of_the_signal():
    """Parseval."""
    values = np.random.default_rng(2).standard_normal(1001)
    _, amplitude = amplitude_spectrum(values, T, "boxcar")
    assert amplitude[0] ** 2 + 0.5 * np.sum(amplitude[1:] ** 2) == pytest.approx(np.mean(values**2))


def test_the_area_is_the_trapezoid_rule_over_the_band_and_no_more():
    f = np.arange(0.0, 101.0)
    assert area(f, np.full_like(f, 2.0), (10.0, 30.0)) == pytest.approx(40.0)
    assert area(f, f, LINE_BAND_HZ) == pytest.approx(1250.0)


@pytest.mark.parametrize("rate", [4.0, -4.0])
def test_the_motor_speed_is_the_slope_of_the_angle_without_delay(rate):
    t = np.arange(1500) * T
    speed = motor_speed_rps(recording(np.zeros(1500), 0.5 * rate * t**2), 2)
    np.testing.assert_allclose(speed[100:-100], (rate * t)[100:-100], atol=1e-3)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("order", [2, 4])
def test_the_window_holds_the_rise_through_its_speeds_and_not_the_fall(order, direction):
    up, down = np.arange(0.0, 10.0, 4.0 * T), np.arange(10.0, 0.0, -20.0 * T)
    speed = np.concatenate([np.zeros(200), up, down, np.zeros(200)])
    inside = np.flatnonzero(
        speed_window(recording(np.zeros_like(speed), direction * np.cumsum(speed) * T), 2, PAPER_WINDOWS_RPS[order])
    )
    low, high = PAPER_WINDOWS_RPS[order]
    assert speed[inside[0]] == pytest.approx(low, abs=0.05)
    assert speed[inside[-1]] == pytest.approx(high, abs=0.05)
    assert np.all(np.diff(inside) == 1)
    assert inside[-1] < 200 + len(up)


def test_a_single_axis_run_is_judged_in_its_window_only():
    """A sine of known size inside the window of k = 2, ten times as much before it."""
    speed = np.concatenate([np.arange(0.0, 10.0, 1.0 * T), np.arange(10.0, 0.0, -20.0 * T), np.zeros(500)])
    t = np.arange(len(speed)) * T
    wave = np.sin(2.0 * math.pi * 12.0 * t)
    acceleration = np.where(speed < 3.0, 2.0, 0.2) * wave
    run = recording(acceleration, np.cumsum(speed) * T)
    found = constant_acceleration_metrics(run, 2, 2, PAPER)
    peak = 1e3 * 0.2 * band_gain(12.0) / (2.0 * math.pi * F_AL) ** 2
    assert found.tip_peak_mm == pytest.approx(peak, rel=0.02)
    assert found.tip_rms_mm == pytest.approx(peak / math.sqrt(2.0), rel=0.02)
    assert found.spectrum_peak_m_s2 == pytest.approx(0.2, rel=0.02)
    assert found.spectrum_peak_hz == pytest.approx(12.0, abs=0.2)
    f, amplitude = amplitude_spectrum(acceleration[speed_window(run, 2, PAPER_WINDOWS_RPS[2])], T, "hann")
    assert found.spectrum_area == pytest.approx(area(f, amplitude, PAPER_BAND_HZ))


def test_a_run_that_misses_the_window_is_refused_with_the_count():
    slow = np.linspace(0.0, 2.0, 1000)
    with pytest.raises(ValueError, match=r"0 samples between 4\.5 and 7\.5 rev/s"):
        constant_acceleration_metrics(recording(np.zeros(1000), np.cumsum(slow) * T), 2, 2, PAPER)


def test_a_line_motion_is_judged_from_half_a_second_to_two_and_its_spectrum_over_the_motion():
    t = np.arange(2500) * T
    start, duration = 1.0, 2.2
    f_hz = 27.0 / (1101 * T)  # whole cycles in the motion's 1101 samples
    wave = np.sin(2.0 * math.pi * f_hz * (t - start))
    size = np.where(t < start, 5.0, np.where(t < start + 2.2, 0.3, 3.0))
    found = line_motion_metrics(recording(size * wave), start, duration, PAPER)
    assert found.tip_peak_mm == pytest.approx(1e3 * 0.3 * band_gain(f_hz) / (2.0 * math.pi * F_AL) ** 2, rel=0.02)
    assert found.spectrum_peak_m_s2 == pytest.approx(0.3, rel=1e-3)
    assert found.spectrum_peak_hz == pytest.approx(f_hz)
    f, amplitude = amplitude_spectrum((size * wave)[(t >= start) & (t <= start + duration)], T, "boxcar")
    assert found.spectrum_area == pytest.approx(np.trapezoid(amplitude[f <= 50.0], f[f <= 50.0]))


def test_halving_the_vibration_halves_every_metric():
    speed = np.concatenate([np.arange(0.0, 10.0, 4.0 * T), np.arange(10.0, 0.0, -20.0 * T), np.zeros(300)])
    noise = np.random.default_rng(3).standard_normal(len(speed))
    whole = constant_acceleration_metrics(recording(noise, np.cumsum(speed) * T), 2, 2, PAPER)
    half = constant_acceleration_metrics(recording(0.5 * noise, np.cumsum(speed) * T), 2, 2, PAPER)
    for name in ("tip_peak_mm", "tip_rms_mm", "spectrum_peak_m_s2", "spectrum_area"):
        assert getattr(half, name) == pytest.approx(0.5 * getattr(whole, name))
    assert half.spectrum_peak_hz == whole.spectrum_peak_hz


def test_every_window_and_band_of_an_axis_is_reckoned_from_its_own_f_al():
    one, twice = tip_scale(9.0), tip_scale(18.0)
    assert twice.band_hz == tuple(2.0 * edge for edge in one.band_hz)
    assert twice.windows_rps[4] == one.windows_rps[2]
    low, high = twice.windows_rps[2]
    assert low < 18.0 / 2.0 < high
    assert (low, high) == pytest.approx((6.84, 11.43))


def test_a_resonance_at_twice_the_papers_frequency_is_judged_where_it_is():
    """A sine that is loud at 9 rev/s alone, where order 2 meets 18 Hz, and silent at the speeds of the paper's robot."""
    speed = np.concatenate([np.arange(0.0, 12.0, 2.0 * T), np.arange(12.0, 0.0, -20.0 * T), np.zeros(500)])
    t = np.arange(len(speed)) * T
    acceleration = 0.4 * np.sin(2.0 * math.pi * 18.0 * t) * np.exp(-(((speed - 9.0) / 0.6) ** 2))
    found = constant_acceleration_metrics(recording(acceleration, np.cumsum(speed) * T), 2, 2, tip_scale(18.0))
    assert found.tip_peak_mm == pytest.approx(1e3 * 0.4 / (2.0 * math.pi * 18.0) ** 2, rel=0.05)
    assert found.ramp_peak_mm == found.tip_peak_mm


def test_the_peak_of_the_whole_ramp_stands_beside_that_of_the_window():
    speed = np.concatenate([np.arange(0.0, 10.0, 2.0 * T), np.arange(10.0, 0.0, -20.0 * T), np.zeros(500)])
    t = np.arange(len(speed)) * T
    acceleration = np.sin(2.0 * math.pi * F_AL * t) * np.where(speed > 8.0, 0.6, 0.2)
    found = constant_acceleration_metrics(recording(acceleration, np.cumsum(speed) * T), 2, 2, PAPER)
    assert found.tip_peak_mm == pytest.approx(1e3 * 0.2 / (2.0 * math.pi * F_AL) ** 2, rel=0.05)
    assert found.ramp_peak_mm == pytest.approx(1e3 * 0.6 / (2.0 * math.pi * F_AL) ** 2, rel=0.1)


def test_a_ramp_that_ends_before_the_resonance_is_not_judged():
    speed = np.concatenate([np.arange(0.0, 8.9, 4.0 * T), np.arange(8.9, 0.0, -20.0 * T), np.zeros(300)])
    run = recording(np.zeros_like(speed), np.cumsum(speed) * T)
    with pytest.raises(ValueError, match=r"order 2 meets f_al = 18\.00 Hz at 9\.00 rev/s; raise end_rps .* by 0\.\d rev/s"):
        constant_acceleration_metrics(run, 2, 2, tip_scale(18.0))


def test_without_an_f_al_a_line_has_an_area_and_no_millimetre():
    t = np.arange(2500) * T
    found = line_motion_metrics(recording(0.2 * np.sin(75.0 * t)), 0.2, 2.2, None)
    assert found.spectrum_area == line_motion_metrics(recording(0.2 * np.sin(75.0 * t)), 0.2, 2.2, PAPER).spectrum_area
    assert found.tip_peak_mm is found.tip_rms_mm is found.spectrum_peak_m_s2 is None


@pytest.mark.parametrize(("duration_s", "window"), [(2.2, (0.5, 2.0)), (5.0, (0.5, 4.8)), (1.0, (0.25, 0.9))])
def test_the_line_is_judged_but_for_its_ends(duration_s, window):
    assert line_window_s(duration_s) == pytest.approx(window)


def test_the_papers_line_is_judged_from_0_5_to_2_seconds_exactly():
    assert line_window_s(2.2) == (0.5, 2.0)


def test_several_axes_are_judged_by_the_lowest_f_al_and_all_bands():
    joint = joint_scale([tip_scale(18.0), tip_scale(10.0)])
    assert joint.f_al_hz == 10.0
    assert joint.band_hz == (tip_scale(10.0).band_hz[0], tip_scale(18.0).band_hz[1])
    with pytest.raises(ValueError, match="no scale"):
        joint_scale([])
