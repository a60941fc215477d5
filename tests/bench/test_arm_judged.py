"""A line on a bench with an arm is judged along x, y, z and the worst direction: result.json and the report have them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from drive_profiles.errors import FileError
from hil.bench.bench import REFERENCE, Bench, load_bench
from hil.bench.model import Identified, IdentifiedArm
from hil.experiments.comparison.plan import ComparisonRequest, KnownRobot, plan
from hil.experiments.comparison.run import request_entry
from hil.experiments.comparison.table import gathered
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION, line_motion
from hil.experiments.plan import Experiment, entries
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog, Recording
from hil.report.writer import write_report_of
from hil.results.comparison import ComparisonResult
from hil.results.files import load_result
from hil.results.runs import ExperimentsResult
from hil.tip_vector import displacement_mm, tip_acceleration
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.physics.articulated import POSITION
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World
from tests.hil.arm.reference import bench_with_arm


@pytest.mark.slow
def test_the_worst_direction_of_a_line_decides_and_all_directions_are_told(quiet_robot: Robot, tmp_path: Path) -> None:
    bench, out = bench_with_arm(tmp_path), tmp_path / "run"
    outcome = run_experiments(
        bench,
        [Experiment(LINE_MOTION, None, each) for each in ("none", "notch")],
        out,
        channel=InProcessChannel(World(quiet_robot)),
    )
    assert outcome.failure is None
    entries = json.loads((out / "result.json").read_text())["runs"]
    for entry in entries:
        found = entry["directions"]
        assert set(found) == {"x", "y", "z", "worst"}
        worst = found["worst"]
        assert entry["tip_peak_mm"] == worst["tip_peak_mm"] >= max(found[name]["tip_peak_mm"] for name in "xyz")
        assert entry["spectrum_area"] == worst["spectrum_area"]
        assert found["y"]["tip_peak_mm"] < 1e-3 < found["x"]["tip_peak_mm"]  # a planar arm, and the tip's x is not still
        assert math.isclose(sum(part**2 for part in worst["unit"]), 1.0, rel_tol=1e-9)
    assert entries[1]["tip_peak_mm"] < 0.8 * entries[0]["tip_peak_mm"]  # the notch, by the vector


def test_a_bench_without_an_arm_is_judged_as_before(reference_bench, quiet_robot: Robot, tmp_path: Path) -> None:
    outcome = run_experiments(
        reference_bench, [Experiment(LINE_MOTION, None, "none")], tmp_path, channel=InProcessChannel(World(quiet_robot))
    )
    assert outcome.failure is None
    entry = json.loads((tmp_path / "result.json").read_text())["runs"][0]
    assert "directions" not in entry
    assert "noise_mm" not in entry


@pytest.mark.ci
def test_an_arm_of_which_nothing_is_known_is_judged_in_the_band_that_its_bench_gives(tmp_path: Path) -> None:
    bench = load_bench("reference-arm")
    assert {axis.model for axis in bench.axis.values()} == {None}
    channel = InProcessChannel(World(load_robot("reference-arm")))
    outcome = run_experiments(bench, [Experiment(LINE_MOTION, None, "none")], tmp_path, channel=channel)
    [entry] = outcome.result.runs
    assert entry.invalid is None
    assert entry.within_spec is False
    assert entry.band_hz == (6.0, 25.0)
    assert (entry.f_al_hz, entry.f_al_source, entry.f_al_words) == (None, None, "band 6 to 25 Hz, from the bench file")
    assert entry.directions is not None
    peaks = {name: each.tip_peak_mm or 0.0 for name, each in entry.directions.items()}
    # its own lowest modes, 8.7 to 14.7 Hz on this line; what the same motion shows without any transmission error is 0.005 mm
    assert 0.055 < peaks["x"] < 0.075
    assert 0.05 < peaks["z"] < 0.07
    assert peaks["y"] < 0.005
    unknown = bench.model_copy(update={"specification": bench.specification.model_copy(update={"band_hz": None})})
    [without] = entries(unknown, Experiment(LINE_MOTION, None, "none"), last_result(unknown, tmp_path), "line.csv")
    assert without.tip_peak_mm is None
    assert "so f_al is not known" in (without.invalid or "")
    assert without.directions is not None  # areas, which need no f_al


@pytest.mark.ci
def test_masses_of_the_model_file_are_kept_beside_the_runs_for_the_modes_of_the_report(tmp_path: Path) -> None:
    robot, bench = load_robot("reference-arm"), load_bench("reference-arm")
    known = IdentifiedArm(
        axes=(2, 3, 5), joints_deg=robot.arm.home_deg if robot.arm is not None else (), masses=(1.0,) * 60,
        stiffness_nm_rad=(48950.0, 16170.0, 5000.0), standard_error_nm_rad=(1.0,) * 3, misfit=1.0, postures=3,
    )  # fmt: skip
    knowledge = Knowledge(identified=Identified(robot=bench.name, arm=known))
    channel = InProcessChannel(World(robot))
    run_experiments(bench, [Experiment(LINE_MOTION, None, "none")], tmp_path, knowledge=knowledge, channel=channel)
    assert load_result(tmp_path, ExperimentsResult, "runs").arm == known


@pytest.mark.slow  # it draws a page
def test_a_ramp_of_an_arm_that_shows_no_single_resonance_is_judged_in_the_band_as_well(tmp_path: Path) -> None:
    bench, channel = load_bench("reference-arm"), InProcessChannel(World(load_robot("reference-arm")))
    outcome = run_experiments(bench, [Experiment(CONSTANT_ACCELERATION, 3, "none")], tmp_path, channel=channel)
    [entry] = outcome.result.runs
    assert entry.invalid is None
    assert (entry.band_hz, entry.f_al_hz, entry.f_al_source) == ((6.0, 25.0), None, None)
    assert (entry.f_al_words or "").startswith("band 6 to 25 Hz, from the bench file: the ramp does not show a single")
    assert entry.directions is not None
    peaks = {name: each.tip_peak_mm or 0.0 for name, each in entry.directions.items()}
    assert 0.06 < peaks["z"] < 0.10  # what its transmission error makes of two modes; without any it is the sensor's noise
    assert peaks["y"] < 0.01
    assert entry.within_spec is False
    assert "band 6 to 25 Hz" in write_report_of(tmp_path).read_text(encoding="utf-8").replace("&nbsp;", " ")
    unknown = bench.model_copy(update={"specification": bench.specification.model_copy(update={"band_hz": None})})
    recording = Recording.load(next(tmp_path.rglob("*axis3*none.csv")))
    result = RunResult(recording, len(recording.time_s), 0, 0, 1.0, 3.0, 250e-6, None)
    [without, *_] = entries(unknown, Experiment(CONSTANT_ACCELERATION, 3, "none"), result, "ramp.csv")
    assert "so f_al is not known" in (without.invalid or "")


def last_result(bench: Bench, folder: Path) -> RunResult:
    recording = Recording.load(next(folder.rglob("line-motion-drive-none.csv")))
    return RunResult(recording, len(recording.time_s), 0, 0, 1.0, 3.0, 250e-6, None)


def test_a_band_is_for_an_arm_and_goes_upwards(tmp_path: Path) -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    for band, words in (("[25.0, 6.0]", "the first must be the lower"), ("[6.0, 25.0]", "needs an arm table")):
        path = tmp_path / "bench.toml"
        path.write_text(text.replace("tip_mm = 0.05", f"band_hz = {band}\ntip_mm = 0.05"), encoding="utf-8")
        with pytest.raises(FileError, match=words):
            load_bench(path)


@pytest.mark.slow  # it draws a page
def test_the_report_shows_the_tip_along_all_directions(tmp_path: Path) -> None:
    channel = InProcessChannel(World(load_robot("reference-arm")))
    experiments = [Experiment(LINE_MOTION, None, "none"), Experiment(LINE_MOTION, None, "notch")]
    run_experiments(load_bench("reference-arm"), experiments, tmp_path, channel=channel)
    page = write_report_of(tmp_path).read_text(encoding="utf-8").replace("&nbsp;", " ")
    assert "Line motion: the tip along x, y and z" in page
    assert page.count("worst (") == 2
    assert "worst direction" in page
    assert page.index('id="arm-line"') < page.index('id="arm-resonances"')


@pytest.mark.slow  # the same
def test_a_comparison_shows_all_directions_with_every_treatment(tmp_path: Path) -> None:
    request = ComparisonRequest((LINE_MOTION,), (), ("none", "notch"))
    channel = InProcessChannel(World(load_robot("reference-arm")))
    made = plan(KnownRobot(load_bench("reference-arm")), request, channel=channel)
    done = run_experiments(made.robot.bench, made.experiments, tmp_path / "arm", channel=channel)
    whole = ComparisonResult(
        started_utc="2026-01-01T00:00:00+00:00", request=request_entry(request), robots=[gathered(made, "arm", done.result, "")],
        emulated=True,
    )  # fmt: skip
    whole.write(tmp_path / "result.json")
    page = write_report_of(tmp_path).read_text(encoding="utf-8")
    assert "Line motion: the tip along x, y and z" in page
    assert page.count("worst (") == 2  # a row of the table for each treatment
    assert page.index('id="arm-line-arm"') < page.index('id="arm-resonances-arm"')
    assert "each run's worst direction" in page.replace("&#39;", "'")


@pytest.mark.ci
def test_the_displacement_that_is_judged_is_that_of_the_tip_itself(tmp_path: Path) -> None:
    """The emulated tip's own position, through the same band, beside the accelerometer's signal integrated twice."""
    robot, bench = load_robot("reference-arm"), load_bench("reference-arm")
    sensor = robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    world = World(robot.model_copy(update={"accelerometer": sensor}))
    measure, arm, samples = world.accelerometer.measure, world.axes.arm, list[tuple[float, ...]]()
    assert arm is not None

    def measured() -> tuple[float, float, float]:
        felt = measure()
        samples.append((*felt, *arm.moved[POSITION].tolist()))
        return felt

    world.accelerometer.measure = measured
    with Session(bench, InProcessChannel(world), BusLog(None)) as session:
        session.bring_up()
        recording = session.run(line_motion(bench, 0.002), "none", "drive").recording
    taken, shown = np.array(samples), tip_acceleration(recording)
    count = len(shown)
    [begin] = [i for i in range(len(taken) - count + 1) if np.allclose(taken[i : i + count, :3], shown, atol=6e-4)]
    position = 1e3 * taken[begin : begin + count, 3:]
    band = signal.butter(4, (6.0, 25.0), "bandpass", fs=500.0, output="sos")
    true = signal.sosfiltfilt(band, position - position[0], axis=0)
    judged, middle = displacement_mm(shown, 0.002, (6.0, 25.0)), slice(350, 1025)  # 0.5 to 1.85 s after the start
    assert float(np.max(np.abs(true[middle]))) > 0.05
    np.testing.assert_allclose(judged[middle], true[middle], rtol=0.0, atol=5e-4)
