"""Conversion of Matplotlib's SVG for an HTML page."""

import io
import re
from typing import Any, NamedTuple

from markupsafe import escape
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from hil.report import palette

FONTS = "'DejaVu Sans', 'Bitstream Vera Sans', Verdana, Geneva, sans-serif"
"""Fonts of equal or lesser width than that in which the figures are laid out."""

_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_COORDINATES = re.compile(r' (d|points|x|y)="([^"]*)"|translate\(([^)]*)\)', re.DOTALL)
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")
_FORMULA = re.compile(r"<text>\s*((?:<tspan [^>]*>[^<]*</tspan>\s*)+)</text>")
_GLYPH = re.compile(r'<tspan x="([^"]*)" y="([^"]*)" style="([^"]*)">([^<]*)</tspan>')


class _Glyph(NamedTuple):
    x: float
    y: str
    style: str
    text: str


def inline(figure: Figure, key: str) -> str:
    """Return a figure as an inline SVG element.

    The element `KEY-title` of the page names it.

    Raises:
        ValueError: The figure has a colour that is not in the palette.
    """
    buffer = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)  # whose methods have no types
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    canvas.print_svg(buffer, metadata={"Date": None})  # `savefig` would draw the whole figure twice
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"\s*<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'\s*<style type="text/css">.*?</style>', "", text, flags=re.DOTALL)
    text = re.sub(r"; font-family: 'DejaVu Sans'", "", text)
    box = re.search(r'viewBox="[^"]*"', text)
    # black is left out by matplotlib: what has no colour has the page's ink
    look = f"fill: {palette.VARIABLES[palette.INK.day]}; font-family: {FONTS}; stroke-linejoin: round; stroke-linecap: butt"
    start = f'<svg role="img" aria-labelledby="{key}-title" {box[0] if box else ""} style="{look}" xmlns="http://www.w3.org/2000/svg">'
    text = re.sub(r"<svg [^>]*>", start, text, count=1).replace("xlink:href", "href")
    text = _FORMULA.sub(_words, _own_ids(text, key))
    text = _COLOUR.sub(lambda match: _variable(match[0], key), text)
    return re.sub(r"\n\s*", "\n", _COORDINATES.sub(_shorter, text.replace('transform="rotate(-0 ', 'transform="rotate(0 ')))


def standalone(svg: str, title: str) -> str:
    """Return inline SVG as a file with its own title and colours.

    The element's `aria-labelledby` names the title.
    """
    name = re.search(r'aria-labelledby="([^"]*)"', svg)
    if name is None:
        raise ValueError("the SVG element has no aria-labelledby")
    used = tuple(colour for colour in palette.OF_FIGURES if f"var(--{colour.name})" in svg)
    head = f'<title id="{name[1]}">{escape(title)}</title>\n<style>\n{palette.css("svg", used)}\n</style>\n'
    begin = svg.index(">") + 1
    return f"{svg[:begin]}\n{head}{svg[begin:].lstrip()}"


def _variable(colour: str, key: str) -> str:
    try:
        return palette.VARIABLES[colour.lower()]
    except KeyError:
        raise ValueError(f"figure {key}: the colour {colour} is not in the palette") from None


def _words(match: re.Match[str]) -> str:
    """Return a formula as searchable text in reading order."""
    glyphs = sorted(
        _Glyph(float(x), y, style, text.replace("\N{NO-BREAK SPACE}", " ")) for x, y, style, text in _GLYPH.findall(match[1])
    )
    runs: list[tuple[_Glyph, str]] = []
    for glyph in glyphs:
        if runs and (runs[-1][0].y, runs[-1][0].style) == (glyph.y, glyph.style):
            runs[-1] = (runs[-1][0], runs[-1][1] + glyph.text)
        elif glyph.text.strip():
            runs.append((glyph, glyph.text))
        elif runs:
            runs[-1] = (runs[-1][0], runs[-1][1] + glyph.text)
    inside = "".join(f'<tspan x="{first.x:.2f}" y="{first.y}" style="{first.style}">{text}</tspan>' for first, text in runs)
    return f"<text>{inside}</text>"


def _shorter(match: re.Match[str]) -> str:
    """Shorten coordinates to two decimals, below every resolution."""
    text = " ".join(_NUMBER.sub(lambda number: f"{float(number[0]):.2f}", match[2] or match[3] or "").split())
    return f"translate({text})" if match[1] is None else f' {match[1]}="{text}"'


def _own_ids(text: str, key: str) -> str:
    """Return text with the ids referred to, numbered: Matplotlib's are memory addresses."""
    numbers: dict[str, int] = {}
    for name in re.findall(r'(?:href="|url\()#([^")]+)', text):
        numbers.setdefault(name, len(numbers))
    text = re.sub(r'\sid="([^"]*)"', lambda m: f' id="{key}-{numbers[m[1]]}"' if m[1] in numbers else "", text)
    return re.sub(r'(href="|url\()#([^")]+)', lambda m: f"{m[1]}#{key}-{numbers[m[2]]}", text)
