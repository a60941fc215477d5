"""Switches, index pulse and probes in the compiled control period: what is active, which edges are seen, and what they latch."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_emulator.motion.record import (
    BRAKED,
    EDGES,
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
    PROFILE_VELOCITY,
)
from tests.plant_emulator.motion.test_modes import TURN
from tests.plant_emulator.motion.test_period import COUNTS_PER_REV, energised

ALL = NEGATIVE_SWITCH | POSITIVE_SWITCH | HOME_SWITCH | PROBE_1 | PROBE_2
PLACES = {
    "negative_switch_counts": -50_000.0,
    "positive_switch_counts": 60_000.0,
    "home_low_counts": 10_000.0,
    "home_high_counts": 20_000.0,
    "index_counts": 5_000.0,
    "probe_1_low_counts": 15_000.0,
    "probe_1_high_counts": 16_000.0,
    "probe_2_low_counts": -7_000.0,
    "probe_2_high_counts": -6_000.0,
}


def switched(mode=PROFILE_VELOCITY, mask=ALL):
    axes = energised(mode)
    for field, counts in PLACES.items():
        axes.motion[0][field] = counts
    axes.motion[0]["input_mask"] = mask
    axes.advance(1)
    return axes


def sweep(axes, rps, until):
    """Turn at a speed past some counts."""
    axes.motion[0]["target_speed_rad_s"] = TURN * rps
    while (axes.counts(0) - until) * math.copysign(1.0, rps) < 0.0:
        axes.advance(1)
    axes.advance(1)


def bits(*edges):
    return sum(1 << edge for edge in edges)


def test_edges_are_latched_where_the_switches_are():
    axes = switched()
    motion = axes.motion[0]
    sweep(axes, 2.0, 65_000.0)
    assert motion["edges"] == bits(HOME_RISING, HOME_FALLING, INDEX, POSITIVE_RISING, PROBE_1_RISING, PROBE_1_FALLING)
    want = {HOME_RISING: 10_000, HOME_FALLING: 20_000, INDEX: 5_000, POSITIVE_RISING: 60_000}
    want |= {PROBE_1_RISING: 15_000, PROBE_1_FALLING: 16_000}
    assert {edge: motion["latch_counts"][edge] for edge in want} == want
    assert motion["inputs"] == POSITIVE_SWITCH
    motion["edges"] = 0
    sweep(axes, -2.0, -55_000.0)
    falling = bits(HOME_RISING, HOME_FALLING, INDEX, POSITIVE_FALLING, PROBE_1_RISING, PROBE_1_FALLING)
    assert motion["edges"] == falling | bits(NEGATIVE_RISING, PROBE_2_RISING, PROBE_2_FALLING)
    want = {HOME_RISING: 20_000, HOME_FALLING: 10_000, INDEX: 5_000, POSITIVE_FALLING: 60_000, NEGATIVE_RISING: -50_000}
    want |= {PROBE_2_RISING: -6_000, PROBE_2_FALLING: -7_000, PROBE_1_RISING: 16_000, PROBE_1_FALLING: 15_000}
    assert {edge: motion["latch_counts"][edge] for edge in want} == want
    assert motion["inputs"] == NEGATIVE_SWITCH
    motion["edges"] = 0
    sweep(axes, 2.0, -40_000.0)
    assert motion["edges"] == bits(NEGATIVE_FALLING)
    assert motion["latch_counts"][NEGATIVE_FALLING] == -50_000


@pytest.mark.parametrize("rps", [4.0, -4.0])
def test_the_index_pulse_comes_once_per_motor_revolution(rps):
    axes = switched(mask=0)
    motion = axes.motion[0]
    motion["edge_mask"] = bits(INDEX)
    axes.advance(1)
    pulses = []
    motion["target_speed_rad_s"] = TURN * rps
    while abs(axes.counts(0)) < 4 * COUNTS_PER_REV:
        axes.advance(8)
        if motion["event"]:
            pulses.append(float(motion["latch_counts"][INDEX]))
            motion["edges"] = motion["event"] = 0
    first = 5_000 if rps > 0.0 else 5_000 - COUNTS_PER_REV
    if rps < 0.0:
        # the motor starts below the pulse at 5000
        assert pulses == [first - COUNTS_PER_REV * turn for turn in range(4)]
    else:
        assert pulses == [first + COUNTS_PER_REV * turn for turn in range(4)]


def test_an_event_wakes_the_owner_once_and_only_for_edges_that_were_asked_for():
    axes = switched()
    motion = axes.motion[0]
    motion["edge_mask"] = bits(HOME_FALLING)
    sweep(axes, 2.0, 15_500.0)
    assert motion["edges"] & bits(HOME_RISING)
    assert (motion["event"], motion["wake"]) == (0, 0)
    sweep(axes, 2.0, 25_000.0)
    assert motion["event"] == bits(HOME_FALLING)
    assert motion["wake"] == 1
    motion["event"] = 0
    axes.advance(1)
    assert (motion["event"], motion["wake"]) == (0, 0)


def test_of_equal_edges_the_first_is_kept_until_it_has_been_taken():
    axes = switched()
    motion = axes.motion[0]
    sweep(axes, 2.0, 25_000.0)
    sweep(axes, -2.0, 5_500.0)
    assert motion["latch_counts"][HOME_RISING] == 10_000
    motion["edges"] = 0
    sweep(axes, 2.0, 25_000.0)
    sweep(axes, -2.0, 15_000.0)
    assert motion["latch_counts"][HOME_RISING] == 10_000
    motion["edges"] = 0
    sweep(axes, -2.0, 5_500.0)
    sweep(axes, 2.0, 12_000.0)
    assert motion["latch_counts"][HOME_RISING] == 10_000
    assert motion["latch_counts"][HOME_FALLING] == 10_000


@pytest.mark.parametrize("mode", [BRAKED, PROFILE_VELOCITY])
def test_a_forced_input_changes_where_the_motor_stands(mode):
    axes = switched(mode)
    motion = axes.motion[0]
    motion["edge_mask"] = bits(PROBE_1_RISING)
    motion["forced_inputs"] = PROBE_1 | HOME_SWITCH
    standing = axes.counts(0)
    axes.advance(1)
    assert motion["inputs"] == PROBE_1 | HOME_SWITCH
    assert motion["edges"] == bits(PROBE_1_RISING, HOME_RISING)
    assert abs(motion["latch_counts"][PROBE_1_RISING] - standing) <= 1
    assert motion["wake"] == 1
    motion["forced_inputs"] = 0
    axes.advance(1)
    assert motion["inputs"] == 0
    assert motion["edges"] & bits(PROBE_1_FALLING)


def test_only_inputs_that_exist_are_active():
    axes = switched(mask=POSITIVE_SWITCH)
    sweep(axes, 2.0, 65_000.0)
    assert axes.motion[0]["inputs"] == POSITIVE_SWITCH
    assert axes.motion[0]["edges"] == bits(POSITIVE_RISING, INDEX)


def test_the_first_look_at_an_input_is_no_edge():
    axes = switched(mask=0)
    motion = axes.motion[0]
    sweep(axes, 2.0, 12_000.0)
    assert (motion["is_watching"], motion["edges"], motion["inputs"]) == (0, 0, 0)
    motion["input_mask"] = HOME_SWITCH
    axes.advance(1)
    assert (motion["edges"], motion["inputs"]) == (0, HOME_SWITCH)
    motion["input_mask"] = 0
    sweep(axes, 2.0, 200_000.0)
    motion["input_mask"] = POSITIVE_SWITCH
    axes.advance(1)
    assert (motion["edges"], motion["inputs"]) == (0, POSITIVE_SWITCH)


def test_switches_change_nothing_of_the_motion():
    plain, watched = energised(PROFILE_VELOCITY), switched()
    plain.advance(1)
    for axes in (plain, watched):
        axes.motion[0]["target_speed_rad_s"] = TURN * 3.0
        axes.advance(2000)
    assert plain.plant_state.tobytes() == watched.plant_state.tobytes()


@settings(max_examples=50)
@given(st.lists(st.integers(-200_000, 200_000), min_size=2, max_size=12))
def test_what_is_latched_lies_on_the_way(places):
    """However far the motor goes in a period: a latch lies between the counts before and after, at a switch's end or a pulse."""
    axes = switched(BRAKED)
    m = axes.motion[0]
    m["is_watching"] = 0
    for before, after in pairwise([places[0], *places]):
        m["edges"] = 0
        axes.plant_state[0]["motor_angle_rad"] = after / m["counts_per_rad"]
        axes.advance(1)
        assert axes.counts(0) == after
        for edge in range(EDGES):
            if int(m["edges"]) >> edge & 1:
                assert min(before, after) <= m["latch_counts"][edge] <= max(before, after)
        active = np.array(
            [
                after <= PLACES["negative_switch_counts"],
                after >= PLACES["positive_switch_counts"],
                PLACES["home_low_counts"] <= after <= PLACES["home_high_counts"],
                PLACES["probe_1_low_counts"] <= after <= PLACES["probe_1_high_counts"],
                PLACES["probe_2_low_counts"] <= after <= PLACES["probe_2_high_counts"],
            ]
        )
        assert m["inputs"] == int(active @ (1 << np.arange(5)))
