"""`hil check` passes robots that are as they must be, and finds each defect in the check that is made for it."""

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drive_profiles.family.runs import family_runs
from drive_profiles.files.toml import loads
from hil.bench.bench import Bench, load_bench
from hil.can.frame import Frame
from hil.commissioning.check import STEPS, check_axes
from hil.commissioning.held import held_axis
from hil.commissioning.seen import Checked
from hil.errors import NotPossibleError
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.motion.record import STOPPING
from plant_emulator.rehearsal.families.made import family_alone, vendor_families
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

AXIS, SENSOR, MASTER = 2, 16, 127
FEEDBACK, COMMAND, TIP = 0x180 + AXIS, 0x200 + AXIS, 0x180 + SENSOR
ENABLED = 0x27
ALL = [name for _, _, names in STEPS for name in names]


class TamperedChannel(InProcessChannel):
    """The bus in one process, with frames changed on their way to the nodes and to the master."""

    takes_messages = False

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.outgoing: Callable[[Frame], Frame] = lambda frame: frame
        self.incoming: Callable[[Frame], Frame] = lambda frame: frame

    def send(self, frame: Frame) -> None:
        super().send(self.outgoing(frame))

    def receive(self, timeout_s: float) -> Frame | None:
        frame = super().receive(timeout_s)
        return None if frame is None else self.incoming(frame)

    def receive_all(self, timeout_s: float) -> list[Frame]:
        frame = super().receive(timeout_s)
        if frame is None:
            return []
        frames = [frame, *self._queue]
        self._queue.clear()
        return [self.incoming(each) for each in frames]


def quick(bench: Bench) -> Bench:
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"answer_timeout_s": 0.05})})


def checked(tmp_path: Path, tamper: Callable[[TamperedChannel], None], robot: Robot | None = None) -> dict[str, tuple[str, str]]:
    """Verdict and words of each check of axis 2 of the reference robot, with a defect."""
    channel = TamperedChannel(World(robot or load_robot("reference")))
    tamper(channel)
    outcome = check_axes(quick(load_bench("reference")), (AXIS,), tmp_path, channel=channel)
    assert outcome.failure is None
    return {each.name: (each.verdict, each.seen) for each in outcome.result.checks}


def feedback(change: Callable[[int, int, int], tuple[int, int, int]]) -> Callable[[TamperedChannel], None]:
    """A tamperer with status word, position and torque of the axis."""

    def tamper(channel: TamperedChannel) -> None:
        def incoming(frame: Frame) -> Frame:
            if frame.can_id != FEEDBACK:
                return frame
            return Frame(FEEDBACK, struct.pack("<Hih", *change(*struct.unpack("<Hih", frame.data))))

        channel.incoming = incoming

    return tamper


def sensor(change: Callable[[int, int, int], tuple[int, int, int]]) -> Callable[[TamperedChannel], None]:
    """A tamperer with the three axes of the accelerometer."""

    def tamper(channel: TamperedChannel) -> None:
        def incoming(frame: Frame) -> Frame:
            return Frame(TIP, struct.pack("<hhh", *change(*struct.unpack("<hhh", frame.data)))) if frame.can_id == TIP else frame

        channel.incoming = incoming

    return tamper


def at_each_sync(act: Callable[[TamperedChannel, np.void], None]) -> Callable[[TamperedChannel], None]:
    """A tamperer with the mechanics of the axis, before each SYNC."""

    def tamper(channel: TamperedChannel) -> None:
        axes = channel.world.axes
        channel.on_sync = lambda number: act(channel, axes.motion[axes.row(AXIS)])

    return tamper


def swapped_phases(channel: TamperedChannel, motion: np.void) -> None:
    law = channel.world.axes.cascade_config[channel.world.axes.row(AXIS)]
    for name in ("velocity_gain_nm_s_rad", "velocity_integral_gain_nm_rad"):
        law[name] = -abs(law[name])


def stranger_in_the_masters_name(channel: TamperedChannel, motion: np.void) -> None:
    if channel.syncs % 20 == 0:
        channel.inject(Frame(0x700 + MASTER, b"\x05"))


def deaf_to_quick_stop(channel: TamperedChannel) -> None:
    def outgoing(frame: Frame) -> Frame:
        is_stop = frame.can_id == COMMAND and frame.data[:2] == b"\x02\x00"
        return Frame(COMMAND, b"\x0f\x00" + frame.data[2:]) if is_stop else frame

    channel.outgoing = outgoing


def lazy_quick_stop(channel: TamperedChannel, motion: np.void) -> None:
    if motion["mode"] == STOPPING:
        motion["stop_deceleration_rad_s2"] = 0.5


def inverted_limits(channel: TamperedChannel, motion: np.void) -> None:
    low, high = channel.world.drives[AXIS].stage.data.limits._limits_counts()
    motion["low_counts"], motion["high_counts"] = -high, -low


def no_limits(channel: TamperedChannel, motion: np.void) -> None:
    motion["low_counts"], motion["high_counts"] = -np.inf, np.inf


def twice_the_counts(channel: TamperedChannel) -> None:
    def incoming(frame: Frame) -> Frame:
        if frame.can_id != 0x580 + AXIS or frame.data[1:4] != b"\x92\x60\x01" or frame.data[0] == 0x80:
            return frame
        counts = int.from_bytes(frame.data[4:], "little")
        return Frame(frame.can_id, frame.data[:4] + (2 * counts).to_bytes(4, "little"))

    channel.incoming = incoming


def sagging() -> Callable[[TamperedChannel], None]:
    """An axis that creeps while it has no torque, once it has been enabled."""
    fallen, was_enabled = [0], [False]

    def change(status: int, position: int, torque: int) -> tuple[int, int, int]:
        is_enabled = status & 0x6F == ENABLED
        was_enabled[0] |= is_enabled
        fallen[0] += was_enabled[0] and not is_enabled and 200
        return status, position - fallen[0], torque

    return feedback(change)


DEFECTS = {
    "the encoder counts backwards": (feedback(lambda s, p, t: (s, -p, t)), "encoder sign", r"stopped|along"),
    "the motor's phases are swapped": (
        at_each_sync(swapped_phases),
        "stands enabled",
        r"stopped although it was commanded to rest",
    ),
    "the torque is told with the wrong sign": (feedback(lambda s, p, t: (s, p, -t)), "torque sign", r"pushed against the motion"),
    "the drive says twice the counts": (twice_the_counts, "accelerometer", r"\+2\.\d\d ± .* scale of the encoder"),
    "the sensor is turned": (sensor(lambda x, y, z: (z, y, x)), "accelerometer", r"along x: the sensor is turned"),
    "the sensor sits upside down": (sensor(lambda x, y, z: (x, y, -z)), "accelerometer", r"against the motor"),
    "the sensor is dead": (sensor(lambda x, y, z: (0, 0, 0)), "accelerometer", r"all the time; check the sensor"),
    "the sensor sits elsewhere": (sensor(lambda x, y, z: (x, y, z % 3)), "accelerometer", r"does not move with this axis"),
    "the drive does not miss its master": (at_each_sync(stranger_in_the_masters_name), "heartbeat loss", r"still enabled 500 ms"),
    "a quick stop is not heard": (deaf_to_quick_stop, "quick stop, standing", r"still in operation"),
    "a quick stop takes its time": (at_each_sync(lazy_quick_stop), "quick stop, moving", r"still in operation 0\.5 s after"),
    "position limits have the wrong sign": (at_each_sync(inverted_limits), "upper limit", r"on the side that is free"),
    "position limits do not act": (at_each_sync(no_limits), "upper limit", r"the motor moved \+0\.2"),
    "the brake does not hold": (sagging(), "brake holds", r"after the torque ended"),
}


@pytest.mark.slow
@pytest.mark.parametrize("defect", DEFECTS)
def test_each_defect_fails_the_check_that_is_made_for_it_and_ends_what_depends_on_it(defect, tmp_path):
    tamper, name, words = DEFECTS[defect]
    found = checked(tmp_path, tamper)
    failed = [each for each, (verdict, _) in found.items() if verdict == "FAIL"]
    assert failed[0] == name, found
    assert re.search(words, found[name][1]), found[name]
    step = next(i for i, (_, _, names) in enumerate(STEPS) if name in names)
    behind = [each for _, _, names in STEPS[step + 1 :] for each in names]
    assert all(found[each] == ("NOT JUDGED", f"not made: {name} failed") for each in behind)


def test_a_brake_that_does_not_open_is_found_by_the_first_turn(tmp_path):
    robot = load_robot("reference")
    axis = robot.axis[AXIS]
    held = axis.model_copy(update={"motor_inertia_kg_m2": 1e3})  # nothing within its limit turns it
    found = checked(tmp_path, lambda channel: None, robot.model_copy(update={"axis": {**robot.axis, AXIS: held}}))
    assert found["brake opens"][0] == "FAIL"
    assert "the brake is open" in found["brake opens"][1]


@pytest.mark.slow
def test_the_reference_robot_passes_every_check_of_every_axis_and_is_left_as_it_was(tmp_path):
    bench = quick(load_bench("reference"))
    outcome = check_axes(bench, (), tmp_path, channel=InProcessChannel(World(load_robot("reference"))))
    assert outcome.failure is None
    assert not outcome.not_restored
    verdicts = [(each.axis, each.name, each.verdict) for each in outcome.result.checks]
    assert verdicts == [(axis, name, "PASS") for axis in (2, 3, 5) for name in ALL]
    written = json.loads((tmp_path / "check.json").read_text())
    assert written["kind"] == "check"
    assert [each["verdict"] for each in written["checks"]] == ["PASS"] * len(verdicts)
    assert all((tmp_path / each["recording"]).exists() for each in written["checks"] if "recording" in each)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 40])
def test_drawn_robots_pass_all_that_can_be_told_of_them(seed, tmp_path):
    robot, text = drawn(seed, "real")
    outcome = check_axes(quick(loads(text, Bench, "drawn")), (), tmp_path, channel=InProcessChannel(World(robot)))
    assert outcome.failure is None
    assert [each.name for each in outcome.result.checks if each.verdict != "PASS"] == []


@pytest.mark.parametrize(
    "family",
    [pytest.param(name, marks=pytest.mark.ci if name == "kollmorgen_akd" else pytest.mark.slow) for name in vendor_families()],
)
def test_a_drive_of_each_family_passes_all_that_can_be_told_of_it_up_to_the_sensor(family, tmp_path):
    alone = family_alone(family)
    outcome = check_axes(quick(alone.bench), (AXIS,), tmp_path, channel=InProcessChannel(World(alone.robot)))
    assert (outcome.failure, outcome.not_restored) == (None, ())
    found = {each.name: each for each in outcome.result.checks}
    assert not outcome.result.not_made
    held = family_runs()[family].held_by_drive
    untold = [] if "position_min_rev" in held else ["upper limit", "lower limit"]
    assert {name: each.seen for name, each in found.items() if each.verdict != "PASS" and name not in untold} == {}
    assert all("only the master does; set the drive's own" in found[name].seen for name in untold)


@pytest.mark.slow
def test_no_check_moves_the_motor_further_than_it_says(tmp_path):
    world, seen = World(load_robot("reference")), []
    channel = InProcessChannel(world)
    row, axes = world.axes.row(AXIS), world.axes
    channel.on_sync = lambda number: seen.append(float(axes.counts(row)))
    check_axes(quick(load_bench("reference")), (AXIS,), tmp_path, channel=channel)
    turns = np.array(seen) / axes.robot.axis[AXIS].encoder_counts_per_rev
    assert np.max(np.abs(turns)) < 0.45
    assert np.max(np.abs(np.diff(turns))) / 0.002 < 1.2


def test_an_axis_that_stands_at_its_limit_is_not_moved(tmp_path):
    bench = quick(load_bench("reference"))
    limits = bench.axis[AXIS].limits.model_copy(update={"position_max_rev": 0.2, "position_min_rev": -0.2})
    table = bench.axis[AXIS].model_copy(update={"limits": limits})
    bench = bench.model_copy(update={"axis": {**bench.axis, AXIS: table}})
    outcome = check_axes(bench, (AXIS,), tmp_path, channel=InProcessChannel(World(load_robot("reference"))))
    found = {each.name: each for each in outcome.result.checks}
    assert found["encoder sign"].verdict == "NOT JUDGED"
    assert "move it away from them with hil move --axis 2 --to REV" in found["encoder sign"].seen
    assert found["quick stop, moving"].verdict == found["upper limit"].verdict == "NOT JUDGED"
    assert {each.name for each in outcome.result.not_made} >= {"brake opens", "encoder sign", "upper limit", "accelerometer"}
    assert not outcome.result.failed


def mute_when_lonely(channel: TamperedChannel) -> None:
    """A drive that sends no PDOs any more when the master's heartbeat is gone, but stays enabled."""
    last = [0]

    def outgoing(frame: Frame) -> Frame:
        if frame.can_id == 0x700 + MASTER:
            last[0] = channel.syncs
        return frame

    def stranger(number: int) -> None:
        if number % 20 == 0:
            channel.world.receive(Frame(0x700 + MASTER, b"\x05"))

    channel.outgoing, channel.on_sync = outgoing, stranger
    channel.passes = lambda frame: frame.can_id != FEEDBACK or channel.syncs - last[0] < 75


def test_a_drive_that_falls_silent_is_not_taken_for_one_that_has_stopped(tmp_path):
    channel = TamperedChannel(World(load_robot("reference")))
    mute_when_lonely(channel)
    outcome = check_axes(quick(load_bench("reference")), (AXIS,), tmp_path, channel=channel)
    assert outcome.failure is None
    assert [each.name for each in outcome.result.failed] == ["heartbeat loss"]


@pytest.mark.slow
def test_a_drive_that_falls_silent_because_it_has_stopped_has_noticed(tmp_path):
    """Its node falls back to pre-operational with it: few cycles without an answer, and no status word that would tell."""
    bench = load_bench("reference")
    bench = bench.model_copy(update={"bus": bench.bus.model_copy(update={"answer_timeout_s": 0.05, "missing_limit": 100})})
    channel = TamperedChannel(World(load_robot("reference")))
    enabled = [False]

    def passes(frame: Frame) -> bool:
        if frame.can_id != FEEDBACK:
            return True
        was, enabled[0] = enabled[0], int.from_bytes(frame.data[:2], "little") & 0x6F == ENABLED
        return enabled[0] or not was or not lonely()

    def lonely() -> bool:
        return channel.syncs - last[0] > 100

    last = [0]

    def outgoing(frame: Frame) -> Frame:
        if frame.can_id == 0x700 + MASTER:
            last[0] = channel.syncs
        return frame

    channel.outgoing, channel.passes = outgoing, passes
    outcome = check_axes(bench, (AXIS,), tmp_path, channel=channel)
    assert outcome.failure is None
    found = {each.name: each for each in outcome.result.checks}
    assert found["heartbeat loss"].verdict == "PASS", found["heartbeat loss"].seen


@pytest.mark.parametrize(("is_masters_fault", "verdict"), [(True, "NOT JUDGED"), (False, "FAIL")])
def test_a_stop_that_lies_in_the_master_says_nothing_of_the_robot(is_masters_fault, verdict):
    held = SimpleNamespace(stopped="a reason", is_masters_fault=is_masters_fault)
    of = Checked(None, AXIS, lambda recording, name: name)  # type: ignore[arg-type]
    found = of.stopped("encoder sign", held, "in a slow third of a turn")  # type: ignore[arg-type]
    assert (found.verdict, found.is_made) == (verdict, not is_masters_fault)
    assert found.seen == "stopped in a slow third of a turn: a reason"


def test_an_axis_that_the_bench_does_not_have_is_refused(tmp_path):
    with pytest.raises(NotPossibleError, match="the bench has no axis 4; it has 2, 3, 5"):
        check_axes(load_bench("reference"), (4,), tmp_path)


def test_the_masters_own_limits_stay_narrow_only_while_it_checks(tmp_path):
    bench = quick(load_bench("reference"))
    with Session(bench, InProcessChannel(World(load_robot("reference"))), BusLog(None)) as session:
        session.bring_up()
        with held_axis(session, AXIS) as held:
            assert session.axes[AXIS].table.limits.position_max_rev == 0.75
            assert held.rise()
        assert session.axes[AXIS].table.limits == bench.axis[AXIS].limits
        assert session.not_restored == []
