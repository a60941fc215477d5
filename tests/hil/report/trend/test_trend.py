"""The runs of a folder over their dates: all that can be read are shown, what cannot is named, and nothing counts twice."""

import shutil

import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.errors import NotPossibleError
from hil.report.pages.page import PageVerdict
from hil.report.trend.gather import gather_runs
from hil.report.trend.page import verdict, write_trend
from hil.results.acted import ActedFilter
from hil.results.learning import LearningResult
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import BENCH, measured_bench, run_entry, written


def put(folder, date, *runs, emulated=True, name=None):
    """A directory of runs with a date."""
    directory = folder / (name or date[:10])
    directory.mkdir(parents=True)
    bench = measured_bench().model_copy(update={"started_utc": date})
    return written(directory, ExperimentsResult(bench=bench, runs=list(runs or [run_entry()]), emulated=emulated))


@pytest.fixture
def folder(tmp_path):
    """Three results with runs, a copy, two that cannot be read, and one of another command."""
    put(tmp_path, "2025-03-01T12:00:00+00:00", run_entry(tip_peak_mm=0.06), run_entry(order=4, tip_peak_mm=0.02))
    put(tmp_path / "deep" / "er", "2025-01-01T12:00:00+02:00", run_entry(tip_peak_mm=0.05, f_al_hz=11.9, f_al_error_hz=0.1))
    acted = tuple(ActedFilter(axis=2, held_by="drive", notch=notch) for notch in BENCH.axis[2].notch)
    put(tmp_path, "2025-02-01T12:00:00Z", run_entry("notch", filters=acted), emulated=False)
    shutil.copytree(tmp_path / "2025-03-01", tmp_path / "copy")
    put(tmp_path, "1970-01-01T00:00:07Z", name="no-clock")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "result.json").write_text("{", encoding="utf-8")
    (tmp_path / "other").mkdir()
    written(tmp_path / "other", LearningResult(bench=measured_bench(), model="learnt.toml"))
    return tmp_path


def test_runs_come_by_date_and_each_once(folder):
    found = gather_runs(folder)
    assert [(run.date_utc, run.folder, run.robot) for run in found.runs] == [
        ("2025-01-01T10:00:00+00:00", "deep/er/2025-01-01", "reference, emulated"),
        ("2025-02-01T12:00:00+00:00", "2025-02-01", "reference"),
        ("2025-03-01T12:00:00+00:00", "2025-03-01", "reference, emulated"),
        ("2025-03-01T12:00:00+00:00", "2025-03-01", "reference, emulated"),
    ]
    assert (found.results, found.copies, found.others) == (3, 1, {"learn": 1})
    assert found.runs[0].margins.sensitivity_peak > 1.0
    assert found.runs[1].margins.sensitivity_peak != found.runs[0].margins.sensitivity_peak  # with the notch


@pytest.mark.slow
def test_what_cannot_be_read_is_named_and_the_rest_goes_on(folder):
    done = CliRunner().invoke(app, ["report", str(folder), "--trend"])
    assert done.exit_code == 0, done.output
    assert "no-clock/result.json: dated 1970-01-01, which is before 2000: the clock of that computer was wrong" in done.output
    assert f"left out: {folder}/bad/result.json: not JSON" in done.output
    text = (folder / "trend.html").read_text(encoding="utf-8").replace("&nbsp;", " ")
    assert "2 results were not read" in text
    assert "1 of hil learn" in text
    assert "1 results are copies" not in text
    assert "A result is a copy of another" in text
    assert text.count("<h2 id=") == 2  # the emulated robot and the real one
    assert "11.9 ± 0.1" in text
    assert "href='deep/er/2025-01-01/report.html'" in text
    assert "<script" not in text


@pytest.mark.slow
def test_the_same_folder_gives_the_same_bytes(folder):
    pages = [write_trend(folder, gather_runs(folder)).read_bytes() for _ in range(2)]
    assert pages[0] == pages[1]


def test_stopped_runs_and_those_outside_are_counted(tmp_path):
    put(tmp_path, "2025-03-01T12:00:00Z", run_entry(tip_peak_mm=0.06), run_entry("notch", tip_peak_mm=None, stopped="SIGINT"))
    found = verdict(gather_runs(tmp_path))
    assert isinstance(found, PageVerdict)
    assert found.headline == "1 result with runs, 2025-03-01"
    assert found.details == ("Runs that were stopped: 1.", "Runs outside the specification: 1.")


def test_a_folder_without_runs_is_refused(tmp_path):
    with pytest.raises(NotPossibleError, match="no runs below"):
        gather_runs(tmp_path)
    (tmp_path / "result.json").write_text("{", encoding="utf-8")
    done = CliRunner().invoke(app, ["report", str(tmp_path), "--trend"])
    assert done.exit_code == 3
    assert "1 cannot be read, of which the first is" in done.output
    assert not (tmp_path / "trend.html").exists()


@pytest.mark.parametrize("more", [["--interactive"], ["--against", "."]])
def test_a_trend_stands_alone(folder, more):
    done = CliRunner().invoke(app, ["report", str(folder), "--trend", *more])
    assert done.exit_code == 2
    assert "give it alone" in done.output
