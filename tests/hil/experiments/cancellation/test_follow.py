"""A cancellation that follows, as `hil run` has it: tried first, used where it is no louder, and told in the result."""

import numpy as np
import pytest

from hil.analysis import tip_scale
from hil.bench.bench import load_bench
from hil.bench.sensors import AccelerometerTable, LoadEncoderTable
from hil.errors import NotPossibleError
from hil.experiments.cancellation.cancellation import cancellation_for
from hil.experiments.cancellation.follow import following_of
from hil.experiments.cancellation.follow_trial import FollowRun, HeardOrder, try_following
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.master.set_point_adder import Sensed, SensingAdder
from hil.recording import Recording
from hil.report.writer import write_report_of
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.gear_change import ErrorChange
from plant_emulator.robots.robot import load_robot, with_drives
from plant_emulator.world import World

BENCH = load_bench("reference")
F_AL_HZ = 11.84


def off_by(degrees: float):
    """The bench with an error whose φ_k are wrong: a gear that has turned since it was identified."""
    table = BENCH.axis[2]
    ate = table.model.ate
    turned = ate.model_copy(update={"phi2_deg": ate.phi2_deg + degrees, "phi4_deg": ate.phi4_deg + degrees})
    model = table.model.model_copy(update={"ate": turned})
    return BENCH.model_copy(update={"axis": {**BENCH.axis, 2: table.model_copy(update={"model": model})}})


@pytest.mark.slow
def test_a_run_follows_an_error_that_has_turned_and_says_so(tmp_path):
    bench = off_by(30.0)
    channel = InProcessChannel(World(load_robot("reference")), is_logged=False)
    experiment = Experiment("constant-acceleration", 2, "cancellation-following")
    outcome = run_experiments(bench, [experiment], tmp_path, channel=channel)
    assert outcome.failure is None
    entry = outcome.result.runs[0].following
    assert entry.is_used, entry.words
    second = next(each for each in entry.orders if each.order == 2)
    assert second.turned_deg == pytest.approx(-30.0, abs=6.0)
    assert second.phase_start_deg == pytest.approx(252.0)
    assert len(second.time_s) == len(second.phase_deg) <= 201
    assert any("turned by" in remark for remark in outcome.remarks)
    window = {each.order: each for each in entry.peaks}
    assert window[2].following_mm < window[2].alone_mm
    page = write_report_of(tmp_path).read_text(encoding="utf-8")
    assert "amplitude and phase as the cancellation followed them" in page


def tip(amplitude: float) -> Recording:
    """A ramp whose tip swings at k θ of order 2."""
    time = np.arange(1500) * 0.002
    angle = 2.0 * np.pi * 2.0 * time**2
    columns = {"time_s": time, "tip_x_m_s2": 0.0 * time, "tip_y_m_s2": 0.0 * time, "tip_z_m_s2": amplitude * np.cos(2.0 * angle)}
    axis = {"reference_rad": angle, "position_rad": angle, "torque_nm": 0.0 * time, "notch_hz": 0.0 * time}
    return Recording({**columns, **{f"axis2_{name}": values for name, values in axis.items()}})


def tried(following: float, left: float, *, moves: bool = True):
    """Its trial where the tip swings so much in it, and the observer, while it listens, hears so much left."""

    def run(follows: bool) -> FollowRun:
        return FollowRun(tip(following if follows else 0.4), [HeardOrder(2, 2, left, follows and moves)])

    return try_following(BENCH, tip_scale(F_AL_HZ), run)


def test_what_makes_the_tip_quieter_follows_from_the_usual_on():
    entry, begins = tried(0.2, 0.3)
    assert entry.is_used
    assert begins == {(2, 2): 0.0}
    assert entry.begins == ()


@pytest.mark.parametrize("following", [0.4, 0.7])
def test_what_moves_and_does_not_help_keeps_still_unless_the_gear_changes(following):
    entry, begins = tried(following, 0.1)
    assert entry.is_used
    assert begins == {(2, 2): pytest.approx(0.15)}
    assert "axis 2, order 2 is followed if more than 15 % of it remains" in entry.begins[0].words


@pytest.mark.parametrize(("following", "words"), [(0.4, "does not fall in any window"), (0.7, "rises from")])
def test_what_could_only_follow_the_motion_s_own_is_refused(following, words):
    entry, _ = tried(following, 0.5)
    assert not entry.is_used
    assert words in entry.words


def test_what_nearly_begins_has_room_for_another_run():
    entry, begins = tried(0.4, 0.05, moves=False)
    assert entry.is_used
    assert begins == {(2, 2): pytest.approx(0.075)}


def test_with_several_axes_and_no_accelerometer_it_is_refused_with_what_to_do_instead():
    sensor = AccelerometerTable(from_load_encoders=True)
    axes = {n: each.model_copy(update={"load_encoder": LoadEncoderTable(counts_per_rev=2**20)}) for n, each in BENCH.axis.items()}
    bench = BENCH.model_copy(update={"accelerometer": sensor, "axis": axes})
    motion = line_motion(bench, 0.002)
    with pytest.raises(NotPossibleError, match="if that axis moves alone; choose --treatment cancellation"):
        following_of(bench, None, cancellation_for(bench, None, motion.axes, 0.002), motion)


@pytest.mark.slow
def test_without_an_accelerometer_the_joint_s_encoder_is_followed(tmp_path):
    """A gear that has turned by 25° since, and turns on during the runs by the robot's own `ate_change`."""
    robot = with_drives(load_robot("reference"), load_encoder_bits=20)
    change = ErrorChange(phase_drift_deg_min=4.0)
    robot = robot.model_copy(update={"axis": {**robot.axis, 2: robot.axis[2].model_copy(update={"ate_change": (change,)})}})
    turned = off_by(-25.0).axis[2].model_copy(update={"load_encoder": LoadEncoderTable(counts_per_rev=2**20)})
    sensor = AccelerometerTable(from_load_encoders=True)
    bench = BENCH.model_copy(update={"accelerometer": sensor, "axis": {2: turned}, "geometry": None, "line_motion": None})
    experiment = Experiment("constant-acceleration", 2, "cancellation-following")
    outcome = run_experiments(bench, [experiment], tmp_path, channel=InProcessChannel(World(robot), is_logged=False))
    assert outcome.failure is None
    entry = outcome.result.runs[0].following
    assert entry.is_used, entry.words
    second = next(each for each in entry.orders if each.order == 2)
    assert second.turned_deg == pytest.approx(30.0, abs=8.0)
    window = {each.order: each for each in entry.peaks}
    assert window[2].following_mm < window[2].alone_mm


@pytest.mark.slow
def test_the_adder_listens_and_begins_with_what_was_identified():
    motion = constant_acceleration(BENCH, 2, 0.002)
    cancellation = cancellation_for(BENCH, None, (2,), 0.002)
    adder, plain = following_of(BENCH, None, cancellation, motion).adder(), cancellation.adder()
    assert isinstance(adder, SensingAdder)
    assert not isinstance(plain, SensingAdder)
    assert adder.followed() == ()
    for row in range(200):
        angle = [float(motion.motor_angle_rad[row, 0])]
        adder.sense(Sensed((0.0, 0.0, 0.0) if row % 7 else None, row))
        assert adder.step(angle, angle, [0.0]) == plain.laws.step(angle, [0.0])
    first = adder.followed()[0]
    assert (first.axis, first.order, first.turned_deg, first.amplitude_end_arcsec) == (2, 2, 0.0, pytest.approx(5.0))


def test_a_line_has_levers_that_change_along_it():
    motion = line_motion(BENCH, 0.002)
    cancellation = cancellation_for(BENCH, None, motion.axes, 0.002)
    levers = following_of(BENCH, None, cancellation, motion).levers_m
    assert levers.shape == (len(motion.time_s), len(cancellation.tables))
    assert np.ptp(levers[:, 0]) > 0.01


def test_an_arm_of_links_is_refused_with_what_to_do_instead():
    arm = load_bench("reference-arm")
    motion = line_motion(arm, arm.bus.sync_period_s)
    cancellation = cancellation_for(BENCH, None, (2,), 0.002)
    with pytest.raises(NotPossibleError, match="choose --treatment cancellation"):
        following_of(arm, None, cancellation, motion)
