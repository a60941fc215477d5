"""python-can's own programs on our bus, by the plug-in's name: a logger, a player and a bridge."""

import contextlib
import signal
import struct
import subprocess
import sys
import time

import can
import pytest

from drive_profiles.standard.cia402 import State
from hil.can.frame import Frame
from plant_emulator.robots.robot import Robot, load_robot
from tests.plant_emulator.bus.conftest import frames_until, wait_for

ANSWER = 0x583
AXIS_2 = Robot(axis={2: load_robot("reference").axis[2]})
"""A robot whose drive, node 2, is not the other one's."""


@contextlib.contextmanager
def tool(module, *arguments):
    """One of python-can's programs, ended as its user does it."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"can.{module}", *arguments],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        yield process
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30)
        assert "Traceback" not in output, output
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def on(served, prefix=""):
    return [f"--{prefix}interface", "hil_local", f"--{prefix}channel", served.path]


def enable(channel):
    """A master's first second: mode, NMT start, three control words, each by SDO; then a few cycles."""
    channel.send(Frame(0x000, b"\x01\x03"))
    for index, size, value in ((0x6060, 1, 1), (0x6040, 2, 6), (0x6040, 2, 7), (0x6040, 2, 15)):
        channel.send(Frame(0x603, struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, 0, value)))
        assert frames_until(channel, ANSWER)[-1].data[0] == 0x60
    for _ in range(20):
        channel.send(Frame(0x080, b""))
        time.sleep(0.002)


def passed_on(channel, other):
    """Return when what is sent on one bus arrives on the other."""
    end = time.monotonic() + 30.0
    while other.receive(0.05) is None:
        assert time.monotonic() < end
        channel.send(Frame(0x7A0, b""))


@pytest.mark.wall
@pytest.mark.parametrize("suffix", [".log", *(pytest.param(each, marks=pytest.mark.slow) for each in (".asc", ".blf", ".trc"))])
def test_a_logged_run_is_whole_and_played_to_another_robot_it_does_the_same(start_served, tmp_path, suffix):
    first, second = start_served(), start_served()
    log = tmp_path / f"run{suffix}"
    master, witness = first.join_local(), first.join_local()
    with tool("logger", *on(first), "-f", str(log)):
        wait_for(lambda: len(first.server._clients) == 3, 30.0)
        wait_for(log.exists, 30.0)  # the logger opens its file behind its bus
        enable(master)
        seen = []
        while (frame := witness.receive(0.3)) is not None:
            seen.append(frame)
    assert first.drive.state is State.OPERATION_ENABLED
    logged = [Frame(message.arbitration_id, bytes(message.data)) for message in can.LogReader(log)]
    assert len(seen) > 9 + 20
    assert logged == seen

    with tool("player", *on(second), "--ignore-timestamps", "-g", "0.001", str(log)) as player:
        assert player.wait(30) == 0
    wait_for(lambda: second.drive.state is State.OPERATION_ENABLED)
    assert second.drive.slave.nmt_state == first.drive.slave.nmt_state


@pytest.mark.slow
def test_a_bridge_makes_two_robots_one_bus(start_served):
    first, second = start_served(), start_served(robot=AXIS_2)
    with tool("bridge", *on(first, "bus1-"), *on(second, "bus2-")):
        wait_for(lambda: first.server._clients and second.server._clients, 30.0)
        channel = first.join_local()
        passed_on(channel, second.join_local())  # its listeners start behind its buses
        channel.send(Frame(0x602, bytes.fromhex("4041600000000000")))
        assert frames_until(channel, 0x582)[-1].data[:4] == bytes.fromhex("4b416000")
        tcp = first.join()
        tcp.send(0x602, bytes.fromhex("4018100100000000"))
        assert tcp.until(0x582)[2][:4] == bytes.fromhex("43181001")
