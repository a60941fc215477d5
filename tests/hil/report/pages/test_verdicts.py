"""What the first screen of a page of runs says: emulated or not, the robot's own terms, and green only where all is green."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.bench.model import IdentifiedError
from hil.report import style
from hil.report.figures import ate
from hil.report.material import Material
from hil.report.pages.demo import cards, millimetres, verdict
from hil.report.tables import paper_runs
from hil.report.writer import write_report_of
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult
from hil.robot_tables import TransmissionErrorTable


def altered(full_directory: Path, tmp_path: Path, change: Callable[[Any], None]) -> Path:
    """A directory with another result.json and without recordings."""
    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    change(result)
    (tmp_path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return tmp_path


def one(full_directory: Path, tmp_path: Path, treatment: str = "notch", **values: Any) -> Material:
    """A directory with one run, as `hil run` leaves it."""

    def change(result: Any) -> None:
        run = next(run for run in result["runs"] if run["treatment"] == treatment and run["order"] == 2)
        result.update(runs=[{**run, **values}], comparisons=[], paper=[])

    return Material(altered(full_directory, tmp_path, change))


# -- emulated --------------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("without_pictures")
def test_an_emulated_robots_page_says_so_first_and_calls_nothing_measured(full_directory: Path, tmp_path: Path) -> None:
    page = write_report_of(altered(full_directory, tmp_path, lambda result: None)).read_text(encoding="utf-8")
    assert page.index("Emulated robot: nothing on this page was measured on a real one.") < page.index("<h1>")
    assert re.search(r"<title>Emulated: ", page)
    assert not re.search(r'class="tag">[^<]*measured', page)


@pytest.mark.ci  # all figures are drawn
def test_no_legend_calls_an_emulated_curve_measured(full_report: Any) -> None:
    page = full_report[0]
    assert not re.search(r">\s*measured\s*<", page)
    assert re.search(r">\s*emulated\s*<", page)


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(("emulated", "band"), [(False, None), (None, "This result does not record whether the robot was")])
def test_a_real_robot_has_no_band_and_an_older_result_says_not_recorded(
    full_directory: Path, tmp_path: Path, emulated: bool | None, band: str | None
) -> None:
    def change(result: Any) -> None:
        result.pop("emulated")
        if emulated is not None:
            result["emulated"] = emulated

    page = write_report_of(altered(full_directory, tmp_path, change)).read_text(encoding="utf-8")
    assert ('class="band"' in page) is (band is not None)
    assert band is None or band in page
    assert "<title>Emulated" not in page


@pytest.mark.usefixtures("without_pictures")
def test_of_a_mixed_bench_the_emulated_axes_are_named(full_directory: Path, tmp_path: Path) -> None:
    def change(result: Any) -> None:
        result["emulated_parts"] = ["axis 3"]

    page = write_report_of(altered(full_directory, tmp_path, change)).read_text(encoding="utf-8")
    assert "Partly emulated: axis 3. Not emulated: axis 2, axis 5, accelerometer." in page


# -- green only where all is green -----------------------------------------------------------------------------------------


def test_the_line_motions_tip_peak_has_a_red_card_while_it_is_outside(full_directory: Path) -> None:
    material = Material(full_directory)
    line = [card for card in cards(material) if card.title.startswith("Line motion")]
    assert [card.unit for card in line] == ["mm", "m/s²·Hz"]
    assert line[1].steps[0].mark.value is True
    run = material.find("line-motion", treatment="notch")
    assert run is not None
    assert run.tip_peak_mm is not None
    assert run.tip_peak_mm > 0.05
    assert (line[0].steps[0].mark.value, line[0].steps[0].mark.text) == (False, "limit ±0.05 mm")


def test_the_headline_is_not_green_over_a_red_card(full_directory: Path, tmp_path: Path) -> None:
    said = verdict(Material(full_directory))
    assert said.kind == "open"
    assert "5 of 5 claims hold" in said.headline
    assert "Outside ±0.05 mm: line motion, notch, drive-closed: tip 0.06" in said.headline

    def change(result: Any) -> None:
        result["runs"] = [run for run in result["runs"] if run["experiment"] != "line-motion"]

    assert verdict(Material(altered(full_directory, tmp_path, change))).kind == "good"


@pytest.mark.usefixtures("without_pictures")
def test_a_motion_with_two_treatments_has_one_card_and_the_headline_names_both(full_directory: Path, tmp_path: Path) -> None:
    def change(result: Any) -> None:
        for found in (result["runs"], result["comparisons"]):
            notch = next(each for each in found if (each["experiment"], each["treatment"]) == ("line-motion", "notch"))
            found.append({**notch, "treatment": "cancellation"})
        result["runs"][-1] |= {"recording": "runs/cancelled.csv", "tip_peak_mm": 0.002, "within_spec": True}

    material = Material(altered(full_directory, tmp_path, change))
    [tip, _] = [card for card in cards(material) if card.title.startswith("Line motion")]
    assert [(step.name, step.mark.value) for step in tip.steps] == [("notch", False), ("cancellation", True)]
    said = verdict(material)
    assert said.kind == "open", "the notch alone is outside"
    assert re.fullmatch(
        r"Line motion: tip 0\.1\d\d mm untreated, 0\.06\d mm with the paper's notch, "
        r"0\.002 mm with cancellation; limit ±0\.05 mm",
        said.headline,
    )
    page = write_report_of(material.directory).read_text(encoding="utf-8")
    assert page.count('<li class="steps">') == 2


def test_without_a_wish_for_the_area_the_line_has_the_card_of_its_peak_alone(full_directory: Path, tmp_path: Path) -> None:
    def change(result: Any) -> None:
        result["bench"]["file"]["specification"].pop("line_area_reduction_pct")

    material = Material(altered(full_directory, tmp_path, change))
    assert [card.unit for card in cards(material) if card.title.startswith("Line motion")] == ["mm"]


# -- in the robot's own terms ----------------------------------------------------------------------------------------------


def test_a_single_run_leads_with_the_tips_number(full_directory: Path, tmp_path: Path) -> None:
    good = verdict(one(full_directory, tmp_path, tip_peak_mm=0.0474, within_spec=True))
    assert any(line.endswith(" in 1 motion.") for line in good.details)
    assert (good.kind, good.headline) == ("good", "Tip 0.047 mm, allowed ≤ 0.05 mm")
    bad = verdict(one(full_directory, tmp_path, tip_peak_mm=0.0612, within_spec=False))
    assert (bad.kind, bad.headline) == ("bad", "Tip 0.061 mm, allowed ≤ 0.05 mm")
    bare = verdict(one(full_directory, tmp_path, "none", tip_peak_mm=0.0748, within_spec=False))
    assert (bare.kind, bare.headline) == ("open", "Tip 0.075 mm, allowed ≤ 0.05 mm, with no treatment")


@pytest.mark.parametrize(
    ("peak", "words"), [(0.0474, "0.047 mm"), (0.05, "0.050 mm"), (0.05004, "0.05004 mm"), (0.0503, "0.0503 mm")]
)
def test_a_peak_is_never_rounded_to_the_other_side_of_its_limit(peak: float, words: str) -> None:
    assert millimetres(peak, 0.05) == words


def test_a_run_that_is_not_judged_has_no_number_and_the_reason(full_directory: Path, tmp_path: Path) -> None:
    nothing = dict.fromkeys(
        ("tip_peak_mm", "tip_rms_mm", "spectrum_peak_m_s2", "spectrum_peak_hz", "spectrum_area", "within_spec")
    )
    said = verdict(one(full_directory, tmp_path, **nothing, invalid="axis 2 has no model"))
    assert (said.kind, said.headline) == ("open", "Not judged")
    assert any("axis 2 has no model" in line for line in said.details)


def test_the_peak_of_the_whole_ramp_and_f_al_stand_beside_the_judged_one(full_directory: Path, tmp_path: Path) -> None:
    material = one(full_directory, tmp_path, tip_peak_mm=0.0474, within_spec=True, ramp_peak_mm=0.0612, f_al_hz=11.84)
    assert "tip peak 0.047 mm, 0.061 mm on the whole ramp; f_al = 11.84 Hz" in " ".join(verdict(material).details)
    table = paper_runs.runs(material)
    assert table is not None
    assert table.rows[0][table.header.index("on the whole ramp (mm)")] == "0.0612"


def test_the_paper_stands_beside_its_own_robot_only(full_directory: Path, tmp_path: Path) -> None:
    def change(result: Any) -> None:
        result["bench"]["file"].pop("reference")

    own, paper = Material(altered(full_directory, tmp_path, change)), Material(full_directory)
    for table_of in (paper_runs.resonances, paper_runs.transmission_errors):
        ours, theirs = table_of(own), table_of(paper)
        assert ours is not None
        assert theirs is not None
        assert not any("paper" in name.lower() for name in ours.header)
        assert any("paper" in name.lower() for name in theirs.header)
        assert {len(row) for row in ours.rows} == {len(ours.header)}


@pytest.mark.ci
def test_the_paper_s_table_2_is_neither_drawn_nor_printed_for_another_robot() -> None:
    part = IdentifiedError(values=TransmissionErrorTable(a2_arcsec=7.0, phi2_deg=10.0, a4_arcsec=1.0, phi4_deg=20.0))
    ours, theirs = ate.errors(2, part), ate.errors(2, part, is_paper=True)
    assert ours is not None
    assert theirs is not None
    assert "Paper" not in ours.header
    assert "Paper" in theirs.header
    with style.styled():
        drawn, with_paper = ate.waveform(2, part), ate.waveform(2, part, is_paper=True)
    assert drawn is not None
    assert with_paper is not None
    assert "Table 2" not in drawn.svg
    assert "Table 2" in with_paper.svg


def test_a_bench_of_the_paper_is_read_back_as_one(full_directory: Path) -> None:
    assert load_result(full_directory, ExperimentsResult, "runs").bench.file.is_paper
