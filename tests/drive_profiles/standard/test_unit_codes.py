"""Units as 60A8h to 60AAh code them, and the scaling that follows from them and from the factor group."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drive_profiles.errors import OutOfRangeError
from drive_profiles.standard.unit_codes import (
    ARC_MINUTE,
    ARC_SECOND,
    DEGREE,
    INCREMENT,
    METRE,
    MINUTE,
    RADIAN,
    REVOLUTION,
    RPM,
    SECOND,
    SECOND_SQUARED,
    acceleration_units,
    code,
    position_units,
    velocity_units,
)
from drive_profiles.standard.units import Scaling

TURN = 2.0 * math.pi


def test_codes_are_those_that_drives_show():
    assert code(REVOLUTION, MINUTE) == 0x00B44700  # rev/min
    assert code(DEGREE, prefix=-1) == 0xFF410000  # 0.1 degrees
    assert code(METRE, SECOND_SQUARED, -3) == 0xFD015700  # mm/s²
    assert code(RPM, SECOND) == 0x00C00300


@pytest.mark.parametrize(
    ("unit", "per_turn"),
    [
        (0, 5000.0),
        (code(INCREMENT), 5000.0),
        (code(METRE, prefix=-6), 5000.0),
        (code(RADIAN, prefix=-6), TURN * 1e6),
        (code(DEGREE, prefix=-3), 360_000.0),
        (code(ARC_MINUTE), 21600.0),
        (code(ARC_SECOND), 1_296_000.0),
        (code(REVOLUTION, prefix=-9), 1e9),
    ],
)
def test_a_turn_of_the_shaft_in_each_position_unit(unit, per_turn):
    assert position_units(unit, 5000.0) == pytest.approx(per_turn)


@pytest.mark.parametrize(
    ("unit", "position_unit", "per_turn"),
    [
        (0, code(DEGREE), 360.0),
        (code(REVOLUTION, MINUTE), 0, 60.0),
        (code(REVOLUTION, MINUTE, -3), 0, 60_000.0),
        (code(DEGREE, SECOND), code(RADIAN), 360.0),
        (code(INCREMENT, SECOND), 0, 5000.0),
        (code(METRE, SECOND, -3), code(METRE, prefix=-6), 5.0),
    ],
)
def test_a_turn_per_second_in_each_velocity_unit(unit, position_unit, per_turn):
    assert velocity_units(unit, position_unit, 5000.0) == pytest.approx(per_turn)


@pytest.mark.parametrize(
    ("unit", "position_unit", "per_turn"),
    [(0, 0, 5000.0), (code(RPM, SECOND), 0, 60.0), (code(DEGREE, SECOND_SQUARED, -1), 0, 3600.0)],
)
def test_a_turn_per_second_squared_in_each_acceleration_unit(unit, position_unit, per_turn):
    assert acceleration_units(unit, position_unit, 5000.0) == pytest.approx(per_turn)


@pytest.mark.parametrize("unit", [1, 0x00010001, 0x01410000, 0x00550000, 0x00410300, 0x80410000])
def test_what_is_no_position_unit_is_refused_with_its_code(unit):
    with pytest.raises(OutOfRangeError, match=f"60A8h {unit:08X}h"):
        position_units(unit, 1.0)


@pytest.mark.parametrize(
    ("unit", "position_unit"),
    [(0x00410000, 0), (code(DEGREE, SECOND_SQUARED), 0), (code(METRE, SECOND), 0), (code(INCREMENT, SECOND), code(METRE))],
)
def test_what_is_no_velocity_unit_or_does_not_go_with_the_position_is_refused(unit, position_unit):
    with pytest.raises(OutOfRangeError, match="60A9h"):
        velocity_units(unit, position_unit, 1.0)


def test_what_is_no_acceleration_unit_is_refused():
    for unit in (code(DEGREE, SECOND), code(METRE, SECOND_SQUARED)):
        with pytest.raises(OutOfRangeError, match="60AAh"):
            acceleration_units(unit, 0, 1.0)


def test_without_a_feed_constant_positions_are_increments_whatever_the_gear():
    scaling = Scaling(131072, 1.0, 100, 1)
    assert scaling.position_counts(TURN) == 131072
    assert scaling.counts_are_increments


def test_with_a_feed_constant_the_gear_counts():
    scaling = Scaling(131072, 1.0, 100, 1, 36000, 1)
    assert scaling.position_counts(TURN) == 360
    assert scaling.speed_rad_s(720) == pytest.approx(2 * TURN)
    assert scaling.acceleration_rad_s2(360) == pytest.approx(TURN)
    assert not scaling.counts_are_increments
    assert scaling.encoder_counts_per_rad == pytest.approx(131072 / TURN)


def test_the_factory_feed_constant_changes_nothing_to_the_last_bit():
    plain, fed = Scaling(131072, 7.1), Scaling(131072, 7.1, feed=131072)
    for value in (0.1, 1.0, 123.456, -7.0):
        assert plain.position_counts(value) == fed.position_counts(value)
        assert plain.position_rad(12345) == fed.position_rad(12345)
        assert plain.counts_per_rad == fed.counts_per_rad == 131072 / TURN
    assert fed.counts_are_increments


def test_the_polarity_reverses_positions_and_velocities_each_for_itself():
    for polarity, position, velocity in ((0x80, -1, 1), (0x40, 1, -1), (0xC0, -1, -1)):
        scaling = Scaling(1000, 1.0, polarity=polarity)
        assert scaling.position_counts(TURN) == 1000 * position
        assert scaling.speed_rad_s(1000 * velocity) == pytest.approx(TURN)
        assert scaling.acceleration_rad_s2(1000) == pytest.approx(TURN)
        assert scaling.counts_are_increments == (position > 0)
    with pytest.raises(OutOfRangeError, match="607Eh"):
        Scaling(1000, 1.0, polarity=1)


@given(
    st.builds(
        Scaling,
        st.integers(1, 2**24),
        st.just(1.0),
        st.integers(1, 1000),
        st.integers(1, 1000),
        st.integers(1, 10**6),
        st.integers(1, 1000),
        st.sampled_from((0, 0x40, 0x80, 0xC0)),
        st.sampled_from((0, code(DEGREE, prefix=-3), code(RADIAN, prefix=-6))),
        st.sampled_from((0, code(REVOLUTION, MINUTE, -3))),
        st.sampled_from((0, code(RPM, SECOND))),
    ),
    st.integers(-(2**31), 2**31 - 1),
)
@settings(max_examples=50)
def test_positions_and_speeds_come_back_in_any_units(scaling, wire):
    assert scaling.position_counts(scaling.position_rad(wire)) == wire
    assert scaling.speed_rad_s(wire) * scaling.speed_units_per_rad_s == pytest.approx(wire)
