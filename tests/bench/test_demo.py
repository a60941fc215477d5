"""`hil demo`, whole, over virtual CAN: the paper's result with its numbers."""

import json
import math
import re
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from hil.recording import Recording
from tests.bench.shared_demo import DemoRun

pytestmark = pytest.mark.ci  # one whole run, or all figures drawn: half a minute

RUN_KEYS = {
    "experiment", "axis", "treatment", "loop", "sync_period_s", "control_period_s", "order", "tip_peak_mm", "tip_rms_mm",
    "spectrum_peak_m_s2", "spectrum_peak_hz", "spectrum_area", "within_spec", "cycles", "missed_cycles", "wall_s", "motion_s",
    "recording", "f_al_hz", "f_al_source", "f_al_words", "band_hz", "filters", "cancelled",
}  # fmt: skip
IN_THE_DRIVES = ("none", "notch", "cancellation")
RAMP_KEYS = {"ramp_peak_mm", "window_rps", "order_mm", "order_error_mm", "noise_mm"}


@pytest.fixture(scope="module")
def demo(demo_run: DemoRun) -> tuple[Path, dict[str, Any]]:
    result = json.loads((demo_run.out / "result.json").read_text())
    assert result == json.loads(demo_run.stdout)
    return demo_run.out, result


def runs(demo: tuple[Path, dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    found = [run for run in demo[1]["runs"] if wanted.items() <= run.items()]
    assert found, wanted
    return found


def test_result_has_the_promised_shape(demo: tuple[Path, dict[str, Any]]) -> None:
    out, result = demo
    assert result["schema"] == 2
    assert set(result) == {"schema", "kind", "bench", "files", "runs", "comparisons", "paper", "emulated"}
    assert result["emulated"] is True
    for run in result["runs"]:
        tried = {"trial"} if run["treatment"] == "cancellation" else set()
        assert set(run) == RUN_KEYS | tried | (set() if run["axis"] is None else RAMP_KEYS)
        assert (out / run["recording"]).is_file()
        assert (run["order"] is None) == (run["experiment"] == "line-motion")
    keys = {(r["experiment"], r["axis"], r["loop"], r["treatment"], r["order"]) for r in result["runs"]}
    single = "constant-acceleration"
    assert keys == {
        *((single, axis, "drive", way, k) for axis in (2, 3) for way in IN_THE_DRIVES for k in (2, 4)),
        *((single, 2, "host", way, k) for way in ("none", "notch") for k in (2, 4)),
        *(("line-motion", None, "drive", way, None) for way in IN_THE_DRIVES),
    }
    for pair in result["comparisons"]:
        assert set(pair) == {
            "experiment",
            "axis",
            "loop",
            "treatment",
            "tip_peak_reduction_pct",
            "spectrum_area_reduction_pct",
        }
    for claim in result["paper"]:
        assert set(claim) == {"claim", "source", "paper", "bench", "unit", "holds"}


@pytest.mark.parametrize("axis", [2, 3])
def test_the_notch_brings_each_axis_within_the_specification(demo: tuple[Path, dict[str, Any]], axis: int) -> None:
    (without,) = runs(demo, axis=axis, loop="drive", treatment="none", order=2)
    (with_notch,) = runs(demo, axis=axis, loop="drive", treatment="notch", order=2)
    assert without["tip_peak_mm"] > 0.05
    assert with_notch["tip_peak_mm"] <= 0.05
    assert with_notch["within_spec"]
    assert not without["within_spec"]


def test_the_line_motion_loses_a_quarter_of_its_spectrum_by_the_notch_and_most_by_cancellation(
    demo: tuple[Path, dict[str, Any]],
) -> None:
    pairs = {pair["treatment"]: pair for pair in demo[1]["comparisons"] if pair["experiment"] == "line-motion"}
    assert pairs["notch"]["spectrum_area_reduction_pct"] >= 26.0
    assert pairs["cancellation"]["spectrum_area_reduction_pct"] >= 80.0  # the rest is the sensor's noise
    assert [run["within_spec"] for run in demo[1]["runs"] if run["experiment"] == "line-motion"] == [False, False, True]


def test_host_closed_on_a_bus_without_bit_times_does_as_well(demo: tuple[Path, dict[str, Any]]) -> None:
    for way in ("none", "notch"):
        (host,) = runs(demo, loop="host", treatment=way, order=2)
        (drive,) = runs(demo, axis=2, loop="drive", treatment=way, order=2)
        assert host["control_period_s"] == host["sync_period_s"] == 250e-6
        assert drive["control_period_s"] == 250e-6
        assert host["tip_peak_mm"] == pytest.approx(drive["tip_peak_mm"], rel=0.15)


def test_table_1_comes_out_of_the_gain_peak(demo: tuple[Path, dict[str, Any]]) -> None:
    table = {claim["claim"]: claim for claim in demo[1]["paper"] if claim["source"] == "Table 1"}
    assert len(table) == 6
    speeds = [table[f"axis {axis}: excitation speed, k = {k}"]["bench"] for axis in (2, 3) for k in (2, 4)]
    assert speeds == pytest.approx([5.92, 2.96, 5.72, 2.86], abs=0.006)


def test_every_claim_of_the_paper_holds(demo: tuple[Path, dict[str, Any]]) -> None:
    assert [claim["claim"] for claim in demo[1]["paper"] if not claim["holds"]] == []
    assert len(demo[1]["paper"]) >= 20


def test_no_cycle_is_missed_and_rows_are_a_period_apart(demo: tuple[Path, dict[str, Any]]) -> None:
    out, result = demo
    for run in result["runs"]:
        assert run["missed_cycles"] == 0
        recording = Recording.load(out / run["recording"])
        assert len(recording.time_s) == run["cycles"]
        np.testing.assert_allclose(np.diff(recording.time_s), run["sync_period_s"], rtol=1e-6)
        assert run["motion_s"] == pytest.approx(recording.time_s[-1])


def test_the_recorded_notch_follows_the_measured_speed(demo: tuple[Path, dict[str, Any]]) -> None:
    """The zero frequency that the drive reports is k f_m inside [f_s, f_e], and the filter is out elsewhere."""
    from hil.analysis import motor_speed_rps  # noqa: PLC0415

    out, _ = demo
    for axis in (2, 3):
        (run,) = runs(demo, axis=axis, loop="drive", treatment="notch", order=2)
        recording = Recording.load(out / run["recording"])
        speed, notch = motor_speed_rps(recording, axis), recording.axis(axis, "notch_hz")
        rising = np.arange(len(speed)) < np.argmax(speed)
        inside = rising & (speed > 4.3) & (speed < 8.7)
        np.testing.assert_allclose(notch[inside], 2.0 * speed[inside], rtol=0.04)
        assert not notch[rising & ((speed < 3.7) | (speed > 9.4))].any()


def test_recordings_name_their_units(demo: tuple[Path, dict[str, Any]]) -> None:
    out, result = demo
    for run in result["runs"]:
        header = (out / run["recording"]).read_text().splitlines()[0].split(",")
        assert all(re.search(r"_(s|rad|nm|hz|m_s2)$", name) or name == "missing" for name in header)


def test_the_bus_log_is_a_candump_log_that_python_can_reads(demo: tuple[Path, dict[str, Any]]) -> None:
    out, result = demo
    counts: dict[int, int] = {}
    for message in can.LogReader(out / "bus.log"):
        counts[message.arbitration_id] = counts.get(message.arbitration_id, 0) + 1
    recorded = sum(run["cycles"] for run in result["runs"] if run["order"] != 4)
    assert counts[0x80] > recorded
    assert counts[0x182] > 0
    assert counts[0x190] > recorded


def test_the_report_is_one_file_that_opens_offline(demo: tuple[Path, dict[str, Any]]) -> None:
    out, _ = demo
    text = (out / "report.html").read_text().replace("&nbsp;", " ")
    links = re.findall(r"""(?:src|href)=["'](https?:[^"']*)""", text)
    assert not links
    assert text.count("<svg") >= 10
    for words in ("Table 1", "Table 2", "Table 3", "Fig. 15"):
        assert words in text


def test_the_tip_peak_can_be_read_off_the_recording_by_hand(demo: tuple[Path, dict[str, Any]]) -> None:
    """The metric once more, from the CSV, with scipy alone."""
    from scipy import signal  # noqa: PLC0415

    out, _ = demo
    (run,) = runs(demo, axis=2, loop="drive", treatment="none", order=2)
    names = (out / run["recording"]).read_text().splitlines()[0].split(",")
    table = np.loadtxt(out / run["recording"], delimiter=",", skiprows=1)
    column = {name: table[:, i] for i, name in enumerate(names)}
    dt = 0.002
    band = signal.butter(2, [6, 25], "bandpass", fs=1 / dt, output="sos")
    millimetres = 1e3 * signal.sosfiltfilt(band, column["tip_z_m_s2"]) / (2 * math.pi * 11.84) ** 2
    revolutions = column["axis2_position_rad"] / (2 * math.pi)
    # at 4 rps/s from rest, 40 ms behind the reference, f_m is 4.5 … 7.5 rps from 1.125 s to 1.875 s after the dwell
    begin, end = 0.2 + 1.125 + 0.04, 0.2 + 1.875 + 0.04
    inside = (column["time_s"] >= begin) & (column["time_s"] <= end)
    assert revolutions[inside][0] == pytest.approx(0.5 * 4 * 1.125**2, abs=0.1)
    assert np.abs(millimetres[inside]).max() == pytest.approx(run["tip_peak_mm"], rel=0.02)
