"""Page of a transmission error: the arm by both identifications, compared where both are at hand; the signal's figures."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.model import IdentifiedError
from hil.design.ate.model import Arm, Sensing
from hil.report import style
from hil.report.figures import ate
from hil.report.figures.ate import AteMaterial, DrawnPass
from hil.report.report_table import Mark
from hil.results.ate import AteResult, KnownArm
from hil.robot_tables import TransmissionErrorTable
from tests.hil.results.made import measured_bench, written

PART = IdentifiedError(
    values=TransmissionErrorTable(a2_arcsec=5.0, phi2_deg=222.0, a4_arcsec=3.0, phi4_deg=126.0),
    standard_error={"a2_arcsec": 0.02, "phi2_deg": 0.1, "arm_hz": 0.004, "damping": 0.0005},
    arm_hz=12.433,
    damping=0.0394,
)


def table(tmp_path, known):
    result = AteResult(bench=measured_bench(), axis=2, sensorless=False, known_before=known, sensing=Sensing(gain=0.7), ate=PART)
    return ate.arm_twice(AteMaterial(written(tmp_path, result), result))


def test_the_arm_is_compared_in_standard_errors_and_in_percent(tmp_path):
    known = KnownArm(source="the model file", start=Arm(12.449, 0.0387), resonance_error_hz=0.001, damping_error=0.0001)
    rows = table(tmp_path, known).rows
    assert rows[0] == [
        "f_a, arm on its gear",
        "Hz",
        "12.449 ± 0.001",
        "12.433 ± 0.004",
        "−0.13",
        "3.9",
        Mark(None, "does not explain it"),
    ]
    assert rows[1] == ["its damping ζ", "", "0.0387 ± 0.0001", "0.0394 ± 0.0005", "+1.81", "1.4", Mark(True, "explains it")]


def test_without_standard_errors_only_the_percent_are_said(tmp_path):
    rows = table(tmp_path, KnownArm(source="the model file", start=Arm(12.449, 0.0387))).rows
    assert [row[-2] for row in rows] == ["–", "–"]
    assert rows[0][-3] == "−0.13"


def test_an_arm_that_was_not_known_is_not_compared(tmp_path):
    assert table(tmp_path, KnownArm(source="nothing", start=None)) is None


@pytest.mark.parametrize(("is_paper", "panels"), [(True, 2), (False, 1)])
def test_the_waveform_shows_how_far_it_is_from_the_papers(is_paper, panels, monkeypatch):
    drawn = []
    monkeypatch.setattr(style, "to_svg", lambda figure, _, **options: drawn.append(figure) or "<svg/>")
    with style.styled():
        ate.waveform(2, PART, is_paper=is_paper)
    assert len(drawn[0].axes) == panels


class Material:
    """As much of the page's material as the figures of the signal take: a first pass to 6 rev/s, a second to 13."""

    axis, part, word, unit, signal_name, furthest = 2, PART, "emulated", "m/s²", "Tip acceleration", 1

    def __init__(self):
        self.passes = [self._drawn(6.0), self._drawn(13.0)]

    def _drawn(self, end_rps):
        time = np.arange(0.0, 2.0 * end_rps / 4.0, 0.002)
        direction = np.where(time < end_rps / 4.0, 1.0, -1.0)
        speed = 4.0 * (time % (end_rps / 4.0))
        angle = 2.0 * math.pi * np.cumsum(speed) * 0.002
        # order 2 is seven times order 4, which is drawn first
        tip = 0.1 * np.cos(4.0 * angle) + 0.7 * np.cos(2.0 * angle)
        return DrawnPass(time, speed, tip, 0.9 * tip, direction)


def figures(monkeypatch, draw, *arguments):
    drawn = []
    monkeypatch.setattr(style, "to_svg", lambda figure, _, **options: drawn.append(figure) or "<svg/>")
    with style.styled():
        made = draw(Material(), *arguments)
    return made, drawn[0].axes


def test_no_curve_of_a_row_leaves_its_panel(monkeypatch):
    _, panels = figures(monkeypatch, ate.windows, 1)
    spectra = [panel for panel in panels if panel.get_xlabel() == "Frequency (Hz)"]
    assert len(spectra) == 2
    for panel in spectra:
        low, high = panel.get_ylim()
        assert low == 0.0
        assert all(np.max(line.get_ydata()) < high for line in panel.lines)


def test_names_of_the_resonant_speeds_stand_above_the_curves_and_only_where_the_motor_was(monkeypatch):
    made, panels = figures(monkeypatch, ate.against_speed)
    assert "pass 2" in made.caption
    top = panels[0]
    names = [text for text in top.texts if "f_a" in text.get_text()]
    assert [name.get_text() for name in names] == ["$f_a$/4 = 3.11 rev/s", "$f_a$/2 = 6.22 rev/s"]
    low, high = top.get_ylim()
    curves = max(float(np.max(line.get_ydata())) for line in top.lines if line.get_label() in {"emulated", "model"})
    assert (curves - low) / (high - low) < 0.87  # a name is a tenth of the panel's height, and stands at its top


def test_the_pass_that_is_drawn_is_the_first_of_those_that_went_furthest(tmp_path):
    known = KnownArm(source="nothing", start=None)
    result = AteResult(bench=measured_bench(), axis=2, sensorless=False, known_before=known, sensing=Sensing(gain=0.7))
    material = AteMaterial(written(tmp_path, result), result)
    material.result = SimpleNamespace(passes=[SimpleNamespace(end_rps=end) for end in (9.5, 18.6, 18.6)])
    assert material.furthest == 1
