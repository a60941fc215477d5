"""How well runs on the wall clock kept their beat, as a table."""

from hil.master.lateness import duration_text
from hil.report.material import Material
from hil.report.tables import NONE, Cell, Table


def timing_table(material: Material) -> Table | None:
    """A row per motion for SYNC, and one for the answers; None where time was counted in SYNCs."""
    by_recording = {run.recording or run.name: run for run in material.result.runs if run.timing is not None}
    rows: list[list[Cell]] = []
    for run in by_recording.values():
        timing = run.timing or {}
        load = timing.get("bus_load")
        counts = [str(timing.get(name, NONE)) for name in ("beats", "dropped", "late", "missed")]
        name = run.model_copy(update={"order": None}).name
        for key, what in (("lateness", "SYNC after its deadline"), ("arrivals", "answers after SYNC")):
            spread = timing.get(key) or {}
            cells = [duration_text(spread.get(share)).replace("-", NONE) for share in ("p50_s", "p99_s", "p999_s", "max_s")]
            first = key == "lateness"
            tail = [*counts, NONE if load is None else f"{100.0 * load:.1f}"] if first else [""] * 5
            rows.append([name if first else "", what, *cells, *tail])
    if not rows:
        return None
    refused = sorted(
        {
            f"{measure['name']} ({measure['detail']})"
            for run in by_recording.values()
            for measure in (run.timing or {}).get("measures", [])
            if not measure["is_granted"]
        }
    )
    header = ("Motion", "What", "p50", "p99", "p99.9", "max", "Cycles", "Dropped", "Late", "Missed", "Bus load (%)")
    told = f" Not granted: {'; '.join(refused)}." if refused else " Everything that was asked of the system was granted."
    return Table(
        "timing",
        "How well the beat was kept",
        "",
        header,
        rows,
        frozenset({0, 1}),
        "Percentiles are at most 2.4 % too large and never too small; the largest is exact. A cycle that is too late is dropped: "
        "its set-points are never sent. Late: SYNC left beyond the limit all the same. Missed: an answer did not come." + told,
    )
