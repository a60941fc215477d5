"""The bench as its user has it: separate processes on a real socket, commands, exit statuses, and what is left on disk."""

import contextlib
import html
import json
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from drive_profiles.address import parse_address
from drive_profiles.family.profile import VENDORS
from drive_profiles.standard.cia402 import State, state_of
from hil.bench.bench import load_bench
from hil.can.frame import Frame
from hil.can.local import LocalChannel
from hil.cli.main import app
from hil.errors import NOT_DISABLED, not_restored_words
from hil.master.session import Session
from hil.recording import BusLog, Recording
from hil.robot_tables import Control
from plant_emulator.pytest_plugin.target import ServedBus, local_bus_servers

REFERENCE = (Path(__file__).parents[2] / "hil" / "bench" / "reference.toml").read_text()
# 50 s of motion, over more turns than the reference bench allows: time to interfere
SLOW = (("acceleration_rps_s = 4.0", "acceleration_rps_s = 0.2"), ("position_max_rev = 22.0", "position_max_rev = 2200.0"))
QUICK = ("acceleration_rps_s = 4.0", "acceleration_rps_s = 16.0")


def bench_file(tmp_path: Path, *changes: tuple[str, str], name: str = "bench.toml") -> Path:
    text = REFERENCE
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = tmp_path / name
    path.write_text(text)
    return path


HIL = [sys.executable, "-m", "hil"]
WITHOUT_PICTURES = [
    sys.executable,
    "-c",
    "from hil.report import style; style.to_svg = lambda figure, key, **_: '<svg></svg>'; from hil.__main__ import main; main()",
]
"""`hil` whose reports have figures that are made but not drawn: drawing them takes longer than a run."""


def hil(*arguments: str, command: list[str] = WITHOUT_PICTURES) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=300, check=False)


def called(*arguments: str) -> Result:
    """The same command in this process, for what ends before anything is heard or sent."""
    return CliRunner().invoke(app, arguments)


def run_arguments(bench: Path, hil_local_bus: ServedBus, out: Path, *more: str) -> list[str]:
    return [
        "run",
        "constant-acceleration",
        "--axis",
        "2",
        "--bench",
        str(bench),
        "--bus",
        hil_local_bus.address,
        "--out",
        str(out),
        *more,
    ]


MARK = 0x7A0
"""An identifier that nobody else uses."""


class Sniffer:
    """A python-can bus on the emulator's socket, read by a thread of its own; of the cyclic frames it keeps the count only."""

    def __init__(self, hil_local_bus: ServedBus) -> None:
        self.bus = can.Bus(interface="hil_local", channel=str(hil_local_bus.socket))
        self.counts: Counter[int] = Counter()
        self.others: list[can.Message] = []
        self._end = False
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        while not self._end:
            try:
                message = self.bus.recv(0.1)
            except can.CanError:
                return
            if message is not None:
                self.counts[message.arbitration_id] += 1
                if not 0x180 <= message.arbitration_id < 0x580 and message.arbitration_id != 0x80:
                    self.others.append(message)

    def wait_for(self, happened: Callable[[], bool], timeout_s: float = 60.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not happened():
            assert time.monotonic() < deadline, "it did not happen in time"
            time.sleep(0.005)

    def wait_for_motion(self) -> None:
        """The master's set-points have been going out for a second: past settling, well within the slow motion."""
        self.wait_for(lambda: self.counts[0x202] > 500)

    def heard_up_to_now(self, hil_local_bus: ServedBus) -> Counter[int]:
        """What it has heard, and forgets: all that was on the bus before a frame of ours that it hears as well."""
        channel = LocalChannel(parse_address(hil_local_bus.address))
        channel.send(Frame(MARK, b""))
        self.wait_for(lambda: self.counts[MARK] > 0)
        channel.close()
        heard = self.counts - Counter({MARK: 1})
        self.counts.clear()
        return heard

    def send(self, can_id: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False), timeout=1.0)

    def upload(self, node: int, index: int, subindex: int = 0) -> bytes:
        """A stranger's expedited upload."""
        before = len(self.others)
        self.send(0x600 + node, bytes((0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0)))

        def answers() -> list[can.Message]:
            return [
                m
                for m in self.others[before:]
                if m.arbitration_id == 0x580 + node and m.data[1:4] == bytes((index & 0xFF, index >> 8, subindex))
            ]

        self.wait_for(lambda: bool(answers()), 60.0)
        return bytes(answers()[0].data[4:])

    def close(self) -> None:
        self._end = True
        self._thread.join()
        self.bus.shutdown()


def start_run(bench: Path, hil_local_bus: ServedBus, out: Path, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*WITHOUT_PICTURES, *run_arguments(bench, hil_local_bus, out, *more)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


# -- a run on a real socket --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_leaves_recording_log_result_and_report(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    out = tmp_path / "out"
    done = hil(*run_arguments(bench_file(tmp_path, QUICK), hil_local_bus, out, "--treatment", "notch", "--json"), command=HIL)
    assert done.returncode in {0, 9}, done.stderr
    result = json.loads(done.stdout)
    assert result == json.loads((out / "result.json").read_text())
    run = result["runs"][0]
    recording = Recording.load(out / run["recording"])
    assert len(recording.time_s) == run["cycles"]
    assert recording.period_s == pytest.approx(run["sync_period_s"])
    assert run["missed_cycles"] == 0
    assert (out / "report.html").stat().st_size > 10_000
    log = list(can.LogReader(out / "bus.log"))
    assert sum(message.arbitration_id == 0x80 for message in log) > run["cycles"]


@pytest.mark.slow
def test_a_run_without_its_report_has_all_that_the_report_is_made_of(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    out = tmp_path / "out"
    done = hil(*run_arguments(bench_file(tmp_path, QUICK), hil_local_bus, out, "--no-report"))
    assert done.returncode in {0, 9}, done.stderr
    assert "report:" not in done.stdout
    assert not (out / "report.html").exists()
    assert hil("report", str(out)).stdout.strip() == str(out / "report.html")
    assert (out / "report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_same_seed_gives_the_same_frames_byte_for_byte(tmp_path: Path, hil_serve_local_bus: Callable[..., ServedBus]) -> None:
    bench, logs = bench_file(tmp_path, QUICK), []
    for i in range(2):
        hil_local_bus = hil_serve_local_bus()
        time.sleep(0.3 * i)  # how long the world has run by itself makes no difference
        done = hil(*run_arguments(bench, hil_local_bus, tmp_path / f"out{i}"))
        assert done.returncode in {0, 9}, done.stderr
        logs.append((tmp_path / f"out{i}" / "bus.log").read_bytes())
    assert logs[0] == logs[1]
    assert len(logs[0]) > 100_000


@pytest.mark.slow
def test_another_seed_gives_other_noise_and_the_same_motion(
    tmp_path: Path, hil_serve_local_bus: Callable[..., ServedBus]
) -> None:
    bench, recordings = bench_file(tmp_path, QUICK), []
    for seed in ("1", "2"):
        hil_local_bus = hil_serve_local_bus("--seed", seed)
        out = tmp_path / seed
        assert hil(*run_arguments(bench, hil_local_bus, out)).returncode in {0, 9}
        recordings.append(Recording.load(next((out / "runs").glob("*.csv"))))
    first, second = recordings
    assert (first.axis(2, "position_rad") == second.axis(2, "position_rad")).all()
    assert (first.columns["tip_z_m_s2"] != second.columns["tip_z_m_s2"]).any()


@pytest.mark.slow
def test_a_stream_socket_carries_the_same_run(tmp_path: Path, hil_serve_local_bus: Callable[..., ServedBus]) -> None:
    hil_local_bus = hil_serve_local_bus("--stream")
    done = hil(*run_arguments(bench_file(tmp_path, QUICK), hil_local_bus, tmp_path / "out"))
    assert done.returncode in {0, 9}, done.stderr


# -- bad input ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sniffed_bus(pytestconfig: pytest.Config) -> Iterator[tuple[ServedBus, Sniffer]]:
    """A bus on which nothing has been sent, and who listens on it."""
    with local_bus_servers(pytestconfig) as start:
        hil_local_bus = start()
        sniffer = Sniffer(hil_local_bus)
        yield hil_local_bus, sniffer
        sniffer.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("settle_s = 0.5", "settle_s = 0.5\nsettel_s = 1.0"), "settel_s"),
        (("speed_rps = 12.0", "speed_rpm = 720.0"), "speed_rps"),
        (("torque_nm = 7.1", 'torque_nm = "7.1 Nm"'), "N·m"),
        (("node_id = 3", "node_id = 2"), "node-ID 2"),
        (("[axis.2]", "[axis.2"), "bench.toml:"),
    ],
    ids=["unknown key", "wrong unit", "unit in the value", "one node-ID twice", "no TOML"],
)
def test_a_bad_bench_file_is_located_and_no_frame_is_sent(
    tmp_path: Path, sniffed_bus: tuple[ServedBus, Sniffer], change: tuple[str, str], words: str
) -> None:
    hil_local_bus, sniffer = sniffed_bus
    bench = bench_file(tmp_path, change)
    done = called(*run_arguments(bench, hil_local_bus, tmp_path / "out"))
    heard = sniffer.heard_up_to_now(hil_local_bus)
    assert done.exit_code == 3
    assert f"{bench}:" in done.stderr
    assert words in done.stderr
    assert isinstance(done.exception, SystemExit), "no traceback"
    assert not heard
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["run", "line-motion", "--bench", "reference", "--axis", "2"], 2, "takes no --axis"),
        (["run", "constant-acceleration", "--bench", "reference"], 2, "needs --axis"),
        (["run", "constant-acceleration", "--bench", "reference", "--axis", "4", "--bus", "local:/nowhere"], 3, "no axis 4"),
        (["run", "line-motion", "--bench", "/nowhere.toml"], 3, "/nowhere.toml"),
        (["run", "line-motion", "--bench", "reference", "--bus", "canzero"], 2, "not a bus address"),
        (["run", "line-motion", "--bench", "reference", "--bus", "local:/nowhere/robot.sock"], 4, "plant-emulator serve"),
        (["run", "line-motion", "--bench", "reference", "--bus", "socketcan:can9", "--yes"], 4, "can9"),
        (["run", "line-motion", "--bench", "reference", "--bus", "virtual:x"], 2, "--yes"),
        (["run", "line-motion", "--bench", "reference", "--bus", "nosuch:x", "--yes"], 2, "nosuch"),
        (["report", "/"], 3, "result.json"),
        (["demo", "--robot", "/nowhere.toml"], 4, "/nowhere.toml"),
        (["run", "line-motion", "--bench", "reference", "--bus", "local:/nowhere/r.sock", "--out", "/dev/null"], 3, "/dev/null"),
        (["fly"], 2, "fly"),
    ],
)
def test_wrong_calls_say_what_is_wrong_and_have_their_exit_status(
    arguments: list[str], status: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = called(*arguments)
    assert done.exit_code == status, done.stderr
    assert words in done.stderr
    assert isinstance(done.exception, SystemExit), "no traceback"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["fly"], 2, "fly"),
        (["run", "line-motion", "--bench", "reference", "--bus", "local:/nowhere/robot.sock"], 4, "plant-emulator serve"),
    ],
)
def test_the_exit_status_of_a_wrong_call_is_that_of_the_process(
    arguments: list[str], status: int, words: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [*HIL, *arguments], capture_output=True, text=True, timeout=300, check=False, cwd=tmp_path, stdin=subprocess.DEVNULL
    )
    assert done.returncode == status, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.ci
def test_a_bad_robot_file_is_located(tmp_path: Path) -> None:
    reference = (Path(__file__).parents[2] / "plant_emulator" / "robots" / "reference.toml").read_text()
    robot = tmp_path / "robot.toml"
    robot.write_text(reference.replace("torque_limit_nm = 3.8", "torque_limit_mnm = 3800.0"))
    done = subprocess.run(
        [sys.executable, "-m", "plant_emulator", "serve", "--robot", str(robot), "--bus", f"local:{tmp_path}/r.sock"],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 3
    line = 1 + next(i for i, text in enumerate(robot.read_text().splitlines()) if "torque_limit_mnm" in text)
    assert f"{robot}:{line}:" in done.stderr
    assert "torque_limit_nm (N·m)" in done.stderr


@pytest.mark.slow
def test_a_bench_with_a_profile_of_its_own_and_gains_as_found_runs_from_any_folder(
    tmp_path: Path, hil_serve_local_bus: Callable[..., ServedBus], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The drive has the gains from its maker, here the robot file; its profile knows no object of them."""
    control = next(line for line in REFERENCE.splitlines() if line.startswith("control = "))
    robot = tmp_path / "robot.toml"
    reference = (Path(__file__).parents[2] / "plant_emulator" / "robots" / "reference.toml").read_text()
    robot.write_text(reference.replace("[axis.2]\n", f"[axis.2]\n{control}\n"))
    folder = tmp_path / "bench"
    folder.mkdir()
    profile = (VENDORS / "emulated_drive.toml").read_text()
    for lines in (*(rf"{key} = \{{ index.*\n" for key in Control.model_fields), r"\[loop\.gains\]\n(?:(?!\[).*\n)*"):
        profile = re.sub(f"^{lines}", "", profile, flags=re.M)
    (folder / "drive.toml").write_text(profile)
    own = bench_file(
        folder, QUICK, ('profile = "emulated_drive"\nreduction_ratio = 120.0', 'profile = "drive.toml"\nreduction_ratio = 120.0'),
        (control, 'control = "as found"'),
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    hil_local_bus = hil_serve_local_bus(robot=str(robot))
    done = hil(*run_arguments(own, hil_local_bus, tmp_path / "out", "--json"))
    assert done.returncode in {0, 9}, done.stderr
    result = json.loads(done.stdout)
    assert result["bench"]["file"]["axis"]["2"]["control"] == "as found"
    known = hil(*run_arguments(bench_file(tmp_path, QUICK), hil_serve_local_bus(), tmp_path / "known", "--json"))
    positions = [
        Recording.load(tmp_path / name / "runs" / Path(result["runs"][0]["recording"]).name).axis(2, "position_rad")
        for name in ("out", "known")
    ]
    assert known.returncode in {0, 9}, known.stderr
    assert np.array_equal(*positions), "the gains are those that the drive had"


# -- what ends a motion ------------------------------------------------------------------------------------------------


def assert_kept(out: Path, words: str) -> None:
    """What was recorded up to the stop is on disk, and the result says why it stopped."""
    result = json.loads((out / "result.json").read_text())
    run = result["runs"][0]
    assert words in run["stopped"]
    assert 0 < len(Recording.load(out / run["recording"]).time_s) == run["cycles"]
    assert (out / "report.html").exists()
    assert (out / "bus.log").stat().st_size > 0


@pytest.mark.ci
def test_ctrl_c_ramps_down_disables_and_keeps_the_recording(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer, out = Sniffer(hil_local_bus), tmp_path / "out"
    try:
        run = start_run(bench_file(tmp_path, *SLOW), hil_local_bus, out)
        sniffer.wait_for_motion()
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=300)
        assert run.returncode == 130, errors
        assert "all axes are stopped and disabled" in errors
        assert state_of(int.from_bytes(sniffer.upload(2, 0x6041)[:2], "little")) is State.SWITCH_ON_DISABLED
        assert_kept(out, "SIGINT")
    finally:
        sniffer.close()


@pytest.mark.slow
def test_ctrl_c_without_an_answer_is_no_safe_stop_and_the_report_says_so(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer, out = Sniffer(hil_local_bus), tmp_path / "out"
    try:
        run = start_run(bench_file(tmp_path, *SLOW, ("answer_timeout_s = 1.0", "answer_timeout_s = 0.2")), hil_local_bus, out)
        sniffer.wait_for_motion()
        hil_local_bus.process.send_signal(signal.SIGSTOP)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=300)
    finally:
        hil_local_bus.process.send_signal(signal.SIGCONT)
        sniffer.close()
    assert run.returncode == 8, errors
    assert NOT_DISABLED in errors
    result, page = json.loads((out / "result.json").read_text()), (out / "report.html").read_text()
    assert result["all_disabled"] is False
    assert NOT_DISABLED in page
    assert result["not_restored"]
    for what in result["not_restored"]:
        assert not_restored_words(what) in errors
        assert not_restored_words(what) in html.unescape(page).replace("\N{NO-BREAK SPACE}", " ")  # a number keeps its unit


@pytest.mark.ci
def test_an_emulator_killed_in_motion_is_a_lost_bus(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer, out = Sniffer(hil_local_bus), tmp_path / "out"
    try:
        run = start_run(bench_file(tmp_path, *SLOW), hil_local_bus, out)
        sniffer.wait_for_motion()
        hil_local_bus.process.kill()
        _, errors = run.communicate(timeout=300)
        assert run.returncode == 8, errors
        assert "NOT every drive" in errors
        assert_kept(out, "lost")
    finally:
        sniffer.close()


@pytest.mark.wall
def test_a_master_killed_in_motion_leaves_drives_that_stop_by_themselves(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer = Sniffer(hil_local_bus)
    try:
        run = start_run(bench_file(tmp_path, *SLOW), hil_local_bus, tmp_path / "out")
        sniffer.wait_for_motion()
        os.kill(run.pid, signal.SIGKILL)
        run.communicate()
        # 8130h: the drive's own heartbeat consumer, in the world's clock, which now follows the wall's
        sniffer.wait_for(lambda: any(m.arbitration_id == 0x82 and m.data[:2] == b"\x30\x81" for m in list(sniffer.others)), 60.0)
        deadline = time.monotonic() + 60.0
        while state_of(int.from_bytes(sniffer.upload(2, 0x6041)[:2], "little")) is not State.SWITCH_ON_DISABLED:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert int.from_bytes(sniffer.upload(2, 0x606C), "little", signed=True) == 0
    finally:
        sniffer.close()


@pytest.mark.ci
def test_an_emergency_from_any_node_stops_the_run(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer, out = Sniffer(hil_local_bus), tmp_path / "out"
    try:
        run = start_run(bench_file(tmp_path, *SLOW), hil_local_bus, out)
        sniffer.wait_for_motion()
        sniffer.send(0x085, bytes.fromhex("1042020000000000"))
        _, errors = run.communicate(timeout=300)
        assert run.returncode == 8, errors
        assert "node 5 reports emergency 4210h" in errors
        assert_kept(out, "4210h")
    finally:
        sniffer.close()


@pytest.mark.slow
def test_a_node_that_is_moving_already_is_refused(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    sniffer = Sniffer(hil_local_bus)
    try:
        sniffer.send(0x000, b"\x01\x03")
        for subindex, index, gain in ((1, 0x2100, 25.0), (1, 0x2101, 0.0905), (2, 0x2101, 1.81)):
            sniffer.send(0x603, bytes((0x23, index & 0xFF, index >> 8, subindex)) + struct.pack("<f", gain))
        sniffer.send(0x603, bytes.fromhex("2f60600001000000"))
        for word in (0x06, 0x07, 0x0F):
            sniffer.send(0x603, bytes((0x2B, 0x40, 0x60, 0, word, 0, 0, 0)))
        sniffer.wait_for(lambda: sniffer.counts[0x583] >= 7, 60.0)
        done = hil(*run_arguments(bench_file(tmp_path), hil_local_bus, tmp_path / "out"))
        assert done.returncode == 5, done.stderr
        assert "operation enabled" in done.stderr
    finally:
        sniffer.close()


@pytest.mark.slow
def test_a_second_run_finds_the_robot_where_the_first_left_it(tmp_path: Path, hil_local_bus: ServedBus) -> None:
    """After an interrupted run the arm is elsewhere; the next line motion brings it home first."""
    sniffer = Sniffer(hil_local_bus)
    try:
        run = start_run(bench_file(tmp_path, *SLOW), hil_local_bus, tmp_path / "first")
        sniffer.wait_for_motion()
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=300)
        assert run.returncode == 130
    finally:
        sniffer.close()
    done = hil(
        "run",
        "line-motion",
        "--bench",
        str(bench_file(tmp_path, *SLOW)),
        "--bus",
        hil_local_bus.address,
        "--out",
        str(tmp_path / "second"),
    )
    assert done.returncode in {0, 9}, done.stderr
    recording = Recording.load(next((tmp_path / "second" / "runs").glob("*.csv")))
    assert abs(recording.axis(2, "position_rad")[0]) < 0.1


@pytest.mark.ci
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: there is nothing to share")
def test_both_ends_of_a_lock_step_bus_share_a_core_while_a_session_lasts(hil_local_bus: ServedBus) -> None:
    def cores() -> list[set[int]]:
        return [os.sched_getaffinity(process) for process in (0, hil_local_bus.process.pid)]

    before, bench = cores(), load_bench("reference")
    with contextlib.closing(LocalChannel(parse_address(hil_local_bus.address))) as channel:
        assert cores() == before, "a channel is opened without it"
        with Session(bench, channel, BusLog(None)):
            mine, its = cores()
            assert mine == its
            assert len(mine) == 1
            channel.send(Frame(0x80, b""))
        assert cores() == before


@pytest.mark.ci
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: there is nothing to share")
def test_the_emulator_has_its_cores_back_when_its_lock_step_client_has_died(hil_local_bus: ServedBus) -> None:
    its = os.sched_getaffinity(hil_local_bus.process.pid)
    code = (
        "import os, signal, sys\n"
        "from drive_profiles.address import parse_address\n"
        "from hil.can.local import LocalChannel\n"
        "with LocalChannel(parse_address(sys.argv[1])).on_one_core():\n"
        "    print(len(os.sched_getaffinity(int(sys.argv[2]))), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    words = [sys.executable, "-c", code, hil_local_bus.address, str(hil_local_bus.process.pid)]
    assert subprocess.run(words, capture_output=True, text=True, check=False).stdout == "1\n"
    deadline = time.monotonic() + 60.0
    while os.sched_getaffinity(hil_local_bus.process.pid) != its:
        assert time.monotonic() < deadline, "the emulator has not got its cores back"
        time.sleep(0.01)
