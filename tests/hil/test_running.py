"""`hil.run` from Python: what it refuses, what the recording has, and what an import costs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.analysis import TipScale, speed_window, tip_displacement_mm
from hil.can.errors import ChannelError
from hil.errors import NotPossibleError
from hil.recording import Recording
from hil.running import DISPLACEMENT, with_displacement
from plant_emulator.pytest_plugin.target import ServedBus
from tests.hil.results.made import run_entry


def test_an_import_of_the_package_loads_no_numpy() -> None:
    heavy = ("numpy", "scipy", "cffi", "pydantic")
    text = f"import sys, hil; assert not set({heavy!r}) & set(sys.modules); hil.run; assert 'numpy' in sys.modules"
    subprocess.run([sys.executable, "-c", text], check=True)


def test_what_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        hil.walk  # noqa: B018 - the look itself


@pytest.mark.parametrize(
    ("experiment", "options", "said"),
    [
        ("ramp", {"axis": 2}, "experiment 'ramp': expected constant-acceleration"),
        ("constant-acceleration", {}, "needs an axis"),
        ("line-motion", {"axis": 2}, "takes no axis"),
        ("constant-acceleration", {"axis": 2, "treatment": "hope"}, "treatment 'hope': expected none"),
        ("constant-acceleration", {"axis": 2, "loop": "Host"}, "loop 'Host': expected drive, host"),
        ("constant-acceleration", {"axis": 2, "repeat": 0}, "repeat 0: expected a whole number of at least 1"),
    ],
)
def test_words_that_mean_nothing_are_refused(experiment: str, options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        hil.run("reference", experiment, **options)  # type: ignore[arg-type]


def test_a_robot_that_may_be_real_moves_only_with_a_yes(tmp_path: Path) -> None:
    with pytest.raises(NotPossibleError, match=r"moves the robot on socketcan:can7: .* yes=True"):
        hil.run("reference", "constant-acceleration", axis=2, bus="socketcan:can7", out=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_bus_that_is_not_there_is_said_and_leaves_no_folder(tmp_path: Path) -> None:
    kept = tmp_path / "mine"
    kept.mkdir()
    for out in (tmp_path / "new", kept):
        with pytest.raises(ChannelError, match=r"no bus at local:/nowhere/x\.sock"):
            hil.run("reference", "constant-acceleration", axis=2, bus="local:/nowhere/x.sock", out=out)
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]


def test_the_displacement_is_that_by_which_a_ramp_is_judged() -> None:
    time = 0.002 * np.arange(1000)
    tip = np.sin(2.0 * np.pi * 11.8 * time)
    recording = Recording({"time_s": time, "tip_z_m_s2": tip})
    entry = run_entry(f_al_hz=11.8, band_hz=(5.0, 25.0))
    scale = TipScale(11.8, (5.0, 25.0), {}, (5.0, 25.0))
    found = with_displacement(recording, entry).columns[DISPLACEMENT]
    assert found == pytest.approx(tip_displacement_mm(tip, 0.002, scale))
    assert DISPLACEMENT not in with_displacement(recording, run_entry()).columns, "no f_al, no millimetre"


@pytest.mark.ci
def test_a_run_from_python_gives_its_result_and_the_tip_over_the_time(hil_local_bus: ServedBus, tmp_path: Path) -> None:
    done = hil.run(
        "reference", "constant-acceleration", axis=2, treatment="notch", bus=hil_local_bus.address, out=tmp_path / "out"
    )
    assert (tmp_path / "out" / "result.json").is_file()
    entry = next(run for run in done.result.runs if run.order == 2)
    assert entry.window_rps is not None
    judged = speed_window(done.recording, 2, entry.window_rps)
    peak = np.max(np.abs(done.recording.columns[DISPLACEMENT][judged]))
    assert peak == pytest.approx(entry.tip_peak_mm, rel=1e-4)
    assert done.entry.filters is not None
