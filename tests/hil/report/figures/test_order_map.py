"""The order map of a ramp: the order that was put in is the one that stands out."""

import math

import numpy as np
import pytest

from hil.recording import Recording
from hil.report import style
from hil.report.figures.order_map import MarkedResonance, order_maps, ramp_map


def recording(order, top_rps=10.0, period_s=0.002):
    """A ramp up at 4 rev/s² and a hard stop after it; the tip rings at one order."""
    time = np.arange(0.0, top_rps / 4.0 + 0.2, period_s)
    speed = np.where(time < top_rps / 4.0, 4.0 * time, np.maximum(0.0, top_rps - 50.0 * (time - top_rps / 4.0)))
    angle = 2.0 * math.pi * np.cumsum(speed) * period_s
    tip = 0.3 * np.cos(order * angle)
    return Recording({"time_s": time, "axis2_position_rad": angle, "tip_z_m_s2": tip})


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0, 6.5])
def test_the_order_that_shakes_stands_out_at_its_height(order):
    found = ramp_map(recording(order), 2)
    strongest = found.orders[np.nanargmax(found.amplitude, axis=1)]
    assert np.all(np.abs(strongest - order) <= 0.1)
    assert np.nanmax(found.amplitude) == pytest.approx(0.3, rel=0.05)


def test_the_braking_after_the_ramp_is_left_out():
    assert ramp_map(recording(2.0), 2).speed_rps[-1] == pytest.approx(9.6, abs=0.3)
    assert np.all(ramp_map(recording(2.0), 2).direction == 1.0)


def test_a_quick_way_to_where_the_ramp_begins_is_no_part_of_it():
    """Back at 12 rev/s, faster than the ramp ever gets: the map is of the ramp, so that its crossings are in it."""
    ramp = recording(2.0)
    time = np.arange(0.0, 1.5, 0.002)
    back = -12.0 * np.clip(np.minimum(time, 1.4 - time) / 0.2, 0.0, 1.0)
    angle = 2.0 * math.pi * np.cumsum(back) * 0.002
    columns = {
        "time_s": np.arange(len(time) + len(ramp.time_s)) * 0.002,
        "axis2_position_rad": np.concatenate([angle, angle[-1] + ramp.axis(2, "position_rad")]),
        "tip_z_m_s2": np.concatenate([np.zeros(len(time)), ramp.columns["tip_z_m_s2"]]),
    }
    found, alone = ramp_map(Recording(columns), 2), ramp_map(ramp, 2)
    assert found.speed_rps[[0, -1]] == pytest.approx(alone.speed_rps[[0, -1]], abs=0.3)
    assert np.all(found.direction == 1.0)


def test_a_motor_that_hardly_turns_has_no_map():
    assert ramp_map(recording(2.0, top_rps=2.0), 2) is None


def test_a_ray_s_name_has_the_page_s_ground_below_it(monkeypatch):
    """It stands on the colours of its own order, light or dark."""
    drawn = []
    monkeypatch.setattr(style, "to_svg", lambda figure, _, **options: drawn.append(figure) or "<svg/>")
    with style.styled():
        order_maps("map", "Map", [("run", recording(2.0))], 2, MarkedResonance(12.0))
    names = [text for panel in drawn[0].axes for text in panel.texts if text.get_text().startswith("k = ")]
    assert [name.get_text() for name in names] == ["k = 1", "k = 2", "k = 4"]
    assert all(name.get_bbox_patch() is not None for name in names)


@pytest.mark.parametrize(("symbol", "printed"), [("f_al", "$f_{al}$"), ("f_a", "$f_{a}$")])
def test_a_resonance_stands_under_its_own_name(monkeypatch, symbol, printed):
    drawn = []
    monkeypatch.setattr(style, "to_svg", lambda figure, _, **options: drawn.append(figure) or "<svg/>")
    with style.styled():
        made = order_maps("map", "Map", [("run", recording(2.0))], 2, MarkedResonance(12.0, symbol))
    names = [text.get_text() for panel in drawn[0].axes for text in panel.texts]
    assert [name for name in names if name.startswith("$f")] == [printed, printed]
    assert f"k f_m = {symbol} = 12.00 Hz" in made.caption
