"""The page of a comparison: what stands in it, and what it says where something is missing."""

import json
import shutil

import pytest

from hil.report import page
from hil.report.figures_compare import OVERLAID
from hil.report.material import Material
from hil.report.page_compare import verdict, write_compare_report


def row(experiment, axis, compensation, peak, **changes):
    before = 0.075
    found = {
        "experiment": experiment, "axis": axis, "compensation": compensation, "loop": "drive", "tip_peak_mm": peak,
        "tip_peak_change_pct": None if compensation == "none" else 100.0 * (peak / before - 1.0), "spectrum_area": 10.0 * peak,
        "spectrum_area_change_pct": None if compensation == "none" else -30.0, "within_spec": peak <= 0.05, "trial": None,
        "compliance": {"slow": 1.0, "peak": 1.0}, "recording": "there",
    }  # fmt: skip
    return found | changes


def left_out(experiment, axis, compensation):
    empty = dict.fromkeys(("tip_peak_mm", "tip_peak_change_pct", "spectrum_area", "spectrum_area_change_pct", "within_spec"))
    return row(experiment, axis, compensation, 1.0) | empty | {"left_out": "<no learning>", "compliance": None}


def robot(rows, name="reference", **changes):
    costs = [
        {"axis": 2, "compensation": way, "loop": "drive", "slow": slow, "peak": slow, "peak_hz": 4.0}
        for way, slow in (("none", 0.1), ("low-gains", 0.37))
    ]
    found = {
        "name": name, "source": "bench.toml", "directory": name, "bus": "local:x", "tip_mm": 0.05, "rows": rows,
        "compliance": costs, "not_restored": [], "versions": {"python": "3.11"},
    }  # fmt: skip
    return found | changes


def result(*robots, **more):
    return {
        "schema": 1,
        "kind": "compare",
        "started_utc": "2025-01-01T12:00:00+00:00",
        "asked": {},
        "robots": list(robots),
        **more,
    }


RAMP = ("constant-acceleration", 2)
ROWS = [
    row(*RAMP, "none", 0.075),
    row(*RAMP, "low-gains", 0.042, compliance={"slow": 3.7, "peak": 2.8}),
    row(*RAMP, "notch", 0.046),
    row("line-motion", None, "none", 0.125),
    row("line-motion", None, "notch", 0.063),
    row("line-motion", None, "low-gains", 0.074),
    left_out(*RAMP, "adaptive"),
]


@pytest.fixture(scope="module")
def directory(full_directory, tmp_path_factory):
    """A comparison of the runs of the demo's directory."""
    out = tmp_path_factory.mktemp("compare")
    shutil.copytree(full_directory, out / "reference")
    (out / "result.json").write_text(json.dumps(result(robot(ROWS))), encoding="utf-8")
    write_compare_report(out)
    return out


def test_tables_and_figures_of_each_experiment_stand_in_one_file(directory):
    text = (directory / "report.html").read_text()
    for key in ("overview", "peaks-reference", "table-line-motion", "table-constant-acceleration-axis2", "compliance", "left-out",
                "vibration-reference-line-motion", "vibration-reference-constant-acceleration-axis2"):  # fmt: skip
        assert f'id="{key}"' in text
    assert "Treatments side by side" in text
    assert "× 3.70" in text
    assert "specification" in text
    assert "&lt;no learning&gt;" in text
    assert "<no learning>" not in text
    assert "<script" not in text
    assert "src=" not in text


def test_a_missing_robot_does_not_keep_the_page_from_being_written(tmp_path):
    gone = robot([row(*RAMP, "none", 1.0) | {"tip_peak_mm": None, "within_spec": None, "not_judged": "no bus"}], ended="no bus")
    (tmp_path / "result.json").write_text(json.dumps(result(gone)), encoding="utf-8")
    text = write_compare_report(tmp_path).read_text()
    assert "The comparison is not complete" in text
    assert "no bus" in text


def test_another_directory_is_refused(full_directory):
    with pytest.raises(ValueError, match="not that of a comparison"):
        write_compare_report(full_directory)


def test_the_verdict_names_the_treatment_that_keeps_the_specification_everywhere():
    found = verdict(result(robot([*ROWS, row(*RAMP, "ate", 0.003), row("line-motion", None, "ate", 0.004)])))
    assert (found.kind, found.headline) == ("good", "Cancellation keeps the tip within ±0.05 mm in all 2 experiments")
    assert (
        "Gains halved: within the specification in 1 of 2, tip peak −44 … −1 %; the motor gives way 3.7 times as far at 1 Hz."
        in (found.details)
    )


def test_a_treatment_that_was_not_run_everywhere_keeps_nothing_everywhere():
    found = verdict(result(robot([*ROWS, row(*RAMP, "ate", 0.003)])))
    assert (found.kind, found.headline) == ("open", "No single treatment keeps the tip within ±0.05 mm in all 2 experiments")


def test_a_refused_cancellation_is_said():
    refused = row(*RAMP, "ate", 1.0) | {"tip_peak_mm": None, "within_spec": None, "trial": "refused", "not_judged": "worse"}
    found = verdict(result(robot([*ROWS, refused])))
    assert "Refused by its trial: reference, axis 2, constant acceleration, cancellation." in found.details


def test_several_robots_stand_in_the_same_table(directory, tmp_path):
    shutil.copytree(directory / "reference", tmp_path / "reference")
    shutil.copytree(directory / "reference", tmp_path / "other")
    (tmp_path / "result.json").write_text(json.dumps(result(robot(ROWS), robot(ROWS, "other"))), encoding="utf-8")
    text = write_compare_report(tmp_path).read_text()
    assert text.count('id="table-line-motion"') == 1
    assert 'id="vibration-other-line-motion"' in text
    assert "in all 4 experiments" in text


def test_many_treatments_have_a_diagram_each(directory, tmp_path):
    """More than can be told apart in one: the title of each has its number."""
    shutil.copytree(directory / "reference", tmp_path / "reference")
    kept = json.loads((tmp_path / "reference" / "result.json").read_text())
    plain = [run for run in kept["runs"] if run["experiment"] == "line-motion" and run["compensation"] == "notch"]
    ways = ("low-gains", "notch-optimised", "ate")
    kept["runs"] += [{**run, "compensation": way} for way in ways for run in plain]
    (tmp_path / "reference" / "result.json").write_text(json.dumps(kept), encoding="utf-8")
    rows = [row("line-motion", None, way, 0.06) for way in ("none", "notch", *ways)]
    assert len(rows) > OVERLAID
    (tmp_path / "result.json").write_text(json.dumps(result(robot(rows))), encoding="utf-8")
    text = write_compare_report(tmp_path).read_text()
    assert "Behind each in orange" in text


STORY = {
    "bench_file": "bench.toml",
    "failure": None,
    "steps": [{"name": "identify plant, axis 2", "what": "f_a", "holds": True, "seconds": 9.0, "link": "x/report.html"}],
}


def demo_with(story, full_directory, tmp_path):
    """A demo's directory with a story below it; only what is looked at is copied."""
    (tmp_path / "story").mkdir()
    shutil.copy(full_directory / "result.json", tmp_path)
    (tmp_path / "story" / "result.json").write_text(json.dumps(story), encoding="utf-8")
    return tmp_path


def test_the_demo_shows_the_story_and_links_to_it(full_directory, tmp_path):
    out = demo_with(result(robot(ROWS), story=STORY), full_directory, tmp_path)
    table = page._own_robot(Material(out))
    assert "href='story/report.html'" in table.caption
    assert [cells[0] for cells in table.rows] == ["nothing", "gains halved", "notch"]
    assert page.typeset(table.caption) == table.caption
    own = write_compare_report(out / "story").read_text()
    assert '<a href="x/report.html">report</a>' in own


def test_a_story_that_ended_early_says_where(full_directory, tmp_path):
    failed = {**STORY, "failure": "the wire broke", "steps": [{**STORY["steps"][0], "holds": False, "what": "the wire broke"}]}
    out = demo_with(result(story=failed), full_directory, tmp_path)
    table = page._own_robot(Material(out))
    assert table.title == "It ended early"
    assert table.rows[0][1] == "the wire broke"
    assert "the wire broke" in write_compare_report(out / "story").read_text()


def test_the_story_of_an_earlier_demo_is_left_alone(full_directory, tmp_path):
    old = result(robot(ROWS), story=STORY) | {"started_utc": "2024-01-01T12:00:00+00:00"}
    assert page._own_robot(Material(demo_with(old, full_directory, tmp_path))) is None
    assert page._own_robot(Material(full_directory)) is None
