from dataclasses import asdict
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.application import Tool, mount
from hil.cli import identify as cli_identify
from hil.cli.identify_plant import _summary
from hil.design.estimation import EstimatedParameter
from hil.experiments.plant.motion import PlantRequest
from hil.results.plant import ExcitationPlan, PlantRequestEntry, PlantResult
from tests.hil.results.made import measured_bench

app = Tool("identify", "")
mount(app, cli_identify)


@app.callback()
def _root() -> None:
    """So that the group stays a group."""


def run(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["identify", "plant", *words])
    return result.exit_code, result.output


def test_help_names_every_option() -> None:
    code, text = run("--help")
    assert code == 0
    for option in ("--bench", "--axis", "--amplitude-nm", "--low-hz", "--high-hz", "--bias-rps", "--periods", "--excitation"):
        assert option in text


def test_an_axis_that_is_not_there_is_a_bad_request() -> None:
    code, text = run("--bench", "reference", "--axis", "4")
    assert code == 3
    assert "no axis 4" in text


def test_a_real_robot_does_not_move_unasked(tmp_path: Path) -> None:
    code, text = run("--bench", "reference", "--axis", "2", "--bus", "virtual:robot", "--out", str(tmp_path / "out"))
    assert code == 2
    assert "excited at 1.5 … 90 Hz" in text
    assert "--yes" in text
    assert not (tmp_path / "out").exists()


def test_without_a_bus_it_says_so(tmp_path: Path) -> None:
    code, _ = run("--bench", "reference", "--axis", "2", "--bus", f"local:{tmp_path}/none.sock", "--out", str(tmp_path / "out"))
    assert code == 4


def test_the_summary_gives_every_number_with_its_error(capsys: pytest.CaptureFixture[str]) -> None:
    plan = ExcitationPlan(
        excitation="torque", amplitude_nm=1.2, crest_factor=1.5, bias_rps=2.1, period_s=2.0, periods=10, travel_rev=(-1.0, 1.0)
    )
    number = EstimatedParameter(48950.0, 38.0)
    request = PlantRequestEntry(**asdict(PlantRequest(2)))
    _summary(
        PlantResult(
            bench=measured_bench(),
            axis=2,
            request=request,
            plan=plan,
            parameters={"gear_stiffness_nm_rad": number, "antiresonance_hz": EstimatedParameter(12.4331, 0.0042)},
            misfit=1.0,
            remarks=("r",),
            cannot_tell=("c",),
        )
    )
    text = capsys.readouterr().out
    assert "K_g, gear" in text
    assert "K_g = 48.95 ± 0.04 kN·m/rad" in text
    assert "r\n" in text.splitlines(keepends=True)
    assert "cannot tell: c" in text
