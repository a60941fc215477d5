"""The page: one file that stands alone, says all there is, and says what is missing."""

import json
import re
import shutil
from html.parser import HTMLParser

import pytest

from hil.bench.bench import load_bench
from hil.report.material import Material
from hil.report.pages.demo import verdict
from hil.report.writer import write_report_of

VOID = {"meta", "br", "hr", "img", "link", "input"}
ALL_FIGURES = {
    "plants", "resonances", "transmission-errors", "identification-2", "identification-3", "schedules", "families", "nyquist",
    "margins", "suppression-2", "suppression-3", "orders-2", "orders-3", "line-motion", "loop-places-2",
}  # fmt: skip
ALL_TABLES = {"claims", "table-1", "table-2", "table-3", "runs", "motions"}


class Page(HTMLParser):
    """Ids, references, text, and whether every element is closed."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.references, self.words, self.tags, self.open, self.figures, self.named_by = [], [], [], [], [], [], []
        self.label = None  # depth of a cell's label, which only a phone shows
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        if "id" in found:
            self.ids.append(found["id"])
        if tag == "figure":
            self.figures.append(found["id"])
        self.named_by += [name for key in ("aria-labelledby", "for") if key in found for name in found[key].split()]
        self.references += [value for name, value in attrs if name in {"href", "src", "xlink:href", "action", "data", "srcset"}]
        self.references += re.findall(r"url\(([^)]*)\)", " ".join(value or "" for _, value in attrs))
        if tag not in VOID:
            self.open.append(tag)
        if found.get("class") == "name":
            self.label = len(self.open)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag
        if self.label is not None and len(self.open) < self.label:
            self.label = None

    def handle_data(self, data):
        if self.label is None:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def full(full_report):
    return full_report[0]


def altered(full_directory, tmp_path, change, *, with_recordings=True):
    """A copy of the directory with another result.json, and its page."""
    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    change(result)
    (tmp_path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    if with_recordings:
        shutil.copytree(full_directory / "runs", tmp_path / "runs", dirs_exist_ok=True)
    page = Page(write_report_of(tmp_path).read_text(encoding="utf-8"))
    assert page.open == []
    return page


@pytest.mark.ci
def test_it_is_well_formed_with_unique_ids(full):
    page = Page(full)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))


@pytest.mark.ci
def test_every_figure_and_table_has_a_name_that_exists(full):
    page = Page(full)
    assert set(page.named_by) == {f"{key}-title" for key in ALL_FIGURES | ALL_TABLES}
    assert set(page.named_by) <= set(page.ids)


@pytest.mark.ci
def test_it_has_a_dark_side_on_screens_and_colours_in_one_place(full):
    assert full.count("@media screen and (prefers-color-scheme: dark)") == 1
    body = full[full.index("</style>") :]
    assert not re.search(r"#[0-9a-fA-F]{6}\b", body)
    used = set(re.findall(r"var\(--([a-z0-9-]+)\)", full))
    assert used <= set(re.findall(r"--([a-z0-9-]+):", full))


@pytest.mark.ci
def test_words_of_figures_are_words(full):
    figures = re.findall(r"<svg.*?</svg>", full, flags=re.DOTALL)
    assert all("<text" in figure for figure in figures)
    words = Page(full).text
    assert "specification ±0.05 mm" in words
    assert "Motor speed f m (rev/s)" in words


@pytest.mark.ci
def test_what_came_of_it_stands_before_the_theory(full):
    order = ["line-motion", "suppression-2", "suppression-3", "claims", "table-1", "families", "runs", "motions"]
    places = [full.index(f' id="{key}"') for key in order]
    assert places == sorted(places)


@pytest.mark.ci
def test_claims_are_grouped_by_axis(full):
    table = full[full.index('<div id="claims"') : full.index("</table>", full.index('<div id="claims"'))]
    assert re.findall(r'<tr class="group">.*?>([^<]+)</th>', table) == ["Axis 2", "Axis 3", "Line motion"]


@pytest.mark.ci
def test_the_moment_is_said_once_and_readably(full):
    words = Page(full).text
    assert words.count("1 January 2025, 12:00 UTC") == 1
    assert "2025-01-01T" not in words


@pytest.mark.ci
def test_it_stands_alone(full):
    page = Page(full)
    inside = [reference[1:] for reference in page.references if reference.startswith("#")]
    assert all(reference.startswith("#") for reference in page.references)
    assert set(inside) <= set(page.ids)
    assert not {"script", "link", "img", "iframe", "object", "embed"} & set(page.tags)
    addresses = set(re.findall(r"https?://[^\s\"'<)]+", full))
    assert addresses == {"http://www.w3.org/2000/svg"}
    assert "@import" not in full


@pytest.mark.ci
def test_every_figure_and_table_is_there_and_in_the_contents(full):
    page = Page(full)
    assert set(page.figures) == ALL_FIGURES
    assert page.tags.count("svg") == len(ALL_FIGURES)
    assert set(page.ids) >= ALL_TABLES
    assert {f"#{key}" for key in ALL_FIGURES | ALL_TABLES} <= set(page.references)


@pytest.mark.ci
def test_every_figure_says_whether_it_was_computed_or_came_from_an_emulated_robot(full):
    for figure in re.findall(r"<figure.*?</figure>", full, flags=re.DOTALL):
        assert re.search(r'class="tag">(emulated|computed|emulated and computed)<', figure)
        caption = re.search(r"<figcaption>(.*?)</figcaption>", figure, flags=re.DOTALL)
        assert caption is not None
        assert len(caption[1]) > 80


@pytest.mark.ci
def test_every_run_is_there(full, full_directory):
    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    for run in result["runs"]:
        assert run["recording"] in full
        assert f"{run['tip_peak_mm']:.4f}" in full
    assert full.count("✔ within") + full.count("✘ outside") == len(result["runs"])


@pytest.mark.ci
def test_the_verdict_stands_at_the_top_in_words(full):
    words = Page(full).text
    assert "The bench reproduces the paper: 5 of 5 claims hold" in words
    assert words.index("claims hold") < words.index("Paper and bench")
    assert "Missed cycles: 0 of" in words


@pytest.mark.ci
def test_identified_and_paper_values_stand_side_by_side(full):
    words = Page(full).text
    assert re.search(r"axis 2 A 2 arcsec 5 5 [45]\.\d\d ± 0\.\d\d", words)
    assert re.search(r"axis 3 φ 4 ° 306 306 30\d\.\d ± \d\.\d", words)
    assert "11.84 11.84 5.92 5.92 2.96 2.96" in words


@pytest.mark.ci
def test_it_is_small(full):
    assert sum(map(len, re.findall(r"<svg.*?</svg>", full, flags=re.DOTALL))) < 2_500_000


@pytest.mark.slow
def test_equal_data_give_equal_bytes(full, full_directory):
    assert write_report_of(full_directory).read_text(encoding="utf-8") == full


def test_the_bench_comes_back_from_json(full_directory):
    bench = Material(full_directory).bench
    assert bench == load_bench("reference")
    assert set(bench.axis) == {2, 3, 5}


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("kept", [0, *(pytest.param(kept, marks=pytest.mark.slow) for kept in (4, 7))])
def test_one_motion_alone_gives_a_report(full_directory, tmp_path, kept):
    treatments = set()

    def change(result):
        recordings = list(dict.fromkeys(run["recording"] for run in result["runs"]))
        result["runs"] = [run for run in result["runs"] if run["recording"] == recordings[kept]]
        result["comparisons"], result["paper"] = [], []
        treatments.update(run["treatment"] for run in result["runs"])

    page = altered(full_directory, tmp_path, change)
    assert {"plants", "resonances"} <= set(page.figures)
    has_filter = any("notch" in treatment for treatment in treatments)
    assert ({"families", "nyquist", "margins"} <= set(page.figures)) is has_filter, "about a filter where one acted"
    assert "claims" not in page.ids
    assert "cannot be read" not in page.text


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
def test_no_runs_at_all(full_directory, tmp_path):
    def change(result):
        result["runs"], result["comparisons"], result["paper"] = [], [], []

    page = altered(full_directory, tmp_path, change, with_recordings=False)
    assert "Not judged" in page.text
    assert "runs" not in page.ids


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
def test_no_models_no_notches_no_line(full_directory, tmp_path):
    def change(result):
        file = result["bench"]["file"]
        file["geometry"] = file["line_motion"] = file["constant_acceleration"] = None
        for axis in file["axis"].values():
            axis["model"], axis["notch"] = None, []
        for run in result["runs"]:
            run["filters"] = []

    page = altered(full_directory, tmp_path, change)
    assert set(page.figures) == {
        "suppression-2", "suppression-3", "orders-2", "orders-3", "line-motion",
        "loop-places-2",
    }  # fmt: skip
    assert "Without f al the specification cannot be converted" in page.text
    assert "the scale on the right" not in page.text, "there is none"


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_an_axis_without_amplitudes_has_no_constraint(full_directory, tmp_path):
    def change(result):
        for axis in ("2", "3"):
            result["bench"]["file"]["axis"][axis]["model"]["ate"].update(a2_arcsec=0.0, a4_arcsec=0.0)

    assert set(altered(full_directory, tmp_path, change).figures) == ALL_FIGURES


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_missing_recordings_are_said(full_directory, tmp_path):
    page = altered(full_directory, tmp_path, lambda result: None, with_recordings=False)
    assert "What is missing here" in page.text
    assert page.text.count("cannot be read") == 8
    assert set(page.figures) == {"plants", "resonances", "transmission-errors", "schedules", "families", "nyquist", "margins"}


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("rows", [40, *(pytest.param(rows, marks=pytest.mark.slow) for rows in (0, 1, 200, 700))])
def test_a_run_that_was_stopped_early_says_so_at_the_top(full_directory, tmp_path, rows):
    name = "runs/constant-acceleration-2-none-drive.csv"
    shutil.copytree(full_directory / "runs", tmp_path / "runs")
    lines = (tmp_path / name).read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / name).write_text("".join(lines[: rows + 1]), encoding="utf-8")

    def change(result):
        measured = ("tip_peak_mm", "tip_rms_mm", "spectrum_peak_m_s2", "spectrum_peak_hz", "spectrum_area", "within_spec")
        for run in result["runs"]:
            if run["recording"] == name:
                run.update(dict.fromkeys(measured), stopped="axis 2: speed 12.4 rev/s is above the limit")

    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    change(result)
    (tmp_path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    text = write_report_of(tmp_path).read_text(encoding="utf-8")
    words = Page(text).text
    assert "A run was stopped early" in words
    assert words.index("speed 12.4 rev/s is above the limit") < words.index("Paper and bench")
    assert 'class="verdict bad"' in text


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_holes_in_a_recording_are_bridged_and_said(full_directory, tmp_path):
    name = "runs/constant-acceleration-3-notch-drive.csv"
    shutil.copytree(full_directory / "runs", tmp_path / "runs")
    lines = (tmp_path / name).read_text(encoding="utf-8").splitlines(keepends=True)
    for row in (500, 501):
        values = lines[row].rstrip("\n").split(",")
        lines[row] = ",".join([values[0], *["nan"] * (len(values) - 1)]) + "\n"
    (tmp_path / name).write_text("".join(lines), encoding="utf-8")
    shutil.copy(full_directory / "result.json", tmp_path)
    page = Page(write_report_of(tmp_path).read_text(encoding="utf-8"))
    assert f"{name}: 2 samples are missing" in page.text
    assert "suppression-3" in page.figures


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_failed_claims_and_markup_in_names(full_directory, tmp_path):
    def change(result):
        result["bench"]["name"] = result["bench"]["file"]["name"] = "<b>&robot"
        result["paper"][1].update(holds=False, bench=12.1)
        result["paper"][0].update(holds=None, bench=None)

    page = altered(full_directory, tmp_path, change)
    assert "<b>&robot" in page.text
    assert "1 of the paper's 5 claims do not hold" in page.text
    assert "paper 11.45 Hz, bench 12.1 Hz" in page.text
    assert "not judged" in page.text


@pytest.mark.parametrize(
    ("treatment", "within", "kind"),
    [("none", False, "open"), ("notch", False, "bad"), ("notch", True, "good"), ("none", None, "open")],
)
def test_without_claims_the_specification_decides(full_directory, tmp_path, treatment, within, kind):
    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    run = next(run for run in result["runs"] if run["treatment"] == treatment and run["order"] == 2)
    result.update(runs=[{**run, "within_spec": within}], comparisons=[], paper=[])
    (tmp_path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    assert verdict(Material(tmp_path)).kind == kind


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
def test_a_result_without_its_bench_file_is_refused(full_directory, tmp_path):
    result = json.loads((full_directory / "result.json").read_text(encoding="utf-8"))
    result["bench"].pop("file")
    (tmp_path / "result.json").write_text(json.dumps({**result, "runs": []}), encoding="utf-8")
    with pytest.raises(ValueError, match=r"bench\.file: is missing"):
        write_report_of(tmp_path)


def test_another_schema_is_refused(tmp_path):
    (tmp_path / "result.json").write_text('{"schema": 3}', encoding="utf-8")
    with pytest.raises(ValueError, match="schema 3"):
        write_report_of(tmp_path)
