"""The page in a real browser: it is shown by day, by night, on a telephone and on paper, and asks nobody for anything."""

import subprocess

import pytest

from hil.report import palette
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, render
from hil.report.report_table import ReportTable
from hil.report.writer import write_report_of
from tests.hil.report.browser import CHROMIUM, Browser

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine (Debian: apt-get install chromium)"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def page(full_directory):
    return write_report_of(full_directory)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def colour(browser, selector, name):
    """Colour of an element as the browser draws it, as #rrggbb."""
    text = browser.value(f"getComputedStyle(document.querySelector({selector!r})).getPropertyValue({name!r})")
    return "#" + "".join(f"{int(part):02x}" for part in text[text.index("(") + 1 : -1].split(",")[:3])


def test_by_night_page_and_figures_are_dark(browser, page):
    shown = {}
    for is_dark in (False, True):
        browser.open(page, is_dark=is_dark)
        shown[is_dark] = browser.picture()
        ground, ink = palette.PAPER[1 + is_dark], palette.INK[1 + is_dark]
        assert colour(browser, "body", "background-color") == ground
        assert colour(browser, "svg path", "fill") == ground  # the ground of the first figure
        assert colour(browser, "svg text", "fill") == colour(browser, "svg", "fill") == ink
    assert shown[False] != shown[True]


def test_paper_is_light_whatever_the_screen_asks_for(browser, page):
    browser.open(page, is_dark=True, media="print")
    assert colour(browser, "body", "background-color") == palette.PAPER.day
    assert colour(browser, "svg text", "fill") == palette.INK.day


@pytest.mark.parametrize("width", [390, 900, 1400, 1920])
def test_the_page_never_scrolls_sideways(browser, page, width):
    browser.open(page, width=width)
    assert browser.value("document.documentElement.scrollWidth") <= width


def test_no_table_is_cut_on_a_wide_screen_and_no_text_on_a_telephone(browser, page):
    cut = "[...document.querySelectorAll('.wide')].filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.parentNode.id)"
    browser.open(page)
    assert browser.value(cut) == []
    browser.open(page, width=390)
    tables = cut.replace("'.wide'", "'.wide:has(> table)'")
    assert browser.value(tables) == []
    labelled = "[...document.querySelectorAll('td[data-name]:not(:first-child)')]"
    assert browser.value(f"{labelled}.length") > 100
    apart = f"{labelled}.every(e => parseFloat(getComputedStyle(e).paddingLeft) > 100)"
    assert browser.value(apart), "each value has room for its name beside it"


def test_contents_stand_beside_on_a_wide_screen_and_in_a_closed_box_on_a_narrow_one(browser, page):
    height = "document.querySelector({!r}).getBoundingClientRect().height"
    browser.open(page)
    assert browser.value(height.format(".beside")) > 200
    assert browser.value(height.format(".above")) == 0
    browser.open(page, width=390)
    assert browser.value(height.format(".beside")) == 0
    assert 0 < browser.value(height.format(".above")) < 60


def test_the_words_of_a_figure_fit_into_it_with_the_fonts_that_are_there(browser, page):
    browser.open(page)
    assert browser.value("getComputedStyle(document.querySelector('svg text')).fontFamily").startswith('"DejaVu Sans"')
    outside = browser.value("""[...document.querySelectorAll('svg')].flatMap(svg => {
      const box = svg.getBoundingClientRect();
      return [...svg.querySelectorAll('text')].filter(text => {
        const own = text.getBoundingClientRect();
        return own.left < box.left - 1 || own.right > box.right + 1 || own.top < box.top - 1 || own.bottom > box.bottom + 1;
      }).map(text => svg.parentNode.parentNode.id + ': ' + text.textContent);
    })""")
    assert outside == []


def test_the_browser_reads_it_as_it_was_written(browser, page):
    browser.open(page)
    assert browser.value("document.querySelectorAll('figure svg').length") == 15
    assert browser.value("document.querySelectorAll('script').length") == 0
    assert browser.value("performance.getEntriesByType('resource').length") == 0


def test_it_prints_on_numbered_pages(browser, page, tmp_path):
    browser.open(page)
    sheet = tmp_path / "page.pdf"
    sheet.write_bytes(browser.print())
    data = sheet.read_bytes()
    assert data.startswith(b"%PDF")
    count = data.count(b"/Type /Page\n") + data.count(b"/Type /Page ")
    assert 6 <= count <= 25
    try:
        text = subprocess.run(["pdftotext", sheet, "-"], capture_output=True, text=True, check=True).stdout  # noqa: S607
    except FileNotFoundError:
        return
    assert f"page {count} of {count}" in text
    assert "f\nal" in text or "fal" in text  # words of figures are words on paper too


def test_names_of_a_table_keep_their_subscripts_on_a_telephone_only(browser, tmp_path):
    orders = ReportTable("orders", "Orders", ("Axis", "f_al (Hz)", "Peak (mm)"), [["2", "11.8", "0.07"]])
    head = PageHead("reference", "2026-11-26T16:00:00Z", heading="Orders")
    content = Page(head, PageVerdict("good", "Orders", ()), [Section("orders", "Orders", (orders,))])
    page = render(tmp_path / "page.html", content)
    shown = "getComputedStyle(document.querySelector('td .name')).display"
    browser.open(page)
    assert browser.value(shown) == "none"
    browser.open(page, width=390)
    assert browser.value(shown) != "none"
    assert browser.value("document.querySelector('td .name').innerHTML") == "f<sub>al</sub> (Hz)"
