"""Numbers of a page's figures as JSON, with an upper bound.

A curve with more samples is reduced to columns with the least and the largest value of each.
"""

import base64
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hil.report.zoomable import Real, ZoomCurve, ZoomFigure, ZoomMap, ZoomPanel

MOST_COLUMNS = 10_000
"""Most columns of a curve: a tenth of it still has as many samples as a screen has pixels."""
MOST_OF_PAGE = 600_000
"""Most samples of all curves of a page, eleven bytes each; two values of a map count as one."""
LEAST_COLUMNS = 100


def numbers_json(figures: Mapping[str, ZoomFigure]) -> str:
    """Return the numbers of figures as JSON for a script element.

    By key; equal figures give equal text. Every number is a 32-bit float: seven digits.
    """
    columns = columns_for(figures.values())
    content = {
        key: [_panel(panel, place, columns) for place, panel in sorted(figure.panels.items())] for key, figure in figures.items()
    }
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def columns_for(figures: Iterable[ZoomFigure]) -> int:
    """Return the columns per curve that keep the bound of a page."""
    panels = [panel for figure in figures for panel in figure.panels.values()]
    lengths = np.array([len(curve.x) for panel in panels for curve in panel.curves])
    room = MOST_OF_PAGE - sum(panel.map.values.size // 2 for panel in panels if panel.map is not None)
    columns = MOST_COLUMNS
    while columns > LEAST_COLUMNS and int(np.minimum(lengths, 2 * columns).sum()) > room:
        columns //= 2
    return max(columns, LEAST_COLUMNS)


def envelope(x: Real, y: Real, columns: int) -> tuple[Real, Real]:
    """Return least and largest value of each column of samples.

    In their order. Without more samples than that, all samples.

    Args:
        x: Abscissa; shape (n,).
        y: Ordinate, NaN for a missing value; shape (n,).
        columns: Columns, of equally many samples each but for one.

    Returns:
        Both of shape (m,), m at most 2 `columns`. A column without any value leaves a gap.
    """
    if len(x) <= 2 * columns:
        return x, y
    size = -(-len(x) // columns)
    count = -(-len(x) // size)
    blocks = np.pad(y, (0, count * size - len(y)), constant_values=np.nan).reshape(count, size)
    first = size * np.arange(count)
    low = first + np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = first + np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    rows = np.stack([np.minimum(low, high), np.maximum(low, high)], axis=1).ravel()
    return x[rows], y[rows]


def _panel(panel: ZoomPanel, place: tuple[int, int], columns: int) -> dict[str, Any]:
    return {
        "place": place, "title": panel.title, "names": panel.names, "x": panel.x, "y": panel.y, "is_log": panel.is_log,
        "is_square": panel.is_square, "right": panel.right, "curves": [_curve(each, columns) for each in panel.curves],
        "lines": [{"name": each.name, "colour": each.colour, "axis": each.axis, "at": each.at} for each in panel.lines],
        "shades": [{"colour": each.colour, "x": _floats(each.x), "y": _floats(each.y)} for each in panel.shades],
        "map": None if panel.map is None else _map(panel.map),
    }  # fmt: skip


def _curve(curve: ZoomCurve, columns: int) -> dict[str, Any]:
    is_rising = bool(np.all(np.diff(curve.x) >= 0.0))
    if is_rising:
        x, y = envelope(curve.x, curve.y, columns)
    else:
        step = -(-len(curve.x) // (2 * columns))
        x, y = curve.x[::step], curve.y[::step]
    return {
        "name": curve.name, "colour": curve.colour, "x": _floats(x), "y": _floats(y), "is_rising": is_rising,
        "is_broken": curve.is_broken, "width": curve.width, "has_points": curve.has_points,
    }  # fmt: skip


def _map(found: ZoomMap) -> dict[str, Any]:
    rows, columns = found.values.shape
    return {
        "x": found.x, "y": found.y, "rows": rows, "columns": columns, "top": found.top, "colours": found.colours,
        "values": _floats(found.values),
    }  # fmt: skip


def _floats(values: Real) -> str:
    """32-bit floats, the lowest byte first, in base 64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")
