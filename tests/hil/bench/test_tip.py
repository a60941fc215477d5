"""The sensor of a bench with an arm: its columns in the base frame, and along the lever of an axis that moves alone."""

import math
from pathlib import Path

import numpy as np
import pytest

from drive_profiles.errors import FileError
from hil.arm.kinematics import Kinematics
from hil.bench.bench import REFERENCE, load_bench
from hil.bench.tip import joint_angles, vertical_levers_m, with_tip
from hil.errors import NotPossibleError
from hil.experiments.cancellation.trial import averaged
from hil.experiments.motions import line_motion
from hil.experiments.window import check_range
from hil.recording import ALONG, SENSED, TIP, Recording
from tests.hil.arm.oracles import acceleration
from tests.hil.arm.reference import CHAIN, START, bench_with_arm, text_with_arm

PERIOD_S = 0.002
TIME = np.arange(0.0, 1.0, PERIOD_S)
MOUNTING = "\n[accelerometer.mounting]\norigin_m = [0.11, 0.01, 0.02]\nrpy_deg = [0.0, 90.0, 0.0]\n"


def mounted(folder: Path, mounting: str = MOUNTING):
    path = folder / "mounted.toml"
    path.write_text(text_with_arm() + mounting, encoding="utf-8")
    return load_bench(path)


def recorded(bench, motor_rad: dict[int, np.ndarray], columns: np.ndarray) -> Recording:
    named = {f"axis{number}_position_rad": angle for number, angle in motor_rad.items()}
    return Recording({"time_s": TIME, **named, **{name: columns[:, i] for i, name in enumerate(TIP)}})


def test_without_an_arm_a_recording_stays_what_it_is(tmp_path):
    bench = load_bench("reference")
    recording = recorded(bench, {2: TIME}, np.ones((len(TIME), 3)))
    assert with_tip(bench, recording) is recording
    assert recording.felt_m_s2 is recording.columns["tip_z_m_s2"]


def test_a_mounted_sensor_on_a_moving_axis_gives_the_axis_acceleration_times_its_lever(tmp_path):
    bench = mounted(tmp_path)
    arm = bench.arm
    assert arm is not None
    mounting = bench.accelerometer.mounting
    assert mounting is not None
    kinematics, of = Kinematics.of(arm), mounting.frame(arm)
    for joint, number in enumerate(arm.axes):
        motor = 30.0 * np.sin(9.0 * TIME)
        ratio = bench.axis[number].reduction_ratio
        speeds, rates = np.zeros((len(TIME), 3)), np.zeros((len(TIME), 3))
        speeds[:, joint], rates[:, joint] = 270.0 * np.cos(9.0 * TIME) / ratio, -2430.0 * np.sin(9.0 * TIME) / ratio
        angles = np.tile(arm.home_rad(), (len(TIME), 1))
        angles[:, joint] += motor / ratio
        _, frames = kinematics.pose(angles, of)
        true = acceleration(kinematics, angles, speeds, rates, of)
        felt = np.einsum("nji,nj->ni", frames, true - np.array(arm.gravity_m_s2))
        recording = with_tip(bench, recorded(bench, {number: motor}, felt))
        np.testing.assert_allclose(joint_angles(bench, recording), angles, rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(np.stack([recording.columns[name] for name in SENSED], axis=1), felt)
        np.testing.assert_allclose(np.stack([recording.columns[name] for name in TIP], axis=1), true, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(recording.felt_m_s2, bench.axis[number].tip_lever_m * rates[:, joint], rtol=0.0, atol=1e-10)
        assert recording.felt_m_s2 is recording.columns[ALONG]


def test_the_levers_are_those_of_the_sensor_and_of_its_posture(tmp_path):
    on_elbow = mounted(tmp_path, "\n[accelerometer.mounting]\naxis = 3\norigin_m = [0.42, 0.0, 0.0]\n")
    at_tip = bench_with_arm(tmp_path)
    assert at_tip.axis[5].tip_lever_m == pytest.approx(0.13)
    assert on_elbow.axis[5].tip_lever_m == 0.0
    assert on_elbow.axis[3].tip_lever_m == pytest.approx(0.42)
    with pytest.raises(NotPossibleError, match=r"its lever at home is 0 mm; at least 1 mm is needed"):
        on_elbow.axis[5].felt_lever_m("identify ate --axis 5")
    assert on_elbow.axis[3].felt_lever_m("identify ate --axis 3") == on_elbow.axis[3].tip_lever_m


def test_levers_upwards_are_those_of_the_planar_chain_along_the_line(tmp_path):
    bench = bench_with_arm(tmp_path)
    motion = line_motion(bench, PERIOD_S)
    columns = {f"axis{axis}_position_rad": motion.motor_angle_rad[:, i] for i, axis in enumerate(motion.axes)}
    levers = vertical_levers_m(bench, Recording({"time_s": motion.time_s, **columns}))
    joints = CHAIN.joints(np.array(START)) + motion.motor_angle_rad / [bench.axis[axis].reduction_ratio for axis in motion.axes]
    for column, lever in enumerate(levers):
        step = 1e-6 * np.eye(3)[column]
        upwards = (CHAIN.tip(joints + step)[:, 1] - CHAIN.tip(joints - step)[:, 1]) / 2e-6
        np.testing.assert_allclose(lever, upwards, rtol=0.0, atol=1e-8)


def test_a_sensor_without_a_response_to_gravity_is_not_freed_of_it(tmp_path):
    bench = mounted(tmp_path, MOUNTING + "gravity = false\n")
    still = with_tip(bench, recorded(bench, {2: 0.0 * TIME, 3: 0.0 * TIME}, np.zeros((len(TIME), 3))))
    assert not any(np.any(still.columns[name]) for name in TIP)
    assert ALONG not in still.columns  # two axes: no lever of its own


def test_a_real_sensor_at_rest_shows_no_motion(tmp_path):
    bench = mounted(tmp_path)
    assert bench.arm is not None
    assert bench.accelerometer.mounting is not None
    _, frame = Kinematics.of(bench.arm).pose(bench.arm.home_rad(), bench.accelerometer.mounting.frame(bench.arm))
    weight = np.tile(frame.T @ np.array([0.0, 0.0, 9.81]), (len(TIME), 1))
    still = with_tip(bench, recorded(bench, {2: 0.0 * TIME}, weight))
    assert max(float(np.max(np.abs(still.columns[name]))) for name in TIP) < 1e-12


def test_a_mounting_needs_an_arm(tmp_path):
    path = tmp_path / "bench.toml"
    text = REFERENCE.read_text(encoding="utf-8")
    path.write_text(text + MOUNTING, encoding="utf-8")
    with pytest.raises(FileError, match=r"accelerometer\.mounting needs an arm table"):
        load_bench(path)


def test_a_bench_with_an_arm_and_its_levers_is_read_again_as_it_was_written(tmp_path):
    bench = mounted(tmp_path)
    again = type(bench).model_validate_json(bench.model_dump_json())
    assert again == bench
    assert not math.isnan(again.axis[5].tip_lever_m)


def test_where_the_other_axes_stand_turns_the_sensor_and_what_is_read_is_scaled_to_home(tmp_path):
    bench = mounted(tmp_path)
    assert bench.arm is not None
    assert bench.accelerometer.mounting is not None
    kinematics, of = Kinematics.of(bench.arm), bench.accelerometer.mounting.frame(bench.arm)
    standing = {3: -40.0, 5: 25.0}  # rad at the motors
    angles = np.tile(bench.arm.home_rad(), (len(TIME), 1))
    angles[:, 0] += 30.0 * np.sin(9.0 * TIME) / 120.0
    angles[:, 1:] += np.array([-40.0 / 100.0, 25.0 / 80.0])
    rates = np.zeros_like(angles)
    rates[:, 0] = -2430.0 * np.sin(9.0 * TIME) / 120.0
    speeds = np.zeros_like(angles)
    speeds[:, 0] = 270.0 * np.cos(9.0 * TIME) / 120.0
    true = acceleration(kinematics, angles, speeds, rates, of)
    felt = np.einsum("nji,nj->ni", kinematics.pose(angles, of)[1], true - np.array(bench.arm.gravity_m_s2))
    raw = recorded(bench, {2: 30.0 * np.sin(9.0 * TIME)}, felt)
    found = with_tip(bench, raw, standing)
    np.testing.assert_allclose(np.stack([found.columns[name] for name in TIP], axis=1), true, rtol=0.0, atol=1e-10)
    lever = float(np.linalg.norm(kinematics.jacobian(angles[0], of)[:3, 0]))
    assert abs(lever / bench.axis[2].tip_lever_m - 1.0) > 0.05
    np.testing.assert_allclose(found.felt_m_s2, bench.axis[2].tip_lever_m * rates[:, 0], rtol=0.0, atol=1e-10)
    assert float(np.max(np.abs(with_tip(bench, raw).felt_m_s2 - found.felt_m_s2))) > 0.5  # had they been taken to stand at home


def at_rest(bench, columns: np.ndarray | None = None, **believed: object) -> Recording:
    """What a sensor that is mounted as the bench says feels at rest, read as other values of its mounting would have it."""
    _, frame = Kinematics.of(bench.arm).pose(bench.arm.home_rad(), bench.accelerometer.mounting.frame(bench.arm))
    weight = np.tile(frame.T @ np.array([0.0, 0.0, 9.81]), (len(TIME), 1)) if columns is None else columns
    mounting = bench.accelerometer.mounting.model_copy(update=believed)
    sensor = bench.accelerometer.model_copy(update={"mounting": mounting})
    return with_tip(bench.model_copy(update={"accelerometer": sensor}), recorded(bench, {2: 0.0 * TIME}, weight))


def test_a_sensor_whose_weight_is_not_where_its_mounting_has_it_is_not_believed(tmp_path):
    bench = mounted(tmp_path)
    assert at_rest(bench).doubt is None
    assert at_rest(bench, rpy_deg=(0.0, 95.0, 0.0)).doubt is None  # a drawing may be 5 degrees off
    wrong = at_rest(bench, rpy_deg=(0.0, 0.0, 0.0))
    assert "shows gravity 90° off its mounting; at most 10° is allowed" in (wrong.doubt or "")
    with pytest.raises(ValueError, match="90° off its mounting"):
        check_range(bench, wrong)
    assert "which is gravity; state gravity = true" in (at_rest(bench, gravity=False).doubt or "")
    dead = at_rest(bench, np.zeros((len(TIME), 3)))
    assert "at rest the accelerometer shows 0.00 m/s², which is not gravity" in (dead.doubt or "")
    assert averaged([at_rest(bench), wrong]).doubt == wrong.doubt


def test_a_mounted_sensor_at_the_end_of_its_range_is_not_believed_whatever_direction_is_read(tmp_path):
    bench = mounted(tmp_path)
    columns = np.zeros((len(TIME), 3))
    columns[:, 0], columns[200:210, 1] = 9.81, 19.62  # of the range of 2 g
    assert "at the end of its range of 19.62 m/s² in 10 rows" in (at_rest(bench, columns).doubt or "")
    assert bench.accelerometer.free_range_m_s2 == pytest.approx(19.62 - 9.80665)  # its weight takes half of it
    assert load_bench("reference").accelerometer.free_range_m_s2 == 19.62
