"""Figures as SVG: colours of the palette, words that can be found, and a file that stands alone."""

import re
from xml.etree import ElementTree

import pytest

from hil.report import palette, style, svg

SVG = "{http://www.w3.org/2000/svg}"


def figure(colour=style.BLUE):
    with style.styled():
        drawn, panels = style.panels(1, 1, 2.0)
        panels[0, 0].plot([0.0, 1.0], [0.0, 1.0], color=colour)
        panels[0, 0].set_xlabel("Motor speed $f_m$ (rev/s)")
        panels[0, 0].set_ylabel("Plain (mm)")
        return str(style.to_svg(drawn, "key"))


def test_every_colour_is_a_variable_of_the_palette():
    made = figure()
    assert not re.search(r"#[0-9a-fA-F]{6}", made)
    assert "var(--blue)" in made
    assert set(re.findall(r"var\(--([a-z0-9-]+)\)", made)) <= {colour.name for colour in palette.OF_FIGURES}


def test_a_colour_of_no_palette_is_refused():
    with pytest.raises(ValueError, match="#123456 is not in the palette"):
        figure("#123456")


def test_words_stand_in_the_picture_in_reading_order():
    texts = ["".join(element.itertext()) for element in ElementTree.fromstring(figure()).iter(f"{SVG}text")]  # noqa: S314 - our own
    assert "Plain (mm)" in texts
    assert "Motor speed fm (rev/s)" in texts


def test_the_font_is_said_once_for_all_words():
    made = figure()
    root = ElementTree.fromstring(made)  # noqa: S314 - our own
    assert f"; font-family: {svg.FONTS};" in root.get("style")
    assert made.count("font-family") == 1


def test_a_file_of_its_own_has_title_colours_and_a_dark_side():
    alone = svg.standalone(figure(), "Speed & tip")
    root = ElementTree.fromstring(alone)  # noqa: S314 - our own
    named = root.get("aria-labelledby")
    title = root.find(f"{SVG}title")
    assert title.get("id") == named
    assert title.text == "Speed & tip"
    assert "@media screen and (prefers-color-scheme: dark)" in alone
    for name in set(re.findall(r"var\(--([a-z0-9-]+)\)", alone)):
        assert alone.count(f"--{name}:") == 2


def luminance(colour):
    parts = (int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5))
    return sum(
        weight * (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4)
        for weight, part in zip((0.2126, 0.7152, 0.0722), parts, strict=True)
    )


def contrast(first, second):
    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("is_dark", [False, True])
def test_words_can_be_read_by_day_and_by_night(is_dark):
    values = {colour.name: colour[1 + is_dark] for colour in (*palette.OF_FIGURES, *palette.OF_PAGES)}
    for name in ("ink", "soft", "link", "good", "bad", "open", "grey"):
        assert contrast(values[name], values["paper"]) >= 4.5, name
    for name in ("good", "bad", "open"):
        assert contrast(values[name], values[f"{name}-ground"]) >= 4.5, name


def test_lines_are_seen_at_night_as_well_as_by_day():
    for colour in (palette.BLUE, palette.ORANGE, palette.SKY, palette.GREEN, palette.VERMILLION, palette.PURPLE):
        by_day, by_night = contrast(colour.day, palette.PAPER.day), contrast(colour.night, palette.PAPER.night)
        assert by_night >= min(by_day, 3.0), colour.name
