"""Figure of the order map: vibration over motor speed and order."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from hil.analysis import motor_speed_rps
from hil.control.arrays import Real
from hil.design.order_map import SLOWEST_RPS, OrderMap, order_map
from hil.recording import Recording
from hil.report import palette, style
from hil.report.style import Drawing
from hil.report.zoomable import keep_map

ORDERS: Real = np.linspace(0.5, 10.0, 96)
LEVELS = 9
FREQUENCIES_HZ = (5.0, 10.0, 20.0, 40.0)
"""Frequencies whose hyperbolas are drawn thin, to read the map in Hz."""
NEAR = 0.3
"""Distance, as a logarithm, at which such a line would crowd that of the resonance."""
COLUMNS = 2
WITH_FREQUENCIES = 4
"""Largest number of runs that are drawn over frequency too."""
TOP_HZ = 50.0
NEARLY_TOP = 0.98
"""Fraction of a stretch's largest speed at which its rise counts as ended: what follows may be a constant speed."""
RAYS = (1, 2, 4)
"""Orders that are drawn as rays over frequency."""


@dataclass(frozen=True)
class MarkedResonance:
    """Frequency at which the tip rings.

    Attributes:
        symbol: `f_al`, the peak of |G_al| of the closed loop, or `f_a`, the arm on its gear with the motor held.
    """

    hz: float | None
    symbol: Literal["f_al", "f_a"] = "f_al"


def order_maps(
    key: str, title: str, runs: Sequence[tuple[str, Recording]], axis: int, resonance: MarkedResonance
) -> Drawing | None:
    """Draw order maps of runs in one colour scale."""
    maps = [(name, found) for name, recording in runs if (found := ramp_map(recording, axis)) is not None]
    top = max((float(np.nanmax(found.amplitude)) for _, found in maps), default=0.0)
    if top <= 0.0:
        return None
    rows = -(-len(maps) // COLUMNS)
    columns = min(COLUMNS, len(maps))
    has_frequencies = len(maps) <= WITH_FREQUENCIES
    every = 2 if has_frequencies else 1
    figure, panels = style.panels(every * rows, columns, 0.6 + 2.6 * every * rows, sharex=True, sharey="row")
    levels = np.linspace(0.0, top, LEVELS + 1)
    for number in range(rows * columns):
        row, column = every * (number // columns), number % columns
        shown = [panels[row + below, column] for below in range(every)]
        if number >= len(maps):
            for panel in shown:
                panel.set_visible(False)
            continue
        name, found = maps[number]
        _draw(shown[0], found, levels, resonance)
        shown[0].set_title(name)
        if has_frequencies:
            _draw_frequencies(shown[1], found, levels, resonance)
    for panel in panels[-1, :]:
        panel.set_xlabel("Motor speed (rev/s)")
    for row, panel in enumerate(panels[:, 0]):
        panel.set_ylabel("Frequency (Hz)" if has_frequencies and row % 2 else "Order k (per turn)")
    draw_colour_scale(figure, panels, levels, "Tip acceleration (m/s²)", aspect=40)
    dashed = (
        f"{resonance.symbol} of this axis is not known: its resonance is not drawn."
        if resonance.hz is None
        else f"Dashed: k f_m = {resonance.symbol} = {resonance.hz:.2f} Hz, the resonance."
    )
    below = (
        "Below: the same over frequency. Orders are rays; vibration of a fixed frequency is a horizontal line. "
        if has_frequencies
        else ""
    )
    caption = (
        "Amplitude of the vertical tip acceleration at k times the motor's angle, in windows of two turns. An error of order k "
        f"shows at that height and grows where it crosses the resonance. {dashed} Dotted: other frequencies. "
        f"{below}"
        f"Because of the window of two turns an order appears about ±1 wide. Blank: below {levels[1]:.2g} m/s²."
    )
    return style.drawing(figure, key, title, caption, is_zoomable=True)


def ramp_map(recording: Recording, axis: int) -> OrderMap | None:
    """Return the tip's order map on the ramp; None for few turns."""
    begin, end = _longest_rise(np.abs(motor_speed_rps(recording, axis)))
    angle, tip = recording.axis(axis, "position_rad")[begin:end], recording.felt_m_s2[begin:end]
    try:
        found = order_map(angle, tip, recording.period_s, ORDERS)
    except ValueError:
        return None
    return found if len(found.speed_rps) > 1 else None


def _longest_rise(speed_rps: Real) -> tuple[int, int]:
    """Return first and last row of the longest rise from rest.

    The last row is exclusive. The longest rise is the ramp, not the fast motion to its starting point. |f_m| has the shape (n,).
    """
    rests = np.flatnonzero(speed_rps < SLOWEST_RPS)
    edges = np.unique(np.concatenate([[0], rests, [len(speed_rps)]]))
    found, longest = (0, int(np.argmax(speed_rps)) + 1), -1
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        stretch = speed_rps[begin:end]
        rise = int(np.argmax(stretch >= NEARLY_TOP * np.max(stretch)))
        if rise > longest:
            found, longest = (begin, begin + int(np.argmax(stretch)) + 1), rise
    return found


def _draw(panel: Axes, found: OrderMap, levels: Real, resonance: MarkedResonance) -> None:
    amplitude = np.ma.masked_invalid(found.amplitude.T)
    panel.grid(visible=False)  # the lowest colour would cover it in parts
    panel.contourf(found.speed_rps, found.orders, amplitude, levels=levels, colors=level_colours())
    keep_map(panel, found.speed_rps, found.orders, found.amplitude, float(levels[-1]), tuple(level_colours()))
    low, high = float(found.speed_rps[0]), float(found.speed_rps[-1])
    speeds = np.linspace(low, high, 200)
    for frequency in FREQUENCIES_HZ:
        if resonance.hz is not None and abs(math.log(frequency / resonance.hz)) < NEAR:
            continue
        _hyperbola(panel, speeds, frequency, f"{frequency:g} Hz", style.MARK)
    if resonance.hz is not None:
        _hyperbola(panel, speeds, resonance.hz, _printed(resonance), {**style.CONSTRAINT, "color": style.VERMILLION})
    panel.set(xlim=(low, high), ylim=(float(ORDERS[0]), float(ORDERS[-1])))
    panel.set_yticks(np.arange(1, math.floor(ORDERS[-1]) + 1))


def _draw_frequencies(panel: Axes, found: OrderMap, levels: Real, resonance: MarkedResonance) -> None:
    """Draw the map over frequency k f_m: orders are rays."""
    speeds, orders = np.meshgrid(found.speed_rps, found.orders, indexing="ij")
    amplitude = np.ma.masked_invalid(found.amplitude)
    panel.grid(visible=False)
    panel.contourf(speeds, orders * speeds, amplitude, levels=levels, colors=level_colours())
    keep_map(panel, found.speed_rps, orders * speeds, found.amplitude, float(levels[-1]), tuple(level_colours()))
    low, high = float(found.speed_rps[0]), float(found.speed_rps[-1])
    top = min(TOP_HZ, float(found.orders[-1]) * high)
    for order in RAYS:
        ends = np.array([low, min(high, top / order)])
        panel.plot(ends, order * ends, **style.MARK)
        at = float(ends[1]), order * float(ends[1])
        style.name_at(panel, f"k = {order}", at, (-2, -8), ha="right", va="top", bbox=style.NAME_GROUND)
    if resonance.hz is not None:
        panel.axhline(resonance.hz, **{**style.CONSTRAINT, "color": style.VERMILLION})
        style.name_at(panel, _printed(resonance), (low, resonance.hz), (3, 2), ha="left", va="bottom")
    panel.set(xlim=(low, high), ylim=(0.0, top))


def _printed(resonance: MarkedResonance) -> str:
    """The symbol with its index, for matplotlib."""
    name, index = resonance.symbol.split("_")
    return f"${name}_{{{index}}}$"


def _hyperbola(panel: Axes, speeds: Real, frequency_hz: float, name: str, look: style.Line) -> None:
    """Draw the line k f_m = f with its name."""
    orders = frequency_hz / speeds
    inside = np.flatnonzero((orders >= ORDERS[0]) & (orders <= ORDERS[-1]))
    if len(inside) < 2:
        return
    panel.plot(speeds[inside], orders[inside], **look)
    at = inside[0]
    is_high = orders[at] > ORDERS[-1] - 1.0
    shift, side = ((8, -1), "top") if is_high else ((3, 2), "bottom")
    style.name_at(panel, name, (speeds[at], orders[at]), shift, ha="left", va=side)


def level_colours() -> list[str]:
    """Colours of `LEVELS` steps, from the page's ground to the strongest."""
    steps = np.linspace(0, len(palette.SPEEDS) - 1, LEVELS - 1).round().astype(int)
    return [style.PAPER, *(palette.SPEEDS[step].day for step in steps)]


def draw_colour_scale(figure: Figure, panels: style.Panels, levels: Real, name: str, aspect: int) -> None:
    """Draw a legend of the colours: the levels as a bar beside the panels."""
    colours = ListedColormap(level_colours(), "order map")
    scale = ScalarMappable(BoundaryNorm(levels, colours.N), colours)
    bar = figure.colorbar(scale, ax=list(panels.flat), aspect=aspect, pad=0.02)
    bar.set_label(name)
    bar.ax.set_yticks(levels[::3], [f"{level:.2g}" for level in levels[::3]])
    bar.ax.grid(visible=False)
