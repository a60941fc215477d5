"""The page of a rehearsal: every chapter for which there is data, and words where there is none."""

import pytest

from hil.report import palette
from plant_emulator.rehearsal.many import tables
from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.page import write_page
from plant_emulator.rehearsal.many.rows import crashed
from tests.plant_emulator.rehearsal.made import page_of, refused, row

QUANTITIES = {"a2_arcsec": (20.0, 20.1, 0.1), "phi2_deg": (359.0, 1.0, 1.0)}
WORDS = "not identified: <hysteresis> of 0.8 N·m"


@pytest.fixture(scope="module")
def robots():
    linear = [
        row(seed, quantities=QUANTITIES, probes={"phi2_off_60": seed == 5}, facts={"antiresonance_hz": 4.0 + seed})
        for seed in (1, 3, 5)
    ]
    real = [row(2, "real"), refused(4, WORDS, "real", facts={"hysteresis_nm": 1.0})]
    worse = row(6, "real", tips={"cancellation": {1: 0.9, 2: 0.009, 4: 0.004}})
    return sorted([*linear, *real, worse, {"kind": "real"} | dict(crashed(8))], key=lambda each: each["seed"])


@pytest.fixture(scope="module")
def page(robots, tmp_path_factory):
    return page_of(tmp_path_factory.mktemp("page") / "report.html", robots).read_text(encoding="utf-8").replace("&nbsp;", " ")


@pytest.mark.slow
def test_every_figure_and_every_table_stands_in_one_file(page):
    for key in ("claims", "tips", "tip-table", "before-after", "steps-figure", "steps-table", "causes", "facts", "errors",
                "estimates", "worse", "probes", "cost-figure", "cost", "robots"):  # fmt: skip
        assert f'id="{key}"' in page, key
    assert "<script" not in page
    assert "src=" not in page
    assert palette.css(":root").splitlines()[1] in page  # by night too


@pytest.mark.ci
def test_the_page_says_that_its_robots_are_emulated_and_which_they_are(page):
    assert "nothing on this page was measured on a real one" in page
    assert "The documented path, rehearsed: 7 robots drawn by seed" in page
    assert "seeds 1, 3 … 5" in page
    assert "bench “" not in page


@pytest.mark.ci
def test_the_verdict_names_every_claim_that_does_not_hold(robots, page):
    failed = [each for each in claims_of(robots) if each.holds is False]
    assert {"never_worse", "wrong_refused", "whole"} <= {each.key for each in failed}
    assert f"{len(failed)} of " in page
    for each in failed:
        assert each.measured in page


def test_words_of_a_robot_are_text_on_the_page(page):
    assert "&lt;hysteresis&gt; of 0.8 N·m" in page
    assert "<hysteresis>" not in page


def test_the_robot_that_was_made_worse_is_named_with_its_order(page):
    assert "cancelled k = 1: 0.3 → 0.9 mm" in page


def test_one_robot_that_broke_makes_a_page_too(tmp_path):
    text = page_of(tmp_path / "report.html", [{"kind": "linear"} | dict(crashed(8))]).read_text(encoding="utf-8")
    assert "its process died 2 times" in text


def test_no_robot_makes_no_page(tmp_path):
    with pytest.raises(ValueError, match="no robot has a result"):
        write_page(tmp_path / "report.html", [], [], [])


@pytest.mark.slow
def test_a_thousand_robots_make_a_page_that_a_browser_likes(tmp_path):
    """A figure has percentiles instead of the deviations of all, and the lists of robots end."""
    rows = [row(seed, "linear" if seed % 2 else "real", quantities=QUANTITIES, cpu_s=0.01 * seed) for seed in range(1000)]
    rows += [refused(1000 + seed, WORDS) for seed in range(200)]
    assert page_of(tmp_path / "report.html", rows).stat().st_size < 1_000_000


@pytest.mark.slow
def test_the_same_robots_make_the_same_page(robots, tmp_path):
    first, second = (page_of(tmp_path / name, robots).read_bytes() for name in ("a.html", "b.html"))
    assert first == second


def test_a_table_in_markdown_keeps_its_columns_and_its_headings(robots):
    lines = tables.steps(robots).markdown().splitlines()
    assert lines[0] == "| Step | Done | Noted | Refused | Stopped | Crashed | Skipped |"
    assert {line.count("|") for line in lines} == {8}
    assert lines[2].startswith("| **Linear gears: 3 robots** |")
    for table in (tables.claims(claims_of(robots)), tables.estimates(robots), tables.causes(robots)):
        lines = table.markdown().replace("\\|", "").splitlines()
        assert {line.count("|") for line in lines} == {len(table.header) + 1}
