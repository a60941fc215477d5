"""Numbers of an interactive page: nothing that stands out is lost, and the page stays as small as it says."""

import base64
import json

import numpy as np
import pytest

from hil.report import style
from hil.report.interactive import parts
from hil.report.zoomable import ZoomFigure, plain


def decoded(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


def zoomed(draw, **options):
    """What can be zoomed of a figure of one panel that `draw` has drawn."""
    with style.styled():
        figure, panels = style.panels(1, 1, 2.0, **options)
        draw(panels[0, 0])
        return style.to_svg(figure, "key", is_zoomable=True).zoom


def curves(figure):
    (panel,) = json.loads(parts.numbers_json({"key": figure}))["key"]
    return panel["curves"]


def test_a_spike_of_one_sample_is_kept_whatever_is_left_out():
    x = np.arange(1_000_000, dtype=np.float64)
    y = np.zeros(len(x))
    y[123_457], y[777_777] = 5.0, -7.0
    shown_x, shown_y = parts.envelope(x, y, 1000)
    assert len(shown_x) == 2000
    assert np.all(np.diff(shown_x) >= 0.0)
    assert (shown_y.max(), shown_y.min()) == (5.0, -7.0)
    assert shown_x[np.argmax(shown_y)] == 123_457
    assert shown_x[np.argmin(shown_y)] == 777_777


def test_columns_without_a_value_leave_a_gap_and_others_their_extremes():
    y = np.sin(np.arange(10_000) / 50.0)
    y[2000:3000] = np.nan
    y[5001] = np.nan
    x, found = parts.envelope(np.arange(10_000.0), y, 100)
    assert np.isnan(found[(x > 2100) & (x < 2900)]).all()
    assert not np.isnan(found[(x < 1900) | (x > 3100)]).any()
    assert np.nanmax(found) == np.nanmax(y)


def test_a_curve_that_fits_keeps_every_sample():
    x = np.linspace(0.0, 1.0, 5000)
    figure = zoomed(lambda panel: style.plot_thin(panel, x, np.sin(40.0 * x), label="a", **style.WITH))
    (curve,) = curves(figure)
    assert len(decoded(curve["x"])) == 5000
    assert decoded(curve["y"]) == pytest.approx(np.sin(40.0 * x), abs=1e-6)
    assert (curve["name"], curve["colour"], curve["is_broken"]) == ("a", "blue", False)


def test_many_curves_share_the_bound_of_the_page():
    x = np.linspace(0.0, 1.0, 30_000)

    def draw(panel):
        for _ in range(40):
            style.plot_thin(panel, x, np.random.default_rng(1).normal(size=len(x)), **style.WITH)

    figure = zoomed(draw)
    assert parts.columns_for([figure]) < parts.MOST_COLUMNS
    assert sum(len(decoded(curve["x"])) for curve in curves(figure)) <= parts.MOST_OF_PAGE
    assert len(parts.numbers_json({"key": figure})) < 11 * parts.MOST_OF_PAGE


def test_lines_across_a_panel_are_lines_and_not_curves():
    def draw(panel):
        panel.plot([0.0, 1.0], [0.0, 2.0], **style.WITH)
        panel.axhline(1.5, label="limit", **style.LIMIT)
        panel.axvline(0.25, **style.MARK)
        style.flag(panel, 0.75, "$f_a$")
        panel.axvspan(0.4, 0.6, color=style.SHADE)

    (panel,) = zoomed(draw).values()
    assert [(line.name, line.axis, line.at) for line in panel.lines] == [("limit", "y", 1.5), ("", "x", 0.25), ("f_a", "x", 0.75)]
    assert len(panel.curves) == 1
    assert panel.shades[0].x == pytest.approx([0.4, 0.6])


def test_equal_figures_give_equal_text_that_ends_no_script():
    def draw(panel):
        panel.plot([0.0, 1.0], [0.0, 2.0], label="</script><b>", **style.WITH)

    texts = {parts.numbers_json({"key": zoomed(draw)}) for _ in range(2)}
    assert len(texts) == 1
    assert "<" not in texts.pop()


def test_no_figure_has_no_numbers():
    assert parts.numbers_json({"key": ZoomFigure({})}) == '{"key":[]}'


def test_formulae_become_letters():
    assert plain(r"poles, k $f_m + \omega_d/2\pi$") == "poles, k f_m + ω_d/2π"
