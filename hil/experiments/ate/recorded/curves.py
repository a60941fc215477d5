"""Curves of an identification from recordings, for its page.

The files are scan.csv, map.csv and fit.csv.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.control.angles import ARCSEC
from hil.design.order_map import TURNS
from hil.design.recorded.fit import AngleSection, SectionFit
from hil.design.recorded.order_columns import SCAN_FROM, SCAN_TO
from hil.design.recorded.scan import BlindScan, plain_amplitudes
from hil.design.recorded.slow import degrees_for, slow_columns
from hil.recording import save_columns

SCAN, MAP, FIT = "scan.csv", "map.csv", "fit.csv"
MAP_STEP = 0.05
"""Accuracy: step of its orders, a tenth of a window's resolution."""
MOST_WINDOWS = 120
"""Bound: columns of a figure's map."""
DRAWN_STRETCHES, DRAWN_SAMPLES = 4, 1500
"""Bound: stretches of a figure, and the samples of each: more than its width has dots."""


def write_curves(
    directory: Path,
    scan: BlindScan,
    sections: Sequence[AngleSection],
    fits: Sequence[SectionFit],
    speeds_rps: Sequence[np.ndarray],
    scale: float,
) -> None:
    """Write the three files.

    Sections are without lines of a fixed frequency. `scale` is the unit of map and fit in that of the signals; the scan is in
    arcsec of the joint.
    """
    save_columns(
        directory / SCAN,
        {"order": scan.order, "amplitude": scan.amplitude / ARCSEC, "floor": scan.floor / ARCSEC, "level": scan.level / ARCSEC},
    )
    _write_map(directory / MAP, sections, speeds_rps, scale)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("stretch", "turns", "signal", "slow", "error", "residual")}
    longest = sorted(range(len(fits)), key=lambda each: -sections[each].turns)[:DRAWN_STRETCHES]
    for number in sorted(longest):
        section, fit = sections[number], fits[number]
        step = max(1, len(section.signal) // DRAWN_SAMPLES)
        rows = slice(None, None, step)
        wave = section.signal - fit.slow - fit.residual
        turned = section.angle_rad / (2.0 * math.pi)
        for name, values in (
            ("turns", turned), ("signal", section.signal / scale), ("slow", fit.slow / scale), ("error", wave / scale),
            ("residual", fit.residual / scale), ("stretch", np.full(len(turned), float(number))),
        ):  # fmt: skip
            columns[name].append(values[rows])
    save_columns(directory / FIT, {name: np.concatenate(each) for name, each in columns.items()})


def _write_map(path: Path, sections: Sequence[AngleSection], speeds_rps: Sequence[np.ndarray], scale: float) -> None:
    """Write the amplitudes over order in windows of a few revolutions."""
    orders = np.arange(SCAN_FROM, SCAN_TO + MAP_STEP / 2, MAP_STEP)
    windows = [
        (section, rows, float(np.median(np.abs(speed[rows]))))
        for section, speed in zip(sections, speeds_rps, strict=True)
        for rows in _windows(section)
    ]
    step = max(1, len(windows) // MOST_WINDOWS)
    rows_of: list[np.ndarray] = []
    for section, rows, speed in windows[::step]:
        angle = section.angle_rad[rows]
        slow = slow_columns(angle, max(degrees_for(TURNS, 1.0)))
        amplitude = plain_amplitudes(section.signal[rows], slow, angle, orders) / scale
        rows_of.append(np.column_stack([np.full(len(orders), speed), orders, amplitude]))
    table = np.vstack(rows_of) if rows_of else np.empty((0, 3))
    save_columns(path, {"speed_rps": table[:, 0], "order": table[:, 1], "amplitude": table[:, 2]})


def _windows(section: AngleSection) -> list[slice]:
    """Windows of `TURNS` revolutions, each half a window behind the one before."""
    turned = np.abs(section.angle_rad - section.angle_rad[0]) / (2.0 * math.pi)
    found = []
    for start in np.arange(0.0, max(float(turned[-1]) - TURNS, 0.0) + 1e-9, TURNS / 2.0):
        rows = slice(int(np.searchsorted(turned, start)), int(np.searchsorted(turned, start + TURNS)))
        if rows.stop - rows.start >= 40:
            found.append(rows)
    return found
