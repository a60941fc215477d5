"""The fixed filter: a given second-order section in the law, started at rest, at every speed."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from scipy import signal

from hil.control.cascade import Cascade
from hil.control.notch import NO_NOTCH, NOTCH_CONFIG, NOTCH_FIXED, NOTCH_STATE, NOTCHES, FixedFilter, Notch
from hil.control.servo import Servo, ServoConfig
from tests.hil.control.law_in_c import notch_step

T = 250e-6
AXIS_2 = Cascade(25.0, 0.196, 3.92, 300.0)


def section(frequency_hz=12.0, zeta_zero=0.03, zeta_pole=0.5, gain=1.0):
    zero = 2.0 * math.pi * frequency_hz
    b, a = signal.bilinear([gain, gain * 2 * zeta_zero * zero, gain * zero**2], [1.0, 2 * zeta_pole * zero, zero**2], fs=1.0 / T)
    return FixedFilter(b[0], b[1], b[2], a[1], a[2])


LOW_PASS = FixedFilter(0.25, 0.25, 0.0, -0.5, 0.0)
LEAD = section(gain=1.7)


def run(filters, values, speed=0.0, mean=0.0):
    config, state = np.zeros((1, NOTCHES), NOTCH_CONFIG), np.zeros((1, NOTCHES), NOTCH_STATE)
    for column in range(NOTCHES):
        (filters[column] if column < len(filters) else NO_NOTCH).write(config[0, column])
    state["mean_nm"] = mean
    out = []
    for value in values:
        for column in range(NOTCHES):
            value = notch_step(config[0, column], state[0, column], T, speed, value)  # noqa: PLW2901 - in series
        out.append(value)
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize("filters", [(section(),), (LOW_PASS,), (LEAD,), (section(), section(40.0)), (LOW_PASS, section())])
@pytest.mark.parametrize("speed", [0.0, 2.0 * math.pi * 6.0])
def test_it_is_scipys_filter_at_every_speed(filters, speed):
    u = np.random.default_rng(3).standard_normal(3000)
    want = u
    for each in filters:
        want = signal.lfilter([each.b0, each.b1, each.b2], [1.0, each.a1, each.a2], want)
    np.testing.assert_allclose(run(filters, u, speed)[200:], want[200:], atol=0.3 if len(filters) > 1 else 0.2)
    # from rest, without the low-passed start, to the last digit
    quiet = np.concatenate((np.zeros(4), u))
    want = quiet
    for each in filters:
        want = signal.lfilter([each.b0, each.b1, each.b2], [1.0, each.a1, each.a2], want)
    np.testing.assert_allclose(run(filters, quiet, speed), want, rtol=0, atol=1e-12)


@pytest.mark.parametrize("filters", [(section(),), (LOW_PASS,), (LEAD,)])
@pytest.mark.parametrize("torque", [0.0, 1.5, -0.4])
def test_it_starts_as_if_the_torque_had_stood_there_for_ever(filters, torque):
    rest = torque * math.prod((f.b0 + f.b1 + f.b2) / (1.0 + f.a1 + f.a2) for f in filters)
    np.testing.assert_allclose(run(filters, np.full(400, torque), mean=torque), rest, atol=1e-12)


def test_the_law_runs_it_behind_the_pi_beside_a_variable_notch():
    fixed = section(30.0)
    for filters in ((fixed,), (Notch(), fixed), (fixed, Notch())):
        servo = Servo(ServoConfig(AXIS_2, 7.1, filters), T)
        servo.start(0.0, 2.0 * math.pi * 6.0, 0.4)
        angle, speed = 0.0, 2.0 * math.pi * 6.0
        for _ in range(400):
            angle += speed * T
            assert servo.step(angle + speed / 25.0, angle) == pytest.approx(0.4, rel=1e-6)
        assert servo.notch_state["active"][0, : len(filters)].all()


def test_writing_it_sets_its_mode_and_coefficients_and_writing_a_notch_takes_it_out():
    row = np.zeros(1, NOTCH_CONFIG)
    fixed = section()
    fixed.write(row[0])
    assert row[0]["mode"] == NOTCH_FIXED
    assert tuple(row[0][name] for name in ("b0", "b1", "b2", "a1", "a2")) == astuple(fixed)
    NO_NOTCH.write(row[0])
    assert row[0]["mode"] == 0


@pytest.mark.parametrize(
    ("coefficients", "word"),
    [
        ((math.nan, 0, 0, 0, 0), "b0"),
        ((1, 0, 0, math.inf, 0), "a1"),
        ((1, 0, 0, 0, 1.0), "not stable"),
        ((1, 0, 0, -2.0, 1.0), "not stable"),
        ((1, 0, 0, 1.2, 0.1), "not stable"),
        ((1, 0, 0, -1.0, 0.0), "not stable"),
    ],
)
def test_what_would_run_away_is_refused(coefficients, word):
    with pytest.raises(ValueError, match=word):
        FixedFilter(*coefficients)
