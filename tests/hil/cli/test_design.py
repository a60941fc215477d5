"""hil design notch: files, exit status and words; the search itself is tested elsewhere."""

import json
import re

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.application import Tool, mount
from drive_profiles.parameter_set.parameters import ParameterSet
from hil.bench.design import load_designs
from hil.cli import design as cli_design
from hil.design import notch_search


@pytest.fixture
def app():
    made = Tool("hil", "")
    mount(made, cli_design)
    return made


@pytest.fixture
def quick(monkeypatch):
    """A search that is over before it begins, in this process."""
    tiny = notch_search.Effort(6, 1, 5, 1)
    monkeypatch.setattr(notch_search.Effort, "quick", classmethod(lambda cls, seed=1: tiny))
    monkeypatch.setattr(cli_design, "usable_processors", lambda: 0)


def run(app, *arguments):
    return CliRunner().invoke(app, ["design", "notch", *map(str, arguments)])


@pytest.mark.slow
def test_a_design_leaves_a_report_a_design_file_a_parameter_set_and_json(app, quick, tmp_path):
    found = run(app, "--bench", "reference", "--axis", 2, "--quick", "--shape", "switched", "--uncertainty-percent", 0,
                "--out", tmp_path, "--json")  # fmt: skip
    assert found.exit_code == 0, found.output
    whole = json.loads(found.stdout)
    assert whole == json.loads((tmp_path / "design.json").read_text())
    assert whole["feasible"] is True
    assert whole["designed"]["holds"] is True
    assert len(whole["plants"]) == 1
    kept = load_designs(tmp_path / "design.toml")
    assert kept.axis[2].notch[0].order == 2
    assert whole["designed"]["tip_peaks"][0]["rising_mm"] == pytest.approx(kept.axis[2].tip_peak_mm["2"])
    assert ParameterSet.load(tmp_path / "notch-axis2.toml").tuning["notch_1.mode"].value == 1
    page = (tmp_path / "design.html").read_text()
    groups = re.findall(r'<tr class="group">.*?>([^<]+)</th>', page)
    assert groups == ["designed filter", "given filter", "no filter"], "each is named once, the design first"
    assert "<code>hil run constant-acceleration</code>" in page
    assert "`" not in page[page.index("</style>") :]
    assert "K<sub>g</sub> (kN·m/rad)" in page
    assert "The designed filters meet all requirements" in page
    for key in ("families", "nyquist", "margins", "ramps", "peaks", "requirements", "plant-set"):
        assert f'id="{key}"' in page
    assert "<script" not in page
    assert "src=" not in page
    assert "[[axis.2.notch]]" in found.stderr


@pytest.mark.usefixtures("without_pictures")
def test_the_given_filter_is_judged_without_a_search(app, quick, tmp_path):
    found = run(app, "--bench", "reference", "--axis", 3, "--given", "--uncertainty-percent", 0, "--out", tmp_path)
    assert found.exit_code == 0, found.output
    assert "0.0446" in found.stdout
    assert not (tmp_path / "design.toml").exists()
    assert "The given filters meet all requirements" in (tmp_path / "design.html").read_text()


@pytest.mark.ci
@pytest.mark.usefixtures("without_pictures")
def test_a_given_filter_that_misses_a_limit_is_said_to_and_the_report_is_there(app, quick, tmp_path):
    found = run(
        app,
        "--bench",
        "reference",
        "--axis",
        2,
        "--given",
        "--max-sensitivity",
        1.5,
        "--uncertainty-percent",
        0,
        "--out",
        tmp_path,
    )
    assert found.exit_code == 9
    assert "the given filters do not meet every requirement: M_s 1.6" in found.stderr
    assert "at most 1.5 required" in found.stderr
    assert "The given filters miss a requirement" in (tmp_path / "design.html").read_text()
    assert not (tmp_path / "notch-axis2.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--axis", 4), 3, "has no axis 4"),
        (("--axis", 5), 3, "axis 5 has no model"),
        (("--axis", 2, "--max-sensitivity", 0.9), 2, "max_sensitivity"),
        (("--axis", 2, "--uncertainty-percent", 80), 2, "80"),
        (("--axis", 2, "--model", "/nowhere/model.toml"), 3, "model.toml"),
        (("--axis", 2, "--order", "3"), 3, "of order 3 is not known"),
        (("--axis", 2, "--order", "two"), 2, "--order 'two'"),
        (("--axis", 2, "--order", "2,2"), 2, "--order '2,2'"),
    ],
)
def test_what_cannot_be_is_refused(app, quick, tmp_path, arguments, code, said):
    found = run(app, "--bench", "reference", "--out", tmp_path, *arguments)
    assert found.exit_code == code, found.output
    assert said in found.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_parameter_set_that_is_there_is_not_replaced_where_its_name_was_given(app, quick, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("# kept\n")
    found = run(app, "--bench", "reference", "--axis", 2, "--given", "--out", tmp_path, "--set", path)
    assert found.exit_code == 3
    assert path.read_text() == "# kept\n"


@pytest.mark.usefixtures("without_pictures")
def test_a_given_filter_goes_into_the_design_file_that_is_named(app, quick, tmp_path):
    path = tmp_path / "mine.toml"
    asked = ("--bench", "reference", "--axis", 3, "--given", "--uncertainty-percent", 0, "--out", tmp_path, "--design", path)
    found = run(app, *asked)
    assert found.exit_code == 0, found.output
    kept = load_designs(path).axis[3]
    assert kept.notch[0].zeta_rn == 0.036
    assert kept.tip_peak_mm["2"] == pytest.approx(0.0446, abs=0.0005)
    assert f"design file: {path}" in found.stderr


@pytest.mark.usefixtures("without_pictures")
def test_a_given_filter_that_breaks_a_margin_goes_into_no_file_and_that_is_said(app, quick, tmp_path):
    path = tmp_path / "mine.toml"
    asked = ("--bench", "reference", "--axis", 2, "--given", "--max-sensitivity", 1.5, "--uncertainty-percent", 0)
    found = run(app, *asked, "--out", tmp_path, "--design", path)
    assert found.exit_code == 9
    assert not path.exists()
    assert "no design file and no parameter set" in found.stderr
