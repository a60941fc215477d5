"""The page of a rehearsal in a real browser: by night, and on every width."""

import pytest

from hil.report import palette
from tests.hil.report.browser import CHROMIUM, Browser
from tests.plant_emulator.rehearsal.made import page_of, refused, row

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine (Debian: apt-get install chromium)"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    quantities = {"a2_arcsec": (20.0, 20.1, 0.1)}
    rows = [row(seed, "linear" if seed % 2 else "real", quantities=quantities, cpu_s=0.5 * seed) for seed in range(1, 21)]
    rows += [
        refused(21, "a word that is " + "very " * 100 + "long", "linear"),
        refused(22, "a/" + "rehearsal/" * 7 + "model.toml: not there", "real"),
    ]
    return page_of(tmp_path_factory.mktemp("page") / "report.html", rows)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def test_it_never_scrolls_sideways_and_no_table_is_cut_on_a_wide_screen(browser, page):
    for width in (390, 900, 1400, 1920):
        browser.open(page, width=width)
        assert browser.value("document.documentElement.scrollWidth") <= width
    cut = "[...document.querySelectorAll('.wide')].filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.parentNode.id)"
    assert browser.value(cut) == []


def test_by_night_the_figures_have_the_page_s_ground(browser, page):
    browser.open(page, is_dark=True)
    drawn = browser.value("getComputedStyle(document.querySelector('svg path')).fill")
    night = palette.PAPER.night.removeprefix("#")
    assert drawn == f"rgb({', '.join(str(int(night[at : at + 2], 16)) for at in (0, 2, 4))})"


def test_the_words_of_every_figure_stay_inside_of_it(browser, page):
    browser.open(page)
    outside = browser.value("""[...document.querySelectorAll('svg')].flatMap(svg => {
      const box = svg.getBoundingClientRect();
      return [...svg.querySelectorAll('text')].filter(text => {
        const own = text.getBoundingClientRect();
        return own.left < box.left - 1 || own.right > box.right + 1 || own.top < box.top - 1 || own.bottom > box.bottom + 1;
      }).map(text => text.textContent);
    })""")
    assert outside == []
