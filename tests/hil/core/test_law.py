"""The law in C computes what the law in plain Python says, to the last bit."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.control.cancellation import CANCELLATION_CONFIG, CANCELLATION_STATE, WAVE_COLUMNS
from hil.control.cascade import Cascade
from hil.control.following import FollowingSettings
from hil.control.notch import NOTCHES, FixedFilter, Notch, notch_coefficients, notch_weight
from hil.control.servo import LAW
from hil.core.library import CORE
from tests.hil.control.inside import inner_cancellation
from tests.oracles import following, law
from tests.oracles.records import numbers, plain

SEEDS = st.integers(0, 2**32 - 1)
STEPS = 100_000


def random_filter(source):
    """A filter of any kind."""
    kind = source.integers(0, 4)
    if kind == 3:
        a2 = source.uniform(-0.95, 0.95)
        return FixedFilter(*source.uniform(-2.0, 2.0, 3), source.uniform(-1.0, 1.0) * (1.0 + a2), a2)
    start = source.uniform(0.5, 8.0)
    shape = {"order": int(source.integers(1, 5)), "start_rps": start, "end_rps": start + source.uniform(0.5, 6.0)}
    shape |= {"offset_hz": source.uniform(0.0, 2.0), "zeta_rn": source.uniform(0.01, 0.3), "zeta_rdth": source.uniform(0.05, 0.9)}
    return Notch(int(kind), **shape, hysteresis_rps=source.uniform(0.0, 0.4) * start, ramp_rps=source.uniform(0.1, 2.0))


def random_law(source):
    """A record of the law with gains and filters of its own."""
    laws = np.zeros(1, LAW)
    Cascade(source.uniform(1.0, 80.0), source.uniform(0.001, 0.2), source.uniform(0.0, 5.0), source.uniform(20.0, 900.0)).write(
        laws["cascade_config"][0]
    )
    for column in range(NOTCHES):
        random_filter(source).write(laws["notch_config"][0, column])
    return laws


def same_steps(seed, steps):
    """Run both laws side by side on a motor whose speed wanders through the filters' ranges."""
    source = np.random.default_rng(seed)
    laws, period_s, limit_nm = random_law(source), source.choice([62.5e-6, 250e-6, 1e-3, 2e-3]), source.uniform(0.05, 3.0)
    spec, pointer = plain(laws[0]), CORE.pointer(laws, "law")
    angle, speed = source.uniform(-5.0, 5.0), source.uniform(-60.0, 60.0)
    CORE.call.servo_start(pointer, angle, speed, 0.1)
    law.servo_start(spec, angle, speed, 0.1)
    draws = source.standard_normal((steps, 4))
    for i in range(steps):
        speed = 0.999 * speed + 2.0 * draws[i, 0]
        angle += speed * period_s
        given_to = (angle + 0.02 * draws[i, 1], 0.3 * draws[i, 2], 0.05 * draws[i, 3], angle)
        torque = CORE.call.servo_step(pointer, period_s, limit_nm, *map(float, given_to))
        assert torque == law.servo_step(spec, float(period_s), limit_nm, *map(float, given_to)), f"step {i}"
    assert numbers(laws[0]) == numbers(spec)


@given(SEEDS)
@settings(max_examples=20)
def test_the_law_is_that_of_the_specification_to_the_last_bit(seed):
    same_steps(seed, 300)


@pytest.mark.ci
@pytest.mark.parametrize("seed", range(3))
def test_the_law_is_that_of_the_specification_over_a_hundred_thousand_steps(seed):
    same_steps(seed, STEPS)


@given(SEEDS)
def test_coefficients_and_weight_are_those_of_the_specification(seed):
    source = np.random.default_rng(seed)
    zero_hz = source.uniform(0.5, 60.0)
    arguments = (zero_hz, zero_hz + source.uniform(0.0, 3.0), source.uniform(0.01, 0.5), source.uniform(0.01, 0.9), 250e-6)
    assert notch_coefficients(*arguments) == law.notch_coefficients(*arguments)
    shape = (int(source.integers(1, 3)), source.uniform(0.0, 12.0), 4.0, 9.0, source.uniform(0.1, 2.0))
    assert notch_weight(*shape) == law.notch_weight(*shape)


@given(SEEDS)
@settings(max_examples=20)
def test_the_cancellation_is_that_of_the_specification_to_the_last_bit(seed):
    source = np.random.default_rng(seed)
    axes, waves, speeds, period_s = 2, 3, 7, 1e-3
    configs, states = np.zeros(axes, CANCELLATION_CONFIG), np.zeros(axes, CANCELLATION_STATE)
    for name in CANCELLATION_CONFIG.names:
        configs[name] = source.uniform(0.01, 2.0, axes)
    configs["torque_step_nm"] = [0.0, 0.001]
    configs["speed_lowpass_hz"] = 20.0
    lines, table = source.uniform(-3.0, 3.0, (axes, waves, 3)), source.uniform(-1.0, 1.0, (axes, waves, speeds, WAVE_COLUMNS))
    spec = [plain(each) for each in configs], [plain(each) for each in states]
    values = np.zeros((2, axes))
    shared, given = CORE.new("cancellation"), [CORE.pointer(each) for each in (lines, table)]
    shared.configs, shared.states = CORE.pointer(configs, "cancellation_config"), CORE.pointer(states, "cancellation_state")
    shared.waves, shared.table = given
    shared.count, shared.wave_count, shared.speeds, shared.period_s = axes, waves, speeds, period_s
    angle = np.zeros(axes)
    for _ in range(200):
        angle += period_s * 2.0 * math.pi * source.uniform(-8.0, 8.0, axes)
        values[:] = angle, source.uniform(-1.0, 1.0, axes)
        given_to = values.tolist()
        CORE.call.cancel(shared, CORE.pointer(values))
        for row in range(axes):
            expected = law.cancellation_step(
                spec[0][row], spec[1][row], lines[row].tolist(), table[row].tolist(), period_s, given_to[0][row], given_to[1][row]
            )
            assert tuple(values[:, row].tolist()) == expected
    assert numbers(states) == numbers(spec[1])


@given(SEEDS)
def test_the_cancellation_in_a_drive_is_that_of_the_specification(seed):
    source = np.random.default_rng(seed)
    known, at = law.InnerCancellation(*source.uniform(-0.3, 0.3, 8).tolist()), source.uniform(-50.0, 50.0, 2).tolist()
    assert inner_cancellation(known, 300.0, 250e-6, *at) == law.inner_cancellation(known, 300.0, 250e-6, *at)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.ci) for seed in (1, 2, 3))])
def test_the_observer_that_follows_is_that_of_the_specification_to_the_last_bit(seed):
    source = np.random.default_rng(seed)
    n_axes, n_orders, period_s = 1 + seed % 3, 1 + seed % 2, 1e-3
    config = np.zeros(1, CORE.dtype("following_config"))
    config[0] = (period_s, *astuple(FollowingSettings()))
    arms, orders = np.zeros(n_axes, CORE.dtype("following_arm")), np.zeros((n_axes, n_orders), CORE.dtype("following_order"))
    for arm in arms:
        f_al = source.uniform(50.0, 90.0)
        arm["a11"], arm["a12"], arm["a21"], arm["a22"] = 0.995, 1e-3, -f_al * f_al * 1e-3, 0.99
        arm["b1"], arm["b2"], arm["stiff"], arm["damping"] = 5e-7, 1e-3, f_al * f_al, 0.05 * f_al
        arm["spring"], arm["dashpot"], arm["f_al_rad_s"], arm["reduction_ratio"], arm["delay_s"] = f_al**2, 3.0, f_al, 100.0, 2e-3
    orders["order"], orders["phase_rad"] = source.integers(1, 5, orders.shape), source.uniform(-3.0, 3.0, orders.shape)
    orders["order"][0, 0], orders["amplitude_rad"] = 2.0, source.uniform(1e-5, 3e-4, orders.shape)
    band, size = np.array([0.02, 0.0, -0.02, -1.95, 0.96]), 2 * n_axes * (1 + n_orders)
    axes, common = np.zeros(n_axes, CORE.dtype("following_axis")), np.zeros(1, CORE.dtype("following_common"))
    filters, states = np.zeros((1 + 2 * n_axes * n_orders + n_axes, CORE.call.BAND_MEMORY)), np.zeros(size)
    covariance, factors = np.diag([0.0] * 2 * n_axes + [0.01] * (size - 2 * n_axes)), np.zeros((n_axes, n_orders, 2))
    factors[:, :, 0] = 1.0
    order_states, samples, heard = (
        np.zeros((n_axes, n_orders), CORE.dtype("following_order_state")),
        np.zeros((3, n_axes)),
        np.zeros(2),
    )
    of = CORE.new("following")
    records = {"config": config, "arms": arms, "orders": orders, "axes": axes, "common": common, "order_states": order_states}
    kinds = {
        "config": "config",
        "arms": "arm",
        "orders": "order",
        "axes": "axis",
        "common": "common",
        "order_states": "order_state",
    }
    arrays = {"band": band, "filters": filters, "states": states, "covariance": covariance, "factors": factors}
    arrays["room"] = np.zeros(CORE.call.following_room(n_axes, n_orders))
    kept = {name: CORE.pointer(array, f"following_{kinds[name]}") for name, array in records.items()}
    kept |= {name: CORE.pointer(array) for name, array in arrays.items()}
    for name, pointer in kept.items():
        setattr(of, name, pointer)
    of.n_axes, of.n_orders = n_axes, n_orders

    def as_numbers(array):
        return array.copy().view(np.float64).reshape(*array.shape, -1)

    spec = [as_numbers(each) for each in (config, arms, orders)]
    spec = [spec[0][0], spec[1], spec[2], band.copy(), as_numbers(axes), as_numbers(common)[0], filters.copy(), states.copy()]
    spec += [covariance.copy(), factors.copy(), as_numbers(order_states)]
    angle, moved = np.zeros(n_axes), set()
    for i in range(2500):
        speed = 2.0 * math.pi * min(8.0, max(0.0, 0.004 * (i - 300)))
        angle = angle + period_s * speed * (1.0 - 0.2 * np.arange(n_axes))
        tip = 0.4 * math.sin(2.0 * angle[0]) if i > 300 else 0.0
        samples[:] = angle, angle, 0.4 + 0.1 * np.arange(n_axes)
        heard[:] = tip + 0.003 * source.standard_normal(), float(i % 41 != 0)
        CORE.call.follow_step(of, CORE.pointer(samples), CORE.pointer(heard))
        following.follow_step(*spec, samples.copy(), heard.copy())
        moved.add(float(factors[0, 0, 0]))
    assert len(moved) > 10
    for mine, theirs in ((states, spec[7]), (covariance, spec[8]), (factors, spec[9]), (filters, spec[6])):
        assert np.array_equal(mine, theirs)
    assert np.array_equal(as_numbers(order_states), spec[10])
