"""Whole runs of the master on a bus with bit times: equal seeds give equal logs to the byte."""

import pytest

from hil.experiments.motions import line_motion
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.faults import BusFaults, Fault
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.bus.timed import TimedBus
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.bench.fault_rig import T_S, bench

RATE = 1_000_000
FAULTS = (
    Fault(kind="corrupt", probability=0.01),
    Fault(kind="corrupt", can_id=0x190, probability=0.05, crc=False),
    Fault(kind="delay", can_id=0x190, probability=0.02, delay_ns=300_000),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The bytes of bus.log of a short line, and the wire."""

    def made(faults=None, seed=0, data_bitrate=None):
        world = World(load_robot("reference"))
        medium = medium_for(world, RATE, data_bitrate, faults=None if faults is None else BusFaults(faults, seed))
        assert isinstance(medium, TimedBus)
        wire = medium.wire
        ends = []
        channel = InProcessChannel(world, medium)
        channel.heard = lambda frame, end_ns: ends.append((frame, end_ns))
        path = tmp_path_factory.mktemp("log") / "bus.log"
        log, short = BusLog(path, "can0"), bench()
        with Session(short, channel, log) as session:
            session.bring_up()
            result = session.run(line_motion(short, T_S), "none", "drive")
        log.write()
        assert result.stopped is None
        return path.read_bytes(), ends, wire.statistics

    return made


@pytest.mark.slow
def test_with_faults_equal_seeds_give_equal_bytes_and_others_do_not(run):
    first = run(FAULTS, seed=1)
    assert first[2].errors > 10
    assert first == run(FAULTS, seed=1)
    assert first[0] != run(FAULTS, seed=2)[0]


@pytest.mark.ci
def test_a_fd_bus_carries_the_same_run_in_less_time(run):
    classic, fd = run(), run(data_bitrate=5_000_000)
    assert fd[2].frames == pytest.approx(classic[2].frames, rel=0.01)
    assert fd[2].busy_ns < 0.6 * classic[2].busy_ns
