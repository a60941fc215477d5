"""Scripts, policy and numbers of an interactive page.

Bokeh from the installed package, our script, and a content security policy that allows these alone.
The numbers of the figures are JSON with an upper bound: a curve with more samples is reduced to columns with the least and the
largest value of each.
"""

import base64
import hashlib
import importlib.util
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from hil.control.arrays import Real
from hil.errors import NotPossibleError
from hil.report.zoomable import ZoomCurve, ZoomFigure, ZoomMap, ZoomPanel

LIBRARY = ("bokeh.min.js", "bokeh-api.min.js")
OWN = ("plotting.js", "zoom.js")


@dataclass(frozen=True)
class InteractiveParts:
    """Parts of a page whose figures can be zoomed.

    Attributes:
        policy: Content security policy: the page may run and load these scripts only.
    """

    policy: str
    scripts: tuple[str, ...]
    style: str
    numbers: str


def interactive_parts(figures: Mapping[str, ZoomFigure]) -> InteractiveParts:
    """Parts for these figures, by key.

    Raises:
        NotPossibleError: Bokeh is not installed.
    """
    scripts, style = _scripts(), (resources.files("hil.report.interactive") / "zoom.css").read_text(encoding="utf-8")
    hashes = (base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii") for script in scripts)
    allowed = " ".join(f"'sha256-{each}'" for each in hashes)
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
    return InteractiveParts(policy, scripts, style, numbers_json(figures))


def check_interactive() -> None:
    """Refuse to go on without the library.

    Raises:
        NotPossibleError: It is not installed.
    """
    if importlib.util.find_spec("bokeh") is None:
        raise NotPossibleError("an interactive report needs bokeh, which is not installed: pip install 'hil-bench[live]'")


@cache
def _scripts() -> tuple[str, ...]:
    check_interactive()
    library, own = resources.files("bokeh") / "server" / "static" / "js", resources.files("hil.report.interactive")
    texts = [(library / name).read_text(encoding="utf-8") for name in LIBRARY]
    texts += [(own / name).read_text(encoding="utf-8") for name in OWN]
    # inlined they cannot end their element early, and have the line ends that a browser hashes
    return tuple(text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--") for text in texts)


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
    content = {key: [_panel(panel, place, columns) for place, panel in sorted(figure.items())] for key, figure in figures.items()}
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def columns_for(figures: Iterable[ZoomFigure]) -> int:
    """Return the columns per curve that keep the bound of a page."""
    panels = [panel for figure in figures for panel in figure.values()]
    lengths = np.array([len(curve.x) for panel in panels for curve in panel.curves])
    room = MOST_OF_PAGE - sum(panel.map.values.size // 2 for panel in panels if panel.map is not None)
    columns = MOST_COLUMNS
    while columns > LEAST_COLUMNS and int(np.minimum(lengths, 2 * columns).sum()) > room:
        columns //= 2
    return max(columns, LEAST_COLUMNS)


def envelope(x: Real, y: Real, columns: int) -> tuple[Real, Real]:
    """Return least and largest value of each column of samples.

    In their order. Without more samples than that, all samples. Abscissa and ordinate, NaN for a missing value, have the shape
    (n,); all columns but one have equally many samples.

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
    return vars(panel) | {
        "place": place,
        "curves": [_curve(each, columns) for each in panel.curves],
        "lines": [vars(each) for each in panel.lines],
        "shades": [vars(each) | {"x": _floats(each.x), "y": _floats(each.y)} for each in panel.shades],
        "map": None if panel.map is None else _map(panel.map),
    }


def _curve(curve: ZoomCurve, columns: int) -> dict[str, Any]:
    is_rising = bool(np.all(np.diff(curve.x) >= 0.0))
    if is_rising:
        x, y = envelope(curve.x, curve.y, columns)
    else:
        step = -(-len(curve.x) // (2 * columns))
        x, y = curve.x[::step], curve.y[::step]
    return vars(curve) | {"x": _floats(x), "y": _floats(y), "is_rising": is_rising}


def _map(found: ZoomMap) -> dict[str, Any]:
    rows, columns = found.values.shape
    return vars(found) | {"rows": rows, "columns": columns, "values": _floats(found.values)}


def _floats(values: Real) -> str:
    """32-bit floats, the lowest byte first, in base 64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")
