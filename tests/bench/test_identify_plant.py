"""The plant of an emulated axis over CAN, from a bench file that knows nothing of it: files, report, figures reached."""

import json
from pathlib import Path
from typing import Any

import pytest

from hil.bench.model import load_identified
from hil.errors import HilError
from hil.experiments.plant.checks import PlantNotIdentifiedError
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.recording import Recording
from hil.report.writer import write_report_of
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.hil.experiments.plant.plant_rig import true_values, unknown_bench

pytestmark = pytest.mark.ci

SHORT = {"position_min_rev": -6.0, "position_max_rev": 6.0}


def channel(sync_s: float, axis: int, seed: int = 1) -> InProcessChannel:
    """The reference robot's axis with the accelerometer that the figures are asked for."""
    robot = load_robot("reference")
    sensor = robot.accelerometer.model_copy(update={"noise_m_s2": 0.05, "resolution_m_s2": 0.01})
    alone = {"axis": {axis: robot.axis[axis]}, "geometry": None, "line_motion": None}
    changes: dict[str, Any] = {"accelerometer": sensor, "sync_period_s": sync_s, "seed": seed, **alone}
    return InProcessChannel(World(robot.model_copy(update=changes)))


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plant")
    request = PlantRequest(3, amplitude_nm=0.5, periods=6)
    run_identify_plant(unknown_bench(3, **SHORT), request, out, model=out / "model.toml", channel=channel(0.004, 3))
    return out


@pytest.mark.ci
def test_over_can_the_plant_is_found_from_nothing(directory: Path) -> None:
    result = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    truth = true_values(3)
    assert result["plan"]["excitation"] == "torque"
    for name, within in (("antiresonance_hz", 5e-3), ("gear_stiffness_nm_rad", 0.03)):
        assert result["parameters"][name]["value"] == pytest.approx(truth[name], rel=within)
    assert result["checks"]
    assert all(check["holds"] for check in result["checks"])
    assert result["cannot_tell"]
    assert "not_restored" not in result


@pytest.mark.slow
def test_the_model_file_has_the_plant(directory: Path) -> None:
    plant = load_identified(directory / "model.toml").axis[3].plant
    assert plant is not None
    assert plant.antiresonance_hz == pytest.approx(true_values(3)["antiresonance_hz"], rel=5e-3)
    assert plant.standard_error["gear_stiffness_nm_rad"] > 0.0
    assert plant.coulomb_friction_nm == pytest.approx(0.05, rel=0.05)
    assert plant.emulated is True, "a design that rests on it says so"


def test_the_recordings_are_kept(directory: Path) -> None:
    result = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    assert set(result["recordings"]) == {"probe", "pilot", "slow", "main"}
    recording = Recording.load(directory / result["recordings"]["main"])
    assert recording.axes == (3,)


@pytest.mark.ci
def test_the_report_shows_fit_confidence_and_friction(directory: Path) -> None:
    page = write_report_of(directory).read_text(encoding="utf-8")
    for key in ("frequency-response", "tip-response", "friction", "parameters", "checks", "What these data cannot tell"):
        assert key in page
    assert "Standard error" in page
    assert "Plant of axis 3" in page


@pytest.mark.slow
def test_what_is_not_identified_leaves_reasons_and_no_model_file(tmp_path: Path) -> None:
    request = PlantRequest(3, amplitude_nm=2.5, periods=6)
    bench, model = unknown_bench(3, **SHORT), tmp_path / "model.toml"
    failure = run_identify_plant(bench, request, tmp_path, model=model, channel=channel(0.004, 3)).failure
    assert isinstance(failure, PlantNotIdentifiedError)
    assert "turned back" in str(failure)
    assert failure.exit_code == 9
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert result["not_identified"] == list(failure.reasons)
    assert (tmp_path / result["recordings"]["main"]).is_file()
    assert not (tmp_path / "model.toml").exists()
    assert "Not identified" in write_report_of(tmp_path).read_text(encoding="utf-8")


def test_the_limits_of_the_bench_file_hold_before_anything_is_sent(tmp_path: Path) -> None:
    bus = channel(0.004, 3)
    narrow = unknown_bench(3, position_min_rev=-2.0, position_max_rev=2.0)
    with pytest.raises(HilError, match="travel"):
        run_identify_plant(narrow, PlantRequest(3), tmp_path, channel=bus)
    assert bus.syncs <= 1


@pytest.mark.slow
@pytest.mark.parametrize("sync_s", [0.001, 0.002])
@pytest.mark.parametrize("axis", [2, 3])
def test_the_figures_asked_for_over_can(axis: int, sync_s: float, tmp_path: Path) -> None:
    outcome = run_identify_plant(unknown_bench(axis, sync_s), PlantRequest(axis), tmp_path, channel=channel(sync_s, axis))
    truth, found = true_values(axis), outcome.result.parameters
    assert found is not None
    assert found["antiresonance_hz"].value == pytest.approx(truth["antiresonance_hz"], rel=1e-3)
    assert found["gear_stiffness_nm_rad"].value == pytest.approx(truth["gear_stiffness_nm_rad"], rel=5e-3)
