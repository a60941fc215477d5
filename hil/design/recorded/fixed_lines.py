"""Lines of a fixed frequency in a recorded signal.

They come from the sampling, the mains or another machine, not from the gear.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from hil.control.arrays import Real
from hil.design.recorded.fit import AngleSection, waves_of_angle
from hil.design.recorded.order_columns import OrderColumns
from hil.design.recorded.scan import MOST_LOOKS, floor_of, floor_reach, plain_amplitudes

KEEPS_FREQUENCY = 10.0
"""Probability: logarithm of the likelihood ratio of a fixed frequency and an order from which a line is of that frequency."""
LINES_FROM_ORDER, LINES_FROM_TURNS = 1.5, 12.0
"""Accuracy: order, and revolutions of a stretch, from which a line is looked for, since below them slow parts look like lines: a
factor of 2 changes nothing in four recordings."""
STANDS_OUT = 3.0
"""Measured: strength, by the median of the scan, from which an order is looked at: 4.2 misses one of three lines that made
recordings have, and with 2.1 a resonance passes for a line in one of three recordings of a drawn error through an arm."""
MOST_FREQUENCIES = 4000
"""Bound: frequencies of a scan."""
PIECES, STEADY_WITHIN = 4, 0.5
"""Measured with `STANDS_OUT`: parts of a stretch in each of which a line is there, and how far from its mean it may be in each,
by the mean: with 3, or with 0.7, that resonance passes for a line; 6, or 0.35, change nothing."""


@dataclass(frozen=True)
class FixedFrequency:
    """A line at a fixed frequency.

    Attributes:
        order: Order at which it stood in the scan.
        amplitude: Amplitude, in the unit of the signal.
    """

    hz: float
    order: float
    amplitude: float


@dataclass(frozen=True)
class Cleaned:
    """A stretch without lines of a fixed frequency.

    Attributes:
        signal: The same signal at the samples of its scan.
        lines: Lines that were taken out.
    """

    section: AngleSection
    signal: Real
    lines: list[FixedFrequency]


def without_lines(section: AngleSection, look: OrderColumns, orders: Real, time_s: Real) -> Cleaned:
    """Remove the lines of a fixed frequency from a stretch.

    Only a stretch whose speed changes can tell: at one speed a frequency is an order. An order is put through the arm where there
    is one: what rings at the arm's own frequency while an order passes is that order.

    Args:
        look: Waves of its orders.
        orders: Orders of these; shape (orders,).
        time_s: Time of its samples; shape (n,).
    """
    signal = look.section.signal
    if section.turns < LINES_FROM_TURNS:
        return Cleaned(section, signal, [])
    elapsed = time_s - time_s[0]
    in_time = AngleSection(section.angle_rad, section.signal, waves_of_angle(2.0 * math.pi * elapsed))
    steps = len(elapsed) // len(signal)  # of n = m few + r samples, r < few <= m, as the look was made
    averaged = in_time.averaged_by(steps)
    few = np.add.reduceat(elapsed, np.arange(0, len(elapsed) - steps + 1, steps)) / steps
    rows: list[int] = []
    found: list[tuple[float, float]] = []
    looked = signal
    for _ in range(MOST_LOOKS):
        left = look.without(looked, rows)
        strength = np.where(orders >= LINES_FROM_ORDER, np.sqrt(look.powers(left)), 0.0)
        row = int(np.argmax(strength))
        floor = floor_of(np.sqrt(look.powers(left)), floor_reach(look.turns_seen(orders)))
        if strength[row] < STANDS_OUT * float(np.median(strength)) or row in rows:
            break
        near = _frequencies(section, elapsed, float(orders[row]))
        over_hz = plain_amplitudes(left, look.basis, 2.0 * math.pi * few, near)
        gain = float(np.max(over_hz, initial=0.0)) ** 2 - float(strength[row]) ** 2
        hz = float(near[int(np.argmax(over_hz))])
        if gain * math.log(2.0) > KEEPS_FREQUENCY * float(floor[row]) ** 2 and _lasts(left, averaged.waves([hz])):
            found.append((hz, float(orders[row])))
            looked = look.beside_slow(signal) - _of_lines(look, rows, averaged, found)[1]
        else:
            rows.append(row)
    if not found:
        return Cleaned(section, signal, [])
    unknowns, waves = _of_lines(look, rows, averaged, found)
    lines = [
        FixedFrequency(hz, order, float(np.hypot(*unknowns[2 * place : 2 * place + 2])))
        for place, (hz, order) in enumerate(found)
    ]
    whole = section.signal - in_time.waves([hz for hz, _ in found]) @ unknowns
    return Cleaned(replace(section, signal=whole), signal - waves, lines)


def _of_lines(look: OrderColumns, rows: list[int], averaged: AngleSection, found: list[tuple[float, float]]) -> tuple[Real, Real]:
    """Fit some lines beside the slow part and some orders.

    Returns the unknowns and the waves of the lines; shapes (2·lines,) and (n,).

    Args:
        look: Waves of the orders.
        rows: Orders that are fitted too.
        averaged: The stretch with waves of a frequency.
        found: Frequency and order of the lines.
    """
    waves = averaged.waves([hz for hz, _ in found])
    orders = look.pairs[rows].reshape(-1, len(waves)).T.astype(np.float64)
    design = np.hstack([waves, look.basis, orders])
    unknowns = np.linalg.lstsq(design, look.section.signal, rcond=1e-9)[0][: waves.shape[1]]
    return unknowns, waves @ unknowns


def _lasts(signal: Real, waves: Real) -> bool:
    """True if a line is present all the time.

    A resonance rings at its own frequency too, but only while an order passes it.
    """
    pieces = []
    for part in np.array_split(np.arange(len(signal)), PIECES):
        x, y = np.linalg.lstsq(waves[part], signal[part], rcond=1e-9)[0]
        pieces.append(complex(x, y))
    mean = sum(pieces) / PIECES
    return all(abs(piece - mean) < STEADY_WITHIN * abs(mean) for piece in pieces)


def _frequencies(section: AngleSection, elapsed_s: Real, order: float) -> Real:
    """Frequencies of a line that the scan shows at an order."""
    speed_rps = section.turns / max(float(elapsed_s[-1]), 1e-9)
    busiest = _busiest_speed(section.angle_rad, elapsed_s)
    fine = 1.0 / max(float(elapsed_s[-1]), 1e-9)
    near = np.arange(order * min(busiest, speed_rps) - 2 * fine, order * max(busiest, speed_rps) + 2 * fine, fine / 6.0)
    return np.asarray(near[near > 0.0][:MOST_FREQUENCIES])


def _busiest_speed(angle_rad: Real, elapsed_s: Real) -> float:
    """Speed in rev/s at which most revolutions are made."""
    even = np.linspace(0, len(angle_rad) - 1, 65).astype(np.intp)
    pieces = np.abs(np.diff(angle_rad[even])) / (2.0 * math.pi)
    speeds = pieces / np.maximum(np.diff(elapsed_s[even]), 1e-9)
    order = np.argsort(speeds)
    return float(speeds[order][np.searchsorted(np.cumsum(pieces[order]), 0.5 * float(np.sum(pieces)))])
