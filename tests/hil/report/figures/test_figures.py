"""What can be said of a figure without eyes: labels, units, nothing that lies on something else."""

import itertools
import re

import numpy as np
import pytest
from matplotlib.text import Annotation, Text

from hil.report import style


@pytest.fixture(scope="module")
def figures(full_report):
    """All matplotlib figures of the full report by key, drawn."""
    _, drawn = full_report
    assert len(drawn) == 15
    return drawn


def test_every_axis_is_named_with_its_unit(figures):
    for key, (figure, _) in figures.items():
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                shown = any(label.get_visible() and label.get_text() for label in axis.get_ticklabels())
                name = axis.get_label().get_text()
                assert not shown or re.search(r"\([^()]+\)$", name), f"{key}: {name!r}"


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
