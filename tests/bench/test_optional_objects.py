"""Drives that lack objects: optional ones are not missed; all others are listed at once, before anything is written."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object, State
from hil.bench.bench import AS_FOUND, AxisTable, Bench
from hil.can.frame import Frame
from hil.control.treatments import LoopName
from hil.errors import NodeError, NotPossibleError
from hil.experiments import measurement
from hil.experiments.motions import constant_acceleration
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.master.drive.needs import MissingObjectsError
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import BusLog
from hil.robot_tables import Control
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.drive.drive import Drive
from plant_emulator.robots.robot import Robot
from plant_emulator.slave.dictionary import Cell, SdoAbort
from plant_emulator.world import World
from tests.bench.conftest import with_bus

AXIS = 2
OPTIONAL = {
    "gear ratio": (Object.GEAR_RATIO, 0x6092),
    "communication cycle period": (0x1006,),
    "polarity and units": (Object.POLARITY, 0x60A8, 0x60A9, 0x60AA),
}
DOWNLOAD = 0x600 + AXIS


def hide(drive: Drive, *indices: int, code: SdoAbortCode = SdoAbortCode.NO_OBJECT) -> None:
    """Take objects from a drive, as far as anybody on the bus can see."""
    dictionary = drive.slave.dictionary
    find = dictionary.find

    def found(index: int, subindex: int) -> Cell:
        if index in indices:
            raise SdoAbort(code)
        return find(index, subindex)

    dictionary.find = found  # type: ignore[method-assign]


def changed(bench: Bench, **changes: object) -> Bench:
    """The bench with another table of the axis."""
    table = bench.axis[AXIS].model_copy(update=changes)
    return bench.model_copy(update={"axis": {**bench.axis, AXIS: AxisTable.model_validate(table.model_dump())}})


def opened(bench: Bench, robot: Robot, *hidden: int, **how: SdoAbortCode) -> tuple[Session, InProcessChannel]:
    channel = InProcessChannel(World(robot))
    hide(channel.world.drives[AXIS], *hidden, **how)
    return Session(with_bus(bench, answer_timeout_s=0.05), channel, BusLog(None)), channel


def run(session: Session, loop: LoopName = "drive") -> RunResult:
    with session:
        session.bring_up()
        return session.run(constant_acceleration(session.bench, AXIS, 0.002), "none", loop)


def written(channel: InProcessChannel) -> list[Frame]:
    """Downloads that the master has begun at the axis' drive."""
    return [frame for frame in channel.sent if frame.can_id == DOWNLOAD and frame.data[0] >> 5 == 1]


def without_feed(monkeypatch: pytest.MonkeyPatch, session: Session) -> None:
    """The same profile for a drive whose positions are increments, whatever gear and feed constant are."""
    axis = session.axes[AXIS]
    assert axis.profile.encoder is not None
    encoder = axis.profile.encoder.model_copy(
        update={"feed": None, "feed_shaft_revs": None, "gear_motor_revs": None, "gear_shaft_revs": None}
    )
    monkeypatch.setattr(axis, "profile", axis.profile.model_copy(update={"encoder": encoder}))


@pytest.mark.slow
@pytest.mark.parametrize("hidden", OPTIONAL.values(), ids=OPTIONAL)
@pytest.mark.parametrize("code", [SdoAbortCode.NO_OBJECT, SdoAbortCode.NO_SUBINDEX])
def test_a_drive_without_an_optional_object_runs(
    hidden: tuple[int, ...], code: SdoAbortCode, short_bench: Bench, reference_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, channel = opened(short_bench, reference_robot, *hidden, code=code)
    if Object.GEAR_RATIO in hidden:
        without_feed(monkeypatch, session)
    result = run(session)
    assert result.stopped is None
    assert not session.not_restored
    assert not [frame for frame in written(channel) if int.from_bytes(frame.data[1:3], "little") in hidden]


def test_a_rated_torque_that_the_drive_does_not_tell_is_that_of_the_bench_file(
    short_bench: Bench, reference_robot: Robot
) -> None:
    rated_nm = reference_robot.axis[AXIS].rated_torque
    session, channel = opened(changed(short_bench, rated_torque_nm=rated_nm), reference_robot, Object.MOTOR_RATED_TORQUE)
    assert run(session).stopped is None
    limit = next(frame for frame in written(channel) if frame.data[1:3] == b"\x72\x60")
    assert int.from_bytes(limit.data[4:6], "little") == round(1000.0 * short_bench.axis[AXIS].limits.torque_nm / rated_nm)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"rated_torque_nm": 9.0}, "but axis.2.rated_torque_nm = 9"), ({"encoder_counts_per_rev": 4096}, "counts 131072")],
)
def test_a_bench_file_that_contradicts_the_drive_is_refused(
    changes: dict[str, float], words: str, short_bench: Bench, reference_robot: Robot
) -> None:
    session, channel = opened(changed(short_bench, **changes), reference_robot)
    with pytest.raises(NodeError, match=words):
        run(session)
    assert written(channel) == []


MISSING = (Object.ABORT_CONNECTION_OPTION, Object.MAX_TORQUE, Object.INTERPOLATION_PERIOD)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("hidden", "at_once"),
    [
        (MISSING, ["6007:0", "6072:0", "60C2:1", "60C2:2"]),
        ((*MISSING, Object.MOTOR_RATED_TORQUE), ["6076:0", "6007:0", "6072:0", "60C2:1", "60C2:2"]),
        ((Object.VELOCITY_ACTUAL, Object.TORQUE_ACTUAL), ["606C:0", "6077:0"]),
        ((0x1600,), ["1600:0"]),
    ],
)
def test_all_that_is_missing_is_listed_at_once_with_its_use_before_anything_is_written(
    hidden: tuple[int, ...], at_once: list[str], short_bench: Bench, reference_robot: Robot
) -> None:
    session, channel = opened(short_bench, reference_robot, *hidden)
    with pytest.raises(MissingObjectsError) as caught:
        run(session)
    lines = str(caught.value).splitlines()
    assert "nothing has been written" in lines[0]
    assert sorted(line.split()[6] for line in lines[1:]) == sorted(at_once)
    assert all(line.startswith(f"  axis {AXIS}, node {AXIS}, has no ") and ": " in line for line in lines[1:])
    assert written(channel) == []
    assert channel.world.drives[AXIS].state is State.SWITCH_ON_DISABLED


def test_two_drives_that_lack_something_stand_in_one_list(short_bench: Bench, reference_robot: Robot) -> None:
    session, channel = opened(short_bench, reference_robot, Object.VELOCITY_ACTUAL)
    hide(channel.world.drives[3], Object.MOTOR_RATED_TORQUE)
    with session, pytest.raises(MissingObjectsError) as caught:
        session.bring_up()
    assert [(axis, needs[0].address[0]) for axis, _, needs in caught.value.missing] == [(2, 0x606C), (3, 0x6076)]


def lacking(names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, session: Session) -> None:
    """A profile of the axis' drive without these parameters."""
    axis = session.axes[AXIS]
    kept = {name: entry for name, entry in axis.profile.parameters.items() if name not in names}
    monkeypatch.setattr(axis, "profile", axis.profile.model_copy(update={"parameters": kept}))


GAINS = tuple(Control.model_fields)


def test_what_a_profile_lacks_is_said_before_anything_is_written(
    short_bench: Bench, reference_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, channel = opened(short_bench, reference_robot)
    lacking((*GAINS, "notch_1.mode"), monkeypatch, session)
    motion = constant_acceleration(session.bench, AXIS, 0.002)
    with session:
        session.bring_up()
        with pytest.raises(NotPossibleError) as caught:
            session.run(motion, "notch", "drive")
    for name in (*GAINS, "notch_1.mode"):
        assert str(caught.value).count(name) == 1
    assert written(channel) == []


def test_what_any_of_several_experiments_lacks_is_said_before_the_first_of_them_moves(
    short_bench: Bench, reference_robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = InProcessChannel(World(reference_robot))
    monkeypatch.setattr(measurement, "open_channel", lambda address: channel)
    experiments = [Experiment("constant-acceleration", AXIS, "none", loop) for loop in ("drive", "host")]
    with pytest.raises(NotPossibleError, match='axis 2: control = "as found" leaves the gains to the drive'):
        run_experiments(changed(short_bench, control=AS_FOUND), experiments, tmp_path)
    assert not channel.sent


def gains_of(robot: Robot, bench: Bench) -> Robot:
    """The robot whose drives hold the gains of the bench from the start, as their maker's tool would have set them."""
    control = bench.axis[AXIS].gains("the test")
    table = robot.axis[AXIS].model_copy(update={"control": control})
    return robot.model_copy(update={"axis": {**robot.axis, AXIS: table}})


def test_a_drive_keeps_the_gains_that_its_makers_tool_has_set(
    short_bench: Bench, reference_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, channel = opened(changed(short_bench, control=AS_FOUND), gains_of(reference_robot, short_bench))
    gains = {session.axes[AXIS].profile.parameters[name].index for name in GAINS}
    lacking(GAINS, monkeypatch, session)
    asked: Callable[[Frame], bool] = lambda f: f.can_id == DOWNLOAD and int.from_bytes(f.data[1:3], "little") in gains  # noqa: E731
    result = run(session)
    assert result.stopped is None
    assert not any(map(asked, channel.sent)), "neither written nor read"
    known, _ = opened(short_bench, reference_robot)
    assert run(known).recording.axis(AXIS, "position_rad") == pytest.approx(result.recording.axis(AXIS, "position_rad"))


def test_a_host_does_not_close_a_loop_whose_gains_it_does_not_know(short_bench: Bench, reference_robot: Robot) -> None:
    session, channel = opened(changed(short_bench, control=AS_FOUND), reference_robot)
    with pytest.raises(NotPossibleError, match="axis 2 closed by the host needs gains in the bench file"):
        run(session, "host")
    assert written(channel) == []
