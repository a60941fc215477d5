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
        (["--axis", "2", "--bus", "virtual:robot"], 2, "not a terminal"),
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


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        ([], 2, "--motion for a motion of the bench file"),
        (["--motion", "line-motion", "--axis", "2"], 2, "a line-motion takes no --axis"),
        (["--axis", "2", "--pace", "0.75"], 2, "--pace is for --motion line-motion"),
        (["--motion", "line-motion", "--pace", "1"], 2, "--pace 1 is the line's own"),
        (["--motion", "line-motion", "--pace", "0.1"], 2, "'0.1': expected at least 0.5"),
        (["--motion", "constant-acceleration"], 2, "needs one --axis"),
        (["--motion", "line-motion", "--probe-arcsec", "0"], 2, "probe-arcsec"),
        (["--motion", "line-motion", "--motor-inertia-kg-m2", "2.6e-4"], 2, "2=2.6e-4 for axis 2"),
        (["--motion", "line-motion", "--motor-inertia-kg-m2", "2=much"], 2, "is not an inertia"),
        (["--axis", "2", "--motor-inertia-kg-m2", "100"], 2, "expected an inertia from"),
        (["--axis", "2", "--motor-inertia-kg-m2", "1e-4", "--motor-inertia-kg-m2", "2=1e-4"], 2, "has two"),
        (["--motion", "line-motion"], 3, "the motor inertia of axis 5 is not known"),
    ],
)
def test_a_motion_and_its_axes_that_do_not_fit_are_refused(tmp_path: Path, options: list[str], status: int, words: str) -> None:
    code, output = learn("--bench", "reference", "--model", str(tmp_path / "m.toml"), "--out", str(tmp_path / "out"), *options)
    assert (code, words in " ".join(output.replace("│", " ").split())) == (status, True), output
    assert not (tmp_path / "m.toml").exists()
