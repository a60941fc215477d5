"""The page of a run tells of what acted in it: its filters with their margins, its tip, and the files behind it."""

from pathlib import Path
from typing import Any

import pytest

from hil.report.material import Material
from hil.report.pages.demo import heading, provenance, sections
from hil.report.tables.paper_runs import notches
from hil.results.acted import ActedFilter, SourceFile
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult
from tests.hil.results.made import BENCH

DESIGNED = (
    BENCH.axis[2]
    .notch[0]
    .model_copy(update={"offset_hz": 2.203, "zeta_rn": 0.0981, "zeta_rdth": 0.507, "start_rps": 1.904, "end_rps": 3.853})
)


def acted(directory: Path, tmp_path: Path, treatment: str, **values: Any) -> Material:
    """A directory with the ramps of axis 2 without treatment and with one, as `hil run` and `hil compare` leave it."""
    result = load_result(directory, ExperimentsResult, "runs")
    plain = [run for run in result.runs if (run.axis, run.treatment, run.loop) == (2, "none", "drive")]
    filters = {"filters": (), "cancelled": ()} | values
    runs = [run.model_copy(update={"treatment": treatment} | filters) for run in plain]
    before = [] if treatment == "none" else [run.model_copy(update={"filters": (), "cancelled": ()}) for run in plain]
    kept = {run.recording: directory / run.recording for run in plain}
    (tmp_path / "runs").mkdir()
    for name, source in kept.items():
        (tmp_path / name).symlink_to(source)
    files = (SourceFile(role="bench", path="my/bench.toml", sha256="ab" * 32),)
    changed = {"runs": [*before, *runs], "comparisons": [], "paper": [], "files": files}
    result.model_copy(update=changed).write(tmp_path / "result.json")
    return Material(tmp_path)


def chapters(material: Material) -> dict[str, list[str]]:
    return {section.key: [item.key for item in section.items] for section in sections(material)}


@pytest.mark.usefixtures("without_pictures")
def test_the_filter_on_the_page_is_the_one_that_acted_with_its_own_margins(full_directory: Path, tmp_path: Path) -> None:
    filters = (ActedFilter(axis=2, held_by="drive", notch=DESIGNED),)
    material = acted(full_directory, tmp_path, "notch-designed", filters=filters)
    (found,) = material.filter_sets
    table = notches(material, found)
    assert table is not None
    assert table.rows[0][1:7] == ["2.203", "0.0981", "0.507", "2", "1.904", "3.853"]
    assert "designed notch" in table.title
    worst = max(each.sensitivity_peak for each in material.margins(2, found).values())
    assert table.rows[0][7] == f"{worst:.2f}"
    placeholder = BENCH.axis[2].loop(250e-6)
    assert placeholder is not None
    assert material.loop(2, found).notches == (DESIGNED.notch(),) != placeholder.notches
    assert {"table-3", "schedules", "families", "nyquist", "margins"} == set(chapters(material)["notch"])


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("treatment", ["none", "cancellation"])
def test_a_page_says_nothing_of_a_filter_where_none_acted(full_directory: Path, tmp_path: Path, treatment: str) -> None:
    material = acted(full_directory, tmp_path, treatment)
    assert "notch" not in chapters(material)
    assert "notch" not in heading(material)


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    "treatment",
    ["none", "cancellation-learnt", *(pytest.param(name, marks=pytest.mark.slow) for name in ("notch-designed", "low-gains"))],
)
def test_every_page_begins_with_the_tip_and_its_order_map(full_directory: Path, tmp_path: Path, treatment: str) -> None:
    material = acted(full_directory, tmp_path, treatment)
    first, *_ = sections(material)
    assert [item.key for item in first.items[:2]] == ["suppression-2", "orders-2"]
    assert ("with and without" in first.items[0].title) is (treatment != "none")
    assert ("without" in first.title) is (treatment != "none")


def test_the_files_of_a_run_stand_on_its_page_with_their_sums(full_directory: Path, tmp_path: Path) -> None:
    lines = dict(provenance(acted(full_directory, tmp_path, "none")))
    assert lines["Bench file"] == f"my/bench.toml (SHA-256 {'ab' * 32})"
