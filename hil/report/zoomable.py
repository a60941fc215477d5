"""Zoomable data of a figure, read from Matplotlib."""

import re
from dataclasses import dataclass
from typing import Any, Literal
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from hil.control.arrays import Real
from hil.report import palette

Range = tuple[float, float]

NAMES = {colour.day: colour.name for colour in palette.OF_FIGURES}
"""Names of the palette's colours by their values by day."""
MAP_COLUMNS = 200
"""Columns of a map, which are evenly spaced."""

_GREEK = {"zeta": "ζ", "theta": "θ", "tau": "τ", "omega": "ω", "phi": "φ", "pi": "π", "Delta": "Δ", "circ": "°"}
_COMMAND = re.compile(r"\\([A-Za-z]+)")
_WHOLE: WeakKeyDictionary[Line2D, tuple[Real, Real]] = WeakKeyDictionary()
_NAMED: WeakKeyDictionary[Line2D, str] = WeakKeyDictionary()
_MAPS: WeakKeyDictionary[Axes, "ZoomMap"] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class ZoomCurve:
    """A curve of a panel.

    Attributes:
        name: Its name in the legend; empty for none.
        x: Abscissa; shape (n,).
        y: Ordinate; shape (n,).
        width: Width of the line; 0 for points alone.
    """

    name: str
    colour: str
    x: Real
    y: Real
    is_broken: bool
    width: float
    has_points: bool


@dataclass(frozen=True)
class ZoomLine:
    """Line across a panel, at a place on one of its axes."""

    name: str
    colour: str
    axis: Literal["x", "y"]
    at: float


@dataclass(frozen=True, eq=False)
class ZoomShade:
    """Shaded part of a panel.

    Attributes:
        x: Corners of the outline in x; shape (n,).
        y: Corners in y; shape (n,); empty for a shade across the whole panel.
    """

    colour: str
    x: Real
    y: Real


@dataclass(frozen=True, eq=False)
class ZoomMap:
    """A map of colours.

    Attributes:
        values: Values in rows from the lowest ordinate up; shape (rows, columns), NaN for a missing value.
        top: Value of the strongest colour; the faintest is 0.
        colours: Names of its colours in the palette, from the faintest.
    """

    x: Range
    y: Range
    values: Real
    top: float
    colours: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ZoomPanel:
    """A panel: its curves and maps, and its limits.

    Attributes:
        names: Names of abscissa and ordinate with their units.
        is_square: True if both axes have one scale.
        right: Name of a second scale on the right, and how many of its units make one of the ordinate's; None without one.
    """

    title: str
    names: tuple[str, str]
    x: Range
    y: Range
    is_log: bool
    is_square: bool
    right: tuple[str, float] | None
    curves: tuple[ZoomCurve, ...]
    lines: tuple[ZoomLine, ...]
    shades: tuple[ZoomShade, ...]
    map: ZoomMap | None


ZoomFigure = dict[tuple[int, int], ZoomPanel]
"""A figure: its panels, by rows and columns of a grid."""


def keep_whole(line: Line2D, x: Real, y: Real) -> None:
    """Keep all samples of a thinned line; shapes (n,)."""
    _WHOLE[line] = x, y


def keep_name(line: Line2D, name: str) -> None:
    """Keep a line's name that is not in the legend."""
    _NAMED[line] = name


def keep_map(panel: Axes, x: Real, y: Real, values: Real, top: float, colours: tuple[str, ...]) -> None:
    """Keep the data of a panel's map, evenly in x.

    Args:
        x: Abscissa of the columns, rising; shape (n,).
        y: Ordinate of the rows, rising evenly; shape (m,), or (n, m) where each column has its own, which are made even.
        values: Values; shape (n, m).
        top: Value of the strongest colour.
        colours: Colours by day, from the faintest.
    """
    rows = y if y.ndim == 1 else np.linspace(float(np.min(y)), float(np.max(y)), y.shape[1])
    if y.ndim > 1:
        values = np.array([np.interp(rows, own, each, np.nan, np.nan) for own, each in zip(y, values, strict=True)])
    even = np.linspace(float(x[0]), float(x[-1]), MAP_COLUMNS)
    image = np.array([np.interp(even, x, row) for row in values.T])
    ends = (float(even[0]), float(even[-1])), (float(rows[0]), float(rows[-1]))
    _MAPS[panel] = ZoomMap(*ends, image, top, tuple(NAMES[each] for each in colours))


def zoomable(figure: Figure) -> ZoomFigure:
    """Return the zoomable data of a drawn figure with final limits."""
    panels: ZoomFigure = {}
    for panel in figure.axes:
        place = panel.get_subplotspec()
        if place is not None and panel.get_visible() and panel.get_label() != "<colorbar>":
            panels[place.rowspan.start, place.colspan.start] = _panel(panel)
    return panels


def _panel(panel: Axes) -> ZoomPanel:
    drawn = [_drawn(panel, line) for line in panel.get_lines()]
    return ZoomPanel(
        plain(panel.get_title(loc="left") or panel.get_title()),
        (plain(panel.get_xlabel()), plain(panel.get_ylabel())),
        _ends(panel.get_xlim()),
        _ends(panel.get_ylim()),
        panel.get_xscale() == "log",
        panel.get_aspect() != "auto",
        _right(panel),
        tuple(each for each in drawn if isinstance(each, ZoomCurve)),
        tuple(each for each in drawn if isinstance(each, ZoomLine)),
        tuple(_shades(panel)),
        _MAPS.get(panel),
    )


def _drawn(panel: Axes, line: Line2D) -> ZoomCurve | ZoomLine | None:
    """Read a line of Matplotlib: a curve, or a line across."""
    is_x, is_y = line.get_transform().contains_branch_seperately(panel.transData)
    label = str(line.get_label())
    name = plain(_NAMED.get(line, "" if label.startswith("_") else label))
    colour = NAMES[to_hex(line.get_color())]
    x, y = _WHOLE.get(line, tuple(np.asarray(each, dtype=np.float64) for each in line.get_data()))
    if not is_x or not is_y:
        return ZoomLine(name, colour, "x" if is_x else "y", float((x if is_x else y)[0])) if is_x or is_y else None
    style = line.get_linestyle()
    width = 0.0 if style in {"None", "none", "", " "} else float(line.get_linewidth())
    has_points = line.get_marker() not in {"None", "none", "", " ", None}
    return ZoomCurve(name, colour, np.asarray(x), np.asarray(y), style != "-", width, has_points) if len(x) else None


def _shades(panel: Axes) -> list[ZoomShade]:
    found = []
    for patch in panel.patches:
        if isinstance(patch, Rectangle):  # of `axvspan`, from the bottom of the panel to its top
            x = np.array([patch.get_x(), patch.get_x() + patch.get_width()])
            found.append(ZoomShade(NAMES[to_hex(patch.get_facecolor())], x, np.zeros(0)))
    for each in panel.collections:
        faces = np.asarray(each.get_facecolor())
        if isinstance(each, PolyCollection) and len(faces):
            colour = NAMES[to_hex(faces[0][:3])]
            found += [ZoomShade(colour, *np.asarray(path.vertices, dtype=np.float64).T) for path in each.get_paths()]
    return found


def _right(panel: Axes) -> tuple[str, float] | None:
    for child in panel.child_axes:
        low, high = panel.get_ylim()
        if child.get_ylabel() and high > low:
            bottom, top = child.get_ylim()
            return plain(child.get_ylabel()), float((top - bottom) / (high - low))
    return None


def _ends(limits: Any) -> Range:
    return float(limits[0]), float(limits[1])


def plain(text: str) -> str:
    r"""Text with its formulae in plain letters.

    >>> plain(r"Pole damping $\zeta_{rd}$ (–)")
    'Pole damping ζ_rd (–)'
    """
    parts = text.split("$")
    for place in range(1, len(parts), 2):
        words = _COMMAND.sub(lambda match: _GREEK.get(match[1], match[1]), parts[place])
        parts[place] = words.replace("{", "").replace("}", "")
    return "".join(parts)
