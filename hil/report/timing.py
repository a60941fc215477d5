"""Table of the punctuality of runs on the wall clock."""

from hil.master.lateness import duration_text
from hil.report.material import Material, run_name
from hil.report.report_table import NONE, Cell, ReportTable


def timing_table(material: Material) -> ReportTable:
    """Tabulate the punctuality of SYNC and answers, by motion."""
    by_recording = {run.recording: (run, run.timing) for run in material.result.runs if run.timing is not None}
    rows: list[list[Cell]] = []
    for run, timing in by_recording.values():
        load = timing.bus_load
        counts = [str(count) for count in (timing.cycles, timing.dropped, timing.late, timing.missed)]
        name = run_name(run, with_window=False)
        for spread, what in ((timing.lateness, "SYNC after its deadline"), (timing.arrivals, "answers after SYNC")):
            durations = (spread.p50_s, spread.p99_s, spread.p999_s, spread.max_s)
            cells = [duration_text(duration_s).replace("-", NONE) for duration_s in durations]
            first = spread is timing.lateness
            tail = [*counts, NONE if load is None else f"{100.0 * load:.1f}"] if first else [""] * 5
            rows.append([name if first else "", what, *cells, *tail])
    refused = sorted(
        {
            f"{measure.name} ({measure.detail})"
            for _, timing in by_recording.values()
            for measure in timing.measures
            if not measure.is_granted
        }
    )
    header = ("Motion", "What", "p50", "p99", "p99.9", "max", "Cycles", "Dropped", "Late", "Missed", "Bus load (%)")
    sentence = f" Not granted: {'; '.join(refused)}." if refused else " The operating system granted every request for real time."
    return ReportTable(
        "timing",
        "Timing of the cycle",
        "",
        header,
        rows,
        frozenset({0, 1}),
        "Percentiles are at most 2.4 % too large and never too small; the largest is exact. A cycle that is too late is "
        "dropped: its set-points are not sent. Late: SYNC was sent after the limit. Missed: an answer did not come." + sentence,
    )
