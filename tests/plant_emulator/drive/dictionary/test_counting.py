"""How a drive counts: each of its conversions undoes its opposite, in any units and from any zero."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.standard.units import Scaling
from plant_emulator.drive.dictionary.counting import INT16_MAX, INT32_MAX, Counting, clip

TURN = 2.0 * math.pi
INCREMENTS = Scaling(131072, 1.2)
SCALINGS = st.builds(
    Scaling,
    st.integers(1000, 2**20),
    st.floats(0.01, 100.0),
    gear_motor_revs=st.integers(1, 200),
    gear_shaft_revs=st.integers(1, 5),
    feed=st.none() | st.integers(1, 10**6),
    polarity=st.sampled_from((0x00, 0x40, 0x80, 0xC0)),
)
COUNTINGS = st.builds(Counting, SCALINGS, st.integers(-(10**6), 10**6))


@given(COUNTINGS, st.integers(-(10**6), 10**6))
def test_a_shown_position_is_the_counts_of_the_encoder_again_to_half_a_unit(counting, counts):
    unit_counts = abs(1.0 / counting.units_per_count)
    again = counting.encoder_counts(counting.shown_position(counts))
    if abs((counts + counting.offset_counts) * counting.units_per_count) < INT32_MAX:
        assert abs(again - counts) <= 0.5 * unit_counts + 1.0


@given(COUNTINGS, st.integers(-(10**6), 10**6))
def test_what_is_shown_at_the_counts_of_a_position_is_that_position_where_the_encoder_is_finer(counting, position):
    if abs(counting.units_per_count) <= 1.0:
        assert counting.shown_position(counting.encoder_counts(position)) == position


@given(COUNTINGS, st.integers(-(2**31) + 1, 2**31 - 1))
def test_a_speed_on_the_bus_is_shown_as_it_was_written(counting, number):
    assert counting.shown_speed(counting.speed_rad_s(number)) == number


@given(COUNTINGS, st.integers(-INT16_MAX, INT16_MAX))
def test_a_torque_on_the_bus_is_shown_as_it_was_written(counting, per_mille):
    assert counting.shown_torque(counting.torque_nm(per_mille)) == per_mille


@given(COUNTINGS, st.integers(-(10**6), 10**6))
def test_from_the_zero_that_homing_has_found_the_drive_shows_the_home_offset_there(counting, counts):
    homed = counting.homed(counting.shown_position(counts), counts)
    assert homed.scaling == counting.scaling
    assert homed.encoder_counts(counting.shown_position(counts)) == counts


def test_in_increments_a_position_is_what_the_encoder_counts_shifted_by_the_zero():
    counting = Counting(INCREMENTS, offset_counts=-1000)
    assert counting.is_encoder
    assert counting.shown_position(1500) == 500
    assert counting.encoder_counts(500) == 1500


def test_polarity_turns_positions_and_speeds_round():
    counting = Counting(Scaling(131072, 1.2, polarity=0xC0))
    assert counting.shown_position(1000) == -1000
    assert counting.encoder_counts(-1000) == 1000
    assert counting.shown_speed(TURN) == -131072
    assert counting.speed_rad_s(-131072) == pytest.approx(TURN)


def test_more_than_an_object_holds_is_shown_as_the_most_that_it_holds():
    counting = Counting(INCREMENTS)
    assert counting.shown_position(1e12) == INT32_MAX
    assert counting.shown_speed(-1e12) == -INT32_MAX
    assert counting.shown_torque(1e6) == INT16_MAX
    assert clip(2.5) == 2


def test_other_units_leave_the_zero_and_another_zero_the_units():
    counting = Counting(INCREMENTS, 77)
    other = Scaling(131072, 2.0)
    assert counting.scaled(other) == Counting(other, 77)
    assert counting.shifted(5) == Counting(INCREMENTS, 5)
    assert counting == Counting(INCREMENTS, 77)
