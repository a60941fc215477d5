"""What every measurement on a bench has in common, whatever it measures: log, load check, record, restoration, its end."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from drive_profiles.address import parse_address
from hil.bench.bench import Bench, load_bench
from hil.cli.main import app
from hil.errors import InterruptedRunError, NotPossibleError, SafetyStopError
from hil.experiments import measurement
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest, Goal
from hil.experiments.cancellation.learn_run import LearnRequest, learn_on_bus
from hil.experiments.measurement import MeasurementOutcome
from hil.experiments.plan import Experiment
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.runner import run_experiments
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.files import load_any
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.bench.conftest import with_bus, with_motion
from tests.bench.fault_rig import everything
from tests.hil.experiments.plant.plant_rig import unknown_bench

AXIS = 3
FEEDBACK = 0x180 + AXIS
KINDS = ("run", "learn", "identify-ate", "identify-plant")
ONE_PASS = Goal({2: 1.0, 4: 1.0}, {2: 90.0, 4: 90.0})
SHORT = {"position_min_rev": -6.0, "position_max_rev": 6.0}


@dataclass
class MeasurementRig:
    """A kind of measurement, the bench it is made on, and the bus.

    Attributes:
        measure: Makes it, into a directory.
    """

    bench: Bench
    channel: InProcessChannel
    measure: Callable[[Path, Reporter], MeasurementOutcome[Any]]


def rig_of(kind: str) -> MeasurementRig:
    """Axis 3 of the reference robot, with a sensor without noise, and a measurement that takes seconds."""
    bench, robot = load_bench("reference"), load_robot("reference")
    sensor = robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    robot = robot.model_copy(update={"accelerometer": sensor})
    if kind == "identify-plant":
        bench = unknown_bench(AXIS, **SHORT)
        alone = {"axis": {AXIS: robot.axis[AXIS]}, "geometry": None, "line_motion": None, "sync_period_s": 0.004}
        robot = robot.model_copy(update=alone)
    bench = with_bus(bench, answer_timeout_s=0.05)
    if kind == "run":
        bench = with_motion(bench, acceleration_rps_s=8.0, end_rps=8.0, tail_s=0.1)
    makers: dict[str, Callable[[Path, Reporter], MeasurementOutcome[Any]]] = {
        "run": lambda out, reporter: run_experiments(
            bench, [Experiment("constant-acceleration", AXIS, "notch")], out, reporter=reporter
        ),
        "learn": lambda out, reporter: learn_on_bus(
            bench, LearnRequest((AXIS,), passes=2, acceleration_rps_s=8.0), out, out / "model.toml", reporter=reporter
        ),
        "identify-ate": lambda out, reporter: identify_ate(bench, AteRequest(AXIS, 8.0, goal=ONE_PASS), out, reporter=reporter),
        "identify-plant": lambda out, reporter: run_identify_plant(
            bench, PlantRequest(AXIS, amplitude_nm=0.5, periods=6), out, reporter=reporter
        ),
    }
    return MeasurementRig(bench, InProcessChannel(World(robot)), makers[kind])


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def rig(kind: str, monkeypatch: pytest.MonkeyPatch) -> MeasurementRig:
    made = rig_of(kind)
    monkeypatch.setattr(measurement, "open_channel", lambda address: made.channel)
    return made


@pytest.mark.slow
def test_log_record_result_report_and_the_nodes_as_they_were(kind: str, rig: MeasurementRig, tmp_path: Path) -> None:
    rig.channel.address = parse_address("socketcan:can0")
    before = everything(rig.channel.world)
    outcome = rig.measure(tmp_path, SILENT)
    assert outcome.failure is None
    assert outcome.not_restored == ()
    assert everything(rig.channel.world) == before
    lines = (tmp_path / "bus.log").read_text().splitlines()
    assert {line.split()[1] for line in lines} == {"can0"}, "a log is played back to the interface that it names"
    described = outcome.result.bench
    assert {"python", "hil-bench", "numpy"} <= described.versions.keys()
    assert described.clock == "lock-step"
    assert described.file == rig.bench
    assert load_any(tmp_path / "result.json") == outcome.result
    assert outcome.result.kind == kind
    report = CliRunner().invoke(app, ["report", str(tmp_path)])
    assert report.exit_code == 0, report.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert outcome.result.emulated is True, "the nodes have said so, whatever the bus is called"
    assert page.index("Emulated robot") < page.index("<h1>")
    assert not re.search(r'class="tag">[^<]*measured', page)


def test_a_bus_that_is_too_full_is_refused_before_anything_is_sent(kind: str, rig: MeasurementRig, tmp_path: Path) -> None:
    rig.channel.address = parse_address("local:/in-process@125k")
    with pytest.raises(NotPossibleError, match=r"oes not fit.*--overload"):
        rig.measure(tmp_path, SILENT)
    assert not rig.channel.sent
    assert not (tmp_path / "result.json").exists(), kind


class Disturber(Reporter):
    """Does something when a fifth of a motion is over."""

    def __init__(self, disturb: Callable[[], None]) -> None:
        self._disturb = disturb

    def progress(self, fraction: float) -> None:
        if fraction > 0.2:
            self._disturb()


def deaf(channel: InProcessChannel) -> None:
    """What the drive tells in every cycle is lost from now on."""
    channel.passes = lambda frame: frame.can_id != FEEDBACK


@pytest.mark.slow
def test_what_is_stopped_keeps_its_recording_and_returns_why(kind: str, rig: MeasurementRig, tmp_path: Path) -> None:
    outcome = rig.measure(tmp_path, Disturber(lambda: deaf(rig.channel)))
    assert isinstance(outcome.failure, SafetyStopError)
    kept = load_any(tmp_path / "result.json")
    assert kept == outcome.result
    assert outcome.result.stopped == str(outcome.failure)
    (recording,) = (tmp_path / "runs").glob("*.csv")
    assert len(Recording.load(recording).time_s) > 10
    report = CliRunner().invoke(app, ["report", str(tmp_path)])
    assert report.exit_code == 0, report.output
    assert "stopped" in (tmp_path / "report.html").read_text(encoding="utf-8"), kind


@pytest.mark.slow
def test_nodes_that_do_not_answer_leave_no_result(kind: str, rig: MeasurementRig, tmp_path: Path) -> None:
    rig.channel.passes = lambda frame: False
    with pytest.raises(Exception, match=r"no answer|node") as error:
        rig.measure(tmp_path, SILENT)
    assert getattr(error.value, "exit_code", None) == 5
    assert not (tmp_path / "result.json").exists(), kind


def test_an_interrupt_before_the_first_run_is_told_in_the_result(
    kind: str, rig: MeasurementRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(session: Session) -> None:
        raise InterruptedRunError("interrupted by SIGINT")

    monkeypatch.setattr(Session, "check_interrupt", interrupted)
    monkeypatch.setattr(Session, "bring_up", lambda session, **_: None)
    outcome = rig.measure(tmp_path, SILENT)
    assert isinstance(outcome.failure, InterruptedRunError)
    assert load_any(tmp_path / "result.json") == outcome.result, kind


# -- what an axis needs of the bus beside its set-point ------------------------------------------------------------------


@pytest.mark.parametrize(("excitation", "fits"), [("reference", True), ("torque", False), ("auto", False)])
def test_an_excitation_by_torque_needs_two_more_bytes(
    excitation: Any, fits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """125 kbit/s and 4 ms: a command with 60B2h is 8 bytes instead of 6, 135 bits at worst instead of 115."""
    made = rig_of("identify-plant")
    made.channel.address = parse_address("local:/in-process@125k")
    monkeypatch.setattr(made.channel, "passes", lambda frame: False)
    request = PlantRequest(AXIS, amplitude_nm=0.5, periods=6, excitation=excitation)
    with pytest.raises(Exception, match="no answer" if fits else "oes not fit.*--overload"):
        run_identify_plant(made.bench, request, tmp_path, channel=made.channel)
    assert bool(made.channel.sent) is fits


@pytest.mark.parametrize(("way", "fits"), [("reference", True), ("torque", False)])
def test_learning_with_torque_offsets_needs_them_too(
    way: Any, fits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = rig_of("learn")
    made.channel.address = parse_address("local:/in-process@250k")
    monkeypatch.setattr(made.channel, "passes", lambda frame: False)
    with pytest.raises(Exception, match="no answer" if fits else "oes not fit.*--overload"):
        learn_on_bus(made.bench, LearnRequest((AXIS,), actuation=way), tmp_path, tmp_path / "model.toml", channel=made.channel)
    assert bool(made.channel.sent) is fits
