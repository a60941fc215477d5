"""Page of a transmission error: the arm by both identifications, compared where both are at hand."""

import pytest

from hil.bench.model import IdentifiedError
from hil.design.ate.model import Arm, Sensing
from hil.report import style
from hil.report.figures import ate
from hil.report.figures.ate import AteMaterial
from hil.report.tables.paper_runs import Mark
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
    return ate.arm_twice(AteMaterial(written(tmp_path, result)))


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
    monkeypatch.setattr(style, "to_svg", lambda figure, _: drawn.append(figure) or "<svg/>")
    with style.styled():
        ate.waveform(2, PART, is_paper=is_paper)
    assert len(drawn[0].axes) == panels
