"""Programs that are not ours on the same bus: the canopen package, python-can's logger; and our own tool."""

import json
import re
import signal
import subprocess
import sys
import time

import can
import canopen
import pytest
from canopen.nmt import NmtError

from plant_emulator.data_sheets import data_sheets
from tests.vcan.conftest import NODES, VCAN, Listener

pytestmark = pytest.mark.vcan


@pytest.fixture
def network(robot):
    network = canopen.Network()
    network.connect(interface="socketcan", channel=VCAN.channel)
    yield network
    network.disconnect()


def drive_profiles(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "drive_profiles", *arguments],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        cwd=cwd,
    )


def wait_for_heartbeat(node, robot):
    """Wait as long as the package does by itself: the virtual machine may stand still for seconds."""
    try:
        node.nmt.wait_for_heartbeat()
    except NmtError as silent:
        raise AssertionError(f"node {node.id}: {silent}; the emulator said: {robot.errors()!r}") from silent


def test_the_canopen_package_finds_reads_writes_and_watches_our_drives(network, robot, tmp_path):
    network.scanner.search()
    time.sleep(0.5)
    assert set(network.scanner.nodes) >= NODES
    for name, text in data_sheets().items():
        (tmp_path / name).write_text(text)
    sheet = next(path for path in tmp_path.glob("*.eds") if "accel" not in path.name)
    node = network.add_node(2, str(sheet))
    assert node.sdo.upload(0x1000, 0)[:2] == b"\x92\x01"  # CiA 402
    node.sdo[0x1017].raw = 100
    assert node.sdo[0x1017].raw == 100
    wait_for_heartbeat(node, robot)
    node.nmt.state = "OPERATIONAL"
    wait_for_heartbeat(node, robot)
    assert node.nmt.state == "OPERATIONAL"
    with pytest.raises(canopen.SdoAbortedError) as refused:
        node.sdo.download(0x5FFF, 0, b"\0")
    assert refused.value.code == 0x06020000
    with Listener(VCAN, 0x702) as bus:  # canopen's own wait_for_bootup misses one that comes before it is called
        node.nmt.state = "RESET"
        assert bus.wait_for(lambda frame: frame.can_id == 0x702, 5.0).data == b"\0"
    assert node.sdo[0x1017].raw == 0


def test_python_cans_logger_keeps_what_passes(robot, tmp_path):
    log = tmp_path / "stranger.log"
    logger = subprocess.Popen(
        [sys.executable, "-m", "can.logger", "-i", "socketcan", "-c", VCAN.channel, "-f", str(log)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert logger.stdout is not None
    line = ""
    while "Logger" not in line and "Connected" not in line:
        line = logger.stdout.readline()
        assert line, "the logger has ended"
    time.sleep(0.5)
    with Listener() as bus:
        for _ in range(20):
            bus.upload(2, 0x6041)
    time.sleep(0.5)
    logger.send_signal(signal.SIGINT)
    logger.communicate(timeout=20)
    ids = [message.arbitration_id for message in can.LogReader(log)]
    assert ids.count(0x602) == ids.count(0x582) == 20


def test_our_own_tool_scans_and_uploads_over_socketcan(robot, tmp_path):
    scan = drive_profiles("scan", "--bus", str(VCAN), "--nodes", "1-20", "--json", "--timeout-s", "0.3")
    assert scan.returncode == 0, scan.stderr
    assert {node["node"] for node in json.loads(scan.stdout)} == NODES
    pulled = drive_profiles("pull", "--bus", str(VCAN), "--node", "2", "--classes", "tuning")
    assert pulled.returncode == 0, pulled.stderr
    wanted, changes = re.subn(r'("position_gain_per_s" = \{ value = )0.0', r"\g<1>21.5", pulled.stdout)
    assert changes == 1, pulled.stdout
    (tmp_path / "set.toml").write_text(wanted)
    done = drive_profiles("upload", "set.toml", "--bus", str(VCAN), "--node", "2", "--yes", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    verified = drive_profiles("verify", "set.toml", "--bus", str(VCAN), "--node", "2", cwd=tmp_path)
    assert verified.returncode == 0, verified.stdout + verified.stderr
