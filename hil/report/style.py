"""Style of all figures: legible for the colour-blind and in grey.

Dashes and markers distinguish lines without colour.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import ListedColormap
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.report import palette, svg
from hil.report.later_text import LaterText
from hil.report.zoomable import ZoomFigure, keep_name, keep_whole, zoomable

BLACK, ORANGE, SKY, GREEN, BLUE, VERMILLION, PURPLE, PAPER, GREY, EDGE, GRID, SHADE = (
    colour.day
    for colour in (
        palette.INK, palette.ORANGE, palette.SKY, palette.GREEN, palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.PAPER,
        palette.GREY, palette.EDGE, palette.GRID, palette.SHADE,
    )
)  # fmt: skip

SPEED_COLOURS = ListedColormap([colour.day for colour in palette.SPEEDS], "speed")
"""Colours of motor speeds: faint for slow, strong for fast."""

Panels = NDArray[Any]
"""Matplotlib axes in rows and columns."""

Line = dict[str, Any]

MEASURED: Line = {"color": BLUE, "linestyle": "-", "linewidth": 1.1}
BROAD: Line = {"color": SKY, "linestyle": "-", "linewidth": 2.4}
"""Line of a measurement under a thin line that nearly covers it."""

MODEL: Line = {"color": VERMILLION, "linestyle": (0, (4, 1.6)), "linewidth": 1.3}
WITHOUT: Line = {"color": ORANGE, "linestyle": (0, (4, 1.2)), "linewidth": 1.2}
WITH: Line = {"color": BLUE, "linestyle": "-", "linewidth": 1.2}
LIMIT: Line = {"color": BLACK, "linestyle": (0, (1, 1.6)), "linewidth": 1.2}
CONSTRAINT: Line = {"color": BLACK, "linestyle": (0, (7, 2)), "linewidth": 1.2}
OTHER_LOOP: Line = {"color": BLACK, "linestyle": (0, (3, 1.4)), "linewidth": 1.0}
RESIDUAL: Line = {"color": BLACK, "linestyle": "-", "linewidth": 0.8}
"""Line of what a model leaves of a measurement, in a panel of its own."""

OVERLAY_LINES: tuple[Line, ...] = (
    WITHOUT,
    WITH,
    {"color": PURPLE, "linestyle": (0, (5, 1.2, 1, 1.2)), "linewidth": 1.5},
    {"color": GREEN, "linestyle": "-", "linewidth": 1.8},
)
"""Lines of runs in one diagram: that without treatment first."""

MARK: Line = {"color": GREY, "linestyle": (0, (1, 1.6)), "linewidth": 0.9}

AXIS_LINES: tuple[Line, ...] = (
    {"color": BLUE, "linestyle": "-", "marker": "o"},
    {"color": VERMILLION, "linestyle": (0, (5, 1.5)), "marker": "s"},
    {"color": GREEN, "linestyle": (0, (5, 1.5, 1, 1.5)), "marker": "^"},
    {"color": PURPLE, "linestyle": (0, (1, 1)), "marker": "D"},
)
"""Lines of the first, second … axis of the robot in a diagram of several axes."""

RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.edgecolor": EDGE,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.color": EDGE,
    "ytick.color": EDGE,
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "axes.labelcolor": BLACK,
    "text.color": BLACK,
    "figure.constrained_layout.h_pad": 0.05,
    "figure.constrained_layout.w_pad": 0.05,
    "mathtext.default": "regular",
    "axes.unicode_minus": True,
    "svg.fonttype": "none",  # text can be searched, selected and read aloud
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
}

NAME_GROUND: dict[str, Any] = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.6}
"""Ground of a name that stands on curves or colours: the page's own, so that it can be read."""

WIDTH_IN = 8.8
"""Width of all figures: that of the page's column."""

BOTH = "measured and computed"
"""Origin of a figure that shows a measurement beside a model."""

MAX_POINTS = 1500
"""Largest number of points of a line: more than the column has pixels cannot be seen."""


@cache
def _load_formulas() -> None:
    """Load fonts and grammar of formulas before processes fork."""
    MathTextParser("path").parse("$f_{al}$ (1/s²)", 72, FontProperties(family="DejaVu Sans", size=8.5))


class SvgPicture:
    """A figure as SVG, drawn in parallel, and its zoomable data."""

    def __init__(self, figure: Figure, key: str, *, is_zoomable: bool = False) -> None:
        _load_formulas()
        self._text = LaterText(partial(svg.inline, figure, key))
        self._figure = figure if is_zoomable else None

    def __str__(self) -> str:
        return str(self._text)

    @property
    def zoom(self) -> ZoomFigure | None:
        """Zoomable data; None without any."""
        if self._figure is None:
            return None
        self._figure.draw_without_rendering()  # as the picture was drawn: its limits are final then
        return zoomable(self._figure)


@dataclass(frozen=True)
class Drawing:
    """One figure of the report.

    Attributes:
        paper: Corresponding figure of the paper; empty for none.
        origin: `measured`, `computed`, or `measured and computed`.
        picture: The picture, or its SVG element alone.
    """

    key: str
    title: str
    paper: str
    origin: str
    caption: str
    picture: SvgPicture | str

    @property
    def svg(self) -> str:
        """The picture as an SVG element; waits until it is drawn."""
        return str(self.picture)

    @property
    def zoom(self) -> ZoomFigure | None:
        """Zoomable data of the picture; None without any."""
        return self.picture.zoom if isinstance(self.picture, SvgPicture) else None


@contextmanager
def styled() -> Iterator[None]:
    """Apply the report's style within the context."""
    with mpl.rc_context():
        mpl.rcParams.update(cast("Any", RC))
        yield


def panels(rows: int, columns: int, height_in: float, **options: Any) -> tuple[Figure, NDArray[Any]]:
    """Make a figure with a grid of axes; shape (rows, columns)."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, np.asarray(axes)


def mosaic(rows: list[Any], height_in: float, **options: Any) -> tuple[Figure, dict[str, Axes]]:
    """Make a figure of rows of named panels."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    return figure, figure.subplot_mosaic(rows, **options)


def legend_above(figure: Figure, *axes: Axes, columns: int = 4) -> None:
    """Draw one legend of several panels above; equal names appear once."""
    handles = {name: handle for panel in axes for handle, name in zip(*panel.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=columns)


def name_rows(panels: Panels, *names: str) -> None:
    """Name the ordinates of the panels in the first column, from the top."""
    for panel, name in zip(panels[:, 0], names, strict=True):
        panel.set_ylabel(name)


def stack_over_time(*panels: Axes) -> None:
    """Share the time axis of panels in a column, the last labelled."""
    for panel in panels[:-1]:
        panel.sharex(panels[-1])
        panel.tick_params(labelbottom=False)
    panels[-1].set_xlabel("Time (s)")


def date_axis(panel: Axes, dates: NDArray[np.datetime64], room: np.timedelta64, name: str) -> None:
    """Name and divide an abscissa of dates, with room around a single one."""
    if len(np.unique(dates)) == 1:
        panel.set_xlim(dates[0] - room, dates[0] + room)
    locator: Any = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    panel.set_xlabel(name)


def residual(panel: Axes, x: Real, rest: Real, unit: str, names: str = "measured − model") -> None:
    """Draw the residual of a model, with its rms in the title."""
    panel.axhline(0.0, **MARK)
    panel.plot(*thin(x, rest), label=names, **RESIDUAL)
    panel.set_title(f"{names}, rms {np.sqrt(np.mean(rest**2)):#.2g} {unit}")


def note(axes: Axes, text: str) -> None:
    """Draw a sentence in an otherwise empty panel."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)


def flag(axes: Axes, x: float, text: str, *, height: float = 0.97, side: str = "left") -> None:
    """Draw a dotted vertical line with its name beside it.

    `height` is a fraction of the panel's; `side` is the side of the text on which the line is.
    """
    keep_name(axes.axvline(x, **MARK), text)
    shift = (3 if side == "left" else -3, 0)
    name_at(axes, text, (x, height), shift, xycoords=("data", "axes fraction"), ha=side, va="top", bbox=NAME_GROUND)


def name_at(panel: Axes, text: str, at: tuple[float, float], shift: tuple[float, float], **look: Any) -> None:
    """Write a name beside a point, shifted by so many points of the paper."""
    panel.annotate(text, at, xytext=shift, textcoords="offset points", **({"fontsize": 7.5} | look))


def thin(*columns: Real, points: int = MAX_POINTS) -> tuple[Real, ...]:
    """Return every n-th sample, about `points` at most; shapes (n,)."""
    step = max(1, len(columns[0]) // points)
    return tuple(column[::step] for column in columns)


def plot_thin(panel: Axes, x: Real, y: Real, **look: Any) -> None:
    """Draw a slow signal thinned out, and keep it whole; shapes (n,)."""
    (line,) = panel.plot(*thin(x, y), **look)
    keep_whole(line, x, y)


def decibel(gain: NDArray[Any]) -> Real:
    """20 log₁₀ |gain|, of the shape of `gain`."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(gain), 1e-300)))


def to_svg(figure: Figure, key: str, *, is_zoomable: bool = False) -> SvgPicture:
    """Return a figure, which does not change any more, as an inline SVG element."""
    return SvgPicture(figure, key, is_zoomable=is_zoomable)


def drawing(
    figure: Figure, key: str, title: str, caption: str, origin: str = "measured", paper: str = "", *, is_zoomable: bool = False
) -> Drawing:
    """Return a finished figure as one of the report; the arguments are those of `Drawing` and `SvgPicture`."""
    return Drawing(key, title, paper, origin, caption, to_svg(figure, key, is_zoomable=is_zoomable))
