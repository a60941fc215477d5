"""The timing table: there where time was the wall clock's, and a run that is not judged is not called outside."""

from pathlib import Path

import pytest

from hil.report.material import Material
from hil.report.pages.demo import verdict
from hil.report.tables.paper_runs import timing_table
from hil.report.writer import write_report_of
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import measured_bench, run_entry, written

SPREAD = {"count": 500, "p50_s": 2.1e-5, "p99_s": 4e-4, "p999_s": 9e-4, "max_s": 0.0123, "histogram": [[1e-4, 490], [None, 10]]}
TIMING = {
    "dropped_cycles": 3, "period_s": 0.002, "limit_s": 0.001, "cycles": 500, "dropped": 4, "late": 0, "missed": 1,
    "lateness": SPREAD, "arrivals": SPREAD, "bus_bits": 12345, "duration_s": 1.0, "bitrate": 1_000_000, "bus_load": 0.4321,
    "receive_overflows": None,
    "measures": [{"name": "SCHED_FIFO", "is_granted": False, "detail": "Operation not permitted; 'ulimit -r 80'"}],
}  # fmt: skip
RUN = run_entry(within_spec=False)


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    run = run_entry(within_spec=False, timing=TIMING, invalid="of 400 cycles 3 were not sent in time")
    return written(tmp_path, ExperimentsResult(bench=measured_bench(), runs=[run]))


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_the_table_says_how_late_it_was_and_what_was_refused(directory: Path) -> None:
    table = timing_table(Material(directory))
    assert table is not None
    assert [len(row) for row in table.rows] == [len(table.header)] * 2
    assert table.rows[0][2:] == ["21 µs", "400 µs", "900 µs", "12.3 ms", "500", "4", "0", "1", "43.2"]
    assert "ulimit -r 80" in table.caption
    assert 'id="timing"' in write_report_of(directory).read_text()


def test_a_run_that_is_not_judged_is_not_said_to_be_outside(directory: Path) -> None:
    said = verdict(Material(directory))
    assert said.kind == "open"
    assert any("not sent in time" in detail for detail in said.details)


def test_in_lock_step_there_is_no_table(directory: Path) -> None:
    written(directory, ExperimentsResult(bench=measured_bench(), runs=[RUN]))
    assert timing_table(Material(directory)).rows == []
