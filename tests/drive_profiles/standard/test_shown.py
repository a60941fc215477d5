"""Values as people read them: short, with one spelling, and never the same for two that differ."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.standard import shown
from drive_profiles.standard.cia301 import DataType

GAIN = (0x2100, 1)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (3.7997330000000002, "3.8"), (25.132741228718345, "25.13"), (100.0, "100"), (1_500_000, "1500000"), (25132.741, "25133"),
        (0.00012345, "0.0001234"), (1e-6, "1e-06"), (-16384.0, "-16384"), (0.1 + 0.2, "0.3"), (math.inf, "inf"),
        (1e300, "1e+300"), (1_234_567.8, "1234568"),
    ],
)  # fmt: skip
def test_numbers_have_four_digits_and_whole_ones_all(number, text):
    assert shown.number(number) == text


@given(st.floats(-1e300, 1e300))
def test_a_shown_number_is_right_to_half_of_its_fourth_digit(number):
    assert math.isclose(float(shown.number(number)), number, rel_tol=5.01e-4, abs_tol=1e-320)


@pytest.mark.parametrize(
    ("address", "held", "data_type", "text"),
    [
        ((0x6041, 0), 0x237, DataType.UNSIGNED16, "0x0237"),
        ((0x6040, 0), 15, DataType.UNSIGNED16, "0x000F"),
        ((0x1001, 0), 0, DataType.UNSIGNED8, "0x00"),
        ((0x1018, 1), 0xFB, DataType.UNSIGNED32, "0x000000FB"),
        ((0x1018, 4), 4711, DataType.UNSIGNED32, "4711"),  # a serial number is counted
        ((0x1014, 0), 0x82, DataType.UNSIGNED32, "0x00000082"),
        ((0x1400, 1), 0x201, DataType.UNSIGNED32, "0x00000201"),
        ((0x1400, 2), 255, DataType.UNSIGNED8, "255"),
        ((0x1A00, 0), 2, DataType.UNSIGNED8, "2"),
        ((0x1A00, 1), 0x60410010, DataType.UNSIGNED32, "0x60410010"),
        ((0x1600, 3), 0x60FF0020, DataType.UNSIGNED32, "0x60FF0020"),
        ((0x1200, 1), 0x601, DataType.UNSIGNED32, "0x00000601"),
        ((0x1003, 0), 2, DataType.UNSIGNED8, "2"),
        ((0x1003, 1), 0x8130, DataType.UNSIGNED32, "0x00008130"),
        ((0x60A8, 0), 0xFD100000, None, "0xFD100000"),
        ((0x6060, 0), 8, DataType.INTEGER8, "8"),
        ((0x605A, 0), 2, DataType.INTEGER16, "2"),
        (GAIN, 25.132741, DataType.REAL32, "25.13"),
        ((0x1008, 0), "Emulated servo drive", DataType.VISIBLE_STRING, "Emulated servo drive"),
    ],
)
def test_words_of_bits_are_hexadecimal_and_counts_are_not(address, held, data_type, text):
    assert shown.value(held, address, data_type) == text


def test_two_values_that_differ_are_not_shown_alike():
    assert shown.pair(3.8, 3.8003, GAIN) == ("3.8", "3.8003")
    assert shown.pair(3.8, 3.8, GAIN) == ("3.8", "3.8")
    assert shown.pair("", 2.0, GAIN) == ("", "2")


@given(st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_whatever_they_are(left, right):
    one, other = shown.pair(left, right, GAIN)
    assert (one == other) == (left == right)


def test_a_unit_has_one_spelling():
    assert [shown.unit(each) for each in ("us", "rps", "deg", "per mille", "N·m", "")] == ["µs", "rev/s", "°", "‰", "N·m", ""]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (48950.23, 38.4, "48950 ± 38"), (0.000260634, 1.2e-7, "0.00026063 ± 0.00000012"), (-12.4331, 0.0042, "-12.4331 ± 0.0042"),
        (250.0, 1234.5, "250 ± 1234"), (5.0, 0.0, "5 ± 0"), (5.25, math.inf, "5.25 ± inf"),
    ],
)  # fmt: skip
def test_what_was_measured_has_the_digits_that_its_error_leaves(value, error, text):
    assert shown.measured(value, error) == text
