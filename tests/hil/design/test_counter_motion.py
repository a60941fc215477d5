"""The waves of a counter-motion add up to the motion that takes the error away, whatever the orders."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.design.counter_motion import MOST_WAVES, counter_motion

ANGLE = np.linspace(0.0, 20.0 * np.pi, 5000)


def motion(amplitude: dict[float, float], phase: dict[float, float]) -> np.ndarray:
    """Δ = −a(θ_0 + Δ) by iteration."""
    delta = np.zeros_like(ANGLE)
    for _ in range(200):
        delta = -sum(size * np.cos(k * (ANGLE + delta) + phase[k]) for k, size in amplitude.items())
    return delta


def waves_sum(amplitude: dict[float, float], phase: dict[float, float]) -> np.ndarray:
    waves = counter_motion(amplitude, phase)
    total = sum(np.real(wave.coefficient * np.exp(1j * wave.order * ANGLE)) for wave in waves)
    return np.asarray(total)


orders = st.lists(st.sampled_from([0.5, 1, 1.7, 2, 3, 4, 6]), min_size=1, max_size=4, unique=True)


@pytest.mark.slow
@given(orders, st.floats(0.01, 0.15), st.integers(0, 2**32 - 1))
def test_the_waves_are_the_motion_but_for_terms_of_fourth_degree(chosen: list[float], bend: float, seed: int) -> None:
    """`bend` is Σ k N A_k: how much faster or slower the motor turns."""
    random = np.random.default_rng(seed)
    share = random.uniform(0.2, 1.0, len(chosen))
    amplitude = {k: bend * part / share.sum() / k for k, part in zip(chosen, share, strict=True)}
    phase = dict(zip(chosen, random.uniform(0.0, 2.0 * np.pi, len(chosen)), strict=True))
    wanted, found = motion(amplitude, phase), waves_sum(amplitude, phase)
    constant = np.mean(wanted - found)  # a constant shakes nothing
    largest = max(amplitude.values())
    assert np.max(np.abs(wanted - found - constant)) <= (5.0 * bend**3 + 0.02) * largest


def test_an_order_of_the_error_comes_first_and_is_the_error_itself() -> None:
    waves = counter_motion({4: 0.01, 1: 0.02}, {4: 0.3, 1: 1.0})
    assert [(wave.order, wave.degree) for wave in waves[:2]] == [(4, 1), (1, 1)]
    assert waves[0].coefficient == pytest.approx(-0.01 * np.exp(0.3j))
    assert {(wave.order, wave.sources) for wave in waves if wave.degree == 2} >= {
        (3.0, frozenset({1, 4})), (5.0, frozenset({1, 4})), (8.0, frozenset({4})), (2.0, frozenset({1}))
    }  # fmt: skip


def test_many_orders_make_no_more_than_so_many_waves() -> None:
    many = {k + 0.1 * k * k: 0.02 for k in range(1, 9)}
    assert len(counter_motion(many, dict.fromkeys(many, 0.4))) <= len(many) + MOST_WAVES


def test_no_error_needs_no_motion() -> None:
    assert counter_motion({}, {}) == ()
