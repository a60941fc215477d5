"""Page of a plant: numbers to their standard error's digit, in the tour's units, and every point of the friction explained."""

import math

import numpy as np
import pytest

from hil.design.estimation import EstimatedParameter
from hil.report import style
from hil.report.pages import plant
from hil.report.pages.page import typeset
from hil.report.pages.plant import verdict
from hil.report.report_table import value_and_error
from hil.results.plant import ExcitationPlan, FrictionCurve, PlantRequestEntry, PlantResult
from tests.hil.results.made import measured_bench


def made():
    """A result with slow turns at three speeds, the slow ones over less of the angle."""
    turns = [(speed * sign, arm) for speed, reach in ((0.5, 3), (1.0, 3), (2.0, 8)) for sign in (1, -1) for arm in range(reach)]
    speed, arm = (np.array(column, dtype=float) for column in zip(*turns, strict=True))
    friction = np.sign(speed) * (0.1 + 0.001 * 2.0 * math.pi * np.abs(speed))
    gravity = 0.3 * np.cos(np.radians(10.0 * arm))
    curve = FrictionCurve(
        residual_nm=0.0, arm_span_deg=80.0, speed_rad_s=tuple(2.0 * math.pi * speed), arm_angle_rad=tuple(np.radians(10.0 * arm)),
        torque_nm=tuple(friction + gravity), model_nm=tuple(friction + gravity), gravity_nm=tuple(gravity),
    )  # fmt: skip
    values = {
        "antiresonance_hz": (12.44932, 0.0012),
        "gear_stiffness_nm_rad": (48974.5, 43.2),
        "motor_inertia_kg_m2": (0.00026048, 7.3e-7),
        "motor_damping_nm_s_rad": (0.000671, 0.00008),
        "friction_coulomb_nm": (0.1, 0.0001),
        "friction_viscous_nm_s_rad": (0.001, 1e-5),
    }
    request = PlantRequestEntry(
        axis=2, amplitude_nm=None, low_hz=2.0, high_hz=50.0, bias_rps=2.0, periods=8, excitation="torque", shape="inertial",
        with_accelerometer=True,
    )  # fmt: skip
    plan = ExcitationPlan(
        excitation="torque", amplitude_nm=1.2, crest_factor=1.5, bias_rps=2.0, period_s=2.0, periods=8, travel_rev=(0.0, 20.0)
    )
    parameters = {name: EstimatedParameter(*pair) for name, pair in values.items()}
    return PlantResult(
        bench=measured_bench(), axis=2, request=request, plan=plan, parameters=parameters, misfit=1.0, friction=curve
    )


def test_the_headline_has_symbols_units_and_no_exponent():
    headline = verdict(made()).headline
    assert headline == "f_a = 12.449 ± 0.001 Hz, K_g = 48.97 ± 0.04 kN·m/rad"
    assert str(typeset(headline)).startswith("f<sub>a</sub> = ")


def test_numbers_end_where_their_standard_error_begins():
    rows = {row[0]: row[1:4] for row in plant.parameters(made()).rows}
    assert rows["J_m, motor"] == ["2.605", "0.007", "kg·cm²"]
    assert rows["D_m, motor"] == ["0.67", "0.08", "mN·m·s/rad"]


def test_no_relative_error_is_written_as_a_power_of_ten():
    result = made()
    poor = result.model_copy(update={"parameters": {**result.parameters, "torque_age_s": EstimatedParameter(27e-6, 90e-6)}})
    percents = {row[0]: row[-1] for row in plant.parameters(poor).rows}
    assert percents["Age of the reported torque"] == "> 100 %"
    assert percents["f_a, anti-resonance"] == "0.0096 %"
    assert percents["D_m, motor"] == "12 %"


@pytest.mark.parametrize(
    ("value", "error", "texts"),
    [
        (48.9745, 0.0432, ("48.97", "0.04")),
        (-0.00067115, 0.00008, ("−0.00067", "0.00008")),
        (12.5, 0.0, ("12.5", "0")),
        (1234.5, 96.0, ("1234", "96")),
        (1.0, 0.096, ("1.0", "0.1")),
        (math.nan, 1.0, ("–", "1")),
    ],
)
def test_value_and_error(value, error, texts):
    assert value_and_error(value, error) == texts


def test_every_point_and_line_of_the_friction_is_in_the_legend(monkeypatch):
    drawn = []
    monkeypatch.setattr(style, "to_svg", lambda figure, _, **options: drawn.append(figure) or "<svg/>")
    with style.styled():
        shown = plant.friction(made())
    (figure,) = drawn
    named = {text.get_text() for text in figure.legends[0].get_texts()}
    for axes in figure.axes:
        assert {line.get_label() for line in axes.get_lines()} <= named
        assert sum(len(line.get_xdata()) for line in axes.get_lines() if line.get_linestyle() == "None") == 28
    assert "0.5, 1 rev/s against 2 rev/s" in shown.caption
