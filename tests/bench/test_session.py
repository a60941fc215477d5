"""The session on a real world in one process: every cycle is the test's."""

import math
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType, FunctionCode
from drive_profiles.standard.cia402 import Object, State
from hil.bench.bench import Bench
from hil.can.frame import CAN_ERR_FLAG, Frame
from hil.errors import (
    AlreadyMovingError,
    InterruptedRunError,
    NoAnswerError,
    NodeError,
    NotPossibleError,
    SafetyStopError,
    UnsafeRequestError,
    WrongIdentityError,
)
from hil.experiments.motions import constant_acceleration, line_motion
from hil.experiments.plan import demo_experiments, entries
from hil.master.session import Session
from hil.recording import BusLog
from hil.robot_tables import Control, NotchShape
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.motion.record import BRAKED
from plant_emulator.pytest_plugin.emulated import EmulatedRobot
from plant_emulator.pytest_plugin.master import BenchSession
from plant_emulator.robots.robot import Robot
from plant_emulator.studies.simulate import simulate
from plant_emulator.world import World
from tests.bench.conftest import all_braked, shortened, with_bus, with_motion


@pytest.fixture
def hil_bench(hil_bench: Bench) -> Bench:
    """The plug-in's, with a second of motion."""
    return shortened(hil_bench)


def session_of(hil_bench: Bench, hil_robot: Robot) -> tuple[Session, InProcessChannel]:
    channel = InProcessChannel(World(hil_robot))
    hil_bench = with_bus(hil_bench, answer_timeout_s=0.05)
    return Session(hil_bench, channel, BusLog(None)), channel


def sdo_write(channel: InProcessChannel, node: int, index: int, subindex: int, data: bytes) -> None:
    """A stranger's expedited download."""
    command = 0x23 | (4 - len(data)) << 2
    channel.inject(Frame(0x600 + node, bytes((command, index & 0xFF, index >> 8, subindex)) + data.ljust(4, b"\0")))


def everything(world: World) -> dict[int, dict[tuple[int, int], object]]:
    """All stored values of all nodes."""
    nodes = {number: drive.slave.dictionary for number, drive in world.drives.items()}
    nodes[0] = world.accelerometer.slave.dictionary
    moving = {0x6041, 0x6064, 0x606C, 0x6077, 0x60F4, 0x2130, 0x6040, 0x607A, 0x6071, 0x7130, 0x1001, 0x1003}
    moving |= {0x6062, 0x6063, 0x6069, 0x606B, 0x6074, 0x6078, 0x60FA, 0x60FC}
    return {
        number: {(e.index, e.subindex): dictionary.get(e.index, e.subindex) for e in dictionary if e.index not in moving}
        for number, dictionary in nodes.items()
    }


# -- what went over CAN is what happens without it ---------------------------------------------------------------------


def notch_table(hil_bench: Bench, axis: int) -> tuple[NotchShape, ...]:
    names = NotchShape.model_fields
    return tuple(
        NotchShape(**{k: v for k, v in table.model_dump().items() if k in names}) for table in hil_bench.axis[axis].notch
    )


@pytest.mark.slow
@pytest.mark.parametrize("axis", [2, 3, None])
@pytest.mark.parametrize("compensation", ["none", "notch"])
def test_what_went_over_can_equals_the_simulation_without_can(
    reference_bench: Bench, quiet_robot: Robot, axis: int | None, compensation: str
) -> None:
    period = reference_bench.bus.sync_period_s
    hil_session, _ = session_of(reference_bench, quiet_robot)
    motion = line_motion(reference_bench, period) if axis is None else constant_acceleration(reference_bench, axis, period)
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(motion, compensation, "drive")  # type: ignore[arg-type]
    assert result.stopped is None

    # the brake opens with one SYNC, the next one's status word says so, and the settling begins with the one after
    settle = reference_bench.settle_s + 2 * period
    without_can = simulate(
        quiet_robot,
        axis,
        controls={n: Control(**t.control.model_dump()) for n, t in reference_bench.axis.items()},
        notches={n: notch_table(reference_bench, n) if compensation == "notch" else () for n in reference_bench.axis},
        sync_period_s=period,
        settle_s=settle,
    )
    recording = result.recording
    assert len(recording.time_s) == len(without_can.time_s)
    for column, number in enumerate(without_can.axes):
        count_rad = 2.0 * math.pi / quiet_robot.axis[number].encoder_counts_per_rev
        counts = recording.axis(number, "position_rad") / count_rad
        np.testing.assert_allclose(counts, without_can.position_counts[:, column], atol=1e-6)
        quantum = hil_session.axes[number].scaling.torque_quantum_nm
        np.testing.assert_allclose(recording.axis(number, "torque_nm"), without_can.torque_nm[:, column], atol=0.51 * quantum)
    for column, name in enumerate("xyz"):
        measured = recording.columns[f"tip_{name}_m_s2"]
        np.testing.assert_allclose(measured, without_can.tip_acceleration_m_s2[:, column], atol=0.51e-3)


# -- nothing is left behind --------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("loop", ["drive", "host"])
def test_the_bus_is_left_as_it_was_found(short_bench: Bench, reference_robot: Robot, loop: str) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    before = everything(channel.world)
    period = short_bench.bus.host_sync_period_s if loop == "host" else short_bench.bus.sync_period_s
    with hil_session:
        hil_session.bring_up()
        assert everything(channel.world) == before, "finding the nodes writes nothing"
        result = hil_session.run(constant_acceleration(short_bench, 3, period), "notch", loop)  # type: ignore[arg-type]
    assert result.stopped is None
    assert everything(channel.world) == before
    assert all_braked(channel.world)
    assert all(drive.state is not State.OPERATION_ENABLED for drive in channel.world.drives.values())
    assert abs(channel.world.axes.counts(channel.world.axes.row(3))) < 100, "the arm is back where it started"


def test_gains_and_filters_reach_the_drive_before_it_is_enabled(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    seen: list[tuple[float, int]] = []

    def look(number: int) -> None:
        drive, row = hil_robot.world.drives[2], hil_robot.world.axes.row(2)
        if drive.state is State.OPERATION_ENABLED:
            axes = hil_robot.world.axes
            seen.append((float(axes.cascade_config[row]["velocity_gain_nm_s_rad"]), int(axes.notch_config[row, 0]["mode"])))

    hil_robot.channel.on_sync = look
    hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "notch", "drive")
    assert seen
    assert {(round(gain, 6), mode) for gain, mode in seen} == {(0.196, 1)}


def test_limits_of_the_bench_file_are_in_the_drive_while_it_moves(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    held: list[dict[str, float]] = []

    def look(number: int) -> None:
        motion = hil_robot.world.axes.motion[hil_robot.world.axes.row(2)]
        if motion["mode"] != BRAKED:
            held.append(
                {name: float(motion[name]) for name in ("torque_limit_nm", "max_speed_rad_s", "low_counts", "high_counts")}
            )

    hil_robot.channel.on_sync = look
    hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    limits = hil_bench.axis[2].limits
    assert held[0]["torque_limit_nm"] == pytest.approx(limits.torque_nm, rel=1e-3)
    assert held[0]["max_speed_rad_s"] == pytest.approx(limits.speed_rps * 2 * math.pi, rel=1e-3)
    assert held[0]["low_counts"] == limits.position_min_rev * 131072
    assert held[0]["high_counts"] == limits.position_max_rev * 131072


# -- what is refused before anything is enabled ------------------------------------------------------------------------


def nothing_was_enabled(channel: InProcessChannel) -> bool:
    commanded = any(0x200 < frame.can_id < 0x280 for frame in channel.sent)
    return all_braked(channel.world) and not commanded


def test_a_silent_node_is_named_and_nothing_is_enabled(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    channel.passes = lambda frame: frame.can_id != 0x583
    with hil_session, pytest.raises(NoAnswerError) as error:
        hil_session.bring_up()
    assert error.value.node == 3
    assert error.value.exit_code == 5
    assert nothing_was_enabled(channel)


def test_another_device_is_refused(short_bench: Bench, reference_robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    profile = hil_session.axes[2].profile
    other = profile.model_copy(update={"identity": profile.identity.model_copy(update={"product_code": 0x999})})
    hil_session.axes[2].profile = other
    with hil_session, pytest.raises(WrongIdentityError) as error:
        hil_session.bring_up()
    assert (error.value.node, error.value.expected, error.value.found) == (2, 0x999, 0x402)
    assert nothing_was_enabled(channel)


def test_a_sync_period_that_a_drive_does_not_take_is_said_in_its_unit(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(with_bus(short_bench, sync_period_s=0.0021), reference_robot)
    before = everything(channel.world)
    with hil_session:
        hil_session.bring_up()
        with pytest.raises(NotPossibleError, match=r"refuses a SYNC period of 2\.1 ms; its control period is 0\.25 ms"):
            hil_session.run(constant_acceleration(short_bench, 2, 0.0021), "none", "drive")
    assert nothing_was_enabled(channel)
    assert everything(channel.world) == before, "what was written before is put back"


def test_another_serial_number_is_refused(short_bench: Bench, reference_robot: Robot) -> None:
    axis = short_bench.axis[5].model_copy(update={"serial_number": 4711})
    hil_bench = short_bench.model_copy(update={"axis": {**short_bench.axis, 5: axis}})
    hil_session, _ = session_of(hil_bench, reference_robot)
    with hil_session, pytest.raises(WrongIdentityError, match="serial number"):
        hil_session.bring_up()


def test_an_axis_that_is_enabled_already_is_left_alone(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    channel.inject(Frame(0x000, b"\x01\x03"))
    for index, subindex, gain in ((0x2100, 1, 25.0), (0x2101, 1, 0.0905), (0x2101, 2, 1.81)):
        sdo_write(channel, 3, index, subindex, struct.pack("<f", gain))
    sdo_write(channel, 3, Object.MODES_OF_OPERATION, 0, b"\x01")
    for word in (0x06, 0x07, 0x0F):
        sdo_write(channel, 3, Object.CONTROL_WORD, 0, bytes((word, 0)))
    assert channel.world.drives[3].state is State.OPERATION_ENABLED
    before = len(channel.sent)
    with hil_session, pytest.raises(AlreadyMovingError) as error:
        hil_session.bring_up()
    assert error.value.exit_code == 5
    assert channel.world.drives[3].state is State.OPERATION_ENABLED, "it is somebody else's"
    writes = [f for f in list(channel.sent)[before:] if 0x600 < f.can_id < 0x680 and f.data[0] & 0xE0 == 0x20]
    assert not writes


def test_a_drive_in_fault_needs_an_explicit_reset(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    channel.world.drives[2]._fault("following error", 0x8611)
    with hil_session, pytest.raises(NodeError, match=r"8611h.*--reset-faults"):
        hil_session.bring_up()
    with hil_session:
        hil_session.bring_up(reset_faults=True)
        assert channel.world.drives[2].state is State.SWITCH_ON_DISABLED
        assert hil_session.run(constant_acceleration(short_bench, 2, 0.002), "none", "drive").stopped is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"end_rps": 13.0}, "speed"), ({"end_rps": 11.0, "acceleration_rps_s": 1.0}, "position")],
)
def test_a_motion_beyond_a_limit_is_refused_before_anything_is_sent(
    reference_bench: Bench, reference_robot: Robot, changes: dict[str, float], words: str
) -> None:
    hil_bench = with_motion(reference_bench, **changes)
    hil_session, channel = session_of(hil_bench, reference_robot)
    before = everything(channel.world)
    with hil_session:
        hil_session.bring_up()
        with pytest.raises(UnsafeRequestError, match=words) as error:
            hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    assert error.value.exit_code == 3
    assert error.value.value > error.value.limit
    assert everything(channel.world) == before
    assert nothing_was_enabled(channel)


def test_an_unstable_host_loop_is_refused(hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench) -> None:
    """The reference gains do not stand 1 ms with a sample of delay."""
    with pytest.raises(UnsafeRequestError, match="edge of stability"):
        hil_session.run(constant_acceleration(hil_bench, 2, 0.001), "none", "host")
    assert nothing_was_enabled(hil_robot.channel)


# -- what stops a run --------------------------------------------------------------------------------------------------


def run_with(
    hil_bench: Bench, hil_robot: Robot, interfere: Callable[[InProcessChannel], None], *, at: int = 500
) -> tuple[SafetyStopError | None, InProcessChannel, int]:
    """A short run of axis 2 in which something happens in cycle `at`; why it stopped, and how many rows it kept."""
    hil_session, channel = session_of(hil_bench, hil_robot)

    def act(number: int) -> None:
        if number == at:
            interfere(channel)

    channel.on_sync = act
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    return result.stopped, channel, result.cycles


@pytest.mark.slow
@pytest.mark.parametrize(
    ("interfere", "words"),
    [
        pytest.param(lambda c: c.inject(Frame(0x082, bytes.fromhex("1181200000000000"))), "8111h", id="emergency of the axis"),
        pytest.param(lambda c: c.inject(Frame(0x085, bytes.fromhex("1042020000000000"))), "node 5", id="emergency of another"),
        pytest.param(lambda c: c.inject(Frame(0x000, b"\x82\x02")), "reset", id="node reset"),
        pytest.param(lambda c: c.inject(Frame(0x000, b"\x80\x02")), "axis 2", id="taken out of operation by a stranger"),
        pytest.param(lambda c: sdo_write(c, 2, 0x1017, 0, b"\0\0"), "heartbeat", id="heartbeat lost"),
        pytest.param(lambda c: c.world.drives[2]._fault("motor speed", 0x8400), "8400h", id="drive fault"),
        pytest.param(lambda c: setattr(c, "passes", lambda f: f.can_id != 0x182), "not answered", id="answers lost"),
        pytest.param(lambda c: sdo_write(c, 2, 0x6065, 0, b"\x01\0\0\0"), "8611h", id="following error"),
        pytest.param(lambda c: sdo_write(c, 2, 0x607D, 2, b"\x01\0\0\0"), "8612h", id="position limit"),
        pytest.param(lambda c: sdo_write(c, 2, 0x6080, 0, b"\x01\0\0\0"), "8400h", id="speed limit"),
    ],
)
def test_what_goes_wrong_in_motion_stops_and_disables_every_axis(
    short_bench: Bench, reference_robot: Robot, interfere: Callable[[InProcessChannel], None], words: str
) -> None:
    stopped, channel, rows = run_with(short_bench, reference_robot, interfere)
    assert stopped is not None
    assert words in str(stopped)
    assert stopped.exit_code == 8
    channel.world.free_step(channel.world.now + 2_000_000_000)
    assert all_braked(channel.world)
    assert all(drive.state is not State.OPERATION_ENABLED for drive in channel.world.drives.values())
    assert 0 < rows < 500, "what was recorded up to then is kept"


def test_the_tip_is_judged_only_where_answers_came(short_bench: Bench, reference_robot: Robot) -> None:
    """A single lost answer is counted and does not stop."""

    def lose_one(channel: InProcessChannel) -> None:
        number = channel.syncs
        channel.passes = lambda frame: not (frame.can_id == 0x182 and channel.syncs == number)

    stopped, _, _ = run_with(short_bench, reference_robot, lose_one)
    assert stopped is None


def test_missing_answers_are_counted(hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench) -> None:
    hil_robot.channel.passes = lambda frame: not (frame.can_id == 0x182 and hil_robot.channel.syncs in (500, 510, 511))
    result = hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    assert result.stopped is None
    assert result.missed_cycles == 3
    assert int(result.recording.columns["missing"].sum()) == 3


def test_a_silent_accelerometer_is_counted_and_does_not_stop(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    hil_robot.channel.passes = lambda frame: not (frame.can_id == 0x190 and hil_robot.channel.syncs >= 700)
    result = hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    assert result.stopped is None
    assert result.missed_cycles > 0


def test_a_lost_bus_ends_the_run_and_keeps_the_recording(short_bench: Bench, reference_robot: Robot) -> None:
    stopped, channel, rows = run_with(short_bench, reference_robot, lambda c: setattr(c, "lost", True))
    assert stopped is not None
    assert "pulled" in str(stopped)
    assert not stopped.all_disabled
    assert rows > 0
    # and the drive ends the motion by its own clock
    channel.world.free_step(channel.world.now + 3_000_000_000)
    assert all_braked(channel.world)
    assert "heartbeat 127" in channel.world.drives[2].slave.emergencies.causes


def test_an_interrupt_ramps_down_and_is_told_apart(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)

    def interrupt(number: int) -> None:
        if number == 500:
            hil_session.interrupt("SIGINT")

    channel.on_sync = interrupt
    before = everything(channel.world)
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(constant_acceleration(short_bench, 2, 0.002), "none", "drive")
    assert result.stopped is not None
    assert result.stopped.exit_code == 130
    assert result.stopped.all_disabled
    assert everything(channel.world) == before


def test_an_interrupt_that_no_drive_has_confirmed_does_not_end_as_a_safe_one(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)

    def interrupt(number: int) -> None:
        if number == 500:
            hil_session.interrupt("SIGINT")
            channel.passes = lambda frame: frame.can_id & 0x7F != 2

    channel.on_sync = interrupt
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(constant_acceleration(short_bench, 2, 0.002), "none", "drive")
    assert isinstance(result.stopped, InterruptedRunError)
    assert not result.stopped.all_disabled
    assert result.stopped.exit_code == 8
    assert "node 2 has not confirmed that it is disabled" in " ".join(hil_session.not_restored)


def test_the_progress_of_a_run_ends_where_the_run_does(short_bench: Bench, reference_robot: Robot) -> None:
    shown: list[float] = []
    hil_session, channel = session_of(short_bench, reference_robot)
    hil_session.progress = shown.append
    motion = constant_acceleration(short_bench, 2, 0.002)
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(motion, "none", "drive")
        assert result.stopped is None
        assert shown[-1] == 1.0
        first = channel.syncs
        channel.on_sync = lambda number: hil_session.interrupt("SIGINT") if number == first + 500 else None
        result = hil_session.run(motion, "none", "drive")
    assert 0 < result.cycles < len(motion.time_s)
    assert shown[-1] == result.cycles / len(motion.time_s)


def test_an_error_of_the_master_itself_stops_the_axes_first(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:

    def stumble(share: float) -> None:
        raise ZeroDivisionError

    hil_session.progress = stumble
    with pytest.raises(ZeroDivisionError):
        hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    assert all_braked(hil_robot.world)
    words = [int.from_bytes(f.data[:2], "little") for f in hil_robot.channel.sent if f.can_id == 0x202]
    assert 0x0002 in words
    assert words[-1] == 0x0000


def test_set_points_stop_when_the_loop_does(short_bench: Bench, reference_robot: Robot) -> None:
    """After a stop no RPDO commands operation again, and the last word disables."""
    stopped, channel, _ = run_with(
        short_bench, reference_robot, lambda c: c.inject(Frame(0x085, bytes.fromhex("1042020000000000")))
    )
    assert stopped is not None
    words = [int.from_bytes(f.data[:2], "little") for f in channel.sent if f.can_id == 0x202]
    first = words.index(0x0002)
    assert 0x000F in words[:first]
    assert set(words[first:]) <= {0x0002, 0x0000}
    assert words[-1] == 0x0000


# -- the shape of a run ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_host_closed_commands_torque_and_drive_closed_positions(short_bench: Bench, reference_robot: Robot) -> None:
    lengths = {}
    for loop, period in (("drive", 0.002), ("host", 250e-6)):
        hil_session, channel = session_of(short_bench, reference_robot)
        with hil_session:
            hil_session.bring_up()
            hil_session.run(constant_acceleration(short_bench, 2, period), "none", loop)  # type: ignore[arg-type]
        lengths[loop] = {len(frame.data) for frame in channel.sent if frame.can_id == 0x202}
    assert lengths == {"drive": {6}, "host": {4}}


@pytest.mark.ci
def test_the_world_advances_by_the_cycle_period_that_the_nodes_were_told(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    instants: list[int] = []
    hil_robot.channel.on_sync = lambda number: instants.append(hil_robot.world.now)
    hil_session.run(constant_acceleration(hil_bench, 2, 250e-6), "none", "host")
    steps = set(np.diff(instants[5:]).tolist())
    assert steps == {250_000}


def test_every_demo_run_has_a_motion_within_the_limits(reference_bench: Bench) -> None:
    for experiment in demo_experiments(reference_bench):
        motion = experiment.motion(reference_bench)
        for column, number in enumerate(motion.axes):
            revolutions = motion.motor_angle_rad[:, column] / (2 * math.pi)
            limits = reference_bench.axis[number].limits
            assert limits.position_min_rev < revolutions.min()
            assert revolutions.max() < limits.position_max_rev


def test_profiles_of_the_reference_bench_state_what_the_nodes_hold(reference_robot: Robot) -> None:
    """Each object that the profile names exists in the emulated node with its type."""
    world = World(reference_robot)
    for profile_name, dictionary in (
        ("emulated_drive", world.drives[2].slave.dictionary),
        ("emulated_accelerometer", world.accelerometer.slave.dictionary),
    ):
        profile = Profile.load(profile_name)
        for parameter in profile.parameters.values():
            entry = dictionary.cell(parameter.index, parameter.subindex).entry
            assert entry.data_type is DataType[parameter.data_type], parameter.written_address
            assert entry.access.is_writable == (parameter.access == "rw"), parameter.written_address
        assert dictionary.get(0x1018, 1) == profile.identity.vendor_id
        assert dictionary.get(0x1018, 2) == profile.identity.product_code
        assert dictionary.get(0x1018, 3) == profile.identity.revision
        assert dictionary.get(0x1000) == profile.identity.device_type


def test_sync_is_sent_before_anything_is_asked(hil_session: BenchSession, hil_robot: EmulatedRobot) -> None:
    """So that the world's clock is the master's from the first frame on, and equal seeds give equal frames."""
    assert hil_robot.channel.sent[0].can_id == FunctionCode.SYNC


# -- what a review has found -------------------------------------------------------------------------------------------


def test_a_drive_that_ignores_the_last_command_is_not_called_disabled(short_bench: Bench, reference_robot: Robot) -> None:
    """It keeps its limits and its supervision; the master's silence then ends it."""
    hil_session, channel = session_of(short_bench, reference_robot)
    drive = channel.world.drives[2]
    deaf = [False]
    receive = drive.slave.receive

    def hard_of_hearing(frame: Frame, now: int) -> list[Frame]:
        commands = frame.can_id == 0x202 or (frame.can_id == 0x602 and frame.data[1:3] == b"\x40\x60") or frame.can_id == 0
        if commands and deaf[0]:
            return []
        return receive(frame, now)

    drive.slave.receive = hard_of_hearing  # type: ignore[method-assign]

    def deafen(number: int) -> None:
        deaf[0] = deaf[0] or number == 500

    channel.on_sync = deafen
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(constant_acceleration(short_bench, 2, 0.002), "none", "drive")
    assert result.stopped is not None
    assert not result.stopped.all_disabled
    assert any("node 2" in words and "keeps the limits" in words for words in hil_session.not_restored)
    assert drive.slave.dictionary.get(0x1016, 1) != 0
    deaf[0] = False
    channel.world.free_step(channel.world.now + 3_000_000_000)
    assert all_braked(channel.world)


def test_drives_are_supervised_before_they_are_enabled(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    """The master's heartbeat follows the order to watch it, so that its loss counts from the first moment."""
    hil_session.run(constant_acceleration(hil_bench, 2, 0.002), "none", "drive")
    ids = [(f.can_id, f.data[1:4]) for f in hil_robot.channel.sent]
    ordered = max(i for i, (can_id, mux) in enumerate(ids) if can_id == 0x602 and mux == b"\x16\x10\x01" and i < len(ids) // 2)
    enabled = next(i for i, f in enumerate(hil_robot.channel.sent) if f.can_id == 0x202 and f.data[0] == 0x0F)
    assert any(can_id == 0x77F for can_id, _ in ids[ordered:enabled])


def test_no_axis_is_enabled_before_all_can_be(reference_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(reference_bench, reference_robot)
    seen: list[set[State]] = []
    channel.on_sync = lambda number: seen.append({drive.state for drive in channel.world.drives.values()})
    session_bench = line_motion(reference_bench, 0.002)
    with hil_session:
        hil_session.bring_up()
        hil_session.run(session_bench, "none", "drive")
    first = next(states for states in seen if State.OPERATION_ENABLED in states)
    assert first == {State.OPERATION_ENABLED}


@pytest.mark.slow
def test_a_host_loop_holds_each_axis_from_its_first_enabled_cycle(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    row, largest = hil_robot.world.axes.row(2), [0.0]
    settled = [False]

    def watch(number: int) -> None:
        if not settled[0]:
            largest[0] = max(largest[0], abs(float(hil_robot.world.axes.plant_state[row]["motor_angle_rad"])))
        settled[0] = settled[0] or number > 200

    hil_robot.channel.on_sync = watch
    hil_session.run(constant_acceleration(hil_bench, 2, 250e-6), "none", "host")
    assert largest[0] < 0.2, "rad at the motor, while the brake opens under gravity"


@pytest.mark.slow
def test_a_run_without_its_accelerometer_is_never_a_pass(reference_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(reference_bench, reference_robot)
    channel.passes = lambda frame: frame.can_id != 0x190
    experiment = demo_experiments(reference_bench)[1]
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(experiment.motion(reference_bench), "notch", "drive")
    assert result.sensor_missed == result.cycles
    for entry in entries(reference_bench, experiment, result, "x.csv"):
        assert entry.within_spec is None
        assert entry.tip_peak_mm is None
        assert "accelerometer was missing" in (entry.invalid or "")


def test_a_motion_that_misses_the_windows_is_run_and_not_judged(hil_session: BenchSession, hil_bench: Bench) -> None:
    experiment = demo_experiments(hil_bench)[0]
    result = hil_session.run(experiment.motion(hil_bench), "none", "drive")
    (fourth,) = entries(hil_bench, experiment, result, "x.csv")
    assert fourth.order == 4
    assert fourth.tip_peak_mm is not None
    missed = [*(fourth.unjudged_orders or ()), *(fourth.unreached_orders or ())]
    begin = "axis 2: order 2 is not judged: it meets f_al = 11.84 Hz at 5.92 rev/s, but the ramp ends at"
    assert [each for each in missed if each.startswith(begin)]


def test_a_filter_that_the_drive_held_before_comes_back_whole(short_bench: Bench, reference_robot: Robot) -> None:
    """1 … 2 rps before, 4 … 9 rps in the run: on the way back the filter is off until its range is whole again."""
    hil_session, channel = session_of(short_bench, reference_robot)
    for subindex, value in ((3, 1.0), (4, 2.0)):
        sdo_write(channel, 2, 0x2110, subindex, struct.pack("<f", value))
    sdo_write(channel, 2, 0x2110, 1, b"\x01")
    before = everything(channel.world)
    with hil_session:
        hil_session.bring_up()
        hil_session.run(constant_acceleration(short_bench, 2, 0.002), "notch", "drive")
    assert hil_session.not_restored == []
    assert everything(channel.world) == before


def test_a_late_sdo_answer_is_nobodys(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    channel.send(Frame(0x80, b""))
    channel.hand_over(Frame(0x582, bytes.fromhex("4364600078563412")))  # 6064h, asked by nobody
    assert hil_session.network.read(2, 0x1018, 2, DataType.UNSIGNED32) == 0x402


def test_a_chatty_bus_does_not_keep_a_cycle_from_ending(short_bench: Bench, reference_robot: Robot) -> None:
    stopped, _, _ = run_with(short_bench, reference_robot, make_chatty)
    assert stopped is not None
    assert "not answered" in str(stopped)


def make_chatty(channel: InProcessChannel) -> None:
    """The axis falls silent, and somebody else never stops talking."""
    channel.passes = lambda frame: frame.can_id != 0x182
    receive = channel.receive
    channel.receive = lambda timeout_s: receive(timeout_s) or Frame(0x7E5, b"\x01")  # type: ignore[method-assign]


def test_a_notch_run_of_an_axis_without_a_notch_is_refused(
    hil_session: BenchSession, hil_robot: EmulatedRobot, hil_bench: Bench
) -> None:
    with pytest.raises(NotPossibleError, match=r"axis\.5\.notch"):
        hil_session.run(constant_acceleration(hil_bench, 5, 0.002), "notch", "drive")
    assert nothing_was_enabled(hil_robot.channel)


def test_a_bus_that_another_master_synchronises_is_left_alone(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)
    channel.hand_over(Frame(0x80, b""))
    with hil_session, pytest.raises(NodeError, match="another master"):
        hil_session.bring_up()
    assert not channel.sent


# -- what is added to the set-points -----------------------------------------------------------------------------------


class Shift:
    """Adds an angle and a torque to every set-point."""

    uses_torque = True

    def __init__(self, rad: float, torque_nm: float) -> None:
        self.rad, self.torque_nm = rad, torque_nm
        self.seen: list[tuple[float, float]] = []

    def step(self, references_rad, positions_rad, torques_nm):  # type: ignore[no-untyped-def]
        self.seen.append((references_rad[0], positions_rad[0]))
        return [self.rad] * len(references_rad), [self.torque_nm] * len(references_rad)


def test_a_torque_offset_of_the_motion_reaches_the_motor_and_is_taken_back(
    hil_session: BenchSession, hil_robot: EmulatedRobot
) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s)
    offset = np.zeros_like(motion.motor_angle_rad)
    offset[100:130] = 0.5
    held: list[float] = []
    channel = hil_robot.channel
    before = channel.heard
    row = hil_robot.world.axes.row(2)

    def watch(frame: Frame, end_ns: int) -> None:
        held.append(float(hil_robot.world.axes.motion[row]["torque_offset_nm"]))
        before(frame, end_ns)

    channel.heard = watch
    result = hil_session.run(replace(motion, torque_offset_nm=offset))
    channel.heard = before
    assert result.stopped is None
    assert max(held) == pytest.approx(0.5, abs=0.01)
    assert hil_robot.world.axes.motion[row]["torque_offset_nm"] == 0.0
    assert hil_robot.world.drives[2].slave.dictionary.get(Object.TORQUE_OFFSET) == 0
    torque = result.recording.axis(2, "torque_nm")
    assert torque[105:130].mean() > torque[60:95].mean() + 0.1


def test_a_torque_offset_beyond_the_axis_limit_is_refused_before_anything_is_sent(hil_session: BenchSession) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s)
    with pytest.raises(UnsafeRequestError, match="torque offset of axis 2"):
        hil_session.run(replace(motion, torque_offset_nm=np.full_like(motion.motor_angle_rad, 7.2)))


def test_a_corrector_sees_where_the_motor_is_and_moves_the_set_points(hil_session: BenchSession) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s)
    plain = hil_session.run(motion)
    shift = Shift(0.02, 0.1)
    result = hil_session.run(motion, adder=shift)
    assert result.stopped is None
    assert len(shift.seen) > len(motion.time_s)
    moved = result.recording.axis(2, "position_rad") - plain.recording.axis(2, "position_rad")
    assert np.median(moved) == pytest.approx(0.02, abs=0.006)
    np.testing.assert_allclose(
        result.recording.axis(2, "reference_rad") - plain.recording.axis(2, "reference_rad"), 0.0, atol=0.01
    )


class Jolt:
    """Adds a step in one cycle, as an angle that was measured late makes one, and takes it back in the next."""

    uses_torque = False

    def __init__(self, cycle: int, size_rad: float) -> None:
        self.cycle, self.size_rad, self.cycles = cycle, size_rad, 0

    def step(self, references_rad, positions_rad, torques_nm):  # type: ignore[no-untyped-def]
        self.cycles += 1
        return [self.size_rad * (self.cycles == self.cycle)] * len(references_rad), [0.0] * len(references_rad)


def test_no_addition_makes_a_set_point_faster_than_its_axis_may_be(hil_session: BenchSession) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s)
    most_rad = math.tau * hil_bench.axis[2].limits.speed_rps * hil_bench.bus.sync_period_s
    result = hil_session.run(motion, adder=Jolt(700, 2.0 * most_rad))
    assert result.stopped is None  # the drive would have refused the step
    assert len(result.recording.time_s) == len(motion.time_s)


def test_a_corrector_that_asks_for_too_much_torque_stops_the_run(hil_session: BenchSession) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s)
    result = hil_session.run(motion, adder=Shift(0.0, 7.5))
    assert result.stopped is not None
    assert "a torque offset of 7.5 N·m; the limit is 7.1 N·m" in str(result.stopped)
    assert result.stopped.all_disabled


def test_set_points_are_not_corrected_where_the_host_closes_the_loop(hil_session: BenchSession) -> None:
    hil_bench = hil_session.bench
    motion = constant_acceleration(hil_bench, 2, hil_bench.bus.host_sync_period_s)
    with pytest.raises(NotPossibleError, match="--loop drive"):
        hil_session.run(motion, "none", "host", Shift(0.0, 0.0))


# -- what the bus tells ------------------------------------------------------------------------------------------------


def test_what_the_controller_tells_of_the_bus_is_in_the_result_and_in_the_reason(
    hil_session: BenchSession, hil_robot: EmulatedRobot
) -> None:
    hil_bench = hil_session.bench
    warning = Frame(CAN_ERR_FLAG | 0x004, bytes((0, 0x08, 0, 0, 0, 0, 0, 0)))

    def tell(number: int) -> None:
        if number % 50 == 0:
            hil_robot.channel.hand_over(warning)

    hil_robot.channel.on_sync = tell
    result = hil_session.run(constant_acceleration(hil_bench, 2, hil_bench.bus.sync_period_s))
    assert result.stopped is None
    assert result.bus_errors == {"error-warning level of sent frames": pytest.approx(25, abs=20)}
    entry, *_ = entries(hil_bench, demo_experiments(hil_bench)[0], result, "x.csv")
    assert entry.bus_errors == result.bus_errors


def test_two_nodes_with_one_id_are_found_before_anything_moves(short_bench: Bench, reference_robot: Robot) -> None:
    hil_session, channel = session_of(short_bench, reference_robot)

    def double(frame: Frame) -> bool:
        if frame.can_id == 0x583:
            channel.hand_over(frame)
        return True

    channel.passes = double
    with hil_session, pytest.raises(NodeError, match=r"node 3.*answers more than once per request.*two nodes"):
        hil_session.bring_up()
    assert all_braked(channel.world)


@pytest.mark.ci
def test_an_accelerometer_at_the_end_of_its_range_is_not_judged(reference_bench: Bench, reference_robot: Robot) -> None:
    sensor = reference_robot.accelerometer.model_copy(update={"range_m_s2": 0.5})
    narrow = reference_bench.accelerometer.model_copy(update={"range_m_s2": 0.5})
    hil_bench = reference_bench.model_copy(update={"accelerometer": narrow})
    hil_session, _ = session_of(hil_bench, reference_robot.model_copy(update={"accelerometer": sensor}))
    experiment = demo_experiments(hil_bench)[0]
    with hil_session:
        hil_session.bring_up()
        result = hil_session.run(experiment.motion(hil_bench), "none", "drive")
    for entry in entries(hil_bench, experiment, result, "x.csv"):
        assert "at the end of its range of 0.5 m/s²" in (entry.invalid or "")
        assert not entry.within_spec


# -- emulated or not -------------------------------------------------------------------------------------------------------


def test_an_emulated_robot_says_that_it_is_one(reference_bench: Bench, reference_robot: Robot) -> None:
    hil_session, _ = session_of(reference_bench, reference_robot)
    with hil_session:
        hil_session.bring_up()
    assert hil_session.emulated == {"axis 2": True, "axis 3": True, "axis 5": True, "accelerometer": True}


def test_a_drive_that_has_hardware_or_says_nothing_of_it_is_not_taken_for_emulated(
    reference_bench: Bench, reference_robot: Robot
) -> None:
    hil_session, channel = session_of(reference_bench, reference_robot)
    channel.world.drives[2].slave.dictionary.cell(0x1009, 0).value = "rev C"
    channel.passes = lambda frame: frame.can_id != 0x583 or frame.data[1:4] != bytes((0x09, 0x10, 0x00))
    with hil_session:
        hil_session.bring_up()
    assert hil_session.emulated == {"axis 2": False, "axis 3": None, "axis 5": True, "accelerometer": True}
