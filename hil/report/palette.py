"""Every colour of pages and figures, by day and night.

Print is always day.
Figures are drawn in the colours of day. In the SVG each of them becomes a CSS variable (`hil.report.svg`), so that one picture
serves both.
"""

from typing import NamedTuple


class Colour(NamedTuple):
    """A colour: its CSS variable, and values on light and dark ground."""

    name: str
    day: str
    night: str


# Okabe and Ito's palette, by day as it was published, by night at least as far from a dark ground
INK = Colour("ink", "#15191f", "#eef1f5")
ORANGE = Colour("orange", "#e69f00", "#eda921")
SKY = Colour("sky", "#56b4e9", "#2e7fb0")
GREEN = Colour("green", "#009e73", "#27bd92")
BLUE = Colour("blue", "#0072b2", "#62b6f2")
VERMILLION = Colour("vermillion", "#d55e00", "#ff8042")
PURPLE = Colour("purple", "#cc79a7", "#e295bf")
PAPER = Colour("paper", "#ffffff", "#12161b")
GREY = Colour("grey", "#5a6270", "#98a2af")
EDGE = Colour("edge", "#444b55", "#aab3be")
GRID = Colour("grid", "#d9dde3", "#333b45")
SHADE = Colour("shade", "#e9eef4", "#222a33")

SPEEDS = tuple(
    Colour(f"speed-{number}", day, night)
    for number, (day, night) in enumerate(
        (
            ("#9ecae9", "#2a5476"), ("#8bbfe3", "#305f86"), ("#77b3dd", "#366b97"), ("#64a8d8", "#3c77a7"),
            ("#519dd2", "#4283b8"), ("#3d91cc", "#4c90c6"), ("#3385be", "#5b9dd0"), ("#2b78b0", "#6ba9d9"),
            ("#226ba2", "#7ab5e1"), ("#1a5f94", "#8bc0e8"), ("#115286", "#9dcbee"), ("#0a4678", "#afd5f2"),
            ("#083c69", "#c1dff6"), ("#063359", "#d2e8f9"), ("#052a4a", "#e2f0fb"), ("#04213e", "#f1f8fe"),
        )
    )
)  # fmt: skip
"""Motor speeds from slow (faint) to fast (strong), as in the paper."""

OF_PAGES = (
    Colour("soft", "#525b68", "#a4aebb"),
    Colour("line", "#d5dae1", "#39424d"),
    Colour("link", "#00538a", "#7cc3f7"),
    Colour("good", "#00664b", "#54d3a8"),
    Colour("bad", "#a33a00", "#ff9c6b"),
    Colour("open", "#6b5200", "#e8c557"),
    Colour("good-edge", "#009e73", "#27bd92"),
    Colour("bad-edge", "#d55e00", "#ff8042"),
    Colour("open-edge", "#b58900", "#c99c1c"),
    Colour("good-ground", "#eef8f4", "#11251f"),
    Colour("bad-ground", "#fdf1ea", "#2c1b12"),
    Colour("open-ground", "#fdf8e6", "#27210f"),
)
"""Colours of text, lines and verdicts, which no figure has."""

OF_FIGURES = (INK, ORANGE, SKY, GREEN, BLUE, VERMILLION, PURPLE, PAPER, GREY, EDGE, GRID, SHADE, *SPEEDS)

VARIABLES = {colour.day: f"var(--{colour.name})" for colour in OF_FIGURES}
"""CSS variable of each colour that a figure may have, by its value by day."""


def css(selector: str, colours: tuple[Colour, ...] = (*OF_FIGURES, *OF_PAGES)) -> str:
    """Return CSS rules with every colour's values by day and night."""
    day, night = (
        " ".join(f"--{colour.name}: {colour.night if is_dark else colour.day};" for colour in colours)
        for is_dark in (False, True)
    )
    return f"{selector} {{ {day} }}\n@media screen and (prefers-color-scheme: dark) {{ {selector} {{ {night} }} }}"
