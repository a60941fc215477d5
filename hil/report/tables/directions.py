"""Table of the tip as a vector on an arm.

Every run along x, y, z and the worst direction.
"""

from collections.abc import Sequence

from markupsafe import Markup

from hil.analysis import DIRECTIONS, Direction, DirectionMetrics
from hil.experiments.treatment import TITLES
from hil.report.material import Material, run_name
from hil.report.report_table import Cell, Columns, Mark, ReportTable, number, tabulate
from hil.results.runs import RunEntry

ALONG: tuple[Direction, ...] = ("x", "y", "z")


def peaks_mm(entries: Sequence[RunEntry], treatment: str) -> dict[Direction, float]:
    """Return the tip's peaks by direction for a treatment.

    From its first judged run; empty if there is none.
    """
    for run in entries:
        if run.treatment == treatment and run.invalid is None and run.directions is not None:
            return {name: each.tip_peak_mm for name, each in run.directions.items() if each.tip_peak_mm is not None}
    return {}


def side_by_side(material: Material, key: str, caption: str | Markup) -> ReportTable:
    """Tabulate the tip's peaks by direction, with a column per treatment.

    Directions are x, y, z and the worst; None if no run has a vector.
    """
    runs, limit_mm = material.result.runs, material.bench.specification.tip_mm
    names = [name for name in dict.fromkeys(run.treatment for run in runs) if peaks_mm(runs, name)]
    peaks = {name: peaks_mm(runs, name) for name in names}
    rows: list[list[Cell]] = []
    for direction in DIRECTIONS:
        own = [peaks[name].get(direction) for name in names]
        cells = [Mark(None) if peak is None else Mark(peak <= limit_mm, f"{peak:.4f}") for peak in own]
        rows.append(["worst" if direction == "worst" else f"along {direction}", *cells])
    header = ("Tip peak (mm)", *(TITLES.get(name, name) for name in names))
    title = "The tip along x, y and z, side by side"
    return ReportTable(key, title, header, rows, range(len(header)), caption)


def directions(material: Material, key: str = "directions") -> ReportTable:
    """Tabulate peaks, root mean squares and areas of every window."""
    columns: Columns[tuple[RunEntry, Direction, DirectionMetrics]] = (
        ("Run", lambda row: run_name(row[0]) if row[1] == "x" else ""),
        ("Direction", lambda row: row[1] + (_unit(row[2]) if row[1] == "worst" else "")),
        ("Tip peak (mm)", lambda row: number(row[2].tip_peak_mm, "{:.4f}")),
        ("Tip rms (mm)", lambda row: number(row[2].tip_rms_mm, "{:.4f}")),
        ("Spectrum peak (m/s²)", lambda row: number(row[2].spectrum_peak_m_s2, "{:.4f}")),
        ("at (Hz)", lambda row: number(row[2].spectrum_peak_hz, "{:.2f}")),
        ("Spectrum area (m/s²·Hz)", lambda row: number(row[2].spectrum_area, "{:.3f}")),
    )
    rows = [
        (run, name, run.directions[name]) for run in material.result.runs if run.directions is not None for name in DIRECTIONS
    ]
    caption = (
        "Displacement of the tip in the base frame: the acceleration in the band of the vibration, integrated twice. The worst "
        "direction is that of the largest displacement, and determines the verdict. Its area and root mean square are those of "
        "all directions together. Areas: from 0.2 f_al to 50 Hz."
    )
    return tabulate(key, "The tip along x, y and z", columns, rows, caption, (0, 1))


def _unit(metrics: DirectionMetrics) -> str:
    return "" if metrics.unit is None else " ({:.2f}, {:.2f}, {:.2f})".format(*metrics.unit).replace("-", "−")
