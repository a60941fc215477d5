"""Every homing method on the simulated axis, from everywhere that matters; where it must end follows from the switches alone."""

import math

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.homing import METHODS, GoTo, Homing, HomingAttained, HomingFailed, Move
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import (
    HOME_FALLING,
    HOME_SWITCH,
    INDEX,
    NEGATIVE_FALLING,
    NEGATIVE_RISING,
    NEGATIVE_SWITCH,
    POSITIVE_RISING,
    POSITIVE_SWITCH,
    PROFILE,
    PROFILE_VELOCITY,
)
from plant_emulator.physics.axis import hang_at_rest
from plant_emulator.robots.behaviour import Switches
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS

TURN = 2.0 * math.pi
WAKE_TICKS = 8
"""Control periods between two looks at the axis: a SYNC period of 2 ms."""

RATIO = ONE_AXIS.axis[AXIS].reduction_ratio
NEGATIVE, POSITIVE, HOME, INDEX_REV = -3.0, 3.0, (0.8, 1.3), 0.25
"""Where the switches stand, in revolutions of the motor, and the index pulse within each of these."""

SWITCHES = Switches(
    negative_limit_deg=NEGATIVE / RATIO * 360.0,
    positive_limit_deg=POSITIVE / RATIO * 360.0,
    home_deg=tuple(edge / RATIO * 360.0 for edge in HOME),
    index_deg=INDEX_REV * 360.0,
)
UPPER = SWITCHES.model_copy(update={"home_deg": (HOME[0] / RATIO * 360.0, 1e6)})
LOWER = SWITCHES.model_copy(update={"home_deg": (-1e6, HOME[1] / RATIO * 360.0)})


class Bare:
    """An axis with switches and its law, without a node; moves as homing demands it."""

    def __init__(self, switches, start_rev):
        robot = ONE_AXIS.model_copy(update={"axis": {AXIS: ONE_AXIS.axis[AXIS].model_copy(update={"switches": switches})}})
        self.axes = Axes(robot)
        self.motion = self.axes.motion[0]
        self.inputs = DigitalInputs(self.axes, AXIS, NoDictionary())
        self.axes.plant_state[0]["motor_angle_rad"] = start_rev * TURN
        hang_at_rest(self.axes.plant[0], self.axes.plant_state[0])
        self.axes.advance(1)
        self.axes.open_brake(0, PROFILE)
        self.edges, self.latches = 0, [0.0] * len(self.motion["latch_counts"])
        for field in ("profile_acceleration_rad_s2", "profile_deceleration_rad_s2"):
            self.motion[field] = 200.0 * TURN
        self.motion["position_window_rad"] = TURN / 1000.0
        self.worst_rev = [start_rev, start_rev]

    @property
    def rev(self):
        return float(self.axes.plant_state[0]["motor_angle_rad"]) / TURN

    def listen(self, edges, latches):
        self.edges |= edges
        self.latches = latches

    def do(self, demand, fast_rps, slow_rps):
        mode = PROFILE if isinstance(demand, GoTo) else PROFILE_VELOCITY
        if self.motion["mode"] != mode:
            self.axes.change_mode(0, mode)
        if isinstance(demand, GoTo):
            self.motion["profile_speed_rad_s"], self.motion["target_counts"] = slow_rps * TURN, demand.counts
        else:
            self.motion["target_speed_rad_s"] = demand.direction * (fast_rps if demand.is_fast else slow_rps) * TURN

    def is_at_rest(self, demand):
        if abs(self.axes.cascade_state[0]["speed_rad_s"]) > 0.5 or self.motion["demand_speed_rad_s"] != 0.0:
            return False
        return not isinstance(demand, GoTo) or abs(self.axes.counts(0) - demand.counts) < COUNTS_PER_REV / 1000

    def home(self, method, fast_rps=5.0, slow_rps=0.5, patience_s=60.0, travel_rev=20.0):
        homing = Homing(method, self.inputs.present, COUNTS_PER_REV, travel_rev * COUNTS_PER_REV)
        self.inputs.listen("homing", 0x7FF, self.listen)
        self.demands = [demand := homing.start(self.axes.counts(0), self.inputs.levels)]
        for _ in range(round(patience_s / (WAKE_TICKS * 250e-6))):
            if isinstance(demand, HomingAttained | HomingFailed):
                return demand
            self.do(demand, fast_rps, slow_rps)
            self.axes.advance(WAKE_TICKS)
            self.inputs.dispatch()
            self.worst_rev = [min(self.worst_rev[0], self.rev), max(self.worst_rev[1], self.rev)]
            demand = homing.step(self.inputs.levels, self.edges, self.latches, self.axes.counts(0), self.is_at_rest(demand))
            self.edges = 0
            if demand != self.demands[-1]:
                self.demands.append(demand)
        raise AssertionError(f"homing has not ended: {self.demands[-5:]}, at {self.rev} rev")


class NoDictionary:
    def on_read(self, *_):
        pass


def next_index(rev, direction):
    """The first index pulse from a place, in a direction."""
    turns = (rev - INDEX_REV) * direction
    return INDEX_REV + math.ceil(turns) * direction


LEFT, RIGHT = HOME
EXPECTED = {
    # the edge at which methods 17 to 30 end, and the way from there to the index pulse of methods 1 to 14
    1: (NEGATIVE, +1),
    2: (POSITIVE, -1),
    3: (LEFT, -1),
    4: (LEFT, +1),
    5: (RIGHT, +1),
    6: (RIGHT, -1),
    7: (LEFT, -1),
    8: (LEFT, +1),
    9: (RIGHT, -1),
    10: (RIGHT, +1),
    11: (RIGHT, +1),
    12: (RIGHT, -1),
    13: (LEFT, +1),
    14: (LEFT, -1),
}
"""From the figures of the standard: methods 7 to 10 meet the home switch from left to right, 11 to 14 from right to left."""

STARTS = {
    "in the negative limit": -3.02,
    "left of home": -1.1,
    "on home": 1.0,
    "right of home": 2.2,
    "in the positive limit": 3.02,
}


def switches_of(method):
    """A home switch that is active up to the end of the way (3, 4), from its beginning (5, 6), or between."""
    return UPPER if method in {3, 4, 19, 20} else LOWER if method in {5, 6, 21, 22} else SWITCHES


MOVING = [*range(1, 15), *range(17, 31)]


def ends_where_it_should(method, switches, start, edge, **speeds):
    """Whether homing ends at an edge, or at the index pulse behind it, and never leaves the limits by more than a stop."""
    wanted = next_index(edge, EXPECTED[(method - 1) % 16 + 1][1]) if method < 17 else edge
    axis = Bare(switches, start)
    found = axis.home(method, **speeds)
    assert isinstance(found, HomingAttained), found
    assert abs(found.counts / COUNTS_PER_REV - wanted) < 2.0 / COUNTS_PER_REV
    assert abs(axis.rev - wanted) < 2e-3
    assert axis.worst_rev[0] > NEGATIVE - 0.4
    assert axis.worst_rev[1] < POSITIVE + 0.4


@pytest.mark.slow
@pytest.mark.parametrize("method", MOVING)
def test_a_method_ends_where_its_switch_says_from_wherever_it_starts(method):
    for start in ("left of home", "on home", "in the positive limit"):
        ends_where_it_should(method, switches_of(method), STARTS[start], EXPECTED[(method - 1) % 16 + 1][0])


@pytest.mark.slow
@pytest.mark.parametrize("method", MOVING)
def test_a_method_ends_where_its_switch_says_from_all_other_places_and_at_other_speeds(method):
    for start in STARTS.values():
        for fast, slow in ((2.0, 0.5), (8.0, 1.0)):
            edge = EXPECTED[(method - 1) % 16 + 1][0]
            ends_where_it_should(method, switches_of(method), start, edge, fast_rps=fast, slow_rps=slow)


@pytest.mark.slow
@given(
    method=st.sampled_from([*range(7, 15), *range(23, 31)]),
    start=st.floats(-3.05, 3.05),
    left=st.floats(-2.2, 1.5),
    width=st.floats(0.02, 1.0),
)
@example(method=10, start=0.0, left=1.5, width=1.0)  # the index pulse behind its edge is beyond the limit switch
@settings(max_examples=60)
def test_a_home_switch_anywhere_is_found_from_anywhere(method, start, left, width):
    right = left + width
    switches = SWITCHES.model_copy(update={"home_deg": (left / RATIO * 360.0, right / RATIO * 360.0)})
    edge = left if EXPECTED[(method - 1) % 16 + 1][0] == LEFT else right
    distance = (edge - INDEX_REV) % 1.0
    assume(method > 16 or 0.01 < distance < 0.99)  # an edge on the index pulse itself: either of two is right
    if method < 17 and next_index(edge, EXPECTED[(method - 1) % 16 + 1][1]) >= POSITIVE:
        failed = Bare(switches, start).home(method)
        assert failed == HomingFailed("positive limit switch reached: to the index pulse")
    else:
        ends_where_it_should(method, switches, start, edge)


@pytest.mark.parametrize(("method", "direction"), [(33, -1), (34, +1)])
@pytest.mark.parametrize("start", [-1.1, 0.24, 0.26, 2.0])
def test_the_next_index_pulse_either_way_is_the_zero(method, direction, start):
    axis = Bare(None, start)
    found = axis.home(method)
    wanted = math.ceil(start) if direction > 0 else math.floor(start)  # without a table the index pulse is at 0
    assert abs(found.counts / COUNTS_PER_REV - wanted) < 1e-4
    assert abs(axis.rev - wanted) < 2e-3


@pytest.mark.parametrize("method", [35, 37])
def test_methods_35_and_37_take_the_place_where_the_motor_stands(method):
    axis = Bare(None, 0.4)
    assert axis.home(method) == HomingAttained(axis.axes.counts(0))
    assert len(axis.demands) == 1


@pytest.mark.parametrize("method", [18, 24, 23])
def test_a_method_finds_its_edge_at_any_speeds(method):
    edge, _ = EXPECTED[method - 16]
    for fast, slow in ((15.0, 2.0), (1.0, 1.0)):
        found = Bare(SWITCHES, 0.1).home(method, fast, slow)
        assert abs(found.counts / COUNTS_PER_REV - edge) < 2.0 / COUNTS_PER_REV


@pytest.mark.parametrize("method", [23, 24, 25, 26, 27, 28, 29, 30])
def test_a_switch_shorter_than_the_way_to_rest_is_found_again(method):
    narrow = SWITCHES.model_copy(update={"home_deg": (1.0 / RATIO * 360.0, 1.03 / RATIO * 360.0)})
    wanted = 1.0 if EXPECTED[method - 16][0] == LEFT else 1.03
    for start in (0.5, 1.5):
        found = Bare(narrow, start).home(method, fast_rps=5.0, slow_rps=0.2)
        assert isinstance(found, HomingAttained), (start, found)
        assert abs(found.counts / COUNTS_PER_REV - wanted) < 2.0 / COUNTS_PER_REV, start


# -- what fails --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [1, 2, 3, 17, 18, 23, 30])
def test_a_switch_that_the_axis_does_not_have_is_a_homing_error_at_once(method):
    axis = Bare(None, 0.4)
    failed = axis.home(method)
    assert isinstance(failed, HomingFailed)
    assert failed.reason.startswith("there is no")
    assert abs(axis.rev - 0.4) < 1e-9


@pytest.mark.parametrize("method", [7, 11, 24, 28])
def test_a_home_switch_that_is_nowhere_between_the_limits_is_an_error_at_the_second_limit(method):
    nowhere = SWITCHES.model_copy(update={"home_deg": (1e5, 1e6)})
    axis = Bare(nowhere, 0.5)
    failed = axis.home(method)
    assert isinstance(failed, HomingFailed)
    assert "limit switch reached" in failed.reason
    assert axis.worst_rev[0] < NEGATIVE < POSITIVE < axis.worst_rev[1]  # it has been at both


@pytest.mark.parametrize(("method", "limit"), [(3, "positive"), (5, "negative"), (33, "negative"), (34, "positive")])
def test_a_method_without_reversal_ends_at_the_limit(method, limit):
    at = -3.001 if limit == "negative" else 3.001
    axis = Bare(SWITCHES.model_copy(update={"home_deg": (1e5, 1e6)}), at)
    failed = axis.home(method)
    assert isinstance(failed, HomingFailed)
    assert failed.reason.startswith(f"{limit} limit switch reached")


def test_a_search_without_any_switch_in_its_way_does_not_go_on_for_ever():
    only_home = Switches(home_deg=(1e5, 1e6))
    axis = Bare(only_home, 0.0)
    failed = axis.home(23, travel_rev=4.0)
    assert isinstance(failed, HomingFailed)
    assert failed.reason.startswith("nothing found within 4.")
    assert axis.rev < 4.2


# -- the sequence alone ------------------------------------------------------------------------------------------------


def test_a_method_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(ValueError, match=r"homing method 15; expected one of 1, 2, 3"):
        Homing(15, 0, COUNTS_PER_REV, 1.0)


def test_the_table_has_every_method_that_the_dictionary_announces():
    assert set(HOMING_METHODS) == {*METHODS, 35, 37}
    for number in range(1, 15):
        assert METHODS[number] == METHODS[number + 16]._replace(has_index=True)


def test_an_index_pulse_that_comes_with_the_edge_counts_where_it_lies_behind_it():
    for index, is_found in ((110.0, True), (90.0, False)):
        homing = Homing(1, NEGATIVE_SWITCH, 1000.0, 1e6)
        assert homing.start(500.0, 0) == Move(-1, True)
        latches = [0.0] * 11
        assert homing.step(NEGATIVE_SWITCH, 0, latches, 99.0, False) == Move(0)
        assert homing.step(NEGATIVE_SWITCH, 0, latches, 90.0, False) == Move(0)
        assert homing.step(NEGATIVE_SWITCH, 0, latches, 90.0, True) == Move(+1, True)
        assert homing.step(0, 1 << NEGATIVE_FALLING, latches, 120.0, False) == Move(0)
        assert homing.step(0, 0, latches, 130.0, True) == Move(-1)
        assert homing.step(NEGATIVE_SWITCH, 0, latches, 99.0, False) == Move(+1)
        latches[NEGATIVE_FALLING], latches[INDEX] = 100.0, index
        step = homing.step(0, 1 << NEGATIVE_FALLING | 1 << INDEX, latches, 112.0, False)
        assert step == (GoTo(110.0) if is_found else Move(+1))
        if is_found:
            assert homing.step(0, 0, latches, 111.0, False) == GoTo(110.0)
            assert homing.step(0, 0, latches, 110.0, True) == HomingAttained(110.0)


def test_an_index_pulse_that_does_not_come_is_an_error():
    homing = Homing(34, HOME_SWITCH | POSITIVE_SWITCH, 1000.0, 1e6)
    assert homing.start(0.0, 0) == Move(+1)
    assert homing.step(0, 0, [0.0] * 11, 1400.0, False) == Move(+1)
    assert isinstance(homing.step(0, 0, [0.0] * 11, 1600.0, False), HomingFailed)


def test_what_the_robot_file_says_of_switches_must_be_in_order():
    for table in (
        {"negative_limit_deg": 3.0, "positive_limit_deg": -3.0},
        {"home_deg": (2.0, 1.0)},
        {"probe_1_deg": (1.0, 1.0)},
        {"index_deg": 360.0},
    ):
        with pytest.raises(ValueError, match=r"index_deg|the first must be the lower"):
            Switches(**table)


# -- limit switches in every phase -------------------------------------------------------------------------------------

NO_LATCHES = [0.0] * 11


def at_switch(method):
    """A sequence that has met the home switch and comes to rest on it."""
    homing = Homing(method, NEGATIVE_SWITCH | POSITIVE_SWITCH | HOME_SWITCH, 1000.0, 1e6)
    homing.start(0.0, 0)
    assert homing.step(HOME_SWITCH, 0, NO_LATCHES, 10.0, False) == Move(0)
    return homing


def beyond(method, way):
    """One that has passed the edge and comes to rest behind it."""
    homing = at_switch(method)
    assert homing.step(HOME_SWITCH, 0, NO_LATCHES, 20.0, True) == Move(way, True)
    assert homing.step(0, 0, NO_LATCHES, 30.0, False) == Move(0)
    return homing


def test_a_limit_behind_the_switch_ends_a_method_that_it_does_not_turn_round():
    failed = at_switch(19).step(HOME_SWITCH | POSITIVE_SWITCH, 0, NO_LATCHES, 20.0, False)
    assert failed == HomingFailed("positive limit switch reached: stop at the switch")
    failed = beyond(19, -1).step(NEGATIVE_SWITCH, 0, NO_LATCHES, 0.0, False)
    assert failed == HomingFailed("negative limit switch reached: stop behind the edge")


def test_a_limit_behind_the_switch_makes_a_method_that_turns_round_brake_harder_and_go_on():
    homing = at_switch(23)
    assert homing.step(HOME_SWITCH | POSITIVE_SWITCH, 0, NO_LATCHES, 20.0, False) == Move(0, is_hard=True)
    assert homing.step(HOME_SWITCH | POSITIVE_SWITCH, 0, NO_LATCHES, 21.0, True) == Move(-1, True)
    homing = beyond(26, +1)
    assert homing.step(POSITIVE_SWITCH, 0, NO_LATCHES, 40.0, False) == Move(0, is_hard=True)
    assert homing.step(POSITIVE_SWITCH, 0, NO_LATCHES, 41.0, True) == Move(-1)


def test_a_search_stands_before_a_limit_turns_it_round():
    homing = Homing(23, NEGATIVE_SWITCH | POSITIVE_SWITCH | HOME_SWITCH, 1000.0, 1e6)
    homing.start(0.0, 0)
    assert homing.step(POSITIVE_SWITCH, 0, NO_LATCHES, 10.0, False) == Move(0, is_hard=True)
    assert homing.step(POSITIVE_SWITCH, 0, NO_LATCHES, 20.0, False) == Move(0, is_hard=True)
    assert homing.step(POSITIVE_SWITCH, 0, NO_LATCHES, 21.0, True) == Move(-1, True)


def test_a_limit_that_the_motor_runs_into_before_it_has_turned_round_is_an_error():
    homing = beyond(19, -1)
    assert homing.step(0, 0, NO_LATCHES, 0.0, True) == Move(+1)
    assert homing.step(HOME_SWITCH, 0, NO_LATCHES, 10.0, False) == Move(-1)
    failed = homing.step(HOME_SWITCH | POSITIVE_SWITCH, 1 << POSITIVE_RISING, NO_LATCHES, 20.0, False)
    assert failed == HomingFailed("positive limit switch reached: pass the edge slowly")


def test_a_limit_on_the_way_to_the_zero_brakes_and_one_on_the_way_back_is_an_error():
    homing = beyond(19, -1)
    homing.step(0, 0, NO_LATCHES, 0.0, True)
    homing.step(HOME_SWITCH, 0, NO_LATCHES, 10.0, False)
    assert homing.step(0, 1 << HOME_FALLING, NO_LATCHES, -5.0, False) == GoTo(0.0)
    assert homing.step(NEGATIVE_SWITCH, 1 << NEGATIVE_RISING, NO_LATCHES, -9.0, False) == GoTo(0.0, is_hard=True)
    assert homing.step(NEGATIVE_SWITCH, 0, NO_LATCHES, -5.0, False) == GoTo(0.0, is_hard=True)
    failed = homing.step(POSITIVE_SWITCH, 1 << POSITIVE_RISING, NO_LATCHES, -1.0, False)
    assert failed == HomingFailed("positive limit switch reached: to the zero")


def test_a_limit_that_the_motor_starts_on_is_no_obstacle_on_the_way_out():
    homing = Homing(19, NEGATIVE_SWITCH | POSITIVE_SWITCH | HOME_SWITCH, 1000.0, 1e6)
    both = HOME_SWITCH | POSITIVE_SWITCH
    assert homing.start(0.0, both) == Move(+1, True)
    assert homing.step(both, 0, NO_LATCHES, 0.1, False) == Move(0)
    assert homing.step(both, 0, NO_LATCHES, 0.2, False) == Move(0)
    assert homing.step(both, 0, NO_LATCHES, 0.2, True) == Move(-1, True)
