"""Switches, index pulse and probes as the control period sees them, and where the encoder stood at each edge; compiled."""

import math

from hil.control.compiled import compiled, inlined
from plant_emulator.motion.record import (
    HOME_FALLING,
    HOME_RISING,
    HOME_SWITCH,
    INDEX,
    NEGATIVE_FALLING,
    NEGATIVE_RISING,
    NEGATIVE_SWITCH,
    POSITIVE_FALLING,
    POSITIVE_RISING,
    POSITIVE_SWITCH,
    PROBE_1,
    PROBE_1_FALLING,
    PROBE_1_RISING,
    PROBE_2,
    PROBE_2_FALLING,
    PROBE_2_RISING,
    MotionRow,
)


@inlined
def _boundary(low: float, high: float, before: float, counts: float) -> float:
    """The end of a switch's range that the motor has passed; the present position where the switch changed by itself."""
    if min(before, counts) < low <= max(before, counts) and not min(before, counts) <= high < max(before, counts):
        return low
    if min(before, counts) <= high < max(before, counts) and not min(before, counts) < low <= max(before, counts):
        return high
    return counts


@compiled
def _latch(m: MotionRow, bit: int, rising: int, falling: int, now: int, low: float, high: float, counts: float) -> None:
    """Keep what an input's edge has seen, until the owner has taken it."""
    if (now ^ m.inputs) & bit:
        edge = rising if now & bit else falling
        if not m.edges & (1 << edge):
            m.edges |= 1 << edge
            m.latch_counts[edge] = _boundary(low, high, m.seen_counts, counts)


@compiled
def watch_inputs(m: MotionRow, counts: float) -> None:
    """Look at all inputs once: their state, their edges, and the counts latched at these.

    A switch's edge lies where the switch does, as a capture unit in hardware has it; an input that is forced changes where the
    motor stands. Of several equal edges the first is kept until its bit of `edges` is cleared. The first look makes no edges.
    """
    mask = m.input_mask
    now = m.forced_inputs
    if mask & NEGATIVE_SWITCH and counts <= m.negative_switch_counts:
        now |= NEGATIVE_SWITCH
    if mask & POSITIVE_SWITCH and counts >= m.positive_switch_counts:
        now |= POSITIVE_SWITCH
    if mask & HOME_SWITCH and m.home_low_counts <= counts <= m.home_high_counts:
        now |= HOME_SWITCH
    if mask & PROBE_1 and m.probe_1_low_counts <= counts <= m.probe_1_high_counts:
        now |= PROBE_1
    if mask & PROBE_2 and m.probe_2_low_counts <= counts <= m.probe_2_high_counts:
        now |= PROBE_2
    if m.is_watching:
        known = m.edges
        if now != m.inputs:
            low, high = -math.inf, math.inf
            _latch(m, NEGATIVE_SWITCH, NEGATIVE_RISING, NEGATIVE_FALLING, now, low, m.negative_switch_counts, counts)
            _latch(m, POSITIVE_SWITCH, POSITIVE_RISING, POSITIVE_FALLING, now, m.positive_switch_counts, high, counts)
            _latch(m, HOME_SWITCH, HOME_RISING, HOME_FALLING, now, m.home_low_counts, m.home_high_counts, counts)
            _latch(m, PROBE_1, PROBE_1_RISING, PROBE_1_FALLING, now, m.probe_1_low_counts, m.probe_1_high_counts, counts)
            _latch(m, PROBE_2, PROBE_2_RISING, PROBE_2_FALLING, now, m.probe_2_low_counts, m.probe_2_high_counts, counts)
        turn = math.floor((counts - m.index_counts) / m.counts_per_rev)
        before = math.floor((m.seen_counts - m.index_counts) / m.counts_per_rev)
        if turn != before and not m.edges & (1 << INDEX):
            m.edges |= 1 << INDEX
            m.latch_counts[INDEX] = m.index_counts + max(turn, before) * m.counts_per_rev
        m.event |= m.edges & ~known & m.edge_mask
    m.inputs, m.seen_counts, m.is_watching = now, counts, 1
