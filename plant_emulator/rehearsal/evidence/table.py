"""Errors of replayed estimates, by kind of robot and quantity."""

from collections.abc import Sequence

from hil.report.report_table import Cell, ReportTable
from plant_emulator.rehearsal.evidence.replay import REPLAYED
from plant_emulator.rehearsal.many.reading import of_kind
from plant_emulator.rehearsal.many.summary import FAR_Z, QuantityStatistics, quantities
from plant_emulator.trials.rows import Row


def errors_table(rows: Sequence[Row], before: Sequence[Row] = ()) -> ReportTable:
    """Return the statistics of every quantity, by kind of robot.

    Args:
        rows: Rows of `replay.replayed`.
        before: Rows of an earlier replay of the same recordings; each cell has its value in brackets.
    """
    cells: list[list[Cell]] = []
    groups = {}
    for kind in dict.fromkeys(str(row["kind"]) for row in rows):
        own, old = of_kind(rows, kind), {each.name: each for each in quantities(of_kind(before, kind), REPLAYED)}
        groups[len(cells)] = f"{kind}: {len(own)} robots, {sum(bool(row['words']) for row in own)} without an estimate"
        for each in quantities(own, REPLAYED):
            now, then = _cells(each), _cells(old[each.name]) if each.name in old else None
            cells.append([each.name, *(f"{a} ({b})" for a, b in zip(now, then, strict=True))] if then else [each.name, *now])
    header = ("Quantity", "Robots", "rms of z", "Mean z", f"|z| > {FAR_Z:g}", "Median σ", "Median deviation", "Largest z")
    return ReportTable("errors", "Replayed estimates and truth", "", header, cells, frozenset({0}), groups=groups)


def _cells(each: QuantityStatistics) -> list[str]:
    off = "–" if each.median_off is None else f"{each.median_off:.2g}"
    worst = f"{each.worst_z:+.1f}: {each.worst_seed}"
    return [str(each.count), f"{each.rms_z:.2f}", f"{each.mean_z:+.2f}", str(each.far), f"{each.median_error:.2g}", off, worst]
