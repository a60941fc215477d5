"""`drive-profiles` runs where signals, flags of files and modules of POSIX are missing, as on a laptop with Windows."""

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time

import pytest

from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.upload import journal
from plant_emulator.robots.robot import load_robot
from tests.drive_profiles.world_bus import WorldBus

EDS = "[FileInfo]\r\nFileName=a.eds\r\n[1000]\r\nParameterName=NAME\r\nDataType=7\r\nAccessType=ro\r\n"


class Daemon(WorldBus):
    """The emulated robot behind a server of socketcand's protocol: a bus that other processes reach by TCP alone."""

    def __init__(self):
        self._out = []
        super().__init__(load_robot("reference"))
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self.wait(0.01)  # what is compiled is compiled before somebody waits for an answer
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self._listening.close()

    def _sort(self, frames):
        self._out += frames

    def _serve(self):
        while not self._end.is_set():
            if select.select([self._listening], [], [], 0.05)[0]:
                with self._listening.accept()[0] as client, contextlib.suppress(ConnectionError):
                    self._talk(client)

    def _talk(self, client):
        client.sendall(b"< hi >")
        text, last, is_raw = "", time.monotonic(), False
        while not self._end.is_set():
            if select.select([client], [], [], 0.002)[0]:
                data = client.recv(4096)
                if not data:
                    return
                text += data.decode("ascii")
            while ">" in text:
                line, _, text = text.partition(">")
                name, *words = line.strip("< ").split()
                if name == "send":
                    self.put(int(words[0], 16), bytes(int(word, 16) for word in words[2:]))
                else:
                    is_raw = name == "rawmode"
                    client.sendall(b"< ok >")
            now = time.monotonic()
            self.wait(min(now - last, 0.02))
            last = now
            out, self._out = self._out, []
            if is_raw:
                client.sendall(b"".join(f"< frame {f.can_id:03X} 1.0 {f.data.hex().upper()} >".encode() for f in out if f.data))


@pytest.fixture(scope="module")
def daemon():
    with Daemon() as served:
        yield served


@pytest.fixture
def run(tmp_path):
    """The real command in a process that lacks what Windows lacks."""

    def ran(*arguments, code=0, daemon=None):
        variables = {**os.environ, "PYTHONPATH": os.getcwd()}
        if daemon is not None:
            variables["CAN_CONFIG"] = json.dumps({"host": "127.0.0.1", "port": daemon.port})
            variables["HIL_BUS"] = "socketcand:can0"
        command = [sys.executable, "-m", "tests.drive_profiles.not_posix", *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=variables, capture_output=True, text=True, encoding="cp1252", timeout=120, check=False
        )
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stderr if code else done.stdout

    return ran


@pytest.mark.slow
def test_help_profiles_and_a_description_need_no_posix(run, tmp_path):
    (tmp_path / "a.eds").write_text(EDS, encoding="ascii")
    assert "Exit status" in run("--help")
    assert "kollmorgen_akd" in run("list")
    assert "upload" in run("upload", "--help")
    run("eds", "check", "a.eds")
    run("eds", "convert", "a.eds", "--out", "b.eds")
    run("eds", "check", "b.eds")


def test_a_file_is_read_and_written_without_posix(run, tmp_path):
    """One of the commands, and quick: names, line ends and the folder of the file."""
    (tmp_path / "a.eds").write_text(EDS, encoding="ascii")
    run("eds", "convert", "a.eds", "--out", "b.eds")
    written = (tmp_path / "b.eds").read_bytes()
    assert b"ParameterName=NAME" in written
    assert b"\r\r" not in written


@pytest.mark.slow
def test_what_a_code_page_lacks_is_escaped(run, tmp_path):
    (tmp_path / "a.eds").write_text(EDS.replace("NAME", "Widerstand, Ω"), encoding="utf-8")
    assert r"Widerstand, \u03a9" in run("eds", "show", "a.eds")
    assert json.loads(run("eds", "show", "a.eds", "--json"))["objects"][0]["name"] == "Widerstand, Ω"


def test_the_emulators_own_bus_is_refused_in_words(run):
    assert "no Unix sockets on this system" in run("scan", "--bus", "local:C:/robot.sock", code=4)


@pytest.mark.slow
def test_nodes_are_found_on_a_bus_of_python_can(run, daemon):
    found = json.loads(run("scan", "--timeout-s", "5", "--json", daemon=daemon))
    assert [node["node"] for node in found] == [2, 3, 5, 16]


@pytest.mark.slow
def test_a_set_is_pulled_uploaded_and_put_back(run, daemon, tmp_path):
    run("pull", "--node", "2", "--out", "axis2.toml", daemon=daemon)
    text = (tmp_path / "axis2.toml").read_text(encoding="utf-8")
    assert ParameterSet.load(tmp_path / "axis2.toml").header.node_id == 2
    changed = text.replace('"notch_1.start_rps" = { value = 4.0', '"notch_1.start_rps" = { value = 4.5')
    (tmp_path / "notch.toml").write_text(changed, encoding="utf-8", newline="\r\n")  # as an editor there writes it
    assert "done, 1 written" in run("upload", "notch.toml", "--node", "2", "--yes", daemon=daemon)
    run("verify", "notch.toml", "--node", "2", daemon=daemon)
    (written,) = tmp_path.rglob("*.jsonl")
    assert b"\r" not in written.read_bytes()
    assert journal.read(written).outcome == "done"
    run("restore", "--snapshot", str(written), "--yes", daemon=daemon)
    run("verify", "axis2.toml", "--node", "2", daemon=daemon)


CTRL_BREAK = """
import signal
from tests.drive_profiles.not_posix import take_away
take_away()
signal.SIGBREAK = signal.Signals(12)  # another number than there
from drive_profiles.cli.console import Interrupts
with Interrupts() as interrupts:
    interrupts.hold("all is put back", "too late")
    signal.raise_signal(signal.SIGBREAK)
    assert interrupts.window.is_interrupted
"""


def test_ctrl_break_is_remembered_while_a_drive_is_written_to():
    done = subprocess.run([sys.executable, "-c", CTRL_BREAK], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"\nall is put back\n")
