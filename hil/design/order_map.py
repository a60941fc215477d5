"""Vibration by motor speed and order: what turns with the motor, in the angle domain.

An error of order k shakes the arm at k θ_m, at whatever speed. In windows of a few turns the vibration a(t) is therefore
compared with sines of the motor's angle instead of time: in an order map with a sine of every order, one after the other,

    A(k) = |2 ∫ w a e^{−jkθ} |dθ|| / ∫ w |dθ|,

where an error is a vertical line, and a resonance f the hyperbola k f_m = f, on which the line swells; and in an order track
with sines of a few orders at once and a slow curve, by least squares, which separates orders whose lines in the map overlap and
has standard errors. Both take samples at any times, and motors that speed up, slow down and turn back.

Source: order tracking as it is common in the diagnosis of rotating machines, e.g. Fyfe and Munck, "Analysis of computed order
tracking", Mechanical Systems and Signal Processing 11 (2), 1997; the windows on the angle are resampling without the resampling.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

TURNS = 2.0
"""Length of a window in turns of the motor: it tells orders one apart, and a ramp through a resonance takes about as many."""
STEP = 0.125
"""Distance between two windows, as a fraction of their length."""
SLOWEST_RPS = 0.3
"""Least motor speed, rev/s: below it friction and the motion's own end are all that is seen."""
FEWEST_PER_TURN = 4.0
"""Least number of samples per cycle of the highest order."""
MAX_WINDOWS = 4000
BESIDE = 1.5
"""Distance from a fitted order at which the fit takes nothing of the noise any more, in orders times turns."""
NEIGHBOURS = 8
"""Number of points beside an order at which the noise is read."""


@dataclass(frozen=True)
class OrderMap:
    """Amplitude of a vibration by motor speed and order.

    Attributes:
        speed_rps: Mean |f_m| of each window, rev/s, rising; shape (m,).
        direction: +1 where the motor turned forwards, −1 backwards; shape (m,).
        orders: Orders k; shape (p,).
        amplitude: Amplitude of the component at k θ_m, in the unit of the vibration; NaN where k f_m is above what the samples
            show; shape (m, p).
    """

    speed_rps: Real
    direction: Real
    orders: Real
    amplitude: Real


@dataclass(frozen=True)
class OrderTrack:
    """Components of a vibration at some orders, all at once, along the motor speed.

    Attributes:
        speed_rps: Mean |f_m| of each window, rev/s, rising; shape (m,).
        direction: +1 where the motor turned forwards, −1 backwards; shape (m,).
        orders: Orders k; shape (p,).
        component: Complex amplitude c_k: the component is Re(c_k e^{jkθ_m}); shape (m, p).
        standard_error: Standard error of |c_k|; shape (m, p).
    """

    speed_rps: Real
    direction: Real
    orders: Real
    component: NDArray[np.complex128]
    standard_error: Real

    @property
    def amplitude(self) -> Real:
        """Amplitude |c_k|; shape (m, p)."""
        return np.asarray(np.abs(self.component))


@dataclass(frozen=True)
class _Window:
    """Samples of one window: relative angle −1 … 1, Hann weight times |dθ|, motor angle, vibration, and the window's speed."""

    place: Real
    weight: Real
    angle_rad: Real
    values: Real
    speed_rps: float
    direction: float
    period_s: float


def order_map(motor_angle_rad: Real, values: Real, period_s: float, orders: Real, turns: float = TURNS) -> OrderMap:
    """Order map of a vibration, window by window along the motor's angle.

    Args:
        motor_angle_rad: θ_m, unwrapped; shape (n,).
        values: The vibration, sampled with it; its mean over a window counts for nothing; shape (n,).
        period_s: Sampling period.
        orders: Orders k > 0; shape (p,).
        turns: Length of a window in turns of the motor.

    Raises:
        ValueError: The samples are not of one length, an order or a length is not positive, or the motor never turns a window.
    """
    orders = np.asarray(orders, dtype=np.float64)
    made = []
    for window in _windows(motor_angle_rad, values, period_s, orders, turns):
        weight = window.weight / np.sum(window.weight)
        waves = np.exp(-1j * np.outer(orders, window.angle_rad))
        level = np.sum(weight * window.values)
        amplitude = 2.0 * np.abs(waves @ (weight * (window.values - level)))
        made.append((window, np.where(_shown(window, orders), amplitude, math.nan)))
    made.sort(key=lambda each: each[0].speed_rps)
    speed = np.array([window.speed_rps for window, _ in made])
    direction = np.array([window.direction for window, _ in made])
    return OrderMap(speed, direction, orders, np.stack([amplitude for _, amplitude in made]))


def order_track(
    motor_angle_rad: Real, values: Real, period_s: float, orders: Sequence[float], turns: float = TURNS
) -> OrderTrack:
    """Components of a vibration at some orders, by weighted least squares of all of them and a parabola in each window.

    The standard error of an order is that of noise as strong as what the residual has beside that order, so that it holds for
    noise of any colour. A component that swells within a window is taken for its mean there, and its skirts count as noise.

    Args:
        motor_angle_rad: θ_m, unwrapped; shape (n,).
        values: The vibration, sampled with it; shape (n,).
        period_s: Sampling period.
        orders: Orders k > 0, at least one turn's worth apart; shape (p,).
        turns: Length of a window in turns of the motor.

    Raises:
        ValueError: As `order_map`, or two orders cannot be told apart in so few turns.
    """
    array = np.asarray(orders, dtype=np.float64)
    gaps = np.diff(np.sort(array))
    if len(gaps) and float(np.min(gaps)) * turns < 1.0:
        raise ValueError(f"orders {float(np.min(gaps)):g} apart cannot be told apart in windows of {turns:g} turns")
    made = [(window, *_components(window, array, turns)) for window in _windows(motor_angle_rad, values, period_s, array, turns)]
    made.sort(key=lambda each: each[0].speed_rps)
    return OrderTrack(
        np.array([each[0].speed_rps for each in made]),
        np.array([each[0].direction for each in made]),
        array,
        np.stack([each[1] for each in made]),
        np.stack([each[2] for each in made]),
    )


def _components(window: _Window, orders: Real, turns: float) -> tuple[NDArray[np.complex128], Real]:
    """Complex amplitudes at the orders that the samples show, and their standard errors; NaN elsewhere."""
    component = np.full(len(orders), complex(math.nan, math.nan))
    error = np.full(len(orders), math.nan)
    shown = np.flatnonzero(_shown(window, orders))
    unknowns = 3 + 2 * len(shown)
    if not len(shown) or len(window.values) < 2 * unknowns:
        return component, error
    phase = np.outer(window.angle_rad, orders[shown])
    slow = np.stack([np.ones_like(window.place), window.place, window.place**2], axis=1)
    columns = np.concatenate([slow, np.cos(phase), -np.sin(phase)], axis=1)
    weighted = window.weight[:, None] * columns
    # sums by hand: for matrices this small the linear algebra's threads only wait for each other
    normal = np.linalg.pinv(np.einsum("ij,ik->jk", columns, weighted), hermitian=True)
    gains = np.einsum("ij,kj->ik", normal, weighted)
    found = np.einsum("ij,j->i", gains, window.values)
    residual = window.values - np.einsum("ij,j->i", columns, found)
    real, imaginary = 3 + np.arange(len(shown)), 3 + len(shown) + np.arange(len(shown))
    component[shown] = found[real] + 1j * found[imaginary]
    length = np.maximum(np.abs(component[shown]), 1e-300)
    along = (found[real] / length)[:, None] * gains[real] + (found[imaginary] / length)[:, None] * gains[imaginary]
    error[shown] = np.sqrt(_noise(window, residual, orders[shown], turns) * np.sum(along**2, axis=1))
    return component, error


def _noise(window: _Window, residual: Real, orders: Real, turns: float) -> Real:
    """Variance of the white noise that would leave what the residual has beside each order; shape of `orders`.

    At an order itself nothing is left, by the fit. So the residual is taken at the nearest points between the orders.
    """
    between = np.arange(0.5, float(np.max(orders)) * turns + 12.0, 0.5) / turns
    fitted = np.concatenate([[0.0], orders])
    free = between[np.min(np.abs(between[:, None] - fitted), axis=1) >= BESIDE / turns]
    weight = window.weight / np.sum(window.weight)
    nearest = np.argsort(np.abs(free - orders[:, None]), axis=1)[:, :NEIGHBOURS]
    wanted = np.unique(nearest)
    power = np.zeros(len(free))
    # all are multiples of half a window's turn: one exponential of each sample and its products, not one for each order
    step = np.exp(-0.5j / turns * window.angle_rad)
    wave, there, multiples = weight * residual + 0j, 0, np.rint(2.0 * turns * free[wanted]).astype(int)
    for row, multiple in zip(wanted, multiples, strict=True):
        for _ in range(multiple - there):
            wave = wave * step
        there = multiple
        power[row] = abs(complex(np.sum(wave))) ** 2
    return np.asarray(np.mean(power[nearest], axis=1)) / float(np.sum(weight**2))


def _shown(window: _Window, orders: Real) -> NDArray[np.bool_]:
    return np.asarray(FEWEST_PER_TURN * orders * window.speed_rps * window.period_s <= 1.0)


def _windows(motor_angle_rad: Real, values: Real, period_s: float, orders: Real, turns: float) -> Iterator[_Window]:
    """Windows along the angle, in each stretch in which the motor turns one way."""
    angle, signal = np.asarray(motor_angle_rad, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if angle.shape != signal.shape or angle.ndim != 1:
        raise ValueError(f"{angle.shape} motor angles and {signal.shape} samples of the vibration are not one recording")
    if not (len(orders) and float(np.min(orders)) > 0.0 and period_s > 0.0 and turns > 0.0):
        raise ValueError(f"orders {orders}, a period of {period_s:g} s and {turns:g} turns have to be positive")
    count = 0
    for begin, end in _stretches(angle, period_s):
        position = np.maximum.accumulate(np.abs(angle[begin:end] - angle[begin])) / (2.0 * math.pi)
        step = np.gradient(position)
        direction = math.copysign(1.0, angle[end - 1] - angle[begin])
        centres = np.arange(
            0.5 * turns, float(position[-1]) - 0.5 * turns + 1e-9, max(STEP * turns, float(position[-1]) / MAX_WINDOWS)
        )
        for centre in centres:
            first, last = np.searchsorted(position, (centre - 0.5 * turns, centre + 0.5 * turns))
            rows = slice(int(first), int(last))
            place = (position[rows] - centre) / (0.5 * turns)
            weight = np.cos(0.5 * math.pi * place) ** 2 * step[rows]
            seconds = np.sum(weight / np.maximum(step[rows], 1e-12)) * period_s
            speed = float(np.sum(weight) / seconds)
            there = slice(begin + int(first), begin + int(last))
            count += 1
            yield _Window(place, weight, angle[there], signal[there], speed, direction, period_s)
    if not count:
        raise ValueError(
            f"the motor never turns {turns:g} turns one way at {SLOWEST_RPS:g} rev/s or more: there is no order to be seen"
        )


def _stretches(angle: Real, period_s: float) -> list[tuple[int, int]]:
    """Rows, from and up to, in which the motor turns one way, at no less than the least speed."""
    if len(angle) < 3:
        return []
    width = max(1, round(0.01 / period_s))
    smooth = np.convolve(np.pad(angle, width, mode="edge"), np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    speed = np.gradient(smooth, period_s) / (2.0 * math.pi)
    way = np.where(np.abs(speed) >= SLOWEST_RPS, np.sign(speed), 0.0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [len(way)]])
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges) if way[a] != 0.0 and b - a > 2]
