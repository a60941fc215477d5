"""A bench without an accelerometer: over the bus, the encoder on the joint is recorded, identifies, and judges."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from drive_profiles.family.profile import Profile
from hil.bench.bench import load_bench
from hil.bench.model import load_identified
from hil.bench.sensors import AccelerometerTable, LoadEncoderTable
from hil.control.order_keys import phase_key
from hil.errors import NodeError, NotPossibleError
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.recorded.identify import identify_recorded
from hil.experiments.ate.recorded.request import RecordedRequest
from hil.experiments.ate.request import AteRequest
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.plan import Experiment
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.master.drive import mapping
from hil.master.session import Session
from hil.plan.check import plan_cycle
from hil.recording import BusLog
from hil.recordings.layout import Said
from hil.tip_vector import displacement_mm, tip_acceleration
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.robots.encoders import LoadEncoder
from plant_emulator.robots.robot import load_robot, with_drives
from plant_emulator.world import World

pytestmark = pytest.mark.ci

EXAMPLE = Path(__file__).parents[2] / "examples" / "load-encoder.toml"
ROBOT = with_drives(load_robot("reference"), load_encoder_bits=20)


def robot(**keys):
    """The reference robot with another encoder on joint 2."""
    axis = ROBOT.axis[2].model_copy(update={"load_encoder": LoadEncoder(**{"counts_per_rev": 2**20, **keys})})
    return ROBOT.model_copy(update={"axis": {**ROBOT.axis, 2: axis}})


def by_frames(world):
    """A bus whose frames somebody looks at one by one: then no cycle is a message."""
    channel = InProcessChannel(world)
    channel.heard = lambda frame, end_ns: None
    return channel


def run(of, bench, channel=InProcessChannel, filters="none"):
    short = bench.constant_acceleration.model_copy(update={"acceleration_rps_s": 12.0, "end_rps": 6.0, "tail_s": 0.1})
    bench = bench.model_copy(update={"constant_acceleration": short, "settle_s": 0.1})
    world = World(of)
    with Session(bench, channel(world), BusLog(None)) as session:
        session.bring_up()
        return session.run(constant_acceleration(bench, 2, 0.002), filters, "drive")


@pytest.mark.ci
def test_a_run_records_the_joint_to_the_last_bit_of_its_encoder():
    recording = run(ROBOT, load_bench(EXAMPLE)).recording
    joint, motor = recording.axis(2, "load_rad"), recording.axis(2, "position_rad") / 120.0
    counts = joint * 2**20 / math.tau
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    apart = joint - motor
    assert np.ptp(joint) > 0.05
    assert 2e-5 < np.ptp(apart) < 2e-3  # wind-up, ringing and transmission error, not nothing
    felt = recording.columns["tip_z_m_s2"]
    assert np.std(felt) > 0.05


def test_in_messages_it_is_the_same_to_the_bit_as_frame_by_frame():
    over_bus, direct = (run(robot(noise_arcsec=0.5), load_bench(EXAMPLE), kind) for kind in (by_frames, InProcessChannel))
    assert list(over_bus.recording.columns) == list(direct.recording.columns)
    for name, column in over_bus.recording.columns.items():
        np.testing.assert_array_equal(direct.recording.columns[name], column, err_msg=name)


def test_beside_an_accelerometer_and_a_filter_s_state_it_goes_into_the_third_pdo():
    bench, encoder = load_bench("reference"), load_bench(EXAMPLE).axis[2].load_encoder
    axis = bench.axis[2].model_copy(update={"load_encoder": encoder})
    bench = bench.model_copy(update={"axis": {**bench.axis, 2: axis}})
    columns = run(ROBOT, bench, filters="notch").recording.columns
    assert {"axis2_load_rad", "axis2_notch_hz", "tip_z_m_s2"} <= columns.keys()
    frames = {frame.name: frame.can_id for frame in plan_cycle(bench, (2,), "drive", 0.002, notch_state=True).frames}
    assert frames["axis 2 load position"] == 0x382
    frames = {frame.name: frame.can_id for frame in plan_cycle(bench, (2,), "drive", 0.002, notch_state=False).frames}
    assert frames["axis 2 load position"] == 0x282


def test_a_joint_that_passes_the_end_of_a_turn_goes_on():
    """60E4h as a single turn would show it: the recording has no jump of 2π."""
    of = robot(offset_deg=179.99)
    joint = run(of, load_bench(EXAMPLE)).recording.axis(2, "load_rad")
    assert np.max(np.abs(np.diff(joint))) < 0.01


def test_an_encoder_that_counts_the_wrong_way_is_refused_and_as_the_file_says_it_is_right():
    bench = load_bench(EXAMPLE)
    with pytest.raises(NotPossibleError, match="it counts the wrong way; "):
        run(robot(is_reversed=True), bench)
    encoder = bench.axis[2].load_encoder.model_copy(update={"is_reversed": True})
    turned = bench.model_copy(update={"axis": {2: bench.axis[2].model_copy(update={"load_encoder": encoder})}})
    assert run(robot(is_reversed=True), turned).stopped is None


def test_other_steps_than_the_drive_says_are_refused_before_anything_moves():
    with pytest.raises(NodeError, match=r"131072/1 steps per revolution .*counts_per_rev is 1048576"):
        run(robot(counts_per_rev=2**17), load_bench(EXAMPLE))


def test_a_drive_without_the_object_is_named_before_anything_is_written():
    with pytest.raises(NodeError, match="60E4:1 position of the second encoder"):
        run(load_robot("reference"), load_bench(EXAMPLE))


def test_on_a_line_three_joints_tell_what_an_accelerometer_feels():
    bench, felt = load_bench("reference"), []
    encoder = LoadEncoderTable(counts_per_rev=2**20)
    axes = {number: axis.model_copy(update={"load_encoder": encoder}) for number, axis in bench.axis.items()}
    for sensor in (bench.accelerometer, AccelerometerTable(from_load_encoders=True)):
        each = bench.model_copy(update={"axis": axes, "accelerometer": sensor})
        with Session(each, InProcessChannel(World(ROBOT)), BusLog(None)) as session:
            session.bring_up()
            recording = session.run(line_motion(each, 0.002), "none", "drive").recording
        tip = np.stack([recording.columns[name] for name in ("tip_x_m_s2", "tip_z_m_s2")])
        felt.append(signal.sosfiltfilt(signal.butter(2, (6.0, 25.0), "bandpass", fs=500.0, output="sos"), tip)[:, 250:-200])
    by_sensor, by_encoders = felt
    assert np.all(np.std(by_sensor, axis=1) > 0.1)
    # the accelerometer's own noise of 0.02 m/s² is in the band as well
    assert np.all(np.std(by_encoders - by_sensor, axis=1) < 0.05 * np.std(by_sensor, axis=1))


def faulty(*faults):
    """A channel to the robot at 1 Mbit/s on which frames are lost."""
    world = World(ROBOT)
    return InProcessChannel(world, medium_for(world, 1_000_000, faults=BusFaults(faults)))


def ramp(bench, channel):
    """The short ramp of `run` on a channel."""
    short = bench.constant_acceleration.model_copy(update={"acceleration_rps_s": 12.0, "end_rps": 6.0, "tail_s": 0.1})
    bench = bench.model_copy(update={"constant_acceleration": short, "settle_s": 0.1})
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        return session.run(constant_acceleration(bench, 2, 0.002), "none", "drive")


LOAD_TPDO = 0x282


def test_lost_answers_of_the_encoder_are_counted_and_shake_no_tip():
    """A count that is held for a cycle would be a step of the joint, ten times the vibration."""
    bench = load_bench(EXAMPLE)
    whole, lossy = ramp(bench, faulty()), ramp(bench, faulty(Fault(kind="drop", can_id=LOAD_TPDO, every=250)))
    assert lossy.stopped is None
    gaps = np.isnan(lossy.recording.axis(2, "load_rad"))
    assert np.count_nonzero(gaps) == lossy.sensor_missed == lossy.missed_cycles > 1
    assert whole.sensor_missed == 0
    np.testing.assert_array_equal(lossy.recording.columns["missing"], gaps.astype(float))
    felt, bridged = (each.recording.columns["tip_z_m_s2"] for each in (whole, lossy))
    assert np.max(np.abs(bridged - felt)) < 0.25 * np.max(np.abs(felt))
    assert lossy.recording.doubt is None


@pytest.mark.slow
def test_a_run_that_lacks_too_much_of_its_encoder_is_not_judged(tmp_path, without_pictures):
    bench = load_bench(EXAMPLE)
    channel = faulty(Fault(kind="drop", can_id=LOAD_TPDO, every=50))
    outcome = run_experiments(bench, [Experiment("constant-acceleration", 2, "none")], tmp_path, channel=channel)
    run_entry = outcome.result.runs[0]
    assert run_entry.within_spec is None
    assert "the encoder on the joint was missing in" in run_entry.invalid


def test_an_encoder_that_is_silent_for_a_while_is_not_believed():
    lossy = ramp(load_bench(EXAMPLE), faulty(Fault(kind="drop", can_id=LOAD_TPDO, from_s=1.0, count=6)))
    assert lossy.stopped is None
    assert "axis 2 did not answer in 6 cycles in a row; at most 3 are allowed" in lossy.recording.doubt


def by_joints(name):
    """A bench with an encoder on every joint and no sensor."""
    bench, encoder = load_bench(name), LoadEncoderTable(counts_per_rev=2**20)
    axes = {number: axis.model_copy(update={"load_encoder": encoder}) for number, axis in bench.axis.items()}
    return bench.model_copy(update={"axis": axes, "accelerometer": AccelerometerTable(from_load_encoders=True)})


def short_line(bench):
    """A third of the line in a third of its time."""
    line = bench.line_motion
    end = line.end_m.model_copy(update={"x": line.start_m.x + (line.end_m.x - line.start_m.x) / 3.0})
    short = line.model_copy(update={"end_m": end, "duration_s": line.duration_s / 3.0, "tail_s": 0.3})
    return bench.model_copy(update={"line_motion": short, "settle_s": 0.1})


ARM = with_drives(load_robot("reference-arm"), load_encoder_bits=20)


@pytest.mark.slow
def test_on_an_arm_all_joints_tell_what_an_accelerometer_feels_at_the_tip():
    felt = []
    with_sensor = load_bench("reference-arm")
    for bench in (short_line(with_sensor), short_line(by_joints("reference-arm"))):
        with Session(bench, InProcessChannel(World(ARM)), BusLog(None)) as session:
            session.bring_up()
            result = session.run(line_motion(bench, 0.002), "none", "drive")
        felt.append(displacement_mm(tip_acceleration(result.recording), 0.002, (6.0, 25.0)))
    by_sensor, by_encoders = felt
    assert {f"axis{number}_load_rad" for number in range(1, 7)} <= result.recording.columns.keys()
    assert result.recording.axes == (2, 3, 5)
    assert np.max(np.abs(by_sensor)) > 0.02
    middle = slice(100, -100)
    assert np.max(np.abs(by_encoders - by_sensor)[middle]) < 0.05 * np.max(np.abs(by_sensor))


def test_joints_that_only_watch_are_the_same_to_the_bit_without_frames_and_left_as_they_were():
    bench, recordings = by_joints("reference-arm"), []
    short = bench.constant_acceleration.model_copy(update={"acceleration_rps_s": 12.0, "end_rps": 3.0, "tail_s": 0.1})
    bench = bench.model_copy(update={"constant_acceleration": short, "settle_s": 0.1})
    for kind in (by_frames, InProcessChannel):
        world = World(ARM)
        before = [world.drives[5].slave.dictionary.cell(index, 1).current() for index in (0x1800, 0x1801, 0x1802)]
        channel = kind(world)
        with Session(bench, channel, BusLog(None)) as session:
            session.bring_up()
            recordings.append(session.run(constant_acceleration(bench, 2, 0.002), "none", "drive").recording)
            assert not session.not_restored
        assert before == [world.drives[5].slave.dictionary.cell(index, 1).current() for index in (0x1800, 0x1801, 0x1802)]
    over_bus, direct = recordings
    assert over_bus.axes == (2,)
    assert np.ptp(over_bus.columns["axis5_load_rad"]) > 0.0, "braked, it swings on its gear"
    for name, column in over_bus.columns.items():
        np.testing.assert_array_equal(direct.columns[name], column, err_msg=name)


def test_six_encoders_of_an_arm_are_counted_on_the_bus_also_of_joints_that_only_watch():
    frames = plan_cycle(by_joints("reference-arm"), (2,), "drive", 0.002, notch_state=False).frames
    assert [frame.can_id for frame in frames if frame.kind == "load position"] == [0x282, 0x281, 0x283, 0x284, 0x285, 0x286]


@pytest.mark.slow
def test_the_recording_of_a_run_is_read_through_the_arm_where_its_plant_is_known_and_else_with_honest_errors(tmp_path):
    """A ramp through the resonance: two encoders alone see the arm's answer there, half a turn from the gear's error."""
    bench = by_joints("reference")
    with Session(bench, InProcessChannel(World(ROBOT)), BusLog(None)) as session:
        session.bring_up()
        recording = session.run(constant_acceleration(bench, 2, 0.002), "none", "drive", shows_filter=False).recording
    recording.columns["axis2_load_rad"][900] = math.nan  # an answer that was lost
    path, true = tmp_path / "run.csv", ROBOT.axis[2].ate
    recording.save(path)
    told = identify_recorded(RecordedRequest((path,), 2, Said()), tmp_path / "told", bench)
    assert told.form == "tip acceleration"
    plain = identify_recorded(RecordedRequest((path,), 2, Said(reduction_ratio=120.0)), tmp_path / "plain")
    assert plain.form == "two encoders"
    for found in (told, plain):
        for order in (2.0, 4.0):
            value, error = found.ate.values.phases_deg()[order], found.ate.standard_error[phase_key(order)]
            off = (value - true.phases_deg()[order] + 180.0) % 360.0 - 180.0
            assert abs(off) < 4.0 * error, (found.form, order)
    assert told.ate.values.a2_arcsec == pytest.approx(true.a2_arcsec, rel=0.03)
    assert told.ate.values.phi2_deg == pytest.approx(true.phi2_deg, abs=2.0)
    assert told.is_identified
    assert plain.ate.standard_error["phi2_deg"] > 20.0


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{}, {"offset_deg": 77.0, "noise_arcsec": 0.3}])
def test_without_an_accelerometer_twenty_bits_on_the_joint_quiet_the_tip_by_twenty_decibels(tmp_path, keys):
    """Identified by the joint's encoder alone, nothing known before; the tip is the true one."""
    of, bench = robot(**keys), load_bench(EXAMPLE)
    model = tmp_path / "model.toml"
    run_identify_plant(
        bench, PlantRequest(2), tmp_path / "plant", model=model, channel=InProcessChannel(World(of), is_logged=False)
    )
    known = load_identified(model)
    part = identify_ate(bench, AteRequest(2), tmp_path / "ate", known, channel=InProcessChannel(World(of), is_logged=False)).part
    true = of.axis[2].ate
    assert part.values.a2_arcsec == pytest.approx(true.a2_arcsec, rel=0.02)
    assert part.values.phi2_deg == pytest.approx(true.phi2_deg, abs=1.0)
    assert part.arm_hz == pytest.approx(12.449, abs=0.05)
    with_sensor = bench.model_copy(update={"accelerometer": AccelerometerTable(node_id=16)})
    survey = Survey(of, with_sensor, 2)
    before = survey.tip("none", Knowledge())
    after = survey.cancelled(known.with_part(2, part), ())
    left_db = {order: 20.0 * math.log10(after[order] / before[order]) for order in (2, 4)}
    assert max(left_db.values()) < -20.0, left_db


@pytest.mark.parametrize(
    ("family", "address"), [("maxon_epos4", (0x60E4, 2)), ("zeroerr_erob", (0x20A0, 0)), ("kollmorgen_akd", (0x60E4, 1))]
)
def test_a_drive_of_another_family_shows_it_where_its_profile_says(family, address):
    world = World(with_drives(ROBOT, {2: family}))
    drive = world.drives[2]
    drive.axes.plant_state[drive.row]["arm_angle_rad"] = 0.25
    shown = drive.slave.dictionary.cell(*address).current()
    assert shown == round(0.25 * 2**20 / math.tau)
    table = load_bench(EXAMPLE).axis[2]
    table = table.model_copy(update={"load_encoder": table.load_encoder.model_copy(update={"object": None})})
    [mapped] = mapping.load_position(table, Profile.load(family))
    assert (mapped.index, mapped.subindex) == address
