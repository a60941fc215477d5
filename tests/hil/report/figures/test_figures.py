"""What can be said of a figure without eyes: labels, units, nothing that lies on something else."""

import itertools
import re

import numpy as np
import pytest
from matplotlib.text import Annotation, Text

from hil.report import style

pytestmark = pytest.mark.slow  # all figures drawn: half a minute; the page of the demo draws most of them in CI


@pytest.fixture(scope="module")
def figures(full_report):
    """All matplotlib figures of the full report by key, drawn."""
    _, drawn = full_report
    assert len(drawn) == 15
    return drawn


@pytest.mark.slow
def test_every_axis_is_named_with_its_unit(figures):
    for key, (figure, _) in figures.items():
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                shown = any(label.get_visible() and label.get_text() for label in axis.get_ticklabels())
                name = axis.get_label().get_text()
                assert not shown or re.search(r"\([^()]+\)$", name), f"{key}: {name!r}"


@pytest.mark.slow
def test_every_line_holds_finite_numbers(figures):
    for key, (figure, _) in figures.items():
        for axes in figure.axes:
            for line in axes.get_lines():
                assert np.isfinite(np.asarray(line.get_ydata(), dtype=float)).all(), key


def words(figure):
    """Every visible text with its box, tick labels left out."""
    ticks = {
        id(label) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels(which="both")
    }
    for text in figure.findobj(Text):
        if id(text) not in ticks and text.get_visible() and text.get_text().strip():
            # an annotation's own extent includes the point it belongs to
            extent = Text.get_window_extent(text) if isinstance(text, Annotation) else text.get_window_extent()
            if extent.width > 0:
                yield text.get_text(), extent


def test_no_text_lies_on_another_or_leaves_the_figure(figures):
    for key, (figure, _) in figures.items():
        found = list(words(figure))
        for (first, box), (second, other) in itertools.combinations(found, 2):
            apart = box.x1 <= other.x0 + 1 or other.x1 <= box.x0 + 1 or box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1
            assert apart, f"{key}: {first!r} lies on {second!r}"
        for text, box in found:
            assert box.x0 >= -1, f"{key}: {text!r}"
            assert box.x1 <= figure.bbox.width + 1, f"{key}: {text!r}"
            assert box.y0 >= -1, f"{key}: {text!r}"
            assert box.y1 <= figure.bbox.height + 1, f"{key}: {text!r}"


def test_legends_stand_outside_or_over_nothing(figures):
    for key, (figure, _) in figures.items():
        for axes in figure.axes:
            legend = axes.get_legend()
            if legend is None:
                continue
            box = legend.get_window_extent()
            for line in axes.get_lines():
                points = axes.transData.transform(np.column_stack(line.get_data()))
                inside = (points[:, 0] > box.x0) & (points[:, 0] < box.x1) & (points[:, 1] > box.y0) & (points[:, 1] < box.y1)
                assert not inside.any(), key


def test_lines_of_one_panel_differ_without_colour(figures):
    looks = ("MEASURED", "BROAD"), ("MODEL", "BROAD"), ("WITH", "WITHOUT"), ("LIMIT", "WITH"), ("CONSTRAINT", "WITHOUT")
    for first, second in looks:
        one, other = getattr(style, first), getattr(style, second)
        assert (one["linestyle"], one["linewidth"]) != (other["linestyle"], other["linewidth"])
    assert len({(str(line["linestyle"]), line["marker"]) for line in style.AXIS_LINES}) == len(style.AXIS_LINES)


def test_svg_is_inline_scalable_and_its_own(figures):
    for key, (_, svg) in figures.items():
        assert svg.startswith(f'<svg role="img" aria-labelledby="{key}-title" viewBox="')
        assert "metadata" not in svg
        assert "DOCTYPE" not in svg
        assert all(name.startswith(f"{key}-") for name in re.findall(r'\sid="([^"]*)"', svg))
        assert not re.search(r'd="[^"]*\d\.\d{3}', svg)


def test_style_leaves_nothing_behind():
    import matplotlib as mpl  # noqa: PLC0415

    before = mpl.rcParams["font.size"]
    with style.styled():
        assert mpl.rcParams["font.size"] == style.RC["font.size"]
    assert mpl.rcParams["font.size"] == before


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


@pytest.mark.parametrize("key", ["transmission-errors", "identification-2", "identification-3"])
def test_a_fit_shows_what_it_leaves(figures, key):
    figure, _ = figures[key]
    rests = [axes for axes in figure.axes if " − " in axes.get_title(loc="left")]
    assert len(rests) == 2
    for axes in rests:
        rms = float(re.search(r"rms (\S+) ", axes.get_title(loc="left"))[1])
        drawn = np.asarray(axes.get_lines()[-1].get_ydata(), dtype=float)
        assert rms == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=0.2)
        assert np.max(np.abs(drawn)) < 0.5 * max(np.max(np.abs(line.get_ydata())) for line in figure.axes[0].get_lines()[:1])


def test_the_speed_that_comes_closest_to_minus_one_is_marked(figures):
    figure, _ = figures["nyquist"]
    near = [axes for axes in figure.axes if "near −1" in axes.get_title(loc="left")]
    assert len(near) == 2
    for axes in near:
        assert re.search(r"worst at \d\.\d\d rev/s$", axes.get_title(loc="left"))
        lines = {line.get_label(): line for line in axes.get_lines()}
        worst, circle = lines["the worst speed"], lines["1/$M_s$ around −1"]
        radius = np.hypot(circle.get_xdata()[0] + 1.0, circle.get_ydata()[0])
        distances = [
            np.min(np.hypot(np.asarray(line.get_xdata()) + 1.0, line.get_ydata()))
            for line in axes.get_lines()
            if len(line.get_xdata()) > 400
        ]
        own = np.min(np.hypot(worst.get_xdata() + 1.0, worst.get_ydata()))
        assert own == pytest.approx(min(distances))
        assert own == pytest.approx(radius, rel=0.02)


def test_the_margins_show_what_is_asked(figures):
    figure, _ = figures["margins"]
    drawn = [
        [float(line.get_ydata()[0]) for line in axes.get_lines() if line.get_label() == "required of a design"]
        for axes in figure.axes
    ]
    assert drawn == [[1.7], [6.0], [35.0]]


def test_curves_of_the_families_can_be_told_apart(figures):
    figure, _ = figures["families"]
    for axes in figure.axes[2:4]:
        dots = [line for line in axes.get_lines() if line.get_marker() == "o"]
        assert len(dots) == 5
        assert len({line.get_color() for line in dots}) == 5
        assert min(line.get_zorder() for line in dots) > max(line.get_zorder() for line in axes.get_lines() if line not in dots)
