"""`hil run` on a served robot: what is judged, by whose numbers, and what the exit status says."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.bench.bench import REFERENCE
from hil.cli.main import app
from hil.report import style
from hil.tour import bench_without_model
from plant_emulator.pytest_plugin.target import ServedBus


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "to_svg", lambda figure, key, **options: "<svg></svg>")


def run(tmp_path: Path, hil_local_bus: ServedBus, text: str, treatment: str, *more: str) -> tuple[int, str, str]:
    """Exit status, output and headline of one run of axis 2."""
    bench, out = tmp_path / "bench.toml", tmp_path / f"out-{treatment}"
    bench.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, [
        "run", "constant-acceleration", "--axis", "2", "--treatment", treatment, "--bench", str(bench),
        "--bus", hil_local_bus.address, "--out", str(out), *more,
    ])  # fmt: skip
    assert (out / "result.json").is_file(), done.output
    return done.exit_code, done.output, (out / "report.html").read_text(encoding="utf-8").replace("&nbsp;", " ")


@pytest.mark.slow
def test_without_a_model_a_run_has_no_millimetre_and_says_what_is_missing(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    status, output, page = run(tmp_path, hil_local_bus, bench_without_model(), "notch")
    assert status == 9
    assert "not judged: axis 2 has no model" in output
    assert "Not judged" in page
    for entry in json.loads((tmp_path / "out-notch" / "result.json").read_text())["runs"]:
        assert (entry["tip_peak_mm"], entry["within_spec"]) == (None, None)
        assert entry["invalid"].startswith("axis 2 has no model, so f_al is not known")
        assert "f_al_hz" not in entry


@pytest.mark.slow
def test_without_a_model_a_ramp_on_which_nothing_acts_is_judged_by_its_own_resonance(
    tmp_path: Path, hil_local_bus: ServedBus
) -> None:
    status, output, page = run(tmp_path, hil_local_bus, bench_without_model(), "none")
    assert status == 0
    assert "from the run's own order" in output
    assert "from the run's own order" in page.replace("&#39;", "'")
    entries = json.loads((tmp_path / "out-none" / "result.json").read_text())["runs"]
    assert [entry["order"] for entry in entries] == [2, 4], "order 1 would meet it at 11.8 rev/s, the ramp ends at 10"
    assert "order 1 is not judged" in output
    for entry in entries:
        assert entry["f_al_source"] == "own"
        assert entry["f_al_hz"] == pytest.approx(11.84, rel=0.02)
        assert abs(entry["f_al_hz"] - 11.84) < 3.0 * entry["f_al_error_hz"]
    assert entries[0]["within_spec"] is False
    assert entries[0]["tip_peak_mm"] == pytest.approx(0.08, rel=0.15)
    assert 0.0 < entries[0]["noise_mm"] < 0.01
    assert entries[0]["order_mm"] == pytest.approx(0.06, rel=0.3)
    assert 0.0 < entries[0]["order_error_mm"] < 0.1 * entries[0]["order_mm"]


@pytest.mark.slow
def test_a_model_that_the_ramp_contradicts_judges_nothing(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    """By the stiffer model the tip would move less than asked: a wrong yes."""
    text = (
        REFERENCE.read_text(encoding="utf-8")
        .replace('reference = "paper"', "")
        .replace("stiffness_nm_rad = 48950.0", "stiffness_nm_rad = 120e3")
    )
    status, output, _ = run(tmp_path, hil_local_bus, text, "none")
    assert status == 9
    assert "the model says f_al = 18." in output
    assert "the ramp itself shows f_al 11." in output
    for entry in json.loads((tmp_path / "out-none" / "result.json").read_text())["runs"]:
        assert entry["within_spec"] is None
        assert "hil identify plant" in entry["invalid"]


@pytest.mark.slow
def test_another_robots_headline_is_its_own(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    text = REFERENCE.read_text(encoding="utf-8").replace('reference = "paper"', 'name_of_the_paper = ""', 1)
    text = "\n".join(line for line in text.splitlines() if "name_of_the_paper" not in line)
    status, output, page = run(tmp_path, hil_local_bus, text, "notch")
    result = json.loads((tmp_path / "out-notch" / "result.json").read_text())
    assert status == 0
    assert result["emulated"] is True
    assert output.count("emulated robot") == 1
    assert "paper" not in output
    assert result["paper"] == []
    assert "allowed ≤ 0.05 mm" in page
    assert "reproduces" not in page
    low, high = next(entry for entry in result["runs"] if entry["order"] == 2)["window_rps"]
    assert (low, high) == pytest.approx((0.76 * 5.92, 1.27 * 5.92), rel=1e-3)


@pytest.mark.slow
def test_a_tip_that_leaves_what_was_asked_ends_with_9(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    text = REFERENCE.read_text(encoding="utf-8").replace("tip_mm = 0.05 ", "tip_mm = 0.02 ")
    assert run(tmp_path, hil_local_bus, text, "notch")[0] == 9
    assert run(tmp_path, hil_local_bus, text, "none")[0] == 0, "nothing was to keep it"
