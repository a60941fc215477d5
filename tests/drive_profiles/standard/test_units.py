"""Conversions as inverse pairs, and what they refuse."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.errors import DriveProfileError, OutOfRangeError
from drive_profiles.standard import units
from drive_profiles.standard.units import Scaling

AXIS_2 = Scaling(encoder_counts_per_rev=131072, rated_torque_nm=7.1)
scalings = st.builds(
    Scaling,
    st.integers(1, 2**24),
    st.floats(1e-3, 1e4),
    st.integers(1, 1000),
    st.integers(1, 1000),
)
int32 = st.integers(-(2**31), 2**31 - 1)
int16 = st.integers(-(2**15), 2**15 - 1)


@given(scalings, int32)
def test_position_comes_back_from_the_wire(scaling, counts):
    assert scaling.position_counts(scaling.position_rad(counts)) == counts


@given(scalings, int16)
def test_torque_comes_back_from_the_wire(scaling, per_mille):
    assert scaling.torque_per_mille(scaling.torque_nm(per_mille)) == per_mille


@given(st.floats(-1e4, 1e4))
def test_what_goes_on_the_wire_is_within_half_a_step(value):
    position = AXIS_2.position_rad(AXIS_2.position_counts(value))
    assert abs(position - value) <= 0.5 / AXIS_2.counts_per_rad * (1 + 1e-6)
    torque_nm = value * 1e-2
    assert abs(AXIS_2.torque_nm(AXIS_2.torque_per_mille(torque_nm)) - torque_nm) <= 0.5 * AXIS_2.torque_quantum_nm * (1 + 1e-6)


@given(st.lists(int32, max_size=8), st.lists(int16, max_size=8))
def test_arrays_are_the_scalars_side_by_side(counts, per_mille):
    positions = AXIS_2.position_rad(np.array(counts, dtype=np.int64))
    assert positions.tolist() == [AXIS_2.position_rad(c) for c in counts]
    assert AXIS_2.position_counts(positions).tolist() == counts
    torques = AXIS_2.torque_nm(np.array(per_mille, dtype=np.int64))
    assert AXIS_2.torque_per_mille(torques).tolist() == per_mille
    assert AXIS_2.torque_per_mille(torques).dtype == np.int64


def test_known_values():
    assert AXIS_2.position_counts(2 * math.pi) == 131072
    assert AXIS_2.torque_per_mille(7.1) == 1000
    assert AXIS_2.torque_per_mille(-3.55) == -500
    assert AXIS_2.speed_rad_s(9 * 131072) == pytest.approx(2 * math.pi * 9.0)
    assert Scaling(units.counts_per_rev("608Fh", 131072, 1), units.rated_torque_nm(7100)) == AXIS_2


def test_halves_go_to_even():
    scaling = Scaling(1000, 1.0)  # 1 mN·m is 1 per mille
    assert [scaling.torque_per_mille(n / 1000) for n in (0.5, 1.5, 2.5, -0.5, -1.5)] == [0, 2, 2, 0, -2]
    assert scaling.torque_per_mille(np.array([0.5, 1.5, 2.5]) / 1000).tolist() == [0, 2, 2]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_number_is_refused_by_every_conversion(value):
    for convert in (
        AXIS_2.position_counts,
        AXIS_2.torque_per_mille,
        units.real32,
        units.interpolation_period,
    ):
        with pytest.raises(OutOfRangeError):
            convert(value)
    with pytest.raises(OutOfRangeError):
        AXIS_2.position_counts(np.array([0.0, value]))


def test_overflow_is_refused_at_the_very_count_with_the_values():
    scaling = Scaling(1000, 1.0)
    assert scaling.torque_per_mille(32.767) == 32767
    assert scaling.torque_per_mille(-32.768) == -32768
    with pytest.raises(OutOfRangeError, match=r"torque 32\.768 N·m: 32768 on the wire is outside -32768 to 32767"):
        scaling.torque_per_mille(32.768)
    with pytest.raises(ValueError, match="outside -2147483648 to 2147483647") as caught:
        scaling.position_counts(np.array([1.0, 2e7]))
    assert isinstance(caught.value, DriveProfileError)
    assert caught.value.value == 2e7


@pytest.mark.parametrize("arguments", [(0, 1.0), (1, 0.0), (1, math.nan), (1, 1.0, 0, 1), (1, 1.0, 1, -1)])
def test_a_scaling_without_inverse_cannot_be_built(arguments):
    with pytest.raises(OutOfRangeError, match="must be positive"):
        Scaling(*arguments)


@pytest.mark.parametrize(("increments", "revs"), [(10, 3), (10, 0), (0, 1)])
def test_objects_that_state_no_scaling_are_refused(increments, revs):
    with pytest.raises(OutOfRangeError):
        Scaling(units.counts_per_rev("608Fh", increments, revs), 1.0)


@pytest.mark.parametrize(
    ("period_s", "value", "index"),
    [
        (250e-6, 25, -5),
        (125e-6, 125, -6),
        (1e-3, 1, -3),
        (500e-6, 5, -4),
        (2e-2, 2, -2),
        (0.255, 255, -3),
        (10.0, 1, 1),
    ],
)
def test_interpolation_period_known_values(period_s, value, index):
    assert units.interpolation_period(period_s) == (value, index)
    assert units.interpolation_period_s(value, index) == period_s


@given(st.integers(1, 255), st.integers(-9, 3))
def test_every_interpolation_period_comes_back(value, index):
    period_s = units.interpolation_period_s(value, index)
    assert units.interpolation_period_s(*units.interpolation_period(period_s)) == period_s


@pytest.mark.parametrize("period_s", [1 / 3000, 256e-6 + 1e-9, 1.0e-10, 0.0, -1e-3, 0.2561])
def test_a_period_that_60c2_cannot_say_is_refused(period_s):
    with pytest.raises(OutOfRangeError, match="interpolation period"):
        units.interpolation_period(period_s)


def test_a_pair_that_60c2_cannot_hold_is_refused():
    for pair in ((0, -3), (256, -3), (1, -129), (1, 64)):
        with pytest.raises(OutOfRangeError):
            units.interpolation_period_s(*pair)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_single_is_held_as_it_is(value):
    assert units.real32(value) == value


@given(st.floats(-1e38, 1e38))
def test_real32_is_what_four_bytes_hold(value):
    assert units.real32(value) == struct.unpack("<f", struct.pack("<f", value))[0] == float(np.float32(value))
    assert units.real32(units.real32(value)) == units.real32(value)
