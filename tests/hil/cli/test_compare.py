"""hil compare: what it refuses, what it asks, and a small comparison over CAN."""

import json

import pytest
from typer.testing import CliRunner

from drive_profiles.address import parse_address
from hil.bench.bench import REFERENCE
from hil.cli import compare as cli_compare
from hil.cli.main import app


def run(*arguments, **options):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)], **options)


@pytest.fixture
def short(tmp_path):
    """A bench whose ramp takes half a second."""
    path = tmp_path / "bench.toml"
    path.write_text(REFERENCE.read_text().replace("acceleration_rps_s = 4.0", "acceleration_rps_s = 16.0"))
    return path


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--experiment", "waltz"), 2, "expected constant-acceleration or line-motion"),
        (("--experiment", "line-motion", "--axis", 2), 2, "--axis is for constant-acceleration"),
        (("--treatment", "notch,magic"), 2, "--treatment magic"),
        (("--treatment", "none"), 2, "expected a second --treatment"),
        (("--bench", "reference", "--bus", "local:/nowhere"), 2, "--bus is for one robot"),
        (("--emulate", "reference", "--bus", "local:/nowhere"), 2, "leave --bus out"),
        (("--emulate", "reference", "--emulate", "reference"), 2, "2 times --emulate for 1 bench files"),
        (("--model", "/nowhere/model.toml"), 3, "model.toml"),
        (("--bus", "local:/nowhere/robot.sock"), 4, "/nowhere/robot.sock"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(tmp_path, arguments, code, said):
    found = run("--bench", "reference", "--out", tmp_path / "out", *arguments)
    assert found.exit_code == code, found.output
    assert said in found.stderr
    assert not (tmp_path / "out").exists()


def test_names_with_commas_and_again_are_the_same():
    once, twice = (
        cli_compare._request([], [], ["notch, cancellation"]),
        cli_compare._request([], [], ["cancellation", "notch"]),
    )
    assert once == twice
    assert once.treatments == ("notch", "cancellation")
    assert once.named == {"notch", "cancellation"}
    assert cli_compare._request([], [], []).named == frozenset()


def test_a_real_robot_is_asked_for_once_for_all_motions(monkeypatch, tmp_path):
    from hil.experiments.comparison import plan  # noqa: PLC0415

    class Silent:
        address = parse_address("socketcan:can7")

        def close(self):
            """Nothing is open."""

    monkeypatch.setattr(plan, "open_channel", lambda address: Silent())
    found = run(
        "--bench", "reference", "--bus", "socketcan:can7", "--treatment", "none,notch,low-gains", "--out", tmp_path / "out"
    )
    assert found.exit_code == 2
    assert found.stderr.count("This moves") == 3  # two axes and the line, each treatment the same
    assert "9 runs" in found.stderr
    assert "not a terminal" in found.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_a_small_comparison_over_can(hil_local_bus, short, tmp_path):
    out = tmp_path / "out"
    ways = "low-gains,cancellation,cancellation-learnt"
    found = run("--bench", short, "--bus", hil_local_bus.address, "--experiment", "constant-acceleration", "--axis", 3,
                "--treatment", ways, "--out", out, "--json")  # fmt: skip
    assert found.exit_code == 9, found.output  # it was asked for, and nothing has been learnt
    result = json.loads(found.stdout)
    assert result == json.loads((out / "result.json").read_text())
    rows = {row["treatment"]: row for row in result["robots"][0]["rows"]}
    assert rows["cancellation"]["trial"] == "accepted"
    assert rows["cancellation"]["tip_peak_mm"] < 0.5 * rows["none"]["tip_peak_mm"]
    assert "--learnt" in rows["cancellation-learnt"]["left_out"]
    assert "not compared: reference, axis 3, cancellation-learnt" in found.stderr
    assert (out / "reference" / rows["cancellation"]["recording"]).is_file()
    page = (out / "report.html").read_text().replace("&nbsp;", " ")
    assert 'id="table-constant-acceleration-axis3"' in page
    (out / "report.html").unlink()
    again = CliRunner().invoke(app, ["report", str(out)])
    assert again.exit_code == 0, again.output
    assert (out / "report.html").read_text().replace("&nbsp;", " ") == page
