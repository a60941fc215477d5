"""One sample of a cancellation that follows in plain Python: what the core in C has to compute."""

import math

import numpy as np
from numpy.typing import NDArray

from tests.oracles.law import lowpass_blend

Real = NDArray[np.float64]

(
    PERIOD, MODEL_ERROR, CORRELATED, WALK, MOST_ERROR, FOLLOW, BEGIN_SIGMAS, END_SIGMAS, BEGIN_M, END_M, LEAST_GAIN, MOST_GAIN,
    MOST_ANGLE, LOW_RATIO, HIGH_RATIO, SLOWEST, LEAST_NOISE, SPEED_LOWPASS, QUICK, QUICK_S, JOLT_PART, WANDER, WANDER_PER_S,
    LIKELY, BEGIN_PART, END_S, STEADY,
) = range(27)  # fmt: skip
"""Numbers of the configuration: the sampling time, then `FollowingSettings`."""
A11, A12, A21, A22, B1, B2, STIFF, DAMPING, SPRING, DASHPOT, F_AL, RATIO, DELAY = range(13)
"""Columns of an arm: discrete states and input; a₀, a₁, b₀ and b₁; f_al in rad/s; reduction ratio; the sensor's delay."""
ORDER, PHASE, SIZE, BEGIN = range(4)
"""Columns of an order: k, φ_k, A_k in rad at the arm, and the least |d| from which on w follows."""
SECTIONS, MEMORY = 2, 5
"""Sections of the band-pass, alike, one behind the other; what one signal in it remembers, its last output included."""
ANGLE, SPEED, SLOWER, REFERENCE, REFERENCE_SPEED, PLANNED, SHAKEN, SHAKING, TURNING, AXIS_COLUMNS = range(10)
"""Columns of an axis' memory: last angle; low-passed speed, twice; last set-point of the motion, its speed and acceleration;
x and ẋ that this shakes; speed as late as neither low-pass."""
STARTED, QUIET, LOUD, COUNT, RESTING, JOLTED, COMMON_COLUMNS = range(7)
"""Columns of the common memory: whether it has begun; least variance at rest; variance; samples at rest; variance there now;
square of what the motion itself shakes."""
OPEN, GIVEN_UP, BEYOND, SINCE, WANDERED, NEAREST, SMALL, ORDER_STATE_COLUMNS = range(8)
"""Columns of an order's state: 1 while w follows; 1 where it was taken back for good; time that it has wanted to leave;
time since it began; length of the way that w has gone of late; largest |d| at which it nearly began, or would have;
time that little has been left."""
LEAST_FOLLOW_SAMPLES = 12.0
"""Samples in which w follows d at least: faster than that, at 8 ms, it swings against the observer."""
BEGIN_MARGIN = 1.5
"""Factor between what is nearly enough to follow and what is enough: another run of the same motion is other by less."""
NOISE_S = 0.15
"""Time of rest over which the sensor's noise is measured."""
LOUD_S = 0.1
"""Time over which the variance is measured."""
BEYOND_S = 0.25
"""Time that an order may want to leave its bounds before it is taken back."""
MOST_SIGMAS = 4.0
"""Standard errors by which a sample may be wrong and still count."""
CIRCLE = 2.0 * math.pi
BAND_WIDTH = 3.0
"""Twice the width of the band over f_al: noise in it is alike for the inverse of that."""
LEFT_AT_LEAST = 0.1
"""Part of an order against which a jolt is held at least."""


def _turned(config: Real, arms: Real, axis: Real, common: Real, samples: Real) -> float:
    """Take angles and set-points; the speed of the fastest motor."""
    period, blend = config[PERIOD], lowpass_blend(config[SPEED_LOWPASS], config[PERIOD])
    begins, fastest = common[STARTED] == 0.0, 0.0
    for i in range(arms.shape[0]):
        own, angle, reference = axis[i], samples[0, i], samples[1, i]
        if begins:
            own[ANGLE], own[REFERENCE] = angle, reference
        own[SPEED] += blend * ((angle - own[ANGLE]) / period - own[SPEED])
        own[SLOWER] += blend * (own[SPEED] - own[SLOWER])
        own[TURNING] = 2.0 * own[SPEED] - own[SLOWER]
        planned = (reference - own[REFERENCE]) / period
        own[PLANNED] = (planned - own[REFERENCE_SPEED]) / period
        own[ANGLE], own[REFERENCE], own[REFERENCE_SPEED] = angle, reference, planned
        fastest = max(fastest, abs(own[TURNING]))
    return fastest


def _passed(band: Real, memory: Real, value: float) -> float:
    """A sample through the band-pass.

    Args:
        band: b₀, b₁, b₂, a₁, a₂ of a section.
        memory: Of this signal; shape (`MEMORY`,).
        value: The sample.
    """
    for section in range(SECTIONS):
        out = band[0] * value + memory[2 * section]
        memory[2 * section] = band[1] * value - band[3] * out + memory[2 * section + 1]
        memory[2 * section + 1] = band[2] * value - band[4] * out
        value = out
    return value


def _driven(config: Real, arms: Real, orders: Real, band: Real, axis: Real, filters: Real, drive: Real) -> None:
    """What each order drives its arm with where d = 1, its two quadratures in the band; written to `drive`."""
    n_orders = orders.shape[1]
    for i in range(arms.shape[0]):
        speed = axis[i, TURNING]
        for m in range(n_orders):
            if orders[i, m, SIZE] == 0.0:
                continue
            k = orders[i, m, ORDER]
            ratio, size = k * abs(speed) / arms[i, F_AL], 0.0
            if 0.8 * config[LOW_RATIO] < ratio < 1.2 * config[HIGH_RATIO]:
                size = -orders[i, m, SIZE] * ((k * speed) * (k * speed))
            angle = k * (axis[i, ANGLE] - speed * arms[i, DELAY]) + orders[i, m, PHASE]
            for part in range(2):
                own = filters[1 + 2 * (i * n_orders + m) + part]
                value = _passed(band, own, size * (math.cos(angle) if part == 0 else math.sin(angle)))
                middle = 0.5 * (value + own[MEMORY - 1])
                own[MEMORY - 1] = value
                drive[i, 2 * m + part] = middle if part == 0 else -middle


def _jolted(config: Real, arms: Real, band: Real, axis: Real, common: Real, filters: Real, samples: Real) -> None:
    """What the motion itself shakes, as its set-points have it: its size is not known well, so it only stands against d."""
    n_axes, period = arms.shape[0], config[PERIOD]
    shakes, decay = 0.0, arms[0, DAMPING]
    for i in range(n_axes):
        a, own = arms[i], axis[i]
        value = _passed(band, filters[filters.shape[0] - n_axes + i], own[PLANNED] / a[RATIO])
        x, v = own[SHAKEN], own[SHAKING]
        own[SHAKEN] = a[A11] * x + a[A12] * v + a[B1] * value
        own[SHAKING] = a[A21] * x + a[A22] * v + a[B2] * value
        shakes += samples[2, i] * (a[SPRING] * own[SHAKEN] + a[DASHPOT] * own[SHAKING])
        decay = min(decay, a[DAMPING])
    common[JOLTED] = max(shakes * shakes, common[JOLTED] * (1.0 - min(1.0, decay * period)))


def _predicted(arms: Real, drive: Real, states: Real, covariance: Real) -> None:
    """States of the arms one sample on, from those before and from the orders; and what is known of them."""
    n_axes, n, width = arms.shape[0], states.shape[0], drive.shape[1]
    own = 2 * n_axes
    moved, fresh = np.zeros((own, n)), np.zeros(own)
    for row in range(own):
        i = row // 2
        a, first = arms[i], own + i * width
        p, q, b = (a[A11], a[A12], a[B1]) if row % 2 == 0 else (a[A21], a[A22], a[B2])
        fresh[row] = p * states[2 * i] + q * states[2 * i + 1]
        for column in range(n):
            moved[row, column] = p * covariance[2 * i, column] + q * covariance[2 * i + 1, column]
        for m in range(width):
            gain = b * drive[i, m]
            fresh[row] += gain * states[first + m]
            for column in range(n):
                moved[row, column] += gain * covariance[first + m, column]
    for row in range(own):
        states[row] = fresh[row]
        for column in range(own, n):
            covariance[row, column] = covariance[column, row] = moved[row, column]
    for column in range(own):
        i = column // 2
        a, first = arms[i], own + i * width
        p, q, b = (a[A11], a[A12], a[B1]) if column % 2 == 0 else (a[A21], a[A22], a[B2])
        for row in range(own):
            total = p * moved[row, 2 * i] + q * moved[row, 2 * i + 1]
            for m in range(width):
                total += b * drive[i, m] * moved[row, first + m]
            covariance[row, column] = total


def _walked(config: Real, arms: Real, orders: Real, axis: Real, order_state: Real, covariance: Real) -> None:
    """Let each d walk where it shows: faster where something has just changed, since little is known of it then."""
    n_axes, n_orders, period = arms.shape[0], orders.shape[1], config[PERIOD]
    for i in range(n_axes):
        for m in range(n_orders):
            ratio = orders[i, m, ORDER] * abs(axis[i, TURNING]) / arms[i, F_AL]
            if orders[i, m, SIZE] == 0.0 or not config[LOW_RATIO] < ratio < config[HIGH_RATIO]:
                continue
            walk = config[WALK]
            if order_state[i, m, OPEN] > 0.0:
                walk *= config[STEADY] + config[QUICK] * math.exp(-order_state[i, m, SINCE] / config[QUICK_S])
            for part in range(2):
                at = 2 * (n_axes + i * n_orders + m) + part
                covariance[at, at] = min(covariance[at, at] + walk * walk * period, config[MOST_ERROR] * config[MOST_ERROR])


def _rested(config: Real, common: Real, tip: float) -> None:
    """The sensor's noise, at the quietest moment of rest: what rings there from a motion before is no noise."""
    period = config[PERIOD]
    common[COUNT] += 1.0
    common[RESTING] += (tip * tip - common[RESTING]) * max(1.0 / common[COUNT], period / NOISE_S)
    if common[COUNT] * period > NOISE_S and (common[QUIET] == 0.0 or common[RESTING] < common[QUIET]):
        common[QUIET] = common[RESTING]
    common[LOUD] = common[QUIET]


def _corrected(
    config: Real,
    arms: Real,
    common: Real,
    states: Real,
    covariance: Real,
    samples: Real,
    tip: float,
    quiet: float,
    alike_s: float,
) -> None:
    """Take the tip's acceleration: the Kalman filter's correction."""
    n_axes, n, period = arms.shape[0], states.shape[0], config[PERIOD]
    common[LOUD] += (tip * tip - common[LOUD]) * min(1.0, period / LOUD_S)
    own = common[JOLTED] + config[MODEL_ERROR] * config[MODEL_ERROR] * max(common[LOUD] - quiet, 0.0)
    noise = quiet * max(1.0, alike_s / period) + own * max(1.0, config[CORRELATED] / period)
    seen = np.zeros(n)
    guess, spread = 0.0, noise
    for i in range(n_axes):
        spring, dashpot = samples[2, i] * arms[i, SPRING], samples[2, i] * arms[i, DASHPOT]
        guess += spring * states[2 * i] + dashpot * states[2 * i + 1]
        for row in range(n):
            seen[row] += spring * covariance[row, 2 * i] + dashpot * covariance[row, 2 * i + 1]
    for i in range(n_axes):
        spread += samples[2, i] * (arms[i, SPRING] * seen[2 * i] + arms[i, DASHPOT] * seen[2 * i + 1])
    most = MOST_SIGMAS * math.sqrt(spread)
    wrong = min(max(tip - guess, -most), most)
    for row in range(n):
        states[row] += seen[row] * wrong / spread
        for column in range(n):
            covariance[row, column] -= seen[row] * seen[column] / spread


def _opened(
    config: Real,
    arm: Real,
    order: Real,
    order_state: Real,
    jolt: float,
    speed: float,
    lever_m: float,
    left: float,
    known: float,
    spectrum: float,
) -> bool:
    """Whether w follows: d is told from nothing, and is more than a tip may shake, in the window, with no jolt beside it.

    Args:
        config: The configuration.
        arm: The axis' arm.
        order: The order.
        order_state: Its state; changed in place.
        jolt: Square of what the motion itself shakes.
        speed: |θ̇_m|.
        lever_m: Lever of the tip.
        left: |d|.
        known: Standard error of d by the observer.
        spectrum: Root of the noise's spectral density.
    """
    omega = order[ORDER] * speed
    real, imaginary = arm[STIFF] - omega * omega, arm[DAMPING] * omega
    gain = math.sqrt(
        (arm[SPRING] * arm[SPRING] + (arm[DASHPOT] * omega) * (arm[DASHPOT] * omega)) / (real * real + imaginary * imaginary)
    )
    reach = order[SIZE] * abs(lever_m) * gain
    felt = max(reach * omega * omega, 1e-9)
    # of d beside the sensor's noise alone: what a wrong model explains wrongly does not make something of nothing
    sigma = math.sqrt(config[WALK] * spectrum / felt)
    inside = config[LOW_RATIO] < omega / arm[F_AL] < config[HIGH_RATIO] and speed > config[SLOWEST]
    jolts, told = (
        math.sqrt(jolt) / (config[JOLT_PART] * max(left, LEFT_AT_LEAST) * felt),
        config[BEGIN_SIGMAS] * max(sigma, known),
    )
    if inside and jolts < BEGIN_MARGIN and BEGIN_MARGIN * left > told and BEGIN_MARGIN * left * reach > config[BEGIN_M]:
        order_state[NEAREST] = max(order_state[NEAREST], left)
    inside = inside and jolts < 1.0
    is_much = left > max(config[BEGIN_PART], order[BEGIN], told) and left * reach > config[BEGIN_M]
    if inside and is_much:
        order_state[OPEN] = 1.0
    is_little = left < max(config[END_SIGMAS] * sigma, order[BEGIN] / BEGIN_MARGIN) or left * reach < config[END_M]
    order_state[SMALL] = order_state[SMALL] + config[PERIOD] if is_little else 0.0
    if not inside or order_state[SMALL] > config[END_S]:
        order_state[OPEN] = 0.0
    order_state[SINCE] = order_state[SINCE] + config[PERIOD] if order_state[OPEN] > 0.0 else 0.0
    return bool(order_state[OPEN] > 0.0)


def _moved_factor(config: Real, order_state: Real, factor: Real, left: Real) -> None:
    """Move w towards w + d within its bounds; an order that wants to leave them, or wanders, is taken back for good.

    Args:
        config: The configuration.
        order_state: The order's state.
        factor: Re and Im of w.
        left: Re and Im of d, which becomes less by what w becomes more.
    """
    period = config[PERIOD]
    part = min(period / config[FOLLOW], 1.0 / LEAST_FOLLOW_SAMPLES)
    re, im = factor[0] + part * left[0], factor[1] + part * left[1]
    gain, angle = math.sqrt(re * re + im * im), math.atan2(im, re)
    kept = min(max(gain, config[LEAST_GAIN]), config[MOST_GAIN])
    kept_angle = min(max(angle, -config[MOST_ANGLE]), config[MOST_ANGLE])
    if kept != gain or kept_angle != angle:
        order_state[BEYOND] += period
        re, im = kept * math.cos(kept_angle), kept * math.sin(kept_angle)
    way = math.sqrt((re - factor[0]) * (re - factor[0]) + (im - factor[1]) * (im - factor[1]))
    order_state[WANDERED] += way
    if order_state[BEYOND] > BEYOND_S or order_state[WANDERED] > config[WANDER]:
        order_state[OPEN], order_state[GIVEN_UP] = 0.0, 1.0
    left[0] -= re - factor[0]
    left[1] -= im - factor[1]
    factor[0], factor[1] = re, im


def _followed(
    config: Real,
    arms: Real,
    orders: Real,
    axis: Real,
    common: Real,
    states: Real,
    covariance: Real,
    factors: Real,
    order_state: Real,
    samples: Real,
    has_heard: bool,
    spectrum: float,
) -> None:
    """Move the factors of all orders; those that were taken back go to 1."""
    n_axes, n_orders, period = arms.shape[0], orders.shape[1], config[PERIOD]
    for i in range(n_axes):
        speed = abs(axis[i, TURNING])
        for m in range(n_orders):
            if orders[i, m, SIZE] == 0.0:
                continue
            at, own = 2 * (n_axes + i * n_orders + m), order_state[i, m]
            own[WANDERED] = max(0.0, own[WANDERED] - config[WANDER_PER_S] * period)
            if own[GIVEN_UP] > 0.0:
                part = min(1.0, period / (4.0 * config[FOLLOW]))
                factors[i, m, 0] -= part * (factors[i, m, 0] - 1.0)
                factors[i, m, 1] -= part * factors[i, m, 1]
                continue
            left = math.sqrt(states[at] * states[at] + states[at + 1] * states[at + 1])
            known = math.sqrt(max(covariance[at, at], covariance[at + 1, at + 1], 0.0))
            lever = samples[2, i]
            if has_heard and _opened(config, arms[i], orders[i, m], own, common[JOLTED], speed, lever, left, known, spectrum):
                _moved_factor(config, own, factors[i, m], states[at : at + 2])


def follow_step(
    config: Real,
    arms: Real,
    orders: Real,
    band: Real,
    axis: Real,
    common: Real,
    filters: Real,
    states: Real,
    covariance: Real,
    factors: Real,
    order_state: Real,
    samples: Real,
    heard: Real,
) -> None:
    """One sample.

    Args:
        config: Shape (27,).
        arms: Arm of each axis; shape (n_axes, 13).
        orders: Orders of each axis, 0 in `SIZE` where there is none; shape (n_axes, n_orders, 4).
        band: b₀, b₁, b₂, a₁, a₂ of a section of the band-pass; shape (5,).
        axis: Memory of each axis; shape (n_axes, `AXIS_COLUMNS`).
        common: Memory of all; shape (`COMMON_COLUMNS`,).
        filters: Memory of the band-pass: of the tip, of Re and Im of each order, of each axis' planned acceleration; shape
            (1 + 2 n_axes n_orders + n_axes, `MEMORY`).
        states: x, ẋ of each axis, then Re, Im of each d; shape (n,).
        covariance: Of the states; shape (n, n).
        factors: Re, Im of w; shape (n_axes, n_orders, 2).
        order_state: Shape (n_axes, n_orders, `ORDER_STATE_COLUMNS`).
        samples: θ_m, the motion's own set-point, and the tip's lever in m; shape (3, n_axes).
        heard: Tip's acceleration, and 1 where it was measured; shape (2,).
    """
    n_axes, n_orders, period = arms.shape[0], orders.shape[1], config[PERIOD]
    fastest = _turned(config, arms, axis, common, samples)
    if common[STARTED] == 0.0:  # gravity is there from the start
        filters[0, 0], filters[0, 1] = (band[1] + band[2]) * heard[0], band[2] * heard[0]
        common[STARTED] = 1.0
    tip = _passed(band, filters[0], heard[0])
    drive = np.zeros((n_axes, 2 * n_orders))
    _driven(config, arms, orders, band, axis, filters, drive)
    _jolted(config, arms, band, axis, common, filters, samples)
    _predicted(arms, drive, states, covariance)
    _walked(config, arms, orders, axis, order_state, covariance)
    lowest = arms[0, F_AL]
    for i in range(n_axes):
        lowest = min(lowest, arms[i, F_AL])
    alike_s = CIRCLE / (BAND_WIDTH * lowest)
    has_heard = heard[1] > 0.0
    if has_heard and fastest < config[SLOWEST]:
        _rested(config, common, tip)
    quiet = max(common[QUIET], config[LEAST_NOISE] * config[LEAST_NOISE])
    if has_heard and fastest >= config[SLOWEST]:
        _corrected(config, arms, common, states, covariance, samples, tip, quiet, alike_s)
    spectrum = math.sqrt(2.0 * quiet * max(period, alike_s))
    _followed(config, arms, orders, axis, common, states, covariance, factors, order_state, samples, has_heard, spectrum)
