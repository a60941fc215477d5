"""Vibration by motor speed and order, in the angle domain.

An error of order k shakes the arm at k θ_m, at whatever speed. In windows of a few turns the vibration a(t) is therefore
compared with sines of the motor's angle instead of time: in an order map with a sine of every order, one after the other,

    A(k) = |2 ∫ w a e^{−jkθ} |dθ|| / ∫ w |dθ|,

where an error is a line of one order, and a resonance f the hyperbola k f_m = f, on which the line swells; and in an order track
with sines of a few orders at once and a slow curve, by least squares, which separates orders whose lines in the map overlap and
has standard errors. Both take samples at any times, and motors that speed up, slow down and turn back.

Source: order tracking as it is common in the diagnosis of rotating machines, e.g. Fyfe and Munck, "Analysis of computed order
tracking", Mechanical Systems and Signal Processing 11 (2), 1997; the windows on the angle are resampling without the resampling.
"""

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real

TURNS = 2.0
"""Bound: a window in turns of the motor: it tells orders one apart, and a ramp through a resonance takes about as many."""
STEP = 0.125
"""Accuracy: distance between two windows, as a fraction of their length: the middle between two has 96 % of a window's weight."""
SLOWEST_RPS = 0.3
"""Bound: least motor speed, rev/s: below it friction and the motion's own end are all that is seen."""
FEWEST_PER_TURN = 4.0
"""Bound: samples per cycle of the highest order, twice those of the sampling theorem."""
MAX_WINDOWS = 4000
"""Bound: windows of a map, more than a screen has columns."""
APART_TURNS = 1.5
"""Bound: distance of two orders, times turns, from which they are told apart: a fit of one takes nothing of what is there."""
NEIGHBOURS = 8
"""Accuracy: points beside an order at which the noise is read: its power to 35 %."""


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
    """Components of a vibration at some orders, over the motor speed.

    Attributes:
        component: Complex amplitude c_k: the component is Re(c_k e^{jkθ_m}); shape (m, p).
        standard_error: Standard error of |c_k|; shape (m, p).
    """

    speed_rps: Real
    direction: Real
    orders: Real
    component: Complex
    standard_error: Real

    @property
    def amplitude(self) -> Real:
        """Amplitude |c_k|; shape (m, p)."""
        return np.asarray(np.abs(self.component))


@dataclass(frozen=True)
class _Window:
    """Samples and speed of one window along the motor angle.

    `place` is the relative angle −1 … 1, `weight` the Hann weight times |dθ|, `values` the vibrations.

    Arrays have shape (n,), `values` (vibrations, n); `rows` are those of the whole motion.
    """

    place: Real
    weight: Real
    rows: slice
    values: Real
    speed_rps: float
    direction: float
    period_s: float


def order_map(motor_angle_rad: Real, values: Real, period_s: float, orders: Real, turns: float = TURNS) -> OrderMap:
    """Order map of a vibration, window by window along the motor's angle.

    Args:
        motor_angle_rad: θ_m, unwrapped; shape (n,).
        values: The vibration, sampled with it; its mean over a window counts for nothing; shape (n,).
        orders: Orders k > 0; shape (p,).
        turns: Length of a window in turns of the motor.

    Raises:
        ValueError: The samples are not of one length, an order or a length is not positive, or the motor never turns a window.
    """
    orders = np.asarray(orders, dtype=np.float64)
    made = []
    for window in _windows(motor_angle_rad, (values,), period_s, orders, turns):
        weight = window.weight / np.sum(window.weight)
        waves = np.exp(-1j * np.outer(orders, motor_angle_rad[window.rows]))
        level = np.sum(weight * window.values[0])
        amplitude = 2.0 * np.abs(waves @ (weight * (window.values[0] - level)))
        made.append((window, np.where(_shown(window, orders), amplitude, math.nan)))
    made.sort(key=lambda each: each[0].speed_rps)
    speed = np.array([window.speed_rps for window, _ in made])
    direction = np.array([window.direction for window, _ in made])
    return OrderMap(speed, direction, orders, np.stack([amplitude for _, amplitude in made]))


def order_track(
    motor_angle_rad: Real, values: Real, period_s: float, orders: Sequence[float], turns: float = TURNS
) -> OrderTrack:
    """Track components of a vibration at some orders.

    The standard error of an order is that of noise as strong as what the residual has beside that order, so that it holds for
    noise of any colour. A component that swells within a window is taken for its mean there, and its skirts count as noise.

    Args:
        values: The vibration, sampled with θ_m; shape (n,).
        orders: Orders k > 0, at least one turn's worth apart; shape (p,).

    Raises:
        ValueError: As `order_map`, or so few turns do not separate two orders.
    """
    return order_tracks(motor_angle_rad, (values,), period_s, orders, turns)[0]


def order_tracks(
    motor_angle_rad: Real, signals: Sequence[Real], period_s: float, orders: Sequence[float], turns: float = TURNS
) -> list[OrderTrack]:
    """Track several signals of one motion, as `order_track` does one.

    Args:
        signals: What was sampled with θ_m; one and more of shape (n,).

    Raises:
        ValueError: As `order_track`.
    """
    array = np.asarray(orders, dtype=np.float64)
    gaps = np.diff(np.sort(array))
    if len(gaps) and float(np.min(gaps)) * turns < 1.0:
        raise ValueError(
            f"orders {float(np.min(gaps)):g} apart cannot be separated in windows of {turns:g} turns; at least "
            f"{1.0 / turns:g} is needed"
        )
    windows = list(_windows(motor_angle_rad, signals, period_s, array, turns))
    # each sample lies in eight windows: its sines are computed once
    phase = array[:, None] * motor_angle_rad
    waves, step = np.concatenate([np.cos(phase), -np.sin(phase)]), np.exp(-0.5j / turns * motor_angle_rad)
    made = [(each, *_components(each, array, turns, waves[:, each.rows], step[each.rows])) for each in windows]
    made.sort(key=lambda each: each[0].speed_rps)
    speed = np.array([window.speed_rps for window, _, _ in made])
    direction = np.array([window.direction for window, _, _ in made])
    component, error = np.stack([each for _, each, _ in made], axis=1), np.stack([each for _, _, each in made], axis=1)
    return [OrderTrack(speed, direction, array, component[row], error[row]) for row in range(len(signals))]


def _components(window: _Window, orders: Real, turns: float, waves: Real, step: Complex) -> tuple[Complex, Real]:
    """Fit the complex amplitudes at some orders, with standard errors.

    They are NaN at orders that the samples do not show; both have the shape (vibrations, orders). `waves` are cos kθ and −sin kθ,
    shape (2 orders, n); `step` see `_noise`.
    """
    component = np.full((len(window.values), len(orders)), complex(math.nan, math.nan))
    error = np.full(component.shape, math.nan)
    shown = np.flatnonzero(_shown(window, orders))
    count = len(shown)
    if not count or window.values.shape[1] < 2 * (3 + 2 * count):
        return component, error
    slow = np.ones_like(window.place), window.place, window.place**2
    rows = np.concatenate([slow, waves[shown], waves[len(orders) + shown]])
    weighted = window.weight * rows
    # sums by hand: for matrices this small the linear algebra's threads only wait for each other
    gains = np.einsum("jk,ki->ji", _inverse(np.einsum("ji,ki->jk", rows, weighted)), weighted)
    found = np.einsum("ji,ci->cj", gains, window.values)
    residual = window.values - np.einsum("cj,ji->ci", found, rows)
    real, imaginary = found[:, 3 : 3 + count], found[:, 3 + count :]
    component[:, shown] = real + 1j * imaginary
    length = np.maximum(np.hypot(real, imaginary), 1e-300)
    # the variance of a gain times that of another, summed over the samples: that of the component along itself
    own = np.einsum("ji,ji->j", gains[3:], gains[3:])
    cross = np.einsum("ji,ji->j", gains[3 : 3 + count], gains[3 + count :])
    cosine, sine = real / length, imaginary / length
    along = cosine**2 * own[:count] + sine**2 * own[count:] + 2.0 * cosine * sine * cross
    error[:, shown] = np.sqrt(_noise(window, residual, tuple(orders[shown].tolist()), turns, step) * along)
    return component, error


def _inverse(square: Real) -> Real:
    """Pseudo-inverse of a positive semidefinite matrix, by its eigenvalues."""
    values, vectors = np.linalg.eigh(square)
    kept = values > 1e-15 * values[-1]
    vectors = vectors[:, kept]
    return np.asarray(np.einsum("ij,kj->ik", vectors / values[kept], vectors))


def _noise(window: _Window, residual: Real, orders: tuple[float, ...], turns: float, step: Complex) -> Real:
    """Variance of white noise that explains the residual beside each order.

    Shape (vibrations, orders).

    At an order itself nothing is left, by the fit. So the residual is taken at the nearest points between the orders. All are
    multiples of half a window's turn: one exponential of each sample, `step`, and its products, not one for each order.
    """
    multiples, nearest = _beside(orders, turns)
    power = np.empty((len(residual), len(multiples)))
    weight = window.weight / np.sum(window.weight)
    wave, there = weight * residual + 0j, 0
    for row, multiple in enumerate(multiples):
        for _ in range(multiple - there):
            wave *= step
        there = multiple
        power[:, row] = np.abs(wave.sum(axis=1)) ** 2
    return np.asarray(np.mean(power[:, nearest], axis=2)) / float(np.sum(weight**2))


@functools.lru_cache(maxsize=64)
def _beside(orders: tuple[float, ...], turns: float) -> tuple[list[int], NDArray[np.intp]]:
    """Choose points beside the orders at which the noise is read.

    Returns the points, rising, in halves of a window's order, and the indices of each order's points, shape (orders,
    neighbours).
    """
    between = np.arange(0.5, max(orders) * turns + 12.0, 0.5) / turns
    fitted = np.concatenate([[0.0], orders])
    free = between[np.min(np.abs(between[:, None] - fitted), axis=1) >= APART_TURNS / turns]
    nearest = np.argsort(np.abs(free - np.array(orders)[:, None]), axis=1)[:, :NEIGHBOURS]
    wanted, among = np.unique(nearest, return_inverse=True)
    multiples = np.rint(2.0 * turns * free[wanted]).astype(int)
    return [int(each) for each in multiples], among.reshape(nearest.shape)


def _shown(window: _Window, orders: Real) -> NDArray[np.bool_]:
    return np.asarray(FEWEST_PER_TURN * orders * window.speed_rps * window.period_s <= 1.0)


def _windows(motor_angle_rad: Real, signals: Sequence[Real], period_s: float, orders: Real, turns: float) -> Iterator[_Window]:
    """Cut the motion into windows along the motor angle."""
    angle, signal = np.asarray(motor_angle_rad, dtype=np.float64), [np.asarray(each, dtype=np.float64) for each in signals]
    for each in signal:
        if angle.shape != each.shape or angle.ndim != 1:
            raise ValueError(
                f"{angle.shape} motor angles and {each.shape} samples of the vibration do not match; both must have "
                "one shape (n,)"
            )
    together = np.stack(signal)
    if not (len(orders) and float(np.min(orders)) > 0.0 and period_s > 0.0 and turns > 0.0):
        raise ValueError(f"orders {orders}, a period of {period_s:g} s and {turns:g} turns must be positive")
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
            yield _Window(place, weight, there, together[:, there], speed, direction, period_s)
    if not count:
        raise ValueError(
            f"the motor never makes {turns:g} turns in one direction at {SLOWEST_RPS:g} rev/s or more, as an order map needs"
        )


def _stretches(angle: Real, period_s: float) -> list[tuple[int, int]]:
    """Find the rows in which the motor turns one way.

    Each stretch is (first row, row after the last). Its speed is at least `SLOWEST_RPS`.
    """
    if len(angle) < 3:
        return []
    width = max(1, round(0.01 / period_s))
    smooth = np.convolve(np.pad(angle, width, mode="edge"), np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    speed = np.gradient(smooth, period_s) / (2.0 * math.pi)
    way = np.where(np.abs(speed) >= SLOWEST_RPS, np.sign(speed), 0.0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [len(way)]])
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges) if way[a] != 0.0 and b - a > 2]
