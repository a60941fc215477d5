"""Orders in a vibration: what was put in comes out, at its order, at its speed, with errors that hold."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from hil.design.order_map import order_map, order_track, order_tracks

PERIOD_S = 0.002


def ramp(acceleration_rps_s=4.0, top_rps=10.0, direction=1.0, period_s=PERIOD_S):
    """Motor angle of a ramp from rest, rad."""
    time = np.arange(0.0, top_rps / acceleration_rps_s, period_s)
    return direction * math.pi * acceleration_rps_s * time**2


def there_and_back(period_s=PERIOD_S):
    """Up, down, a pause, and backwards: speeds to 8 rev/s."""
    up = np.linspace(0.0, 8.0, 1000)
    speed = np.concatenate([up, up[::-1], np.zeros(200), -up, -up[::-1]])
    return 2.0 * math.pi * np.cumsum(speed) * period_s


@given(
    amplitude=st.tuples(*[st.floats(0.01, 5.0)] * 3),
    phase=st.tuples(*[st.floats(-180.0, 180.0)] * 3),
    slow=st.tuples(*[st.floats(-3.0, 3.0)] * 2),
    forwards=st.booleans(),
)
@settings(max_examples=12)
def test_each_order_comes_out_as_it_was_put_in(amplitude, phase, slow, forwards):
    angle = ramp(direction=1.0 if forwards else -1.0)
    turned = np.abs(angle) / np.max(np.abs(angle))
    orders = (1.0, 2.0, 4.0)
    vibration = slow[0] + slow[1] * turned + sum(
        a * np.cos(k * angle + math.radians(p)) for k, a, p in zip(orders, amplitude, phase, strict=True)
    )  # fmt: skip
    track = order_track(angle, vibration, PERIOD_S, orders)
    assert np.all(track.direction == (1.0 if forwards else -1.0))
    wanted = np.array(amplitude) * np.exp(1j * np.radians(phase))
    assert np.allclose(track.component, wanted, rtol=1e-6, atol=1e-6)


def test_the_map_shows_an_order_as_a_line_of_its_height():
    angle = there_and_back()
    orders = np.arange(0.5, 10.01, 0.25)
    found = order_map(angle, 3.0 + 0.7 * np.cos(2.0 * angle + 0.4), PERIOD_S, orders)
    assert set(found.direction) == {-1.0, 1.0}
    assert np.all(np.diff(found.speed_rps) >= 0.0)
    line = found.amplitude[:, orders == 2.0][:, 0]
    assert np.allclose(line, 0.7, rtol=0.03)
    away = found.amplitude[:, np.abs(orders - 2.0) > 1.0]
    assert np.nanmax(away) < 0.1 * 0.7
    assert np.all(orders[np.nanargmax(found.amplitude, axis=1)] == 2.0)


def test_a_resonance_is_a_hyperbola():
    angle = ramp(2.0, 10.0)
    time = PERIOD_S * np.arange(len(angle))
    orders = np.arange(0.5, 10.01, 0.05)
    found = order_map(angle, np.sin(2.0 * math.pi * 12.0 * time), PERIOD_S, orders)
    fast = found.speed_rps > 3.0
    peak = orders[np.nanargmax(found.amplitude[fast], axis=1)]
    assert np.allclose(peak * found.speed_rps[fast], 12.0, rtol=0.05)


def test_speeds_of_windows_are_the_motors():
    angle = np.linspace(0.0, 2.0 * math.pi * 40.0, 4001)  # 5 rev/s
    found = order_map(angle, np.cos(angle), PERIOD_S, np.array([1.0]))
    assert np.allclose(found.speed_rps, 5.0, rtol=1e-6)


def test_a_component_is_followed_as_it_swells_and_falls():
    angle = ramp(1.0, 10.0)
    speed = np.gradient(angle, PERIOD_S) / (2.0 * math.pi)
    swell = 1.0 / np.hypot(1.0, (speed - 6.0) / 0.5)
    track = order_track(angle, swell * np.cos(2.0 * angle), PERIOD_S, (1.0, 2.0, 4.0))
    top = int(np.argmax(track.amplitude[:, 1]))
    assert track.speed_rps[top] == pytest.approx(6.0, abs=0.1)
    assert track.amplitude[top, 1] == pytest.approx(1.0, abs=0.05)
    assert np.max(track.amplitude[:, (0, 2)]) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["white", "low-passed"])
def test_standard_errors_hold(colour):
    rng = np.random.default_rng(20261122)
    angle, z = ramp(1.5, 9.0), []
    for _ in range(25):
        noise = rng.normal(0.0, 0.2, len(angle))
        if colour == "low-passed":
            noise = 3.0 * signal.sosfilt(signal.butter(2, 60.0, fs=1.0 / PERIOD_S, output="sos"), noise)
        track = order_track(angle, np.cos(2.0 * angle + 1.0) + 0.5 * np.cos(4.0 * angle) + noise, PERIOD_S, (2.0, 4.0))
        rows = np.arange(0, len(track.speed_rps), 8)  # windows that do not overlap
        z.append(((track.amplitude - [1.0, 0.5]) / track.standard_error)[rows])
    rms = np.sqrt(np.mean(np.concatenate(z) ** 2))
    assert 0.7 < rms < 1.5, rms


def test_an_order_above_what_the_samples_show_is_not_shown():
    angle = ramp(4.0, 10.0, period_s=0.008)
    found = order_map(angle, np.cos(2.0 * angle), 0.008, np.array([2.0, 10.0]))
    assert np.all(np.isfinite(found.amplitude[:, 0]))
    assert np.all(np.isnan(found.amplitude[found.speed_rps > 3.2, 1]))
    assert np.all(np.isfinite(found.amplitude[found.speed_rps < 3.0, 1]))


@pytest.mark.parametrize(
    ("angle", "values", "period_s", "orders", "turns", "words"),
    [
        (np.zeros(50), np.zeros(50), PERIOD_S, [2.0], 2.0, "never makes 2 turns"),
        (ramp(), np.zeros(3), PERIOD_S, [2.0], 2.0, "do not match"),
        (ramp(), np.zeros(1250), PERIOD_S, [0.0, 2.0], 2.0, "positive"),
        (ramp(), np.zeros(1250), 0.0, [2.0], 2.0, "positive"),
        (ramp(), np.zeros(1250), PERIOD_S, [2.0], -1.0, "positive"),
        (ramp(), np.zeros(1250), PERIOD_S, [], 2.0, "positive"),
    ],
)
def test_what_cannot_be_mapped_is_refused_with_its_values(angle, values, period_s, orders, turns, words):
    with pytest.raises(ValueError, match=words):
        order_map(angle, values, period_s, np.array(orders), turns)


def test_orders_too_close_are_refused():
    with pytest.raises(ValueError, match=r"0\.25 apart"):
        order_track(ramp(), np.zeros(1250), PERIOD_S, (2.0, 2.25))


def test_signals_of_one_motion_are_each_what_they_are_alone():
    angle, rng = ramp(), np.random.default_rng(2)
    signals = [np.cos(2.0 * angle + 1.0), rng.standard_normal(len(angle)), np.cumsum(rng.standard_normal(len(angle)))]
    for each, track in zip(signals, order_tracks(angle, signals, PERIOD_S, (1.0, 2.0, 4.0)), strict=True):
        alone = order_track(angle, each, PERIOD_S, (1.0, 2.0, 4.0))
        np.testing.assert_allclose(track.component, alone.component, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(track.standard_error, alone.standard_error, rtol=1e-9)
