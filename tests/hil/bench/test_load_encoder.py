"""Encoders on the joints: how they must count, and the tip that they tell where no sensor is."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from drive_profiles.files.toml import FileError
from hil.arm.kinematics import Kinematics
from hil.bench.bench import load_bench
from hil.bench.load_encoder import (
    LONGEST_GAP_ROWS,
    by_load_encoders,
    second_derivative,
    tip_of_joints,
    watched_axes,
    with_load_encoders,
)
from hil.bench.sensors import AccelerometerTable, LoadEncoderTable
from hil.bench.tip import with_tip
from hil.errors import NotPossibleError
from hil.recording import Recording

EXAMPLE = Path(__file__).parents[3] / "examples" / "load-encoder.toml"
T = 0.002


def recording(bench, scale=1.0, travel_rev=4.0, more=0.0):
    """A smooth motion of axis 2 there; its joint's encoder has turned `scale` times as far, and `more` besides."""
    time = T * np.arange(1500)
    motor = math.tau * travel_rev * 0.5 * (1.0 - np.cos(math.pi * np.clip((time - 0.3) / 2.4, 0.0, 1.0)))
    load = scale * motor / bench.axis[2].reduction_ratio + more
    counted = np.round(load / bench.axis[2].load_encoder.rad_per_count) * bench.axis[2].load_encoder.rad_per_count
    zero = np.zeros_like(time)
    columns = {"time_s": time, "axis2_position_rad": motor, "axis2_load_rad": counted}
    return Recording({**columns, "tip_x_m_s2": zero, "tip_y_m_s2": zero, "tip_z_m_s2": zero})


def changed(tmp_path, *replacements):
    text = EXAMPLE.read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "bench.toml").write_text(text)
    return tmp_path / "bench.toml"


@pytest.mark.parametrize("hz", [5.0, 12.0, 30.0])
def test_the_tip_is_the_lever_times_the_second_derivative_of_the_joint(hz):
    """A burst in the band: exact, where differences of neighbours lose (π f T)²/3."""
    bench = load_bench(EXAMPLE)
    time = T * np.arange(1500)
    envelope = np.exp(-(((time - 1.5) / 0.3) ** 2))
    burst = 1e-4 * envelope * np.sin(math.tau * hz * time)
    fine = np.arange(0.0, 3.0, T / 50)
    shape = 1e-4 * np.exp(-(((fine - 1.5) / 0.3) ** 2)) * np.sin(math.tau * hz * fine)
    exact = np.gradient(np.gradient(shape, T / 50), T / 50)[::50]
    of = recording(bench, travel_rev=0.0, more=burst)
    z = tip_of_joints(bench, of, {2: of.axis(2, "load_rad")})[:, 2]
    noise = 0.15  # of 20 bits, on 0.7 m
    assert np.max(np.abs(z - 0.70 * exact)) < noise + 0.01 * 0.70 * np.max(np.abs(exact))
    clean = second_derivative(burst, T)
    assert np.max(np.abs(clean - exact)) < 5e-3 * np.max(np.abs(exact)) * (1.0 if hz < 20.0 else 2.0)


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (-1.0, "counts the wrong way; state load_encoder.is_reversed = true"),
        (120.0 / 101.0, r"correct reduction_ratio to 101, or load_encoder.counts_per_rev from 1048576 to 124\d{4}"),
        (0.0, "does not move; load_encoder.object may be"),
        (2.0, "correct reduction_ratio to 60, "),
    ],
)
def test_an_encoder_that_contradicts_the_motor_is_refused_with_the_numbers(scale, words):
    bench = load_bench(EXAMPLE)
    with pytest.raises(NotPossibleError, match=words) as refused:
        with_load_encoders(bench, recording(bench, scale))
    assert "axis 2: the load encoder turned" in str(refused.value)
    assert "12.00° of travel" in str(refused.value)
    assert refused.value.exit_code == 3


def test_wind_up_and_a_short_travel_accuse_no_encoder():
    bench = load_bench(EXAMPLE)
    wound = 1e-3 * np.sin(np.linspace(0.0, math.pi, 1500))
    with_load_encoders(bench, recording(bench, more=wound))
    with_load_encoders(bench, recording(bench, scale=-1.0, travel_rev=0.01))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("from_load_encoders = true", "", "needs either a node_id on the bus or a serial table"),
        ("from_load_encoders = true", "from_load_encoders = true\nnode_id = 16", "needs either a node_id"),
        ("from_load_encoders = true", "from_load_encoders = true\nrange_m_s2 = 19.6", "excludes range_m_s2"),
        ("counts_per_rev = 1048576", "counts_per_rev = 12", "counts_per_rev"),
        ('object = "60E4:1"', 'object = "additional"', "object"),
        ("[axis.2.load_encoder]\ncounts_per_rev = 1048576", "", "object"),
    ],
)
def test_a_bench_file_that_contradicts_itself_is_refused(tmp_path, old, new, words):
    with pytest.raises(FileError, match=re.escape(words)):
        load_bench(changed(tmp_path, (old, new)))


def test_an_axis_without_an_encoder_would_move_unseen(tmp_path):
    text = EXAMPLE.read_text()
    at = text.index("[axis.2.load_encoder]")
    (tmp_path / "bench.toml").write_text(text[:at] + text[text.index("[constant_acceleration]") :])
    with pytest.raises(FileError, match="axis 2 has no load_encoder table; every axis needs one"):
        load_bench(tmp_path / "bench.toml")


def test_an_encoder_may_stand_in_for_a_sensor_that_is_there():
    bench = load_bench("reference")
    with pytest.raises(NotPossibleError, match="axis 2 has no second encoder"):
        by_load_encoders(bench, [2])
    encoder = load_bench(EXAMPLE).axis[2].load_encoder
    both = bench.model_copy(update={"axis": {2: bench.axis[2].model_copy(update={"load_encoder": encoder})}})
    assert by_load_encoders(both, [2]).accelerometer.from_load_encoders
    arm = load_bench("reference-arm")
    axes = {n: axis.model_copy(update={"load_encoder": encoder}) for n, axis in arm.axis.items()}
    arm = arm.model_copy(update={"axis": axes})
    assert by_load_encoders(arm, [2]).accelerometer.from_load_encoders
    axes[5] = axes[5].model_copy(update={"load_encoder": None})
    with pytest.raises(NotPossibleError, match="axis 5 has no second encoder, and on an arm every joint vibrates"):
        by_load_encoders(arm.model_copy(update={"axis": axes}), [2])


def arm_by_joints():
    """The reference arm's bench with an encoder on every joint and no sensor."""
    arm, encoder = load_bench("reference-arm"), LoadEncoderTable(counts_per_rev=2**20)
    axes = {n: axis.model_copy(update={"load_encoder": encoder}) for n, axis in arm.axis.items()}
    return arm.model_copy(update={"axis": axes, "accelerometer": AccelerometerTable(from_load_encoders=True)})


def test_of_an_arm_every_joint_is_recorded_and_of_other_benches_those_that_move():
    assert watched_axes(arm_by_joints(), (2, 3)) == (1, 4, 5, 6)
    assert watched_axes(load_bench("reference-arm"), (2, 3)) == ()
    assert watched_axes(load_bench(EXAMPLE), (2,)) == ()


def test_a_joint_that_does_not_move_swings_the_tip_of_an_arm_as_its_jacobian_says():
    """Axis 5 is braked and swings by 20″: the tip moves by its lever, wherever its encoder counts from."""
    bench, time = arm_by_joints(), T * np.arange(1500)
    swing = 1e-4 * np.exp(-(((time - 1.5) / 0.3) ** 2)) * np.sin(math.tau * 12.0 * time)
    zero = np.zeros_like(time)
    columns = {"time_s": time, "axis2_position_rad": zero, "axis2_load_rad": zero + 0.3}
    columns |= {f"axis{n}_load_rad": zero - 1.0 for n in (1, 3, 4, 6)} | {"axis5_load_rad": 2.0 + swing}
    made = Recording(columns | dict.fromkeys(("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2"), zero))
    told = with_tip(bench, with_load_encoders(bench, made, {}))
    found = np.stack([told.columns[name] for name in ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2")], axis=1)
    lever = Kinematics.of(bench.arm).jacobian(bench.arm.home_rad())[:3, bench.arm.axes.index(5)]
    exact = np.outer(second_derivative(swing, T), lever)
    assert np.max(np.abs(found - exact)) < 2e-3 * np.max(np.abs(exact))
    assert told.axes == (2,)


def lossy(bench, first, count):
    """A motion with a swing, of which some answers of the encoder are lost."""
    time = T * np.arange(1500)
    swing = 1e-4 * np.exp(-(((time - 1.5) / 0.3) ** 2)) * np.sin(math.tau * 12.0 * time)
    made = recording(bench, more=swing)
    load = made.columns["axis2_load_rad"].copy()
    load[first : first + count] = math.nan
    return made, Recording(made.columns | {"axis2_load_rad": load})


@pytest.mark.parametrize("first", [0, 700, 1497])
def test_a_lost_answer_of_the_encoder_is_no_standstill_of_the_joint(first):
    """Held counts would be a step of 0.4 mm at the tip, five times the vibration; the gap is bridged, and stays a gap."""
    bench = load_bench(EXAMPLE)
    whole, gap = lossy(bench, first, LONGEST_GAP_ROWS)
    told, true = with_load_encoders(bench, gap), with_load_encoders(bench, whole)
    assert told.doubt is None
    assert np.count_nonzero(np.isnan(told.columns["axis2_load_rad"])) == LONGEST_GAP_ROWS
    off = told.columns["tip_z_m_s2"] - true.columns["tip_z_m_s2"]
    assert np.max(np.abs(off)) < 0.25 * np.max(np.abs(true.columns["tip_z_m_s2"]))


def test_an_encoder_that_is_silent_for_long_is_not_believed():
    bench = load_bench(EXAMPLE)
    _, gap = lossy(bench, 700, LONGEST_GAP_ROWS + 1)
    assert "axis 2 did not answer in 4 cycles in a row; at most 3 are allowed" in with_load_encoders(bench, gap).doubt
    _, dead = lossy(bench, 0, 1500)
    assert with_load_encoders(bench, dead).doubt == "the second encoder of axis 2 has not answered: check its cable and supply"
