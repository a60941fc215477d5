"""hil learn: what is asked wrongly is said before anything moves."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.main import app


def learn(*options: str) -> tuple[int, str]:
    found = CliRunner().invoke(app, ["learn", *options])
    return found.exit_code, found.output


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--axis", "2", "--passes", "1"], 2, "passes"),
        (["--axis", "2", "--acceleration-rps-s", "0"], 2, "acceleration"),
        (["--axis", "2", "--bus", "socketcan:can9"], 2, "nobody can be asked here"),
        (["--axis", "2", "--bus", "local:/nowhere.sock"], 4, "no bus at local:/nowhere.sock"),
        (["--axis", "2", "--bus", "nonsense"], 2, "nonsense"),
    ],
)
def test_what_cannot_be_is_refused_with_its_reason(tmp_path: Path, options: list[str], status: int, words: str) -> None:
    code, output = learn("--bench", "reference", "--model", str(tmp_path / "m.toml"), "--out", str(tmp_path / "out"), *options)
    assert (code, words in output) == (status, True), output
    assert not (tmp_path / "m.toml").exists()


def test_a_model_file_of_another_robot_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text('robot = "other"\n', encoding="utf-8")
    code, output = learn("--bench", "reference", "--axis", "2", "--model", str(path), "--out", str(tmp_path / "out"))
    assert code == 3, output
    assert "'other'" in output
    assert path.read_text(encoding="utf-8") == 'robot = "other"\n'
