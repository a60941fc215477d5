"""Findings on vibration in the following error of an axis.

The vibration is at a multiple of the motor's angle, or at a frequency of its own. The error is analysed twice over a stretch in
which the motor turns one way: over the motor's angle, in orders k of one revolution, and over time, in Hz. A vibration that
follows the motor's angle is one line in the first spectrum; ringing, as of a loop at the edge of stability, is one in the second.
At a constant speed both are the same, and the log cannot distinguish them.
"""

from collections.abc import Iterator

import numpy as np

from hil.control.arrays import Real
from hil.logs.findings.finding import Finding, Said, Severity, Untold, picture_of
from hil.logs.nodes import Node
from hil.logs.trace import Trace

LEAST_REV, LEAST_ANSWERS, MOST_ANSWERS = 6.0, 512, 120_000
"""Revolutions and answers of a stretch that can be looked at, and the answers that are."""
LINE_FRACTION = 0.4
"""Fraction of the power that one line must hold of all that is faster than the motion's own course."""
CLEARER = 1.5
"""Ratio of the two lines from which on one of them is the cause."""
LEAST_AMPLITUDE = 1e-3
"""Amplitude of a line as a fraction of a motor revolution: what every gear does to its motor is less."""
GEAR_ORDERS = 4.5
"""Orders below this are of the gear and the encoder's mounting; those above of the motor's poles and slots."""
LEAST_ORDER, MOST_ORDER = 0.75, 60.0
SAMPLES_PER_REV = 256
LEAST_SWINGS, SLOWEST_HZ = 10.0, 5.0
"""Periods in a stretch, and frequency, below which a swing is the course of the motion itself."""
VARIES = 1.3
"""Ratio of the highest speed to the lowest within a stretch that parts orders from frequencies."""


def order_findings(trace: Trace) -> Iterator[Said]:
    """Lines in the following errors of all nodes."""
    for node in trace.nodes.values():
        increments, turns = node.value(0x608F, 1), node.value(0x608F, 2)
        per_rev = increments / turns if increments and turns else None
        target, measured = node.pdo_with("rpdo", 0x607A), node.pdo_with("tpdo", 0x6064)
        if per_rev is None or target is None or measured is None:
            continue
        commands, answers = trace.of(target[0]), trace.of(measured[0])
        stamp_s = answers.stamp_ns[:MOST_ANSWERS].astype(float) * 1e-9
        position = measured[1].of(answers)[:MOST_ANSWERS].astype(float)
        row = np.searchsorted(commands.stamp_ns, answers.stamp_ns[:MOST_ANSWERS]) - 1
        if len(position) < LEAST_ANSWERS or not np.any(row >= 0):
            continue
        error = target[1].of(commands)[np.maximum(row, 0)] - position
        for stretch in _stretches(position, per_rev):
            said = _of_stretch(node, stamp_s[stretch], position[stretch] / per_rev, error[stretch] / per_rev)
            if said is not None:
                yield said
                break


def _stretches(position: Real, per_rev: float) -> list[slice]:
    """Stretches in which the motor turns one way, the longest first."""
    direction = np.sign(np.diff(position))
    moving = np.abs(np.diff(position)) > 0.0
    direction = np.where(moving, direction, 0.0)
    edges = np.flatnonzero(np.diff(direction) != 0.0) + 1
    begins, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(direction)]])
    found = [
        slice(int(begin), int(end))
        for begin, end in zip(begins, ends, strict=True)
        if end - begin >= LEAST_ANSWERS and abs(position[end] - position[begin]) >= LEAST_REV * per_rev
    ]
    return sorted(found, key=lambda each: each.start - each.stop)


def _line(numbers: Real, per_unit: float, low: float, high: float) -> tuple[float, float, float]:
    """Return place, amplitude and power fraction of the highest line."""
    grid = np.linspace(-1.0, 1.0, len(numbers))
    slow = np.polynomial.polynomial.polyfit(grid, numbers, 7)
    rest = numbers - np.polynomial.polynomial.polyval(grid, slow)
    window = np.hanning(len(rest))
    power = np.abs(np.fft.rfft(rest * window)) ** 2
    place = np.fft.rfftfreq(len(rest), 1.0 / per_unit)
    allowed = (place >= low) & (place <= high)
    if not np.any(allowed) or not np.any(power[allowed]):
        return 0.0, 0.0, 0.0
    peak = int(np.argmax(np.where(allowed, power, 0.0)))
    around = slice(max(peak - 2, 0), peak + 3)
    if power[peak] < float(np.max(power[around])):  # the slope of what is slower: no line
        return 0.0, 0.0, 0.0
    own = float(np.sum((power * allowed)[around]))
    amplitude = 2.0 * np.sqrt(power[peak]) / float(np.sum(window))
    return float(place[peak]), float(amplitude), own / float(np.sum(power[allowed]))


def _of_stretch(node: Node, stamp_s: Real, turned: Real, error: Real) -> Said | None:
    way = turned * np.sign(turned[-1] - turned[0])
    angle = np.arange(way[0], way[-1], 1.0 / SAMPLES_PER_REV)
    order, amplitude, of_angle = _line(np.interp(angle, way, error), SAMPLES_PER_REV, LEAST_ORDER, MOST_ORDER)
    even = np.linspace(stamp_s[0], stamp_s[-1], len(stamp_s))
    rate = (len(stamp_s) - 1) / (stamp_s[-1] - stamp_s[0])
    frequency, swing, of_time = _line(
        np.interp(even, stamp_s, error), rate, max(LEAST_SWINGS / (stamp_s[-1] - stamp_s[0]), SLOWEST_HZ), 0.45 * rate
    )
    if max(of_angle, of_time) < LINE_FRACTION or max(amplitude, swing) < LEAST_AMPLITUDE:
        return None
    quarter = len(way) // 8
    speed = np.abs(np.diff(way[:: max(quarter, 1)]))
    varies = float(np.max(speed) / max(float(np.min(speed)), 1e-12)) >= VARIES
    drawn = picture_of(turned, error * 360.0, ("motor angle [rev]", f"following error of node {node.number} [°]"), is_line=True)
    where = (round(float(stamp_s[0]), 6),)
    if varies and of_angle >= CLEARER * of_time:
        is_gear = order < GEAR_ORDERS
        return Finding(
            "order-line", Severity.WARNING,
            f"the following error of node {node.number} swings by {360.0 * amplitude:.2g}° of the motor, order "
            f"{round(order, 1):g} at every speed: {100.0 * of_angle:.0f} % of the error; "
            + ("that is the gear (a harmonic drive has orders 1, 2 and 4), or an encoder that is not centred" if is_gear
               else "that is cogging, or the currents of the motor's phases"),
            "measure it (hil identify ate) and cancel it, or keep its frequency off the resonance" if is_gear
            else "set the drive's cogging compensation, current offsets and commutation angle",
            where, 1, node.number, drawn,
        )  # fmt: skip
    if varies and of_time >= CLEARER * of_angle:
        return Finding(
            "loop-rings", Severity.WARNING,
            f"the following error of node {node.number} swings by {360.0 * swing:.2g}° of the motor at {frequency:.0f} Hz, "
            f"at any speed: {100.0 * of_time:.0f} % of the error; no rotating part causes this",
            "lower the gains, or set a filter at that frequency: the loop is nearly unstable, or a resonance is excited",
            where, 1, node.number, drawn,
        )  # fmt: skip
    tells = (
        "record more revolutions, which separate the two"
        if varies
        else "record a log with changing speed, which separates gear and loop"
    )
    return Untold(
        "what-swings", f"its following error swings by {360.0 * max(amplitude, swing):.2g}°, as order {round(order, 1):g} "
        f"or at {frequency:.0f} Hz: {tells}", node.number,
    )  # fmt: skip
