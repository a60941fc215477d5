"""The session where time is the wall clock's: on a clock that the test owns for exactness, and once on the real one for truth."""

import itertools
import math
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from drive_profiles.address import Address
from drive_profiles.standard.cia402 import State
from hil.bench.bench import Bench, RealTimeTable, load_bench
from hil.can.adapter import AdapterChannel
from hil.can.frame import Frame
from hil.errors import AlreadyMovingError, NotPossibleError, UnsafeRequestError
from hil.experiments.motions import constant_acceleration
from hil.experiments.plan import Experiment, entries
from hil.experiments.runner import run_experiments
from hil.master.motion import RunResult
from hil.master.sensor import TIP_ELSEWHERE, TipSource
from hil.master.session import Session
from hil.recording import BusLog
from hil.sensor.framing import Vector
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.motion.record import BRAKED, TORQUE
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.hil.master.virtual_time import NS, VirtualBus, VirtualClock

PERIOD_S = 0.02
RPDO, SYNC_ID = 0x202, 0x80
QUICK_STOP, DISABLE_VOLTAGE = b"\x02\x00", b"\x00\x00"


def bench_of(**bus: object) -> Bench:
    """A second of motion up to 4 rps at 20 ms; nothing is asked of the system that would disturb the other tests."""
    bus = {"sync_period_s": PERIOD_S, "real_time": RealTimeTable(priority=0, lock_memory=False), **bus}
    bench = load_bench("reference")
    motion = bench.constant_acceleration
    assert motion is not None
    motion = motion.model_copy(update={"acceleration_rps_s": 8.0, "end_rps": 4.0, "tail_s": 0.1})
    return bench.model_copy(update={"constant_acceleration": motion, "bus": bench.bus.model_copy(update=bus)})


BENCH = bench_of()
ROBOT = load_robot("reference")


class Rig:
    """A session on the virtual bus; pauses count from the first set-point of the drive."""

    def __init__(self, bench: Bench = BENCH, *, latency_s: float = 0.0005, bitrate: int | None = None) -> None:
        self.clock = VirtualClock()
        self.bus = VirtualBus(World(ROBOT), self.clock, latency_s=latency_s, bitrate=bitrate)
        self.bench = bench
        self.session = Session(bench, self.bus, BusLog(None), clock=self.clock)

    def run(self, *pauses: tuple[int, float]) -> RunResult:
        """A run with pauses: the number of the SYNC after which the master is frozen, and for how long."""
        waiting = dict(pauses)
        syncs = [0]
        send = self.bus.send

        def watched(frame: Frame) -> None:
            send(frame)
            if frame.can_id == SYNC_ID:
                syncs[0] += 1
                if syncs[0] in waiting:
                    self.clock.pauses.append((self.clock.now(), waiting[syncs[0]]))

        self.bus.send = watched  # type: ignore[method-assign]
        with self.session:
            self.session.bring_up()
            return self.session.run(constant_acceleration(self.bench, 2, PERIOD_S), "none", "drive")

    def set_points(self) -> list[bytes]:
        return [frame.data for _, frame in self.bus.sent if frame.can_id == RPDO]

    def is_at_rest(self) -> bool:
        world = self.bus.world
        self.clock.sleep_until(self.clock.now() + 1.0)
        self.bus.follow()
        enabled = any(drive.state is State.OPERATION_ENABLED for drive in world.drives.values())
        return not enabled and bool(np.all(world.axes.motion["mode"] == BRAKED))


@pytest.fixture(scope="module")
def undisturbed() -> tuple[Rig, RunResult]:
    rig = Rig(bitrate=500_000)
    return rig, rig.run()


def test_an_undisturbed_run_keeps_its_beat_and_says_so(undisturbed: tuple[Rig, RunResult]) -> None:
    rig, result = undisturbed
    timing = result.timing
    assert result.stopped is None
    assert timing is not None
    assert (timing.dropped, timing.late, timing.missed, result.dropped_cycles) == (0, 0, 0, 0)
    assert timing.lateness.max_s == pytest.approx(0.0, abs=1e-9)
    assert timing.arrivals.p50_s == pytest.approx(0.0005, rel=0.024)
    assert timing.arrivals.count >= 2 * timing.cycles
    assert timing.lateness.count == timing.cycles > result.cycles
    assert timing.receive_overflows == 0
    assert timing.bus_load is not None
    # RPDO, SYNC, two TPDOs of 6 to 8 bytes in 20 ms, with heartbeats
    assert 300 / 10_000 < timing.bus_load < 600 / 10_000
    assert {measure.name for measure in timing.measures} == {"garbage collection", "timer slack"}
    assert rig.is_at_rest()


def test_syncs_leave_a_period_apart(undisturbed: tuple[Rig, RunResult]) -> None:
    rig, result = undisturbed
    syncs = [at for at, frame in rig.bus.sent if frame.can_id == SYNC_ID][-result.cycles :]
    np.testing.assert_allclose(np.diff(syncs), PERIOD_S, atol=1e-9)


def test_a_set_point_that_is_too_late_is_dropped_and_never_sent(undisturbed: tuple[Rig, RunResult]) -> None:
    before, whole = undisturbed
    rig = Rig()
    result = rig.run((60, PERIOD_S + 0.012))
    assert result.stopped is None
    assert result.timing is not None
    assert (result.timing.dropped, result.dropped_cycles, result.missed_cycles) == (1, 1, 0)
    assert result.cycles == whole.cycles
    (row,) = np.flatnonzero(result.recording.columns["missing"])
    assert result.recording.columns["missing"][row] == 2, "drive and accelerometer were not asked"
    expected, sent = before.set_points(), rig.set_points()
    # the recording's set-points, the one of the dropped row left out; all others leave in their own cycles
    dropped = [place for place in range(len(expected)) if expected[:place] + expected[place + 1 :] == sent]
    assert len(dropped) == 1
    assert result.timing.lateness.max_s == pytest.approx(0.0115, abs=0.0006)
    np.testing.assert_array_equal(result.recording.axis(2, "reference_rad"), whole.recording.axis(2, "reference_rad"))


def test_a_little_lateness_is_measured_and_sent() -> None:
    rig = Rig()
    result = rig.run((60, PERIOD_S + 0.008))
    assert result.stopped is None
    assert result.timing is not None
    assert (result.timing.dropped, result.dropped_cycles) == (0, 0)
    assert 0.007 < (result.timing.lateness.max_s or 0.0) < 0.0081


def test_the_limit_is_the_bench_files() -> None:
    result = Rig(bench_of(max_lateness_s=0.004)).run((60, PERIOD_S + 0.008))
    assert result.timing is not None
    assert (result.timing.limit_s, result.timing.dropped) == (0.004, 1)


def test_a_frozen_master_finds_itself_late_and_stays_stopped() -> None:
    rig = Rig()
    result = rig.run((60, 1.0))
    assert result.stopped is not None
    assert "the master was late" in str(result.stopped)
    assert result.stopped.exit_code == 8
    assert result.cycles < 60
    assert result.timing is not None
    assert result.timing.dropped >= 48
    assert result.timing.lateness.max_s == pytest.approx(1.0 - PERIOD_S, abs=0.002)
    times = [at for at, frame in rig.bus.sent if frame.can_id == SYNC_ID]
    (gap,) = np.flatnonzero(np.diff(times) > 0.5)
    later = [frame.data[:2] for at, frame in rig.bus.sent if frame.can_id == RPDO and at > times[gap] + 0.5]
    assert later
    assert set(later) <= {QUICK_STOP, DISABLE_VOLTAGE}, "nothing but the stop leaves after it"
    assert np.all(np.diff(times[gap + 1 :]) > 0.9 * PERIOD_S), "and on a beat of its own, not as fast as it can"
    assert rig.is_at_rest()


def test_drives_that_are_not_heard_may_end_their_ramp_before_the_voltage_is_cut() -> None:
    """Without voltage a brake closes, on a motor that turns."""
    rig, turning = Rig(), dict[bytes, float]()
    hear, deaf_s = rig.bus.receive, (1.5, 3.0)
    began_s = rig.clock.now()

    def receive(timeout_s: float) -> Frame | None:
        frame = hear(timeout_s)
        while frame is not None and frame.can_id == 0x182 and deaf_s[0] < rig.clock.now() - began_s < deaf_s[1]:
            frame = hear(0.0)
        return frame

    send = rig.bus.send

    def watched(frame: Frame) -> None:
        if frame.can_id == RPDO and (frame.data[:2] == QUICK_STOP or (turning and frame.data[:2] == DISABLE_VOLTAGE)):
            turning.setdefault(frame.data[:2], abs(float(rig.bus.world.axes.plant_state["motor_speed_rad_s"][0])))
        send(frame)

    rig.bus.receive, rig.bus.send = receive, watched  # type: ignore[method-assign]
    with rig.session:
        rig.session.bring_up()
        result = rig.session.run(constant_acceleration(rig.bench, 2, PERIOD_S), "none", "drive")
    assert result.stopped is not None
    assert "has not answered" in str(result.stopped)
    assert turning[QUICK_STOP] > 1.0
    assert turning[DISABLE_VOLTAGE] < 0.01
    assert rig.is_at_rest()


def test_too_many_in_a_row_stop_and_fewer_do_not() -> None:
    limit = BENCH.bus.missing_limit
    while_it_stands = 15  # a drive that moves would refuse the step of its set-points
    assert Rig().run((while_it_stands, (limit + 0.8) * PERIOD_S)).stopped is None
    stopped = Rig().run((while_it_stands, (limit + 1.8) * PERIOD_S)).stopped
    assert stopped is not None
    assert "the master was late" in str(stopped)


def test_a_pause_while_the_brakes_open_stops_as_well() -> None:
    rig = Rig()
    result = rig.run((3, 1.0))
    assert result.stopped is not None
    assert "the master was late" in str(result.stopped)
    assert result.cycles == 0
    assert rig.is_at_rest()


def test_sync_is_withheld_where_sending_the_set_points_took_too_long() -> None:
    rig = Rig()
    slow = rig.bus.send
    count = [0]

    def send(frame: Frame) -> None:
        count[0] += frame.can_id == RPDO
        rig.bus.send_s = 0.015 if frame.can_id == RPDO and count[0] == 70 else 0.0
        slow(frame)

    rig.bus.send = send  # type: ignore[method-assign]
    result = rig.run()
    assert result.stopped is None
    assert result.timing is not None
    assert (result.timing.dropped, result.timing.late) == (1, 0)
    order = [frame.can_id for _, frame in rig.bus.sent if frame.can_id in {RPDO, SYNC_ID}]
    twice = [place for place, pair in enumerate(itertools.pairwise(order)) if pair == (RPDO, RPDO)]
    assert len(twice) == 1, "the next set-point replaces it before any SYNC"


def test_a_master_that_was_late_too_often_is_not_judged() -> None:
    rig = Rig()
    result = rig.run(*((number, PERIOD_S + 0.012) for number in (60, 70, 80)))
    assert result.stopped is None
    assert result.dropped_cycles == 3
    for entry in entries(BENCH, Experiment("constant-acceleration", 2, "none"), result, "x.csv"):
        assert "3 were not sent in time" in (entry.invalid or "")
        assert entry.within_spec is None
        assert entry.timing is not None
        assert entry.timing.dropped == 3


def test_a_step_of_the_date_changes_nothing(undisturbed: tuple[Rig, RunResult], monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.time
    hour = [0.0]

    def stepping() -> float:
        hour[0] = 3600.0 - hour[0]
        return now() + hour[0] - 1800.0

    monkeypatch.setattr(time, "time", stepping)
    rig = Rig()
    result = rig.run()
    assert result.timing is not None
    assert result.timing.dropped == 0
    assert rig.set_points() == undisturbed[0].set_points()


def test_a_limit_beyond_the_period_is_refused() -> None:
    rig = Rig(bench_of(max_lateness_s=0.03))
    with pytest.raises(UnsafeRequestError, match="max_lateness_s"):
        rig.run()
    assert not rig.set_points()


def test_in_lock_step_there_is_no_timing() -> None:
    session = Session(BENCH, InProcessChannel(World(ROBOT)), BusLog(None))
    with session:
        session.bring_up()
        result = session.run(constant_acceleration(BENCH, 2, PERIOD_S), "none", "drive")
    assert result.stopped is None
    assert result.timing is None
    (entry, *_) = entries(BENCH, Experiment("constant-acceleration", 2, "none"), result, "x.csv")
    assert entry.timing is None


@pytest.mark.parametrize(("wanted", "words"), [("wall", "counted in SYNCs"), ("lock-step", "do not wait for SYNC")])
def test_another_clock_than_the_bus_has_is_refused(
    wanted: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = InProcessChannel(World(ROBOT)) if wanted == "wall" else VirtualBus(World(ROBOT), VirtualClock())
    monkeypatch.setattr("hil.experiments.measurement.open_channel", lambda address: channel)
    with pytest.raises(NotPossibleError, match=words) as error:
        run_experiments(BENCH, [Experiment("constant-acceleration", 2, "none")], tmp_path, clock=wanted)  # type: ignore[arg-type]
    assert error.value.exit_code == 3
    assert not channel.sent


# -- the real clock ----------------------------------------------------------------------------------------------------


class LiveWorld:
    """The world in a thread, on python-can's virtual bus, in real time."""

    def __init__(self, channel: str) -> None:
        self.world = World(ROBOT)
        self.world.axes.advance(0)
        self.world.free_step(NS // 100)
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._epoch_ns = time.monotonic_ns() - self.world.now
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> "LiveWorld":
        self._send(self.world.power_on())
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        self._bus.shutdown()

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

    def _serve(self) -> None:
        while not self._end.is_set():
            message = self._bus.recv(0.002)
            self._send(self.world.free_step(max(self.world.now, time.monotonic_ns() - self._epoch_ns)))
            if message is not None:
                self._send([answer for _, answer in self.world.hear(Frame(message.arbitration_id, bytes(message.data)))])


@pytest.fixture
def live() -> Iterator[tuple[LiveWorld, AdapterChannel]]:
    name = uuid.uuid4().hex
    with LiveWorld(name) as world:
        channel = AdapterChannel(Address("virtual", name))
        yield world, channel
        channel.close()


def live_run(live: tuple[LiveWorld, AdapterChannel], interfere: Callable[[int], None], bench: Bench) -> RunResult:
    """A run whose progress a test can see: called after each of the master's sends of SYNC."""
    world, channel = live
    syncs = [0]
    send = channel.send

    def watched(frame: Frame) -> None:
        send(frame)
        if frame.can_id == SYNC_ID:
            syncs[0] += 1
            interfere(syncs[0])

    channel.send = watched  # type: ignore[method-assign]
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        result = session.run(constant_acceleration(bench, 2, PERIOD_S), "none", "drive")
        assert world is not None
        return result


@pytest.mark.wall
def test_a_real_run_tells_how_late_it_was(live: tuple[LiveWorld, AdapterChannel]) -> None:
    """Nothing is said here about how fast this machine is: what it did is in the result, and the robot is at rest after it."""
    tolerant = bench_of(missing_limit=100, heartbeat_s=1.0)
    result = live_run(live, lambda number: None, tolerant)
    timing = result.timing
    assert timing is not None
    assert timing.lateness.count + timing.arrivals.count > 0
    assert timing.receive_overflows is None
    assert timing.bus_load is None
    assert timing.bus_bits > 0
    assert timing.lateness.p50_s is not None
    assert timing.lateness.p50_s <= (timing.lateness.p99_s or 0.0) <= (timing.lateness.max_s or 0.0)
    if result.stopped is None:
        assert result.cycles == len(constant_acceleration(tolerant, 2, PERIOD_S).time_s)
    assert all(drive.state is not State.OPERATION_ENABLED for drive in live[0].world.drives.values())


@pytest.mark.wall
def test_a_real_pause_of_a_second_stops_the_run(live: tuple[LiveWorld, AdapterChannel]) -> None:
    result = live_run(live, lambda number: time.sleep(1.0) if number == 12 else None, bench_of(heartbeat_s=1.0, missing_limit=10))
    assert result.stopped is not None
    assert "the master was late" in str(result.stopped)
    assert result.timing is not None
    assert result.timing.dropped >= 3
    assert (result.timing.lateness.max_s or 0.0) > 0.5
    assert all(drive.state is not State.OPERATION_ENABLED for drive in live[0].world.drives.values())


def test_a_sensor_is_asked_for_the_instant_of_sync_by_the_master_s_clock() -> None:
    rig = Rig()
    asked: list[float] = []

    def sample(sync_s: float) -> Vector:
        asked.append(sync_s)
        return (0.0, 0.0, 9.81)

    rig.session.sensor.configure = lambda: TipSource(TIP_ELSEWHERE)  # type: ignore[method-assign]
    rig.session.sensor.sample = sample  # type: ignore[method-assign]
    rig.run()
    syncs = [instant for instant, frame in rig.bus.sent if frame.can_id == SYNC_ID]
    assert len(asked) > 50
    np.testing.assert_allclose(asked, syncs[-len(asked) :], rtol=0.0, atol=1e-9)


def test_a_motor_that_coasts_is_seen_by_its_position(monkeypatch: pytest.MonkeyPatch) -> None:
    """Families count 606Ch in units of their own (the EPOS4 in rev/min), so what it says is no proof of rest."""
    rig = Rig()
    look_at_sensor = rig.session.sensor.open

    def coast() -> None:
        look_at_sensor()
        axes = rig.bus.world.axes
        axes.motion["mode"][0] = TORQUE
        axes.motion["target_torque_nm"][0] = ROBOT.axis[2].coulomb_friction_nm  # a load that goes on falling
        axes.plant_state["motor_speed_rad_s"][0] = 2.0 * math.pi

    monkeypatch.setattr(rig.session.sensor, "open", coast)
    with rig.session, pytest.raises(AlreadyMovingError, match=r"axis 2 turns at \d\.\d\d rev/s"):
        rig.session.bring_up()
