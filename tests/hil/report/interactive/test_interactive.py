"""An interactive page: one file that loads nothing, the same bytes each time, and a plain page where it is not asked for."""

import base64
import hashlib
import re
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.errors import NotPossibleError
from hil.report import palette, style
from hil.report.interactive import parts
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.writer import write_report_of
from hil.results.learning import LearningResult
from tests.hil.report.browser import CHROMIUM, Browser
from tests.hil.results.made import measured_bench, written

in_a_browser = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine (Debian: apt-get install chromium)"),
    pytest.mark.slow,
]
ZOOMABLE = {
    "suppression-2", "suppression-3", "line-motion", "orders-2", "orders-3", "loop-places-2", "families", "nyquist", "margins",
}  # fmt: skip
MOST_BYTES = 9_000_000


def small(path, *, is_interactive):
    """A page of one figure."""
    with style.styled():
        figure, panels = style.panels(1, 1, 2.0)
        x = np.linspace(0.0, 1.0, 30_000)
        style.plot_thin(panels[0, 0], x, np.sin(90.0 * x), label="</script>", **style.WITH)
        svg = style.to_svg(figure, "one", is_zoomable=True)
    drawing = style.Drawing("one", "A figure", "", "measured", "Words.", svg)
    verdict = PageVerdict("good", "Well", ())
    render(path, Page(PageHead("bench"), verdict, [Section("all", "All", (drawing,))]), is_interactive=is_interactive)
    return path.read_text(encoding="utf-8")


def test_the_page_is_one_file_whose_scripts_are_named_by_their_hashes(tmp_path):
    text = small(tmp_path / "page.html", is_interactive=True)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert re.findall(r"'sha256-([^']*)'", policy) == hashes
    assert len(hashes) == 4
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "http" not in policy
    assert "unsafe-eval" not in policy
    without = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert re.findall(r"<(?:script|img|link)[^>]+(?:src|href)=", without) == []


@pytest.mark.ci
def test_the_same_numbers_give_the_same_bytes(tmp_path):
    assert small(tmp_path / "a.html", is_interactive=True) == small(tmp_path / "b.html", is_interactive=True)


@pytest.mark.ci
def test_the_plain_page_has_no_script_and_the_interactive_one_keeps_its_picture(tmp_path):
    plain, shown = (small(tmp_path / "page.html", is_interactive=each) for each in (False, True))
    assert "<script" not in plain
    assert "zoom" not in plain
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:\">" in plain
    (svg,) = re.findall(r"<svg .*?</svg>", plain, re.DOTALL)
    assert svg in shown


def test_without_the_library_nothing_is_written(tmp_path, monkeypatch):
    written(tmp_path, LearningResult(bench=measured_bench(), model="learnt.toml"))
    find = parts.importlib.util.find_spec
    monkeypatch.setattr(parts.importlib.util, "find_spec", lambda name: None if name == "bokeh" else find(name))
    with pytest.raises(NotPossibleError, match=r"needs bokeh, which is not installed: pip install 'hil-bench\[live\]'"):
        parts.check_interactive()
    found = CliRunner().invoke(app, ["report", str(tmp_path), "--interactive"])
    assert found.exit_code == 3
    assert "pip install" in found.output
    assert not (tmp_path / "report.html").exists()


def test_a_page_without_such_figures_says_so(tmp_path):
    written(tmp_path, LearningResult(bench=measured_bench(), model="learnt.toml", not_learnt="no pass"))
    found = CliRunner().invoke(app, ["report", str(tmp_path), "--interactive"])
    assert found.exit_code == 0
    assert "no figure that can be zoomed" in found.output
    assert "<script" not in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(full_directory, tmp_path_factory):
    """An interactive page of all runs, away from the plain one."""
    directory = shutil.copytree(full_directory, tmp_path_factory.mktemp("interactive") / "runs")
    return write_report_of(directory, is_interactive=True)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def wait(browser, condition):
    for _ in range(400):
        if browser.value(f"Boolean({condition})"):
            return
        browser.value("new Promise(done => setTimeout(done, 50))")
    raise AssertionError(f"not so within a while: {condition}")


def show_all(browser):
    """Bring each figure on the screen, and wait until it is drawn."""
    for key in sorted(ZOOMABLE):
        browser.value(f"document.getElementById('{key}').scrollIntoView({{ behavior: 'instant' }})")
        wait(browser, f"zoomed.has('{key}') && zoomed.get('{key}').isShown")


class TestInABrowser:
    pytestmark = in_a_browser

    def test_every_figure_is_drawn_narrow_and_wide_by_day_and_by_night(self, browser, page):
        for width, is_dark in ((390, False), (1400, False), (1400, True)):
            self.every_figure_is_drawn(browser, page, width, is_dark=is_dark)

    def every_figure_is_drawn(self, browser, page, width, *, is_dark):
        browser.open(page, width=width, is_dark=is_dark)
        show_all(browser)
        assert set(browser.value("[...zoomed.keys()]")) == ZOOMABLE
        assert browser.value("document.documentElement.scrollWidth") <= width
        grounds = "[...zoomed.values()].flatMap(each => [...each.figures.values()].map(one => one.background_fill_color))"
        assert set(browser.value(grounds)) == {palette.PAPER[1 + is_dark]}
        assert browser.value("getComputedStyle(document.querySelector('#suppression-2 svg')).display !== 'none'")
        assert browser.value("document.querySelector('#suppression-2 > .wide:not(.zoom)').clientHeight") == 0
        outside = (
            "[...document.querySelectorAll('.zoom')].filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.parentNode.id)"
        )
        assert browser.value(outside) == []

    def test_zoom_names_and_policy(self, browser, page):
        browser.open(page)
        show_all(browser)
        assert page.stat().st_size < MOST_BYTES
        self.zoom_draws_the_samples_of_that_window(browser)
        self.panels_below_each_other_move_together(browser)
        self.name_turns_its_curves_off_and_on(browser)
        self.nobody_is_asked_for_anything(browser)

    def zoom_draws_the_samples_of_that_window(self, browser):
        browser.value("window.one = zoomed.get('suppression-2'); window.two = one.curves[0]; undefined")
        browser.value("[...one.figures.values()][0].x_range.setv({ start: 1.501, end: 1.999 })")
        seen = browser.value("[...two.source.data.x]")
        inside = browser.value("[...two.x].filter(x => x >= 1.501 && x <= 1.999)")
        assert seen[1:-1] == inside  # all of them, and the next to either side
        assert len(inside) > 200

    def panels_below_each_other_move_together(self, browser):
        browser.value("window.map = zoomed.get('orders-2'); [...map.figures.values()][0].x_range.setv({ start: 4, end: 6 })")
        ranges = browser.value("[...map.figures.values()].map(each => [each.x_range.start, each.x_range.end])")
        assert ranges.count([4, 6]) == 2  # the map over orders and that over frequency below it

    def name_turns_its_curves_off_and_on(self, browser):
        visible = "[...zoomed.get('suppression-2').figures.values()][0].renderers.map(each => each.visible)"
        before = browser.value(visible)
        browser.value("document.querySelector('#suppression-2 .zoom-names button').click()")
        assert browser.value(visible).count(False) == before.count(False) + 1
        browser.value("document.querySelector('#suppression-2 .zoom-names button').click()")
        assert browser.value(visible) == before

    def nobody_is_asked_for_anything(self, browser):
        asked = browser.value("performance.getEntriesByType('resource').map(each => each.name)")
        assert [name for name in asked if not name.startswith(("data:", "blob:"))] == []
        assert browser.value("fetch('http://127.0.0.1:9/').then(() => 'asked', error => error.name)") == "TypeError"
        browser.value("window.other = document.createElement('script'); other.textContent = 'window.foreign = 1'; undefined")
        browser.value("document.body.append(other)")
        assert browser.value("typeof window.foreign") == "undefined"

    def test_on_paper_it_has_the_still_pictures(self, browser, page):
        browser.open(page, media="print")
        assert browser.value("document.querySelector('#suppression-2 > .wide:not(.zoom)').clientHeight") > 100
        assert browser.value("document.querySelector('#suppression-2 > .zoom').clientHeight") == 0
