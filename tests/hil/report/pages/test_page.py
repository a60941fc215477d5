"""What every page does with words: symbols, code, instants."""

import pytest
from markupsafe import Markup

from hil.report.pages.page import moment_text, typeset


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("K_g and f_al", "K<sub>g</sub> and f<sub>al</sub>"),
        ("what `hil design notch` makes of f_a", "what <code>hil design notch</code> makes of f<sub>a</sub>"),
        ("the key `K_g`", "the key <code>K_g</code>"),
        ("a lone ` stays", "a lone ` stays"),
        ("<b> & f_a", "&lt;b&gt; &amp; f<sub>a</sub>"),
        ("axis2_position_rad", "axis2_position_rad"),
        (Markup("<i>f_a</i>"), "<i>f_a</i>"),
        ("0.064 mm, −49 % peak, at 5.92 rev/s", "0.064&nbsp;mm, −49&nbsp;% peak, at 5.92&nbsp;rev/s"),
        ("in 3 steps, 2 mmm", "in 3 steps, 2 mmm"),
    ],
)
def test_symbols_and_code_are_set_and_nothing_else(text, html):
    assert str(typeset(text)) == html


@pytest.mark.parametrize(
    ("instant", "words"),
    [
        ("2026-11-22T14:02:37+00:00", "22 November 2026, 14:02 UTC"),
        ("2026-11-22T00:30:00+01:00", "21 November 2026, 23:30 UTC"),
        ("2025-01-01T12:00:00Z", "1 January 2025, 12:00 UTC"),
        ("2025-01-01T12:00:00", "1 January 2025, 12:00 UTC"),
        ("some day", "some day"),
    ],
)
def test_an_instant_is_said_as_a_reader_says_it(instant, words):
    assert moment_text(instant) == words
