"""Numbers in the cells of tables."""

import pytest

from hil.report.report_table import number, value_and_error


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.2, "{:.0f}", "0"),
        (-0.04, "{:+.1f}", "0.0"),
        (-0.2, "{:.1f} %", "−0.2 %"),
        (-0.0004, "{:.2f} %", "0.00 %"),
        (None, "{}", "–"),
    ],
)
def test_no_zero_has_a_minus_sign(value, form, text):
    assert number(value, form) == text


def test_an_estimate_of_about_zero_has_none_either():
    assert value_and_error(-0.2, 5.0) == ("0", "5")
