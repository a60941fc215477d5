"""`hil run` on a served robot: what is judged, by whose numbers, and what the exit status says."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.bench.bench import REFERENCE
from hil.cli.main import app
from hil.report import style
from hil.story import bench_without_model
from plant_emulator.pytest_plugin.served import ServedBus

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "to_svg", lambda figure, key: "<svg></svg>")


def run(tmp_path: Path, local_bus: ServedBus, text: str, treatment: str, *more: str) -> tuple[int, str, str]:
    """Exit status, output and headline of one run of axis 2."""
    bench, out = tmp_path / "bench.toml", tmp_path / f"out-{treatment}"
    bench.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, [
        "run", "constant-acceleration", "--axis", "2", "--treatment", treatment, "--bench", str(bench),
        "--bus", local_bus.address, "--out", str(out), *more,
    ])  # fmt: skip
    assert (out / "result.json").is_file(), done.output
    return done.exit_code, done.output, (out / "report.html").read_text(encoding="utf-8")


def test_without_a_model_a_run_has_no_millimetre_and_says_what_is_missing(tmp_path: Path, local_bus: ServedBus) -> None:
    """A verdict is asked where something acts: 9; a robot that is only looked at: 0."""
    status, output, page = run(tmp_path, local_bus, bench_without_model(), "notch")
    assert status == 9
    assert "not judged: axis 2 has no model" in output
    assert "Not judged" in page
    for entry in json.loads((tmp_path / "out-notch" / "result.json").read_text())["runs"]:
        assert (entry["tip_peak_mm"], entry["within_spec"]) == (None, None)
        assert entry["invalid"].startswith("axis 2 has no model, so f_al is not known")
        assert "f_al_hz" not in entry
    assert run(tmp_path, local_bus, bench_without_model(), "none")[0] == 0


def test_another_robots_headline_is_its_own(tmp_path: Path, local_bus: ServedBus) -> None:
    text = REFERENCE.read_text(encoding="utf-8").replace('reference = "paper"', 'name_of_the_paper = ""', 1)
    text = "\n".join(line for line in text.splitlines() if "name_of_the_paper" not in line)
    status, output, page = run(tmp_path, local_bus, text, "notch")
    result = json.loads((tmp_path / "out-notch" / "result.json").read_text())
    assert status == 0
    assert result["emulated"] is True
    assert output.count("emulated robot") == 1
    assert "paper" not in output
    assert result["paper"] == []
    assert "asked ≤ 0.05 mm" in page
    assert "reproduces" not in page
    low, high = next(entry for entry in result["runs"] if entry["order"] == 2)["window_rps"]
    assert (low, high) == pytest.approx((0.76 * 5.92, 1.27 * 5.92), rel=1e-3)


def test_a_tip_that_leaves_what_was_asked_ends_with_9(tmp_path: Path, local_bus: ServedBus) -> None:
    text = REFERENCE.read_text(encoding="utf-8").replace("tip_mm = 0.05 ", "tip_mm = 0.02 ")
    assert run(tmp_path, local_bus, text, "notch")[0] == 9
    assert run(tmp_path, local_bus, text, "none")[0] == 0, "nothing was to keep it"
