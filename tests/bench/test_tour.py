"""The demo's second part: a robot of which nothing is known, identified, designed for, uploaded to, and run side by side."""

import json
from pathlib import Path
from typing import Any

import pytest

from drive_profiles.device.bus import SdoBus
from drive_profiles.device.target import device_at
from hil import tour
from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, update_designs
from hil.cli.demo import ROBOT_SEED
from hil.design.notch_design import NotchVerdict, PeakRow, RequirementCheck
from hil.design.notch_search import Effort
from hil.emulator import draw_robot
from hil.errors import NotPossibleError
from hil.experiments.notch_design import NotchDesignOutcome, parameter_set
from hil.experiments.notch_problem import NotchDesignRequest
from hil.report.writer import write_report_of
from hil.reporter import SILENT
from plant_emulator.pytest_plugin.target import ServedBus
from plant_emulator.robots.robot import load_robot
from tests.bench.shared_demo import DemoRun


def test_the_bench_of_the_tour_knows_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(tour.bench_without_model())
    found, reference = load_bench(path), load_bench("reference")
    assert (found.name, found.is_paper, reference.is_paper) == ("own-robot", False, True)
    for number, table in found.axis.items():
        assert table.model is None
        assert table.model_copy(update={"model": reference.axis[number].model}) == reference.axis[number]


def test_a_tour_without_a_robot_says_where_it_ended(tmp_path: Path) -> None:
    done = tour.run("local:/nowhere/robot.sock", tmp_path)
    assert done.failure is not None
    assert done.comparison is None
    kept = json.loads((tmp_path / "result.json").read_text())
    assert kept["tour"]["failure"] == str(done.failure)
    assert [step["holds"] for step in kept["tour"]["steps"]] == [False]
    assert "The comparison is not complete" in write_report_of(tmp_path).read_text()


def test_a_step_that_is_refused_is_linked_to_the_report_that_it_left(tmp_path: Path) -> None:
    runner = tour._TourRunner(load_bench("reference"), tmp_path, (2,), Effort.quick(), SILENT)

    def refused() -> tuple[str, str]:
        (tmp_path / "page.html").touch()
        raise NotPossibleError("no such arm")

    for name in ("page.html", "none.html"):
        with pytest.raises(NotPossibleError):
            runner.step("look", refused, name)
    assert [(step.link, step.holds, step.what) for step in runner.steps] == [
        ("page.html", False, "no such arm"),
        ("", False, "no such arm"),
    ]


@pytest.mark.ci
def test_a_drawn_robots_tour_begins_with_its_blank_bench_and_ends_with_its_truth(tmp_path: Path) -> None:
    """Here nothing is served: the first step fails, and what the robot was is told all the same."""
    robot = draw_robot(3, tmp_path / "drawn")
    done = tour.run("local:/nowhere/robot.sock", tmp_path / "out", robot=robot)
    assert done.failure is not None
    bench = load_bench(tmp_path / "out" / "bench.toml")
    assert bench.name == "fleet-real-3"
    assert all(axis.model is None for axis in bench.axis.values())
    part = json.loads((tmp_path / "out" / "result.json").read_text())["tour"]
    assert part["seed"] == 3
    facts = {fact["symbol"]: fact for fact in part["facts"]}
    truth = load_robot(robot.robot_file).axis[2]
    assert facts["A_2"]["truth"] == truth.ate.a2_arcsec
    assert facts["K_g"]["truth"] == pytest.approx(1e-3 * truth.gear_stiffness_nm_rad)
    assert "estimate" not in facts["K_g"]
    page = write_report_of(tmp_path / "out").read_text()
    assert "Truth and estimate" in page
    assert "bench “fleet-real-3”" in page, "no robot was run, and its bench has a name all the same"


@pytest.mark.ci
def test_a_robot_that_is_not_drawn_says_why(tmp_path: Path) -> None:
    draw_robot(3, tmp_path)
    with pytest.raises(NotPossibleError, match="already exist"):
        draw_robot(3, tmp_path)


def verdict(peak_mm: float, m_s: float) -> NotchVerdict:
    """A filter with a predicted peak, that misses the tip's limit, and M_s of at most 1.7 too where it is larger."""
    checks = (
        RequirementCheck("M_s", m_s, 1.7, "", True, 5.0, "believed"),
        RequirementCheck("tip peak", peak_mm, 0.05, "mm", True, None, "believed", is_tip_limit=True),
    )
    return NotchVerdict((), checks, {}, (PeakRow(2.0, peak_mm, peak_mm, peak_mm, "believed"),))


@pytest.mark.parametrize(
    ("given", "kept_mm", "said"),
    [
        (verdict(0.066, 1.5), 0.066, "the bench file's notch is kept"),
        (verdict(0.066, 1.9), 0.084, "the bench file's notch is not used: 0.066 mm, but it misses M_s 1.9"),
        (verdict(0.090, 1.5), 0.084, "the bench file's notch: 0.090 mm"),
        (None, 0.084, ""),
    ],
)
def test_the_tour_takes_the_better_filter_or_says_why_not(given: NotchVerdict | None, kept_mm: float, said: str) -> None:
    unused: Any = None
    request, designed = NotchDesignRequest(axis=2), verdict(0.084, 1.6)
    outcome = NotchDesignOutcome(unused, "", request, unused, 11.8, unused, given, designed, None, 0.0)
    kept, words = tour.better_of(outcome)
    assert kept.best.peaks[0].rising_mm == kept_mm
    assert said in words


class _Verdict:
    """As much of a designed filter as a parameter set takes."""

    def __init__(self, notches: tuple[Any, ...]) -> None:
        self.notches = notches


def prepared(hil_local_bus: ServedBus, out: Path, monkeypatch: pytest.MonkeyPatch) -> tour._TourRunner:
    """Everything that comes before the upload, by hand."""
    (out / "bench.toml").write_text(tour.bench_without_model())
    bench = load_bench(out / "bench.toml")
    bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": hil_local_bus.address})})
    runner = tour._TourRunner(bench, out, (2, 3), Effort.quick(), SILENT)
    monkeypatch.setattr("hil.experiments.notch_design.summary", lambda found: "by hand")
    for axis in (2, 3):
        notch = bench.axis[axis].notch[0].model_copy(update={"zeta_rn": 0.05})
        designed = DesignedAxis(notch=(notch,), sensitivity_peak=1.5, phase_margin_deg=40.0, gain_margin_db=9.0, period_s=250e-6)
        update_designs(runner.design, bench.name, axis, designed)
        made = parameter_set(bench, axis, _Verdict((notch.notch(),)), 11.8)  # type: ignore[arg-type]
        made.save(runner.parameter_set(axis), force=True)
    return runner


@pytest.mark.ci
def test_what_is_uploaded_is_in_the_drives_and_found_there_again(
    hil_local_bus: ServedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = prepared(hil_local_bus, tmp_path, monkeypatch)
    what, _ = runner.upload()
    assert what.count("read back, stored") == 2
    with SdoBus(hil_local_bus.address) as bus:
        for axis in (2, 3):
            device = device_at(bus, axis, "emulated_drive")
            entry = device.catalogue.find("notch_1.zeta_rn", whole=True)
            assert entry.decoded(device.read(entry.address), device.scaling([entry])) == pytest.approx(0.05)
    assert runner.upload()[0].count("nothing to write") == 2
    assert "holds the uploaded value" in runner.read_back()[0]
    assert len(list((tmp_path / "drive-journals").iterdir())) == 2


@pytest.mark.ci
def test_a_set_that_is_not_the_design_is_not_uploaded(
    hil_local_bus: ServedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = prepared(hil_local_bus, tmp_path, monkeypatch)
    path = runner.parameter_set(3)
    path.write_text(path.read_text().replace("value = 0.05", "value = 0.06"))
    with pytest.raises(tour.NotPossibleError, match=r"axis 3: notch_1\.zeta_rn differs between"):
        runner.upload()
    assert not (tmp_path / "drive-journals").exists()


@pytest.mark.ci
def test_the_whole_demo_ends_with_the_tour_and_a_whole_arm(whole_demo_run: DemoRun) -> None:
    out = whole_demo_run.out
    told = json.loads((out / "tour" / "result.json").read_text())
    assert told["tour"]["failure"] is None
    assert told["emulated"] is True
    names = [step["name"] for step in told["tour"]["steps"]]
    assert names[:3] == ["identify plant, axis 2", "identify transmission error, axis 2", "design notch, axis 2"]
    for step in told["tour"]["steps"]:
        assert not step["link"] or (out / "tour" / step["link"]).is_file()
    (robot,) = told["robots"]
    assert robot["name"] == f"fleet-real-{ROBOT_SEED}"
    peaks = {row["treatment"]: row["tip_peak_mm"] for row in robot["rows"]}
    assert {"none", "notch", "cancellation"} <= set(peaks)
    assert peaks["cancellation"] < 0.5 * peaks["none"]
    assert all(row["trial"] in {"accepted", "accepted in part"} for row in robot["rows"] if row["treatment"] == "cancellation")
    facts = {fact["symbol"]: fact for fact in told["tour"]["facts"]}
    assert {"f_a", "J_m", "A_1", "A_2", "A_4"} <= set(facts)
    assert facts["A_2"]["estimate"] == pytest.approx(facts["A_2"]["truth"], rel=0.25)
    assert told["tour"]["seed"] == ROBOT_SEED
    assert (out / "tour" / "robot.toml").is_file()
    page = (out / "report.html").read_text().replace("&nbsp;", " ")
    assert "Your own robot" in page
    assert "tour/report.html" in page
    own = (out / "tour" / "report.html").read_text().replace("&nbsp;", " ")
    assert own.index("Emulated robot") < own.index("<h1>")
    assert "Truth and estimate" in own
    assert "Paper</th>" not in (out / "tour" / "identify-ate-axis2" / "report.html").read_text()
    assert json.loads((out / "result.json").read_text())["paper"]
    arm = json.loads((out / "arm" / "result.json").read_text())
    assert arm["tour"]["failure"] is None
    assert arm["emulated"] is True
    assert [step["holds"] for step in arm["tour"]["steps"]] == [True, True]
    claims = {claim["claim"]: claim for claim in arm["tour"]["claims"]}
    assert all(claim["found"] is not None for claim in claims.values())
    assert claims["no treatment: the tip exceeds ±0.05 mm"]["found"] > 0.07
    assert claims["learnt: within ±0.05 mm in the worst direction"]["found"] < 0.25 * 0.07
    assert claims["learnt: the goal along x, y and z"]["found"] <= 0.010
    assert 'id="whole-arm-table"' in page
    assert "arm/report.html" in page
    assert 'id="whole-arm-line"' in page
    for key in ("arm-line-reference-arm", "arm-resonances-reference-arm", "tour-claims"):
        assert f'id="{key}"' in (out / "arm" / "report.html").read_text()
    claim = next(line for line in whole_demo_run.stderr.splitlines() if "learnt: within ±0.05 mm along x" in line)
    assert claim.split()[-1] == "yes", "standard output is the result's"
