"""Transmission errors from recordings, which are made here with a known one."""

import gzip
import math

import numpy as np
import pytest

from benchmarks.recordings import AXIS, drawn, model_of, recorded, scores
from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.experiments.ate.recorded.identify import identify_recorded
from hil.experiments.ate.recorded.request import ContradictedError, RecordedAteError, RecordedRequest
from hil.recordings import RecordingFileError, Said
from hil.report.writer import write_report_of

PERIOD_S, RATIO = 0.004, 100.0
TRUE = {1: (3.0, 20.0), 2: (8.0, 222.0), 4: (4.0, 126.0)}
NAMES = "time_s,motor_rad,load_rad"


def motion(turns=9.0, speed_rps=2.5, seed=1):
    """Stamps that jitter by up to a period, and a motor that turns there and back."""
    random = np.random.default_rng(seed)
    ramp_s = 0.5
    there_s = turns / speed_rps
    true_s = np.arange(0.0, 2.0 * (there_s + 2.0 * ramp_s), PERIOD_S)
    speed = np.interp(
        true_s,
        np.cumsum([0.0, ramp_s, there_s - ramp_s, ramp_s, ramp_s, ramp_s, there_s - ramp_s, ramp_s]),
        speed_rps * np.array([0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0]),
    )
    angle = 2.0 * math.pi * np.cumsum(speed) * PERIOD_S + 0.7
    return true_s + random.uniform(0.0, 0.004, len(true_s)), angle


def joint(angle, turned_deg=0.0, seed=1, noise_arcsec=1.5):
    """Joint angle with wind-up, eccentricity, a known error and the noise of an encoder."""
    random = np.random.default_rng(1000 + seed)
    load = angle / RATIO
    speed = np.gradient(angle)
    wound_up = 40.0 * np.sin(3.0 * load) + 25.0 * np.sin(load + 1.0) + 12.0 * np.tanh(speed / 0.01)
    error = sum(a * np.cos(k * angle + math.radians(phi + turned_deg * (k == 2))) for k, (a, phi) in TRUE.items())
    coloured = np.convolve(random.normal(0.0, noise_arcsec, len(angle) + 4), np.ones(5) / math.sqrt(5.0), "valid")
    return load + ARCSEC * (wound_up + error + coloured)


def written(path, time, motor, load, names=NAMES):
    text = (
        names
        + "\n"
        + "\n".join(f"{a:.6f},{b!r},{c!r}" for a, b, c in zip(time, map(float, motor), map(float, load), strict=True))
    )
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def request(*files, said=None, orders=(1, 2, 4)):
    return RecordedRequest(files, 1, said or Said(), orders)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    time, angle = motion()
    return identify_recorded(request(written(folder / "joint.csv.gz", time, angle, joint(angle))), folder / "out")


@pytest.mark.ci
@pytest.mark.parametrize("order", TRUE)
def test_amplitudes_and_phases_are_found_within_their_standard_errors(result, order):
    size, phase = TRUE[order]
    errors = result.ate.standard_error
    off = (result.ate.values.phases_deg()[order] - phase + 180.0) % 360.0 - 180.0
    assert abs(result.ate.values.amplitudes_arcsec()[order] - size) < 4.0 * errors[f"a{order}_arcsec"] < 0.15 * 4.0 * 8.0
    assert abs(off) < 4.0 * errors[f"phi{order}_deg"]


def test_each_way_is_a_stretch_with_a_slow_part_of_its_own(result):
    assert [each.direction for each in result.stretches] == [1, -1]
    assert all(each.degree > 1 for each in result.stretches)


def test_it_is_the_entry_of_a_model_file_that_says_its_source(result):
    assert result.ate.learnt_by == "recording"
    assert result.is_identified
    assert result.reduction_ratio == RATIO


def test_a_phase_that_is_the_same_everywhere_is_not_said_to_change(result):
    assert not any(each.is_seen for each in result.changes)


def test_the_blind_scan_names_the_orders_that_there_are(result):
    assert sorted(round(peak.order) for peak in result.scan.peaks if peak.amplitude > 1.5 * peak.level) == [1, 2, 4]


@pytest.mark.ci
def test_a_phase_that_differs_between_recordings_is_said_with_its_size(tmp_path):
    files = []
    for number, turned in enumerate((0.0, 30.0)):
        time, angle = motion(seed=number)
        files.append(written(tmp_path / f"day{number}.csv", time, angle, joint(angle, turned, seed=number)))
    result = identify_recorded(request(*files), tmp_path / "out")
    [change] = [each for each in result.changes if each.order == 2]
    assert change.is_seen
    assert 25.0 < change.phi_span_deg < 45.0
    assert any("order 2 changes" in note for note in result.notes)


@pytest.mark.ci
def test_angles_that_begin_anew_are_the_same_as_those_that_do_not(tmp_path, result):
    time, angle = motion()
    load = joint(angle)
    counts = np.round(np.mod(angle, 2.0 * math.pi) / (2.0 * math.pi) * 2**24), np.mod(load, 2.0 * math.pi)
    path = written(tmp_path / "wrapped.csv", time, *counts, names="t_s,enc,load_rad")
    said = Said({"motor": "enc", "time": "t_s"}, {"motor": "2^24/rev"})
    wrapped = identify_recorded(request(path, said=said), tmp_path / "out")
    assert wrapped.ate.values.amplitudes_arcsec() == pytest.approx(result.ate.values.amplitudes_arcsec(), abs=0.02)
    assert any("wraps" in note for note in wrapped.notes)


def test_a_ratio_that_the_data_contradict_is_refused_with_both(tmp_path):
    time, angle = motion()
    path = written(tmp_path / "joint.csv", time, angle, joint(angle) * 100.0 / 101.0)
    with pytest.raises(ContradictedError, match=r"ratio of 100 was given; the encoders show 10\d\.\d+; check whether it is 101"):
        identify_recorded(request(path, said=Said(reduction_ratio=100.0)), tmp_path / "out")


def test_encoders_that_count_against_each_other_are_refused(tmp_path):
    time, angle = motion()
    path = written(tmp_path / "joint.csv", time, angle, -joint(angle))
    with pytest.raises(ContradictedError, match="count in opposite directions"):
        identify_recorded(request(path), tmp_path / "out")


def test_stretches_that_are_too_short_for_the_orders_are_refused(tmp_path):
    time, angle = motion(turns=1.5, speed_rps=1.0)
    path = written(tmp_path / "short.csv", time, angle, joint(angle))
    with pytest.raises(RecordedAteError, match=r"turns 1\.[45]\d* revolutions one way at most: orders 1, 2, 4 need 2"):
        identify_recorded(request(path), tmp_path / "out")


def test_a_file_without_a_second_signal_says_what_is_needed(tmp_path):
    time, angle = motion()
    path = written(tmp_path / "motor.csv", time, angle, angle, names="time_s,motor_rad,something")
    with pytest.raises(ContradictedError, match="one of joint angle, tip acceleration or motor torque"):
        identify_recorded(request(path), tmp_path / "out")


def test_noise_alone_is_no_transmission_error(tmp_path):
    time, angle = motion()
    random = np.random.default_rng(4)
    path = written(tmp_path / "noise.csv", time, angle, angle / RATIO + random.normal(0.0, 2.0 * ARCSEC, len(angle)))
    assert not identify_recorded(request(path), tmp_path / "out").is_identified


def test_a_bad_number_is_named_with_its_line(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("time_s,motor_rad,load_rad\n0.0,0.0,0.0\n0.004,broken,0.0\n", encoding="utf-8")
    with pytest.raises(RecordingFileError, match="line 3: 'broken' in the column 'motor_rad' is not a number"):
        identify_recorded(request(path), tmp_path / "out")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("form", "seed"),
    [
        ("encoders", 3),
        pytest.param("acceleration", 3, marks=pytest.mark.slow),
        pytest.param("torque", 44, marks=pytest.mark.slow),  # slopes over rounding made its standard errors half as large
    ],
)
def test_a_recording_of_the_emulated_robot_gives_its_error_within_the_standard_errors(form, seed):
    found = scores(seed, form)
    assert max(abs(value) for name, value in found.items() if not name.startswith("e_")) < 4.0
    assert found["e_2"] < {"encoders": 0.3, "acceleration": 0.1, "torque": 0.3}[form]


def test_a_sensor_without_a_plant_is_refused_with_the_file_that_says_it(tmp_path):
    time, angle = motion()
    path = written(tmp_path / "tip.csv", time, angle, 0.0 * angle, names="time_s,motor_rad,acceleration_m_s2")
    with pytest.raises(ContradictedError, match="name the file with lever, ratio and plant with --bench"):
        identify_recorded(request(path), tmp_path / "out")


def test_samples_that_are_too_slow_for_the_arm_are_refused(tmp_path):
    time, angle = motion()
    path = written(tmp_path / "tip.csv", 10.0 * time, angle, 0.0 * angle, names="time_s,motor_rad,acceleration_m_s2")
    with pytest.raises(ContradictedError, match="do not show an arm at 12"):
        identify_recorded(RecordedRequest((path,), 2, Said()), tmp_path / "out", load_bench("reference"))


@pytest.mark.slow
def test_a_scan_through_the_arm_names_the_orders_and_takes_no_resonance_for_a_line(tmp_path):
    truth = drawn(3, "torque")
    recorded(truth, "torque", 3, tmp_path / "recording.csv")
    asked = RecordedRequest((tmp_path / "recording.csv",), AXIS, Said(), (1, 2, 4), sensorless=True)
    scan = identify_recorded(asked, tmp_path / "out", load_bench("reference"), model_of(truth, 3)).scan
    assert scan.unit == "arcsec"
    assert sorted(round(peak.order, 1) for peak in scan.peaks) == [1.0, 2.0, 4.0]
    assert not scan.lines
    page = write_report_of(tmp_path / "out").read_text(encoding="utf-8")
    assert "through the arm to the sensor" in page
    assert "torque without that of the motor&#39;s own motion" in page


@pytest.mark.ci
def test_the_page_shows_the_path_of_a_recording_as_it_is(tmp_path):
    time, angle = motion(turns=4.0)
    path = written(tmp_path / "p_joint.csv", time, angle, joint(angle))
    identify_recorded(request(path, orders=(2,)), tmp_path / "out")
    assert f"<code>{path}</code>" in write_report_of(tmp_path / "out").read_text(encoding="utf-8")
