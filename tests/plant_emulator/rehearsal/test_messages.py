"""A run whose cycles are messages records what it does frame by frame, to the bit."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from drive_profiles.address import Address, parse_address
from drive_profiles.files.toml import loads
from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, IdentifiedError
from hil.can.opening import open_channel
from hil.core.library import CORE
from hil.errors import NotPossibleError
from hil.experiments.bus_demand import BusDemand, check_load
from hil.experiments.cancellation.cancellation import cancellation_of, cancellation_on
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.treatment import Knowledge
from hil.master import cyclic
from hil.master.session import Session
from hil.recording import BusLog
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

FAST = {"acceleration_rps_s": 12.0, "end_rps": 6.0, "tail_s": 0.1}


def short(bench):
    motion = bench.constant_acceleration.model_copy(update=FAST)
    return bench.model_copy(update={"constant_acceleration": motion, "settle_s": 0.1})


def sessions(robot, bench, log_of=lambda number: BusLog(None)):
    """The same robot three times: frame by frame, in messages, and in cycles of C alone."""
    by_frames, in_messages = InProcessChannel(World(robot)), InProcessChannel(World(robot))
    by_frames.heard = lambda frame, end_ns: None  # somebody looks at every frame
    for number, channel in enumerate((by_frames, in_messages, InProcessChannel(World(robot), is_logged=False))):
        yield Session(bench, channel, log_of(number))


def recorded(robot, bench, motion, filters="none", *, loop="drive", cancels=False, runs=1):
    """Columns of the last of some runs, of each kind of session."""
    found = []
    for session in sessions(robot, bench):
        with session:
            session.bring_up()
            for _ in range(runs):
                adder = cancellation_on(session, None, motion).adder() if cancels else None
                result = session.run(motion, filters, loop, adder)
            found.append(result)
    return found


def assert_same(results):
    over_bus, *others = results
    assert over_bus.stopped is None
    for direct in others:
        assert direct.stopped is None
        assert list(direct.recording.columns) == list(over_bus.recording.columns)
        for name, column in over_bus.recording.columns.items():
            np.testing.assert_array_equal(direct.recording.columns[name], column, err_msg=name)
        assert replace(direct, recording=None, wall_s=0.0) == replace(over_bus, recording=None, wall_s=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{}, {"filters": "notch"}, {"cancels": True}, {"runs": 2}], ids=["plain", "notch", "cancellation", "second run"]
)
def test_a_recording_without_frames_is_that_over_the_bus_to_the_bit(options):
    bench = short(load_bench("reference"))
    assert_same(recorded(load_robot("reference"), bench, constant_acceleration(bench, 2, 0.002), **options))


@pytest.mark.ci
def test_torque_offsets_reach_the_drive_without_frames_too():
    bench = short(load_bench("reference"))
    motion = constant_acceleration(bench, 2, 0.002)
    torque = 0.4 * np.sin(40.0 * motion.time_s)[:, np.newaxis]
    results = recorded(load_robot("reference"), bench, replace(motion, torque_offset_nm=torque))
    assert_same(results)
    plain = recorded(load_robot("reference"), bench, motion)[1]
    assert np.max(np.abs(results[1].recording.axis(2, "torque_nm") - plain.recording.axis(2, "torque_nm"))) > 0.1


def test_several_axes_move_without_frames_as_they_do_over_the_bus():
    bench = short(load_bench("reference"))
    motion = line_motion(bench, 0.004)
    there = motion.motor_angle_rad[:100]
    angle = np.concatenate([there, 2.0 * there[-1:] - there[-2::-1]])  # a part of it, and to rest as it began
    part = replace(motion, time_s=motion.time_s[:199], motor_angle_rad=angle)
    assert_same(recorded(load_robot("reference"), bench, part))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 9])
def test_a_drawn_robot_with_a_slow_sensor_and_late_answers_is_the_same_without_frames(seed):
    robot = draw(seed)
    bench = short(loads(blank_bench(robot), Bench)).on("local:/tmp/robot.sock")
    assert robot.accelerometer.filters
    assert_same(recorded(robot, bench, constant_acceleration(bench, 2, robot.sync_period_s)))


def test_a_limit_that_is_broken_stops_a_run_without_frames_in_the_words_of_the_drive():
    robot, bench = load_robot("reference"), short(load_bench("reference"))
    limits = bench.axis[2].limits.model_copy(update={"following_error_rev": 0.05, "following_error_timeout_s": 0.02})
    table = bench.axis[2].model_copy(update={"limits": limits})
    bench = bench.model_copy(update={"axis": {**bench.axis, 2: table}})
    over_bus, *others = recorded(robot, bench, constant_acceleration(bench, 2, 0.002))
    for direct in others:
        assert direct.stopped is not None
        assert direct.stopped.reason == over_bus.stopped.reason
        assert direct.stopped.all_disabled
        assert direct.cycles == over_bus.cycles


def test_cycles_of_c_alone_leave_few_to_python(monkeypatch):
    bench, robot, messages, in_frames = short(load_bench("reference")), load_robot("reference"), [], []
    send, send_all = InProcessChannel.send_message, InProcessChannel.send_all
    monkeypatch.setattr(InProcessChannel, "send_message", lambda self, records: (messages.append(self), send(self, records)))
    monkeypatch.setattr(InProcessChannel, "send_all", lambda self, frames: (in_frames.append(self), send_all(self, frames)))
    *_, by_messages, alone = recorded(robot, bench, constant_acceleration(bench, 2, 0.002))
    assert by_messages.cycles == alone.cycles
    logged = sum(channel.is_logged for channel in messages)
    assert len(messages) - logged < 0.1 * logged
    assert sum(not channel.is_logged for channel in in_frames) < 0.01 * logged, "a heartbeat leaves the next cycle to messages"


def test_the_log_of_a_run_is_the_same_frame_by_frame_in_messages_and_in_cycles_of_c_alone(tmp_path):
    bench, robot, logs = short(load_bench("reference")), load_robot("reference"), []
    motion = constant_acceleration(bench, 2, 0.002)
    for number, session in enumerate(sessions(robot, bench, lambda number: BusLog(tmp_path / str(number)))):
        with session:
            session.bring_up()
            assert session.run(motion, "none", "drive").stopped is None
        lines = (tmp_path / str(number)).read_text().splitlines()
        logs.append([line for line in lines if " 70" not in line])  # a heartbeat may come with a SYNC's answers, or after them
    assert sum(" 080#" in line for line in logs[0]) > len(motion.time_s)
    assert logs[1:] == logs[:1] * 2


def test_a_bus_that_is_lost_ends_a_run_in_cycles_of_c_at_once():
    bench, channel, told = short(load_bench("reference")), InProcessChannel(World(load_robot("reference")), is_logged=False), []
    motion = constant_acceleration(bench, 2, 0.002)

    def progress(share):
        if not channel.lost:
            told.append(round(share * len(motion.time_s)))
        channel.lost = share > 0.3

    with Session(bench, channel, BusLog(None), progress=progress) as session:
        session.bring_up()
        result = session.run(motion, "none", "drive")
    assert result.stopped is not None
    assert not result.stopped.all_disabled
    assert "pulled" in result.stopped.reason
    assert len(result.recording.time_s) == told[-1] + 1, "no row after that of the loss"


def test_a_loop_of_the_host_goes_frame_by_frame_and_is_the_same():
    bench = short(load_bench("reference"))
    motion = constant_acceleration(bench, 2, 0.00025)
    part = replace(motion, time_s=motion.time_s[:800], motor_angle_rad=motion.motor_angle_rad[:800])
    assert_same(recorded(load_robot("reference"), bench, part, loop="host"))


def test_the_bit_rate_of_the_robot_limits_what_a_bus_carries_without_frames_too():
    robot = load_robot("reference")
    bench = load_bench("reference")
    channel = InProcessChannel(World(robot), bitrate=125_000, is_logged=False)
    assert channel.address == Address("local", "in-process", 125_000)
    with pytest.raises(NotPossibleError, match="SYNC period"):
        check_load(bench, channel, BusDemand("three axes", (2, 3, 5), 0.001))


@pytest.mark.parametrize(("bitrate", "has_room"), [(1_000_000, True), (250_000, False)])
def test_a_bus_without_room_for_torque_offsets_gets_a_cancellation_without_them(bitrate, has_room):
    bench, period_s = load_bench("reference"), 0.001
    motion = constant_acceleration(bench, 2, period_s)
    values = TransmissionErrorTable(a2_arcsec=10.0, phi2_deg=0.0, a4_arcsec=10.0)
    strong = Identified(robot=bench.name).with_part(2, IdentifiedError(values=values))
    channel = InProcessChannel(World(load_robot("reference")), bitrate=bitrate, is_logged=False)
    assert cancellation_of(bench, strong, motion, channel).uses_torque is has_room


@pytest.mark.slow
def test_a_robot_whose_speed_limit_leaves_no_room_is_quiet_all_the_same():
    """By set-points alone, order 2 is left out where order 1 resonates: 0.034 mm of 0.529 mm stay."""
    robot, text = drawn(117, "linear")
    bench = loads(text, Bench, "bench")
    survey, axis = Survey(robot, bench, min(bench.axis)), min(bench.axis)
    left = survey.cancelled(model_of(robot, bench, axis, robot.axis[axis].ate), ())
    assert max(survey.tip("none", Knowledge()).values()) > 0.5
    assert max(left.values()) < 0.01


@pytest.mark.slow
def test_a_gear_that_reacts_on_its_motor_is_held_up_against():
    """Gravity of 52 N·m on the slope of the error is a torque of each order, 0.04 mm of 0.57 mm."""
    robot, text = drawn(123, "linear")
    bench = loads(text, Bench, "bench")
    survey, axis = Survey(robot, bench, min(bench.axis)), min(bench.axis)
    known = model_of(robot, bench, axis, robot.axis[axis].ate)
    part = known.axis[axis].ate
    assert part is not None
    left = [
        max(survey.cancelled(known.with_part(axis, part.model_copy(update={"gear_reaction": reaction})), ()).values())
        for reaction in (0.0, 1.0)
    ]
    assert left[0] > 0.03
    assert left[1] < 0.005


@pytest.mark.parametrize(("loop", "period_s"), [("drive", 0.002), ("host", 0.00025)])
def test_a_stretch_over_the_local_bus_is_its_cycles_one_by_one(loop, period_s, hil_serve_local_bus, monkeypatch, tmp_path):
    bench, results, logs, calls = short(load_bench("reference")), [], [], []

    def run_cycles(exchange, run, stretch):
        calls[-1] += 1
        stretch.count = min(stretch.count, most)
        return CORE.call.run_cycles(exchange, run, stretch)

    monkeypatch.setattr(cyclic, "_run_cycles", run_cycles)
    for most in (1, 1000):
        calls.append(0)
        channel, log = open_channel(parse_address(hil_serve_local_bus().address)), tmp_path / f"{most}.log"
        with closing(channel), Session(bench, channel, BusLog(log)) as session:
            session.bring_up()
            results.append(session.run(constant_acceleration(bench, 2, period_s), "none", loop))
        logs.append(log.read_text())
    assert_same(results)
    assert logs[0] == logs[1]
    assert calls[1] < 0.1 * calls[0]
