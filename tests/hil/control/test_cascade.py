"""The P-PI cascade against blocks that scipy has discretised."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.control.cascade import CASCADE_CONFIG, CASCADE_STATE, Cascade
from tests.hil.control.law_in_c import cascade_start, cascade_step, hold_integrator, observe_speed

AXIS_2 = Cascade(25.0, 0.196, 3.92, 300.0)


def records(cascade):
    config, state = np.zeros(1, CASCADE_CONFIG)[0], np.zeros(1, CASCADE_STATE)[0]
    cascade.write(config)
    return config, state


def walk(count, period_s, seed):
    """A motor angle that moves, and a reference that does not quite fit it."""
    rng = np.random.default_rng(seed)
    angle = np.cumsum(np.cumsum(rng.standard_normal(count))) * 40.0 * period_s**2
    return angle, angle + 0.02 * np.cumsum(rng.standard_normal(count)), rng.standard_normal(count)


@pytest.mark.parametrize("period_s", [250e-6, 1e-3])
def test_the_law_equals_the_bilinear_blocks_of_scipy(period_s):
    angle, position, offset = walk(4000, period_s, 3)
    angle[0] = position[0] = offset[0] = 0.0
    config, state = records(AXIS_2)
    cascade_start(state, 0.0, 0.0, 0.0)
    speed, torque = np.empty_like(angle), np.empty_like(angle)
    for i in range(len(angle)):
        speed[i] = observe_speed(config, state, period_s, angle[i])
        torque[i], _ = cascade_step(config, state, period_s, position[i], offset[i])
    corner = 2.0 * math.pi * 300.0
    want_speed = signal.lfilter(*signal.bilinear([corner, 0.0], [1.0, corner], fs=1.0 / period_s), angle)
    error = 25.0 * (position - angle) + offset - want_speed
    want = signal.lfilter(*signal.bilinear([0.196, 3.92], [1.0, 0.0], fs=1.0 / period_s), error)
    np.testing.assert_allclose(speed, want_speed, atol=1e-9 * np.max(np.abs(want_speed)))
    np.testing.assert_allclose(torque, want, atol=1e-9 * np.max(np.abs(want)))


def test_a_start_in_motion_under_load_is_without_a_bump():
    config, state = records(AXIS_2)
    speed, period_s = 30.0, 250e-6
    cascade_start(state, 100.0, speed, 0.43)
    for i in range(1, 200):
        angle = 100.0 + speed * period_s * i
        assert observe_speed(config, state, period_s, angle) == pytest.approx(speed, rel=1e-9)
        # the position loop of a moving axis runs v/K_pp behind
        torque, _ = cascade_step(config, state, period_s, angle + speed / 25.0, 0.0)
        assert torque == pytest.approx(0.43, rel=1e-7)


@pytest.mark.parametrize(
    ("excess", "error", "held"),
    [(1.0, 2.0, True), (-1.0, -2.0, True), (1.0, -2.0, False), (-1.0, 2.0, False), (1.0, 0.0, False)],
)
def test_the_integrator_is_held_only_where_the_error_would_wind_it_further(excess, error, held):
    _, state = records(AXIS_2)
    state["integral_nm"], state["error_rad_s"] = 0.9, error
    hold_integrator(state, 0.8, excess)
    assert state["integral_nm"] == (0.8 if held else 0.9)


@pytest.mark.parametrize(
    "values",
    [
        {"position_gain_per_s": -1.0},
        {"velocity_gain_nm_s_rad": -1.0},
        {"velocity_integral_gain_nm_rad": math.nan},
        {"lowpass_hz": 0.0},
    ],
)
def test_a_gain_that_turns_the_loop_round_is_refused_by_name(values):
    gains = {
        "position_gain_per_s": 25.0,
        "velocity_gain_nm_s_rad": 0.1,
        "velocity_integral_gain_nm_rad": 1.0,
        "lowpass_hz": 300.0,
    }
    with pytest.raises(ValueError, match=next(iter(values))):
        Cascade(**{**gains, **values})
