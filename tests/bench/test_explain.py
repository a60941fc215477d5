"""What `hil explain` finds in logs of the emulated robot: nothing in clean ones, and each fault that is put into one."""

import json
import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.bench.bench import load_bench
from hil.cli.main import app
from hil.experiments.motions import constant_acceleration, line_motion
from hil.logs.explain import explain
from hil.logs.opening import open_log
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.bench.fault_rig import T_S, bench

RATE = 1_000_000
SYNC, RPDO, TPDO, HEARTBEAT, EMERGENCY = 0x080, 0x202, 0x182, 0x702, 0x082


@dataclass(frozen=True)
class At:
    """A frame of a log."""

    time_s: float
    can_id: int
    data: bytes

    @property
    def line(self):
        wide = self.can_id & 0xE0000000
        return f"({self.time_s:.6f}) can0 {self.can_id:0{8 if wide else 3}X}#{self.data.hex().upper()}\n"


def log_of(folder, motion, setup, robot=None, rate=RATE):
    """Frames of a run on a bus with bit times."""
    world = World(robot or load_robot("reference"))
    channel = InProcessChannel(world, medium_for(world, rate))
    path = folder / "bus.log"
    log = BusLog(path, "can0")
    with Session(setup, channel, log) as session:
        session.bring_up()
        result = session.run(motion, "none", "drive")
    log.write()
    assert result.stopped is None
    return path


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Path of the log of a line of three axes."""
    setup = bench()
    return log_of(tmp_path_factory.mktemp("clean"), line_motion(setup, T_S), setup)


@pytest.fixture(scope="module")
def frames(clean):
    """Its frames."""
    log = open_log(clean)
    found = [
        (int(stream.position[row]), At(stream.stamp_ns[row] * 1e-9, stream.can_id, stream.bytes_of(row)))
        for stream in log.streams.values()
        for row in range(len(stream))
    ]
    return [each for _, each in sorted(found, key=lambda pair: pair[0])]


def found_in(path, frames):
    path.write_text("".join(each.line for each in frames))
    return explain(open_log(path), {}, RATE)


def kinds(found):
    return [each.kind for each in found.findings]


def working(frames):
    """Positions of the SYNCs of the motion's middle: the drives are enabled there, and move."""
    syncs = [row for row, each in enumerate(frames) if each.can_id == SYNC]
    return syncs[len(syncs) // 3 : 2 * len(syncs) // 3]


@pytest.mark.ci
def test_a_clean_log_has_nothing_wrong(clean):
    found = explain(open_log(clean), {}, RATE)
    assert [each.words for each in found.findings] == []
    assert [each.words for each in found.unknown] == []
    axis = found.trace.nodes[2]
    assert {entry.address[0] for pdo in axis.pdos for entry in pdo.entries} >= {0x6040, 0x607A, 0x6041, 0x6064}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "period_s"),
    [(line_motion, 0.002), (line_motion, 0.004), (line_motion, 0.008), (constant_acceleration, 0.001),
     (constant_acceleration, 0.002), (constant_acceleration, 0.004)],
)  # fmt: skip
def test_clean_logs_of_other_rates_and_motions_have_nothing_wrong(tmp_path, motion, period_s):
    setup = bench()
    setup = setup.model_copy(update={"bus": setup.bus.model_copy(update={"sync_period_s": period_s})})
    made = line_motion(setup, period_s) if motion is line_motion else constant_acceleration(setup, 2, period_s)
    found = explain(open_log(log_of(tmp_path, made, setup)), {}, RATE)
    assert [each.words for each in found.findings] == []


def test_stamps_of_whole_seconds_are_read_without_an_error(tmp_path, clean):
    path = tmp_path / "coarse.log"
    path.write_text(re.sub(r"\((\d+)\.\d+\)", r"(\1.000000)", clean.read_text()))
    assert explain(open_log(path), {}, RATE).findings


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "runs"), [(None, 24), (RATE, 3)])
def test_a_log_of_several_runs_has_nothing_wrong_where_no_drive_is_enabled(tmp_path, rate, runs):
    """Between two runs the set-point goes from the end of one to the place where the motor stands, in a frame."""
    setup = bench()
    world = World(load_robot("reference"))
    channel = InProcessChannel(world, medium_for(world, rate))
    log = BusLog(tmp_path / "bus.log", "can0")
    with Session(setup, channel, log) as session:
        session.bring_up()
        for _ in range(runs):
            assert session.run(constant_acceleration(setup, 2, T_S), "none", "drive").stopped is None
    log.write()
    found = explain(open_log(tmp_path / "bus.log"), {}, RATE)
    assert not {"set-point-jump", "two-masters", "too-fast", "nmt-while-working"} & set(kinds(found)), found.findings


def test_runs_with_other_periods_and_axes_in_one_log_are_each_judged_by_their_own_cycle(tmp_path):
    """Each has its own SYNC period, nodes and mapping; most of the SYNCs are those of the shorter period."""
    setup, log = bench(), BusLog(tmp_path / "bus.log", "can0")
    motions = line_motion(setup, 0.004), constant_acceleration(setup, 2, 0.001), line_motion(setup, 0.002)
    with Session(setup, InProcessChannel(World(load_robot("reference"))), log) as session:
        session.bring_up()
        assert [session.run(motion, "none", "drive").stopped for motion in motions] == [None] * 3
    log.write()
    whole = open_log(tmp_path / "bus.log")
    assert set(kinds(explain(whole, {}, 8 * RATE))) <= {"order-line"}
    syncs = whole.of(SYNC).position
    cut = int(syncs[len(syncs) // 2])  # a fault of one run is found all the same, at its place
    less = {
        can_id: stream.only((stream.position < cut) | (stream.position > cut + 100)) for can_id, stream in whole.streams.items()
    }
    [missing] = [each for each in explain(replace(whole, streams=less), {}, 8 * RATE).findings if each.kind == "sync-missing"]
    assert missing.stamps_s == pytest.approx([whole.of(SYNC).stamp_ns[len(syncs) // 2 - 1] * 1e-9])


def log_of_drawn(folder, seed):
    """Log of a ramp of a robot drawn by seed, with the drive, SYNC period and bit rate of its own, and its bit rate."""
    robot = draw(seed, kind="real")
    file = folder / "bench.toml"
    file.write_text(blank_bench(robot))
    setup = load_bench(file)
    made = constant_acceleration(setup, next(iter(setup.axis)), setup.bus.sync_period_s)
    return log_of(folder, made, setup, robot, robot.bus.bitrate), robot.bus.bitrate


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 23, 28, 30])
def test_clean_logs_of_drawn_robots_have_nothing_wrong(tmp_path, seed):
    """8, 2, 1 and 1 ms, 500 kbit/s and 1 Mbit/s, encoders of 13 to 20 bits."""
    path, rate = log_of_drawn(tmp_path, seed)
    assert [each.words for each in explain(open_log(path), {}, rate).findings] == []


@pytest.mark.slow
def test_an_error_of_the_gear_that_shakes_its_motor_is_named_with_its_order(tmp_path):
    """Its A_1 is 51 arcsec at N = 156, three times its A_2: 2.2° of the motor."""
    path, rate = log_of_drawn(tmp_path, 27)
    [said] = explain(open_log(path), {}, rate).findings
    assert said.kind == "order-line"
    assert "order 1 at every speed" in said.words
    assert "that is the gear" in said.words


# -- faults, each put into the clean log -------------------------------------------------------------------------------


def without(frames, can_id, every):
    """Every so-manieth frame of an identifier is lost while the robot works."""
    rows = range(working(frames)[0], working(frames)[-1])
    of_id = [row for row in rows if frames[row].can_id == can_id]
    gone = set(of_id[::every])
    return [each for row, each in enumerate(frames) if row not in gone]


def moved(frames, can_id, by_s, every=1, only_working=True):
    """Frames of an identifier come later, or earlier."""
    rows = range(working(frames)[0], working(frames)[-1]) if only_working else range(len(frames))
    of_id = [row for row in rows if frames[row].can_id == can_id]
    late = set(of_id[::every])
    changed = [At(each.time_s + by_s, each.can_id, each.data) if row in late else each for row, each in enumerate(frames)]
    return sorted(changed, key=lambda each: each.time_s)


def doubled(frames, can_id, after_s, every=1, change=lambda data: data):
    rows = working(frames)
    of_id = [row for row in range(rows[0], rows[-1]) if frames[row].can_id == can_id][::every]
    more = [At(frames[row].time_s + after_s, can_id, change(frames[row].data)) for row in of_id]
    return sorted([*frames, *more], key=lambda each: each.time_s)


def rewritten(frames, can_id, change):
    """Data of the frames of an identifier changed, by their number among those of the middle."""
    rows = range(working(frames)[0], working(frames)[-1])
    number, found = 0, list(frames)
    for row in rows:
        if frames[row].can_id == can_id:
            found[row] = At(frames[row].time_s, can_id, change(number, frames[row].data))
            number += 1
    return found


def held(frames, can_id, every, start, size):
    """A number in every so-manieth frame is that of the frame before."""
    last = [b""]

    def change(number, data):
        data = data[:start] + last[0] + data[start + size :] if number % every == 0 and last[0] else data
        last[0] = data[start : start + size]
        return data

    return rewritten(frames, can_id, change)


def frozen(frames, can_id, numbers, start, size):
    """A number stands still for some frames."""
    kept = []

    def change(number, data):
        if number == numbers.start:
            kept.append(data[start : start + size])
        return data[:start] + kept[0] + data[start + size :] if number in numbers else data

    return rewritten(frames, can_id, change)


def stepped(data, by):
    value = int.from_bytes(data[2:6], "little", signed=True) + by
    return data[:2] + value.to_bytes(4, "little", signed=True) + data[6:]


def with_status(frames, at, bits):
    """The status word of one frame is another."""

    def change(number, data):
        word = int.from_bytes(data[:2], "little")
        return (bits(word) if number == at else word).to_bytes(2, "little") + data[2:]

    return rewritten(frames, TPDO, change)


def counted_in(frames, can_id, grain):
    """Positions that are multiples of so many counts, from the log's beginning to its end."""

    def coarse(each):
        if each.can_id != can_id or len(each.data) < 6:
            return each
        value = int.from_bytes(each.data[2:6], "little", signed=True) // grain * grain
        return At(each.time_s, can_id, each.data[:2] + value.to_bytes(4, "little", signed=True) + each.data[6:])

    return [coarse(each) for each in frames]


def path_of(frames, path):
    """Target positions by a function of the number of the cycle, from the middle of the log on."""
    first = []

    def change(number, data):
        first.append(int.from_bytes(data[2:6], "little", signed=True))
        return data[:2] + (first[0] + path(number)).to_bytes(4, "little", signed=True) + data[6:]

    return rewritten(frames, RPDO, change)


def trapezoid(number):
    """Speed up by 200 counts per cycle² for 20 cycles, stand for 60, slow down, and again: nothing limits the jerk."""
    speed = np.interp(np.arange(number) % 200, [0, 20, 80, 100, 200], [0, 4000, 4000, 0, 0])
    return round(float(np.sum(speed)))


def swung(frames, swing):
    """A motor that turns ever faster for two seconds, and swings about its set-points by a function of its turns and the time."""
    begin = frames[working(frames)[0]].time_s
    before = [each for each in frames if each.time_s < begin]
    count = 131072
    made = []
    for number in range(1200):
        time_s = number * T_S
        turns = 2.0 * time_s + 1.5 * time_s**2
        target, actual = round(count * turns), round(count * (turns - swing(turns, time_s)))
        command = b"\x0f\x00" + target.to_bytes(4, "little", signed=True)
        answer = (0x1637).to_bytes(2, "little") + actual.to_bytes(4, "little", signed=True) + b"\0\0"
        made += [At(begin + time_s - 3e-4, RPDO, command), At(begin + time_s, SYNC, b""), At(begin + time_s + 3e-4, TPDO, answer)]
    return [*before, *made]


def starved(frames, by, who):
    """In every tenth cycle five frames of high priority come first, and an answer waits for them."""
    syncs = [frames[row].time_s for row in working(frames)][::10]
    burst = [At(stamp + 5e-5 + 1e-4 * number, by, bytes(8)) for stamp in syncs for number in range(5)]
    ends = np.array(syncs)

    def waits(each):
        near = ends[max(int(np.searchsorted(ends, each.time_s, side="right")) - 1, 0)]
        return At(each.time_s + 5e-4, who, each.data) if each.can_id == who and 0.0 <= each.time_s - near < 0.5 * T_S else each

    return sorted([*map(waits, frames), *burst], key=lambda each: each.time_s)


def inserted(frames, *more):
    middle = frames[working(frames)[0]].time_s
    new = [At(middle + each.time_s, each.can_id, each.data) for each in more]
    return sorted([*frames, *new], key=lambda each: each.time_s)


def with_setup(frames, node, index, subindex, data):
    """An SDO write."""
    size = {1: 0x2F, 2: 0x2B, 4: 0x23}[len(data)]
    head = index.to_bytes(2, "little") + bytes([subindex])
    before = frames[working(frames)[0]].time_s
    return sorted(
        [*frames, At(before - 2e-4, 0x600 + node, bytes([size]) + head + data.ljust(4, b"\0")),
         At(before - 1e-4, 0x580 + node, b"\x60" + head + bytes(4))], key=lambda each: each.time_s,
    )  # fmt: skip


FAULTS = {
    "sync-missing": lambda frames: without(frames, SYNC, 50),
    "sync-doubled": lambda frames: doubled(frames, SYNC, 0.4 * T_S),
    "sync-jitter": lambda frames: moved(frames, SYNC, 0.3 * T_S, every=7),
    "set-points-missing": lambda frames: without(frames, RPDO, 20),
    "set-points-doubled": lambda frames: doubled(frames, RPDO, 0.1 * T_S, every=10),
    "set-points-stale": lambda frames: moved(frames, RPDO, 0.4 * T_S, every=9),
    "set-points-late": lambda frames: moved(frames, RPDO, -0.3 * T_S, every=9),
    "set-points-repeated": lambda frames: held(frames, RPDO, 10, 2, 4),
    "set-point-jump": lambda frames: rewritten(frames, RPDO, lambda n, data: stepped(data, 40_000) if n == 60 else data),
    "set-point-beat": lambda frames: with_setup(frames, 2, 0x60C2, 1, b"\x03"),
    "answers-missing": lambda frames: without(frames, TPDO, 20),
    "answers-old": lambda frames: frozen(frames, TPDO, range(100, 110), 2, 4),
    "two-nodes": lambda frames: doubled(frames, TPDO, 5e-5),
    "two-masters": lambda frames: doubled(frames, RPDO, 1e-4, change=lambda data: stepped(data, 500_000)),
    "heartbeat-lost": lambda frames: [each for each in frames if each.can_id != HEARTBEAT or each not in beats(frames)[3:9]],
    "node-restarted": lambda frames: inserted(frames, At(0.0, HEARTBEAT, b"\0")),
    "emergency": lambda frames: inserted(frames, At(0.0, EMERGENCY, bytes.fromhex("1186200000000000"))),
    "sdo-aborts": lambda frames: inserted(
        frames, At(0.0, 0x602, bytes.fromhex("2340600000000000")), At(1e-4, 0x582, bytes.fromhex("8040600002000106"))
    ),
    "sdo-unanswered": lambda frames: [*frames, At(frames[-1].time_s + 0.1, 0x602, bytes.fromhex("4041600000000000")),
        At(frames[-1].time_s + 2.0, 0x602, bytes.fromhex("4041600000000000"))],
    "drive-fault": lambda frames: with_status(frames, 50, lambda word: word & ~0x6F | 0x08),
    "quick-stop": lambda frames: with_status(frames, 50, lambda word: word & ~0x6F | 0x07),
    "internal-limit": lambda frames: with_status(frames, 50, lambda word: word | 1 << 11),
    "following-error": lambda frames: with_status(frames, 50, lambda word: word | 1 << 13),
    "not-following": lambda frames: with_status(frames, 80, lambda word: word & ~(1 << 12)),
    "nmt-while-working": lambda frames: inserted(frames, At(0.0, 0x000, b"\x80\x00")),
    "beyond-limits": lambda frames: with_setup(frames, 2, 0x607D, 2, (-1000).to_bytes(4, "little", signed=True)),
    "too-fast": lambda frames: with_setup(frames, 2, 0x6080, 0, (20).to_bytes(4, "little")),
    "coarse-set-points": lambda frames: counted_in(frames, RPDO, 64),
    "coarse-encoder": lambda frames: counted_in(frames, TPDO, 64),
    "acceleration-jump": lambda frames: path_of(frames, trapezoid),
    "order-line": lambda frames: swung(frames, lambda turns, time_s: 0.004 * math.sin(2.0 * math.tau * turns)),
    "loop-rings": lambda frames: swung(frames, lambda turns, time_s: 0.004 * math.sin(60.0 * math.tau * time_s)),
    "starved": lambda frames: starved(frames, 0x081, 0x185),
    "error-frames": lambda frames: inserted(frames, At(0.0, 0x20000088, bytes.fromhex("0000040000000000"))),
    "log-damaged": lambda frames: [*frames[:500], Cut(), *frames[501:]],
    "log-backwards": lambda frames: [At(each.time_s - (0.5 if row > 900 else 0.0), each.can_id, each.data)
        for row, each in enumerate(frames)],
}  # fmt: skip


class Cut:
    """A line that was cut in its middle."""

    line = "(0.5122"
    can_id = -1


def beats(frames):
    return [each for each in frames if each.can_id == HEARTBEAT]


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_found_and_named(tmp_path, frames, kind):
    found = found_in(tmp_path / "faulty.log", FAULTS[kind](frames))
    assert kind in kinds(found), kinds(found)
    [first] = [each for each in found.findings if each.kind == kind][:1]
    assert first.remedy
    assert all(math.isfinite(stamp) for stamp in first.stamps_s)
    if first.picture is not None:
        assert np.all(np.isfinite(first.picture.y))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("swing", "words"),
    [
        (lambda turns, time_s: 0.004 * math.sin(2.0 * math.tau * turns), "order 2 at every speed"),
        (lambda turns, time_s: 0.004 * math.sin(12.0 * math.tau * turns), "order 12 at every speed"),
        (lambda turns, time_s: 0.004 * math.sin(60.0 * math.tau * time_s), "at 60 Hz, at any speed"),
    ],
)
def test_what_swings_is_told_apart_gear_cogging_or_loop(tmp_path, frames, swing, words):
    found = found_in(tmp_path / "swung.log", swung(frames, swing))
    [said] = [each for each in found.findings if each.kind in {"order-line", "loop-rings"}]
    assert words in said.words
    assert ("cogging" in said.words) == ("order 12" in words)
    still = found_in(tmp_path / "still.log", swung(frames, lambda turns, time_s: 0.0))
    assert not {"order-line", "loop-rings"} & set(kinds(still))


def test_who_starves_whom_is_named(tmp_path, frames):
    found = found_in(tmp_path / "starved.log", starved(frames, 0x081, 0x185))
    [said] = [each for each in found.findings if each.kind == "starved"]
    assert "TPDO 1 of node 5" in said.words
    assert "081h is sent" in said.words


def test_answers_that_slip_into_the_next_cycle_are_those_of_one_node(tmp_path, frames):
    """A bus without room for a cycle: in a log of few cycles its end has one answer more than there are cycles."""
    syncs = [row for row, each in enumerate(frames) if each.can_id == SYNC]
    slipped = moved(frames[: syncs[25] - 1], TPDO, T_S, every=4, only_working=False)
    said = kinds(found_in(tmp_path / "slipped.log", slipped))
    assert "answers-missing" in said
    assert "two-nodes" not in said


def test_a_bus_that_is_full_is_said_with_who_fills_it(clean):
    found = explain(open_log(clean), {}, RATE // 2)
    assert "bus-load" in kinds(found)
    assert "080h" in next(each.words for each in found.findings if each.kind == "bus-load")


def test_without_set_up_in_the_log_it_says_that_it_cannot_tell_and_a_description_helps(tmp_path, frames):
    cut = [each for each in frames if each.can_id not in range(0x580, 0x680)]
    found = found_in(tmp_path / "cut.log", cut)
    assert {each.kind for each in found.unknown} >= {"set-points", "state"}
    assert all(each.kind not in {"set-point-jump", "drive-fault"} for each in found.findings)


def test_the_command_tells_as_text_json_and_page(tmp_path, frames):
    path, page = tmp_path / "faulty.log", tmp_path / "page.html"
    path.write_text("".join(each.line for each in FAULTS["set-points-missing"](frames)))
    done = CliRunner().invoke(app, ["explain", str(path), "--bitrate", "1M", "--page", str(page)])
    assert done.exit_code == 9, done.output
    assert "no target position for node 2" in done.output
    assert "<svg" in page.read_text(encoding="utf-8")
    told = json.loads(CliRunner().invoke(app, ["explain", str(path), "--json"]).stdout)
    assert told["findings"][0]["kind"] == "set-points-missing"
