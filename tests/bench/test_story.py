"""The demo's second part: a robot of which nothing is known, identified, designed for, uploaded to, and run side by side."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drive_profiles.device.bus import SdoBus
from drive_profiles.device.target import device_at
from hil import story
from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, update_designs
from hil.design.notch_search import Effort
from hil.experiments.notch_design import parameter_set
from hil.report.pages.compare import write_compare_report
from hil.reporter import SILENT
from plant_emulator.pytest_plugin.served import ServedBus


def test_the_bench_of_the_story_knows_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(story.bench_without_model())
    found, reference = load_bench(path), load_bench("reference")
    assert (found.name, found.is_paper, reference.is_paper) == ("own-robot", False, True)
    for number, table in found.axis.items():
        assert table.model is None
        assert table.model_copy(update={"model": reference.axis[number].model}) == reference.axis[number]


def test_a_story_without_a_robot_says_where_it_ended(tmp_path: Path) -> None:
    done = story.tell("local:/nowhere/robot.sock", tmp_path)
    assert done.failure is not None
    assert done.comparison is None
    kept = json.loads((tmp_path / "result.json").read_text())
    assert kept["story"]["failure"] == str(done.failure)
    assert [step["holds"] for step in kept["story"]["steps"]] == [False]
    assert "The comparison is not complete" in write_compare_report(tmp_path).read_text()


class _Verdict:
    """As much of a designed filter as a parameter set takes."""

    def __init__(self, notches: tuple[Any, ...]) -> None:
        self.notches = notches


def prepared(local_bus: ServedBus, out: Path, monkeypatch: pytest.MonkeyPatch) -> story._Teller:
    """Everything that comes before the upload, by hand."""
    (out / "bench.toml").write_text(story.bench_without_model())
    bench = load_bench(out / "bench.toml")
    bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": local_bus.address})})
    teller = story._Teller(bench, out, (2, 3), Effort.quick(), SILENT)
    monkeypatch.setattr("hil.experiments.notch_design.summary", lambda found: "by hand")
    for axis in (2, 3):
        notch = bench.axis[axis].notch[0].model_copy(update={"zeta_rn": 0.05})
        designed = DesignedAxis(notch=(notch,), sensitivity_peak=1.5, phase_margin_deg=40.0, gain_margin_db=9.0, period_s=250e-6)
        update_designs(teller.design, bench.name, axis, designed)
        made = parameter_set(bench, axis, _Verdict((notch.notch(),)), 11.8)  # type: ignore[arg-type]
        made.save(teller.parameter_set(axis), force=True)
    return teller


def test_what_is_uploaded_is_in_the_drives_and_found_there_again(
    local_bus: ServedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    teller = prepared(local_bus, tmp_path, monkeypatch)
    what, _ = teller.upload()
    assert what.count("read back, stored") == 2
    with SdoBus(local_bus.address) as bus:
        for axis in (2, 3):
            device = device_at(bus, axis, "emulated_drive")
            entry = device.catalogue.find("notch_1.zeta_rn", whole=True)
            assert entry.decoded(device.read(entry.address), device.scaling([entry])) == pytest.approx(0.05)
    assert teller.upload()[0].count("nothing to write") == 2
    assert "as uploaded" in teller.still_there()[0]
    assert len(list((tmp_path / "drive-journals").iterdir())) == 2


def test_a_set_that_is_not_the_design_is_not_uploaded(
    local_bus: ServedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    teller = prepared(local_bus, tmp_path, monkeypatch)
    path = teller.parameter_set(3)
    path.write_text(path.read_text().replace("value = 0.05", "value = 0.06"))
    with pytest.raises(story.NotPossibleError, match=r"axis 3: notch_1\.zeta_rn is not the same"):
        teller.upload()
    assert not (tmp_path / "drive-journals").exists()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_whole_demo_ends_with_the_story(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    done = subprocess.run(
        [sys.executable, "-m", "hil", "demo", "--out", str(out)], capture_output=True, text=True, timeout=580, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads((out / "story" / "result.json").read_text())
    assert told["story"]["failure"] is None
    assert told["emulated"] is True
    names = [step["name"] for step in told["story"]["steps"]]
    assert names[-4:] == ["design notch, axis 3", "upload, read back, store", "run side by side", "read back after the runs"]
    assert all(step["holds"] for step in told["story"]["steps"])
    for step in told["story"]["steps"]:
        assert (out / "story" / step["link"]).is_file()
    (robot,) = told["robots"]
    peaks = {(row["axis"], row["treatment"]): row["tip_peak_mm"] for row in robot["rows"]}
    assert set(peaks) == {(axis, name) for axis in (2, 3, None) for name in story.TREATMENTS}
    for axis in (2, 3, None):
        assert peaks[axis, "cancellation"] < 0.01
        assert peaks[axis, "cancellation"] < peaks[axis, "notch"] < peaks[axis, "none"]
    for axis in (2, 3):
        assert peaks[axis, "notch-designed"] < peaks[axis, "notch"] < 0.05 < peaks[axis, "none"]
    assert all(row["trial"] == "accepted" for row in robot["rows"] if row["treatment"] == "cancellation")
    page = (out / "report.html").read_text()
    assert "Your own robot" in page
    assert "story/report.html" in page
    own = (out / "story" / "report.html").read_text()
    assert own.index("Emulated robot") < own.index("<h1>")
    assert "This rests on an emulated robot" in (out / "story" / "design-axis2" / "design.html").read_text()
    assert "Paper</th>" not in (out / "story" / "identify-ate-axis2" / "report.html").read_text()
    assert json.loads((out / "result.json").read_text())["paper"]
