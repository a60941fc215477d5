"""hil report: which page a directory gets, and what is said of one that gets none."""

import html
import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.errors import NOT_DISABLED, not_restored_words
from hil.results.ate import AteResult, KnownArm, Sensing
from hil.results.learning import LearningResult
from hil.results.plant import PlantRequestEntry, PlantResult
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import comparison, measured_bench, robot, row, tour, written


def report(directory: Path) -> tuple[int, str]:
    found = CliRunner().invoke(app, ["report", str(directory)])
    return found.exit_code, found.output


ROWS = [row("line-motion", None, "none", None, not_judged="no bus")]


@pytest.mark.parametrize(
    ("result", "heading"),
    [
        (comparison(robot(ROWS, ended="no bus")), "Treatments side by side"),
        (tour(robot(ROWS), failure="the wire broke"), "Your own robot"),
    ],
)
def test_every_directory_gets_the_page_of_its_kind(tmp_path, result, heading):
    code, output = report(written(tmp_path, result))
    assert code == 0, output
    assert heading in (tmp_path / "report.html").read_text(encoding="utf-8")


BAD_END = {"stopped": "stopped: SIGINT", "all_disabled": False, "not_restored": ("node 2: object 6072h:00h",)}
REQUEST = PlantRequestEntry(
    axis=2, amplitude_nm=None, low_hz=2.0, high_hz=50.0, bias_rps=0.0, periods=8, excitation="multisine", shape="inertial",
    with_accelerometer=True,
)  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize(
    "result",
    [
        ExperimentsResult(bench=measured_bench(), **BAD_END),
        PlantResult(bench=measured_bench(), axis=2, request=REQUEST, **BAD_END),
        AteResult(
            bench=measured_bench(), axis=2, sensorless=False, known_before=KnownArm(source="the bench file", start=None),
            sensing=Sensing(gain=0.5), **BAD_END,
        ),
        LearningResult(bench=measured_bench(), model="learnt.toml", **BAD_END),
        comparison(robot(ROWS, all_disabled=False, not_restored=BAD_END["not_restored"])),
    ],
    ids=lambda result: result.kind,
)  # fmt: skip
def test_every_page_says_of_the_drives_what_standard_error_said(tmp_path, result, without_pictures):
    code, output = report(written(tmp_path, result))
    assert code == 0, output
    page = html.unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert NOT_DISABLED in page
    assert not_restored_words("node 2: object 6072h:00h") in page
    assert page.index(NOT_DISABLED) < page.index('role="status"'), "it comes before the verdict"


@pytest.mark.slow
def test_a_page_of_drives_that_were_left_well_has_no_such_words(tmp_path):
    code, _ = report(written(tmp_path, ExperimentsResult(bench=measured_bench(), stopped="stopped: SIGINT", all_disabled=True)))
    assert code == 0
    assert 'id="aftermath"' not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_result_of_the_schema_before_is_told_with_what_to_do(tmp_path):
    old = json.loads(ExperimentsResult(bench=measured_bench()).dumps()) | {"schema": 1}
    old.pop("kind")
    (tmp_path / "result.json").write_text(json.dumps(old), encoding="utf-8")
    code, output = report(tmp_path)
    assert code == 3
    assert f"{tmp_path / 'result.json'}: schema 1; expected 2; run the command again" in output
    assert not (tmp_path / "report.html").exists()


def test_the_directory_of_a_design_is_told_who_writes_its_report(tmp_path):
    (tmp_path / "design.json").write_text("{}", encoding="utf-8")
    code, output = report(tmp_path)
    assert code == 3
    assert "hil design notch writes" in output


def test_a_directory_of_directories_is_told_which_of_them_to_name(tmp_path):
    for name, age in (("old", 1e9), ("new", 2e9)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, ExperimentsResult(bench=measured_bench()))
        os.utime(tmp_path / name, (age, age))
    code, output = report(tmp_path)
    assert code == 3
    assert f"has no result.json; 2 of its folders have one; for the newest: hil report {tmp_path / 'new'}" in output


def test_any_other_directory_is_none_of_hils(tmp_path):
    code, output = report(tmp_path)
    assert code == 3
    assert "has no result.json; give the directory of a hil run, identify, learn, compare or demo" in output
