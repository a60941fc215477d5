"""hil identify ate as a command: what it writes, what it says, and how it ends."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drive_profiles.cli.application import Tool, mount
from hil.bench.model import load_identified
from hil.cli import identify_ate as cli_identify_ate
from hil.experiments import measurement
from hil.experiments.ate.request import Goal
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

app = Tool("identify", "")
mount(app, cli_identify_ate)


def invoke(*words: str):
    return CliRunner().invoke(app, ["ate", "--bench", "reference", *words])


@pytest.fixture
def on_the_emulator(monkeypatch: pytest.MonkeyPatch) -> InProcessChannel:
    channel = InProcessChannel(World(load_robot("reference")))
    monkeypatch.setattr(measurement, "open_channel", lambda address: channel)
    return channel


@pytest.mark.slow
@pytest.mark.usefixtures("on_the_emulator")
def test_it_writes_the_model_file_and_a_report(tmp_path: Path) -> None:
    out, model = tmp_path / "out", tmp_path / "model.toml"
    found = invoke("--axis", "2", "--out", str(out), "--model", str(model), "--json")
    assert found.exit_code == 0, found.stderr
    assert json.loads(found.stdout)["ate"]["learnt_by"] == "identify"
    part = load_identified(model).axis[2].ate
    assert part is not None
    assert part.values.a2_arcsec == pytest.approx(5.0, rel=0.02)
    assert part.standard_error["phi2_deg"] < 0.5
    assert (out / "report.html").is_file()
    assert "pass 1 of at most 6: axis 2 to 10.00 rev/s at 4.00 rev/s² and back" in found.stderr
    assert "fit of all passes, with the arm simulated on its gear" in found.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("on_the_emulator", "without_pictures")
def test_a_goal_that_is_missed_is_said_and_ends_with_9(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    goal = Goal({2: 1e-6, 4: 1.0}, {2: 90.0, 4: 90.0})
    monkeypatch.setattr(Goal, "missed", lambda self, found, missed=Goal.missed: missed(goal, found))
    found = invoke("--axis", "3", "--out", str(tmp_path), "--sensorless", "--passes", "1")
    assert found.exit_code == 9
    assert "f_a, arm on its gear" in found.stdout, "with the motor held"
    assert "f_al" not in found.stdout, "the closed loop's resonance, which this command does not know"
    assert "sensorless: A_k has the relative error of J_l, which comes from the bench file" in found.stdout
    assert "note: A_2 has a standard error of" in found.stdout
    part = load_identified(tmp_path / "model.toml").axis[3].ate
    assert part is not None
    assert part.learnt_by == "sensorless"


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("--axis", "4"), 3, "has no axis 4; it has 2, 3, 5"),
        (("--axis", "2", "--acceleration-rps-s", "0"), 3, "must be above 0"),
        (("--axis", "2", "--passes", "0"), 3, "at least 1 is needed"),
        (("--axis", "2", "--bus", "nonsense"), 2, "nonsense"),
        (("--axis", "2", "--bus", "virtual:robot"), 2, "--yes to move without confirmation"),
    ],
)
def test_what_is_refused_before_anything_moves(words: tuple[str, ...], code: int, message: str) -> None:
    found = invoke(*words)
    assert found.exit_code == code
    assert message in found.stderr
