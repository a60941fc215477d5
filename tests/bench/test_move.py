"""`hil move`: one axis slowly to a position, from wherever a run, a stop or a fault has left it."""

import contextlib
import math
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from drive_profiles.standard.cia402 import State
from hil.bench.bench import Bench
from hil.can.frame import Frame
from hil.errors import NOT_DISABLED, InterruptedRunError, NodeError, NotPossibleError, SafetyStopError, UnsafeRequestError
from hil.experiments.measurement import log_label
from hil.experiments.motions import constant_acceleration
from hil.experiments.move import Move, MoveRequest, make_move, plan_move
from hil.experiments.position_before import position_before
from hil.master.session import Session
from hil.master.whereabouts import rev_text
from hil.recording import BusLog
from hil.reporter import Reporter
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World
from tests.bench.conftest import all_braked, shortened, with_bus

FULL_TURNS = 4.0
"""Turns that are away enough for a test, and quickly made."""


@pytest.fixture
def channel(reference_robot: Robot) -> InProcessChannel:
    return InProcessChannel(World(reference_robot))


@pytest.fixture
def bench(reference_bench: Bench) -> Bench:
    return with_bus(shortened(reference_bench), answer_timeout_s=0.05)


def limited(bench: Bench, **limits: float) -> Bench:
    table = bench.axis[2]
    return bench.model_copy(
        update={"axis": {**bench.axis, 2: table.model_copy(update={"limits": table.limits.model_copy(update=limits)})}}
    )


def stands_rev(channel: InProcessChannel) -> float:
    """Where axis 2 really stands."""
    read = channel.world.drives[2].slave.dictionary.get
    return read(0x6064, 0) * read(0x608F, 2) / read(0x608F, 1)


def moved(bench: Bench, channel: InProcessChannel, **request: float) -> float:
    outcome = make_move(plan_move(bench, MoveRequest(2, **request), channel=channel), channel=channel)
    assert outcome.stopped is None
    assert outcome.not_restored == ()
    assert outcome.stands_rev is not None
    return outcome.stands_rev


def test_an_axis_goes_where_it_is_wanted_and_back_and_all_else_is_put_back(bench: Bench, channel: InProcessChannel) -> None:
    dictionary = channel.world.drives[2].slave.dictionary
    before = dictionary.get(0x607D, 2)
    assert moved(bench, channel, to_rev=1.0) == pytest.approx(1.0, abs=0.01)
    assert moved(bench, channel, by_rev=-0.5) == pytest.approx(0.5, abs=0.01)
    assert moved(bench, channel, to_rev=0.0) == pytest.approx(0.0, abs=0.01)
    assert channel.world.drives[2].state is not State.OPERATION_ENABLED
    assert dictionary.get(0x607D, 2) == before


def test_the_drive_holds_the_acceleration_limit_as_well_while_it_is_moved(bench: Bench, channel: InProcessChannel) -> None:
    """Beside the 50 rev/s² of its quick stop (6085h) it gets the 100 rev/s² of the bench file in 60C5h and 60C6h."""
    drive, seen = channel.world.drives[2], set()
    dictionary = drive.slave.dictionary
    before = dictionary.get(0x60C5, 0), dictionary.get(0x60C6, 0)

    def look(number: int) -> None:
        if drive.state is State.OPERATION_ENABLED:
            seen.add(tuple(dictionary.get(index, 0) for index in (0x60C5, 0x60C6, 0x6085)))

    channel.on_sync = look
    moved(bench, channel, to_rev=0.1)
    assert {(up / stop, down / stop) for up, down, stop in seen} == {(2.0, 2.0)}
    assert (dictionary.get(0x60C5, 0), dictionary.get(0x60C6, 0)) == before


def test_a_move_is_slow(bench: Bench, channel: InProcessChannel) -> None:
    planned = plan_move(bench, MoveRequest(2, to_rev=3.0), channel=channel)
    assert planned.speed_rps <= min(bench.approach_rps, 0.25 * bench.axis[2].limits.speed_rps)
    assert "from 0 to 3 rev" in planned.sentences[-1]


@pytest.mark.parametrize("request_", [MoveRequest(2, to_rev=22.5), MoveRequest(2, by_rev=-30.0)], ids=["to", "by"])
def test_a_position_beyond_the_limits_is_refused_with_the_range(
    bench: Bench, channel: InProcessChannel, request_: MoveRequest
) -> None:
    limits = bench.axis[2].limits
    with pytest.raises(UnsafeRequestError, match=rf"within {limits.position_min_rev:g} … {limits.position_max_rev:g} rev"):
        plan_move(bench, request_, channel=channel)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (MoveRequest(9, to_rev=0.0), "has no axis 9; it has"),
        (MoveRequest(2, to_rev=math.nan), "nan is not a motor position"),
        (MoveRequest(2, by_rev=math.inf), "inf is not a motor position"),
    ],
)
def test_a_request_that_cannot_be_is_refused_before_the_bus_is_opened(bench: Bench, request_: MoveRequest, words: str) -> None:
    with pytest.raises(NotPossibleError, match=words):
        plan_move(bench.on("local:/nowhere/x.sock"), request_)


def test_a_log_that_cannot_be_written_is_said_before_anything_moves(
    bench: Bench, channel: InProcessChannel, tmp_path: Path
) -> None:
    planned = plan_move(bench, MoveRequest(2, to_rev=1.0), channel=channel)
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        make_move(planned, tmp_path / "file" / "bus.log", channel=channel)
    assert stands_rev(channel) == pytest.approx(0.0, abs=0.01)


def test_a_fault_is_named_and_reset_by_the_move(bench: Bench, channel: InProcessChannel) -> None:
    channel.world.drives[2]._fault("following error", 0x8611)
    planned = plan_move(bench, MoveRequest(2, to_rev=0.5), channel=channel)
    assert planned.sentences[0] == "axis 2 is in fault, error code 8611h (following error): the fault is reset first"
    assert channel.world.drives[2].state is State.FAULT, "looking at it changes nothing"
    outcome = make_move(planned, channel=channel)
    assert outcome.stands_rev == pytest.approx(0.5, abs=0.01)


def test_a_fault_whose_cause_stays_ends_the_move_before_anything_moves(bench: Bench, channel: InProcessChannel) -> None:
    drive = channel.world.drives[2]
    drive._fault("following error", 0x8611)
    planned = plan_move(bench, MoveRequest(2, to_rev=0.5), channel=channel)
    drive.slave.dictionary.wrap_write(0x6040, 0, lambda own: lambda value: None)  # it hears no control word
    with pytest.raises(NodeError, match=r"still in fault, error code 8611h \(following error\) after a reset"):
        make_move(planned, channel=channel)
    assert stands_rev(channel) == pytest.approx(0.0, abs=0.01)


def test_another_axis_in_fault_is_refused_with_where_it_stands(bench: Bench, channel: InProcessChannel) -> None:
    channel.world.drives[3]._fault("motor speed", 0x8400)
    with pytest.raises(NodeError, match=r"axis 3 is in fault, error code 8400h \(speed controller\), and at 0 rev.*faults"):
        plan_move(bench, MoveRequest(2, to_rev=0.5), channel=channel)


def test_an_axis_that_was_turned_after_the_question_is_not_moved(bench: Bench, channel: InProcessChannel) -> None:
    planned = plan_move(bench, MoveRequest(2, to_rev=0.5), channel=channel)
    elsewhere = Move(planned.request, 0.3, planned.to_rev, planned.speed_rps, planned.fault, planned.bench)
    with pytest.raises(NodeError, match=r"has turned from 0\.3 to 0 rev in the meantime"):
        make_move(elsewhere, channel=channel)


def test_from_beyond_its_limits_an_axis_can_be_moved_back_and_no_further(bench: Bench, channel: InProcessChannel) -> None:
    moved(bench, channel, to_rev=1.0)
    narrow = limited(bench, position_max_rev=0.8)
    with pytest.raises(UnsafeRequestError, match=r"within -.* … 0\.8 rev"):
        plan_move(narrow, MoveRequest(2, to_rev=1.05), channel=channel)
    assert moved(narrow, channel, to_rev=0.5) == pytest.approx(0.5, abs=0.01)


def test_from_its_very_limit_an_axis_can_be_moved_back_under_its_load(bench: Bench, channel: InProcessChannel) -> None:
    stands = moved(bench, channel, to_rev=1.0)
    narrow = limited(bench, position_max_rev=stands + 1e-6)
    assert moved(narrow, channel, to_rev=0.5) == pytest.approx(0.5, abs=0.01)


def test_ctrl_c_stops_a_move_as_it_stops_a_run_and_says_how_to_go_on(bench: Bench, channel: InProcessChannel) -> None:
    planned = plan_move(bench, MoveRequest(2, to_rev=FULL_TURNS), channel=channel)

    class CtrlC(Reporter):
        def progress(self, fraction: float) -> None:
            if fraction > 0.3:
                signal.raise_signal(signal.SIGINT)

    outcome = make_move(planned, channel=channel, reporter=CtrlC())
    assert isinstance(outcome.stopped, InterruptedRunError)
    assert outcome.stopped.exit_code == 130
    here = stands_rev(channel)
    assert 0.5 < here < FULL_TURNS
    said = str(outcome.stopped)
    assert f"axis 2 is at {here:.2f}".rstrip("0") in said
    assert said.endswith("to bring it back: hil move --axis 2 --to 0")
    assert moved(bench, channel, to_rev=0.0) == pytest.approx(0.0, abs=0.01)


class Killed(BaseException):
    """What ends the master where it stands, as SIGKILL does."""


def lose_node(channel: InProcessChannel, session: Session) -> None:
    channel.passes = lambda frame: frame.can_id & 0x7F != 2


def pull_bus(channel: InProcessChannel, session: Session) -> None:
    channel.lost = True


def narrow_limit(channel: InProcessChannel, session: Session) -> None:
    channel.inject(Frame(0x602, b"\x23\x7d\x60\x02\x01\0\0\0"))  # 607Dh:2, the highest position


STOPS = {
    "Ctrl-C": (lambda channel, session: session.interrupt("SIGINT"), "interrupted by SIGINT", True),
    "SIGTERM": (lambda channel, session: session.interrupt("SIGTERM"), "interrupted by SIGTERM", True),
    "emergency": (lambda channel, session: channel.world.drives[2]._fault("motor speed", 0x8400), "emergency 8400h", True),
    "limit": (narrow_limit, "8612h (reference limit", True),
    "lost node": (lose_node, "axis 2 has not answered", False),
    "pulled bus": (pull_bus, "pulled", False),
}


@pytest.mark.parametrize(("stop", "reason", "is_known"), STOPS.values(), ids=STOPS)
def test_whatever_stops_a_motion_the_message_says_how_the_arm_stands_and_what_brings_it_back(
    bench: Bench, channel: InProcessChannel, stop: Callable[[InProcessChannel, Session], None], reason: str, is_known: bool
) -> None:
    """Why it stopped, whether torque may act, where the axis is, and the command; and what is said is so."""
    with Session(bench, channel, BusLog(None)) as session:
        channel.on_sync = lambda number: stop(channel, session) if number == 900 else None
        session.bring_up()
        stopped = session.run(constant_acceleration(bench, 2, 0.002), "none", "drive").stopped
    assert stopped is not None
    assert reason in stopped.reason
    end, where = str(stopped).removeprefix(f"stopped: {stopped.reason}; ").split("; ", 1)
    if is_known:
        here = stands_rev(channel)
        assert end == "all axes are stopped and disabled, and their drives close the brakes"
        assert where == f"axis 2 is at {rev_text(here)} rev; to bring it back: hil move --axis 2 --to 0"
        assert abs(here) > 0.1
        assert channel.world.drives[2].state is not State.OPERATION_ENABLED
        assert all_braked(channel.world)
    else:
        assert end == f"{NOT_DISABLED}: torque may act, and a brake may be open"
        assert where == "the position of axis 2 is not known; once the bus answers again: hil move --axis 2 --back"
    answering(channel)
    assert moved(bench, channel, to_rev=0.0) == pytest.approx(0.0, abs=0.01)


def test_after_a_master_that_was_killed_the_next_command_says_how_the_arm_stands(bench: Bench, channel: InProcessChannel) -> None:
    def kill(number: int) -> None:
        if number == 900:
            channel.lost = True
            raise Killed

    channel.on_sync = kill
    with contextlib.suppress(Killed), Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        session.run(constant_acceleration(bench, 2, 0.002), "none", "drive")
    assert channel.lost
    answering(channel)
    assert all_braked(channel.world), "the drive has missed the master's heartbeat"
    planned = plan_move(bench, MoveRequest(2, to_rev=0.0), channel=channel)
    assert stands_rev(channel) > 0.1
    assert f"from {rev_text(stands_rev(channel))} to 0 rev" in planned.sentences[-1]
    assert make_move(planned, channel=channel).stands_rev == pytest.approx(0.0, abs=0.01)


def answering(channel: InProcessChannel) -> None:
    """The bus as it is two seconds after the stop, repaired."""
    channel.on_sync, channel.passes, channel.lost = lambda number: None, lambda frame: True, False
    channel.world.free_step(channel.world.now + 2_000_000_000)


def test_a_run_after_a_stop_names_where_the_axis_stands_and_the_move_that_lets_it_run(
    bench: Bench, channel: InProcessChannel
) -> None:
    narrow = limited(bench, position_max_rev=2.5)
    motion = constant_acceleration(narrow, 2, narrow.bus.sync_period_s)
    longest = float(motion.motor_angle_rad.max()) / math.tau
    moved(narrow, channel, to_rev=2.0)
    with Session(narrow, channel, BusLog(None)) as session:
        session.bring_up()
        with pytest.raises(UnsafeRequestError) as refused:
            session.run(motion, "none", "drive")
    assert longest < 2.5
    assert "it is at 2 rev; hil move --axis 2 --to 0 moves it to where the motion fits" in str(refused.value)
    moved(narrow, channel, to_rev=0.0)
    with Session(narrow, channel, BusLog(None)) as session:
        session.bring_up()
        assert session.run(motion, "none", "drive").stopped is None


def test_an_emergency_is_said_in_the_words_of_the_drive_s_maker(bench: Bench, channel: InProcessChannel) -> None:
    table = bench.axis[2].model_copy(update={"profile": "maxon_epos4"})
    session = Session(bench.model_copy(update={"axis": {**bench.axis, 2: table}}), channel, BusLog(None))
    session.network.dispatch(Frame(0x080 + table.node_id, bytes.fromhex("828A810000000000")))
    assert str(session.network.emergencies[0]).endswith("emergency 8A82h (software position limit; error register 81h)")


def test_an_emergency_in_a_run_is_said_in_words_with_where_the_axis_stands(bench: Bench, channel: InProcessChannel) -> None:
    def act(number: int) -> None:
        if number == 900:
            channel.world.drives[2]._fault("following error", 0x8611)

    channel.on_sync = act
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        stopped = session.run(constant_acceleration(bench, 2, 0.002), "none", "drive").stopped
    assert isinstance(stopped, SafetyStopError)
    said = str(stopped)
    assert said.startswith("stopped: node 2 reports emergency 8611h (following error; error register 21h); all axes are stopped")
    assert "axis 2 is at " in said
    assert "hil move --axis 2 --to 0" in said
    channel.on_sync = lambda number: None
    channel.world.free_step(channel.world.now + 2_000_000_000)
    assert moved(bench, channel, to_rev=0.0) == pytest.approx(0.0, abs=0.01)


def test_back_is_where_the_axis_was_before_the_last_motion_even_if_the_master_was_killed_in_it(
    bench: Bench, channel: InProcessChannel, tmp_path: Path
) -> None:
    moved(bench, channel, to_rev=0.25)
    planned = plan_move(bench, MoveRequest(2, to_rev=1.0), channel=channel)
    seen: list[float] = []

    class Watching(Reporter):
        def progress(self, fraction: float) -> None:
            if fraction > 0.5 and not seen:
                seen.append(position_before(on_channel, 2, tmp_path).counts)

    on_channel = bench.on(str(channel.address))
    outcome = make_move(planned, tmp_path / "bench-out" / "killed" / "bus.log", channel=channel, reporter=Watching())
    assert outcome.stands_rev == pytest.approx(1.0, abs=0.01)
    before = position_before(on_channel, 2, tmp_path)
    assert seen == [before.counts], "the log has it while the axis moves"
    request = MoveRequest(2, before=before)
    back = plan_move(bench, request, channel=channel)
    assert f"to 0.25 rev, its position before the motion in {before.log}," in back.sentences[-1]
    assert make_move(back, channel=channel).stands_rev == pytest.approx(0.25, abs=0.01)


def test_back_does_not_take_the_log_of_a_command_that_was_refused(
    bench: Bench, channel: InProcessChannel, tmp_path: Path
) -> None:
    make_move(plan_move(bench, MoveRequest(2, to_rev=0.3), channel=channel), tmp_path / "seen" / "bus.log", channel=channel)
    with Session(bench, channel, BusLog(tmp_path / "refused" / "bus.log", log_label(channel.address))) as session:
        session.bring_up()
    before = position_before(bench.on(str(channel.address)), 2, tmp_path)
    assert before.log == tmp_path / "seen" / "bus.log"
    assert before.counts == pytest.approx(0, abs=2000)
