"""The plug-in as its user has it: test files of their own, run by a pytest of their own."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from _pytest.pytester import SysModulesSnapshot

from hil.can.frame import Frame, pack
from hil.recording import LoggedCycles
from plant_emulator.pytest_plugin.artefacts import FrameLog
from plant_emulator.pytest_plugin.target import ServedBus

pytest_plugins = ["pytester"]

Run = Callable[..., pytest.RunResult]

ROOT = Path(__file__).parents[2]
REFERENCE = (ROOT / "hil" / "bench" / "reference.toml").read_text()
PASSES = "def test_it(hil_drive):\n    hil_drive.hold(0.1)\n    assert hil_drive.is_enabled\n"
STAY = {"numpy", "scipy", "hil", "plant_emulator", "drive_profiles"}
"""Packages of which everything stays loaded."""

FAILS = "def test_it(hil_drive):\n    hil_drive.hold(0.1)\n    assert not hil_drive.is_enabled\n"


@pytest.fixture(autouse=True)
def _modules_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """pytester forgets modules that an inner pytest has loaded; numpy cannot stand that."""
    make = SysModulesSnapshot.__init__

    def remember(self: SysModulesSnapshot, preserve: Callable[[str], bool] | None = None) -> None:
        make(self, lambda name: name.split(".")[0] in STAY or (preserve is not None and preserve(name)))

    monkeypatch.setattr(SysModulesSnapshot, "__init__", remember)


@pytest.fixture
def run(pytester: pytest.Pytester) -> Run:
    def run(source: str, *options: str) -> pytest.RunResult:
        pytester.makepyfile(source)
        return pytester.runpytest_inprocess("-p", "no:cacheprovider", "-W", "error", "-rs", *options)

    return run


def bench_file(pytester: pytest.Pytester, address: str) -> Path:
    return pytester.path.joinpath("real.toml").write_text(REFERENCE.replace("local:/tmp/robot.sock", address)) and Path(
        "real.toml"
    )


# -- the page ----------------------------------------------------------------------------------------------------------


def test_the_example_of_the_page_holds_as_it_stands(run: Run, pytester: pytest.Pytester) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "testing.md").read_text(), re.DOTALL)
    run(example).assert_outcomes(passed=3)
    assert not (pytester.path / ".hil-traces").exists(), "what passes leaves nothing"


@pytest.mark.ci
def test_the_example_holds_on_a_bus_with_bit_times(run: Run) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "testing.md").read_text(), re.DOTALL)
    run(example, "--hil-bitrate", "1M", "--hil-axis", "3").assert_outcomes(passed=3)


def test_the_page_names_every_option_and_every_fixture(run: Run) -> None:
    page = (ROOT / "docs" / "testing.md").read_text()
    told = run("", "--help").stdout.str()
    group = told[told.index("robot bench (hil-bench)") :].split("\n\n", 1)[0]
    options = re.findall(r"^  (--[a-z-]+)", group, re.MULTILINE)
    assert len(options) == 7
    assert [option for option in options if f"| `{option}" not in page] == []
    fixtures = re.findall(r"^(\w+)(?: \[\w+ scope\])? -- .*pytest_plugin", run("", "--fixtures").stdout.str(), re.MULTILINE)
    assert len(fixtures) == 10
    assert [name for name in fixtures if f"`{name}" not in page] == []


@pytest.mark.slow
def test_the_same_file_runs_on_another_bus_and_says_what_it_cannot_do_there(
    run: Run, pytester: pytest.Pytester, hil_local_bus: ServedBus
) -> None:
    """A served bus stands for the real one: the plug-in knows no more of either."""
    source = PASSES + (
        "def test_inside(hil_robot): pass\n"
        "def test_wrong_set_points(hil_faults): hil_faults.delay(0x202, 0.01)\n"
        "def test_lost(hil_drive, hil_faults, hil_bench):\n"
        "    hil_faults.stop_heartbeat(hil_bench.bus.master_node_id)\n"
        "    reason = str(hil_drive.wait_for_stop(1.0))\n"
        # the drive goes pre-operational with its emergency: a busy master may miss its answers first
        "    assert '8130h' in reason or 'has not answered' in reason\n"
        "def test_after(hil_drive, hil_accelerometer):\n"
        "    hil_drive.hold(0.1)\n"
        "    assert len(hil_accelerometer.read()) == 3\n"
    )
    result = run(source, f"--hil-bench={bench_file(pytester, hil_local_bus.address)}")
    result.assert_outcomes(passed=3, skipped=2)
    result.stdout.fnmatch_lines(["*needs the emulated robot*", "*delayed set-points would reach a real robot*"])


@pytest.mark.wall
def test_by_the_wall_clock_the_drive_is_held_while_the_test_thinks(
    run: Run, pytester: pytest.Pytester, hil_serve_local_bus: Callable[..., ServedBus]
) -> None:
    source = (
        "import time\n"
        "def test_it(hil_drive):\n"
        "    time.sleep(0.5)\n"  # five heartbeats
        "    hil_drive.hold(0.05)\n"
        "    assert hil_drive.is_enabled\n"
    )
    bench = REFERENCE.replace("local:/tmp/robot.sock", hil_serve_local_bus("--wall").address)
    bench = bench.replace("sync_period_s = 0.002 ", "sync_period_s = 0.01 ").replace("missing_limit = 3 ", "missing_limit = 90 ")
    pytester.path.joinpath("wall.toml").write_text(bench.replace("heartbeat_s = 0.1 ", "heartbeat_s = 0.2 "))
    run(source, "--hil-bench=wall.toml").assert_outcomes(passed=1)


# -- hardware ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("option", "outcome"), [([], "skipped"), (["--hil-require-hardware"], "errors")])
def test_a_bus_that_is_not_there_skips_or_fails_as_asked(
    run: Run, pytester: pytest.Pytester, option: list[str], outcome: str
) -> None:
    bench = bench_file(pytester, "local:/nowhere/robot.sock")
    result = run("def test_it(hil_session): pass\n", f"--hil-bench={bench}", *option)
    result.assert_outcomes(**{outcome: 1})
    result.stdout.fnmatch_lines(["*no bus at local:/nowhere/robot.sock*"])


@pytest.mark.slow
def test_a_real_robot_does_not_move_unless_that_is_allowed(
    run, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its channel is an emulated one here, under the address of a real one."""
    pytester.makeconftest(REAL_IN_DISGUISE)
    bench = bench_file(pytester, "socketcan:can7")
    source = (
        PASSES
        + "def test_run(hil_session, hil_bench):\n"
        + "    from hil.experiments.motions import constant_acceleration\n"
        + "    hil_session.run(constant_acceleration(hil_bench, 2, 0.002))\n"
        + "def test_reading(hil_accelerometer):\n"
        + "    assert len(hil_accelerometer.read()) == 3\n"
    )
    result = run(source, f"--hil-bench={bench}")
    result.assert_outcomes(passed=1, skipped=2)
    result.stdout.fnmatch_lines(["*would move the robot on socketcan:can7; give --hil-allow-motion to permit it"])
    run(source, f"--hil-bench={bench}", "--hil-allow-motion").assert_outcomes(passed=3)


REAL_IN_DISGUISE = """
import pytest
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.pytest_plugin import target
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

@pytest.fixture(autouse=True)
def _no_bus(monkeypatch):
    monkeypatch.setattr(target, "open_channel", lambda address: InProcessChannel(World(load_robot("reference"))))
"""


def test_a_silent_node_is_missing_hardware(run: Run, pytester: pytest.Pytester) -> None:
    pytester.makeconftest(REAL_IN_DISGUISE)
    text = REFERENCE.replace("local:/tmp/robot.sock", "socketcan:can7").replace(
        "answer_timeout_s = 1.0", "answer_timeout_s = 0.1"
    )
    pytester.path.joinpath("real.toml").write_text(text.replace("node_id = 5", "node_id = 6"))
    result = run("def test_it(hil_session): pass\n", "--hil-bench=real.toml")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*node 6: no answer*"])


def test_a_bench_file_runs_on_an_emulated_robot_where_one_is_named(run: Run, pytester: pytest.Pytester) -> None:
    run(PASSES, f"--hil-bench={bench_file(pytester, 'socketcan:can7')}", "--hil-robot", "reference").assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--hil-bench=nowhere.toml"], "--hil-bench: nowhere.toml"),
        (["--hil-robot", "nowhere.toml"], "--hil-robot: nowhere.toml"),
        (["--hil-axis", "4"], "the bench has no axis 4; it has 2, 3, 5"),
        (["--hil-bitrate", "fast"], "--hil-bitrate 'fast' is not a bit rate"),
    ],
)
def test_a_wrong_option_is_named_without_a_traceback(run: Run, options: list[str], words: str) -> None:
    result = run(PASSES, *options)
    result.assert_outcomes(errors=1)
    assert words in result.stdout.str()
    assert "Traceback" not in result.stdout.str()
    assert "pytest_plugin/" not in result.stdout.str()


# -- fixtures ----------------------------------------------------------------------------------------------------------


def test_the_axis_can_be_parametrised(run: Run) -> None:
    run(
        "import pytest\n"
        "@pytest.mark.parametrize('hil_axis', [2, 3])\n"
        "def test_by_name(hil_drive, hil_axis): assert hil_drive.number == hil_axis\n"
        "@pytest.mark.parametrize('hil_drive', [5], indirect=True)\n"
        "def test_by_drive(hil_drive): assert hil_drive.number == 5\n"
    ).assert_outcomes(passed=3)


def test_bench_and_robot_can_be_changed_by_their_user(run: Run, pytester: pytest.Pytester) -> None:
    pytester.makeconftest(
        "import pytest\n"
        "@pytest.fixture\n"
        "def hil_bench(hil_bench): return hil_bench.model_copy(update={'approach_rps': 3.0})\n"
        "@pytest.fixture\n"
        "def hil_robot_model(hil_robot_model): return hil_robot_model.model_copy(update={'name': 'mine'})\n"
    )
    run(
        "def test_it(hil_robot, hil_session):\n"
        "    assert hil_robot.model.name == 'mine'\n"
        "    assert hil_session.bench.approach_rps == 3.0\n"
    ).assert_outcomes(passed=1)


@pytest.mark.ci
def test_a_test_leaves_its_drive_disabled_and_as_it_was(run: Run, pytester: pytest.Pytester) -> None:
    pytester.makeconftest(
        "import pytest\n"
        "def kept(entry): return 0x1003 < entry.index < 0x6000 or entry.index in (0x6065, 0x6066, 0x6072, 0x607D)\n"
        "@pytest.fixture(autouse=True)\n"
        "def _after(hil_robot):\n"
        "    drive = hil_robot.drives[2].slave.dictionary\n"
        "    before = {(e.index, e.subindex): drive.get(e.index, e.subindex) for e in drive if kept(e)}\n"
        "    yield\n"
        "    assert before == {key: drive.get(*key) for key in before}\n"
        "    assert hil_robot.is_braked(2)\n"
    )
    run(
        "def test_it(hil_drive, hil_robot):\n"
        "    hil_drive.write('following_error_timeout_s', 0.25)\n"
        "    assert hil_drive.read('following_error_timeout_s') == 0.25\n"
        "    assert not hil_robot.is_braked(2)\n"
        "def test_that_fails(hil_drive): assert 0\n"
        "def test_whose_drive_has_stopped(hil_drive, hil_faults):\n"
        "    hil_faults.lose_bus(after_s=0.1)\n"
        "    assert 'pulled' in str(hil_drive.wait_for_stop(1.0))\n"
    ).assert_outcomes(passed=2, failed=1)


def test_a_stop_that_nobody_asks_about_fails_the_test(run: Run) -> None:
    result = run(
        "import contextlib\n"
        "def test_it(hil_drive, hil_faults, hil_robot):\n"
        "    hil_faults.emergency(5, 0x4210)\n"
        "    hil_drive._keeper.call(hil_drive.idle)\n"
    )
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*axis 2 was stopped: node 5 reports emergency 4210h*the test did not read `stopped`*"])


FAULTS = """
import pytest
from drive_profiles.standard.cia301 import NmtCommand
from hil.can.frame import Frame

@pytest.mark.parametrize(("fault", "words"), [
    (lambda f: f.lose(0x182, after_s=0.1), "not answered"),
    (lambda f: f.delay(0x182, 0.1, after_s=0.1), "not answered"),
    (lambda f: f.corrupt(0x182, bits=(3,), after_s=0.1), "left operation enabled"),
    (lambda f: f.stop_heartbeat(2, after_s=0.1), "node 2 has lost its heartbeat"),
    (lambda f: f.stop_heartbeat(127, after_s=0.1), "8130h"),
    (lambda f: f.lose_bus(after_s=0.1), "pulled"),
    (lambda f: f.lose_bus(), "pulled"),
    (lambda f: f.reset_node(2, after_s=0.1), "has been reset"),
    (lambda f: f.nmt(NmtCommand.RESET_NODE, 2, after_s=0.1), "has been reset"),
    (lambda f: f.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, after_s=0.1), "not answered"),
    (lambda f: f.emergency(5, 0x4210, after_s=0.1), "4210h"),
    (lambda f: f.safe_torque_off(2, after_s=0.1), "5441h"),
    pytest.param(lambda f: f.bus_off(2, after_s=0.1, for_s=0.2), "not answered", id="bus_off"),
    (lambda f: f.send(Frame(0x82, bytes.fromhex("1181200000000000"))), "8111h"),
])
def test_it_stops(hil_drive, hil_faults, fault, words, hil_robot):
    hil_drive.hold(0.1)
    fault(hil_faults)
    before = hil_robot.now_s
    assert words in str(hil_drive.wait_for_stop(1.0))
    hil_robot.advance(3.0)
    assert hil_robot.is_braked(2)

@pytest.mark.parametrize("fault", [
    lambda f: f.lose(0x182, every=10),
    lambda f: f.lose(0x182, count=2),
    lambda f: f.lose(0x182, after_s=0.1, for_s=0.004),
    lambda f: f.delay(0x182, 0.003, count=2),
    lambda f: f.duplicate(0x182, 2, every=3),
    lambda f: f.duplicate(0x202, every=3),
])
def test_it_goes_on(hil_drive, hil_faults, fault):
    hits = fault(hil_faults).hits
    hil_drive.hold(0.5)
    assert hil_drive.is_enabled
    assert hits[0] > 0

def test_an_input_is_active_for_a_time_and_a_motion_into_it_stops(hil_drive, hil_faults, hil_robot):
    inputs = hil_robot.drives[2].inputs
    hil_faults.hold_input(2, "home", after_s=0.1, for_s=0.1)
    hil_faults.hold_input(2, "positive_limit")
    seen = set()
    for _ in range(8):
        hil_drive.hold(0.05)
        seen.add(inputs.levels)
    assert seen == {2, 2 | 4}
    assert hil_drive.is_enabled

def test_sto_ends_and_what_is_not_there_is_named(hil_drive, hil_faults, hil_robot):
    hil_faults.safe_torque_off(3, for_s=0.1)
    assert hil_robot.drives[3].inputs.is_sto_active
    hil_drive.hold(0.2)
    assert not hil_robot.drives[3].inputs.is_sto_active
    assert hil_drive.is_enabled
    for call, words in (
        (lambda: hil_faults.safe_torque_off(4), "no axis 4; it has 2, 3, 5"),
        (lambda: hil_faults.hold_input(2, "door"), "unknown input door; expected one of negative_limit"),
        (lambda: hil_faults.bus_off(99), "no node 99; it has 2, 3, 5, 16"),
    ):
        with pytest.raises(ValueError, match=words):
            call()

def test_noticed(hil_drive, hil_faults):
    again = hil_faults.corrupt(0x182, noticed=True, every=5)
    hil_drive.hold(0.2)
    assert again.hits[0] > 5
"""


def assert_all_passed(result: pytest.RunResult, skipped: int) -> None:
    """All that was collected and not deselected has run: no case of the table has been lost, whatever its length."""
    (collected,) = map(int, re.findall(r"^collected (\d+) items", result.stdout.str(), re.MULTILINE))
    deselected = result.parseoutcomes().get("deselected", 0)
    assert collected >= FAULTS.count("lambda f:") + FAULTS.count("def test_") - 2, "two of the tests have a table of faults"
    assert collected > deselected + skipped
    result.assert_outcomes(passed=collected - deselected - skipped, skipped=skipped, deselected=deselected)


@pytest.mark.slow
def test_every_fault_does_what_it_says(run: Run) -> None:
    result = run(FAULTS)
    assert_all_passed(result, skipped=1)


@pytest.mark.slow
def test_a_crc_is_noticed_where_bits_have_times(run: Run) -> None:
    result = run(FAULTS, "--hil-bitrate", "1M", "-k", "test_noticed or test_it_goes_on or bus_off")
    assert_all_passed(result, skipped=0)


# -- what is left ------------------------------------------------------------------------------------------------------


def kept(result: pytest.RunResult) -> list[Path]:
    return [Path(path) for path in re.findall(r"^kept in (.*)$", result.stdout.str(), re.MULTILINE)]


def test_a_failure_keeps_trace_and_recording_and_says_where(run: Run, pytester: pytest.Pytester) -> None:
    result = run(FAILS, "--hil-keep-traces", "traces")
    result.assert_outcomes(failed=1)
    (directory,) = kept(result)
    assert directory.parent == pytester.path / "traces"
    assert "test_it" in directory.name
    assert sorted(path.name for path in directory.iterdir()) == ["01-axis-2-held.csv", "bus.log", "runs.json"]
    log = list(can.LogReader(directory / "bus.log"))
    ids = [message.arbitration_id for message in log]
    assert ids[:4] == [0x702, 0x703, 0x705, 0x710], "from the boot-up messages …"
    assert ids.index(0x202) < len(ids) - 1 - ids[::-1].index(0x602), "… to the end of the teardown"
    times = [message.timestamp for message in log]
    assert times == sorted(times)
    syncs = [message.timestamp for message in log if message.arbitration_id == 0x80]
    assert syncs[30] - syncs[20] == pytest.approx(0.02), "in the bench's time"
    assert (directory.parent / ".gitignore").read_text() == "*\n"


def test_a_trace_has_the_frames_of_cycles_that_crossed_in_messages() -> None:
    there, back = pack(Frame(0x202, b"\1\2")) + pack(Frame(0x80, b"")), pack(Frame(0x182, bytes(8)))
    trace = FrameLog()
    trace.add(LoggedCycles(0.5, 0.25, 2 * (there + back), len(there), len(there) + len(back)))
    expected = [(Frame(0x202, b"\1\2"), 0), (Frame(0x80, b""), 0), (Frame(0x182, bytes(8)), 1)]
    assert list(trace.frames) == [
        (500_000_000 + 250_000_000 * (cycle + later), frame) for cycle in (0, 1) for frame, later in expected
    ]


def test_equal_tests_leave_equal_traces(run: Run) -> None:
    logs = [(kept(run(FAILS, "--hil-keep-traces", name))[0] / "bus.log").read_bytes() for name in "ab"]
    assert logs[0] == logs[1]
    assert len(logs[0]) > 1000


@pytest.mark.ci
def test_a_run_is_kept_with_its_recording(run: Run) -> None:
    result = run(
        "from hil.experiments.motions import constant_acceleration\n"
        "def test_it(hil_session, hil_bench):\n"
        "    result = hil_session.run(constant_acceleration(hil_bench, 2, 0.002))\n"
        "    assert result.stopped is not None\n"
    )
    (directory,) = kept(result)
    assert (directory / "01-axis-2-drive-none.csv").stat().st_size > 10_000


def test_a_failed_set_up_keeps_what_led_to_it(run: Run) -> None:
    result = run("import pytest\n@pytest.fixture\ndef bad(hil_session): assert 0\ndef test_it(bad): pass\n")
    result.assert_outcomes(errors=1)
    assert (kept(result)[0] / "bus.log").stat().st_size > 1000


@pytest.mark.ci
def test_no_more_is_kept_than_is_bounded(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from plant_emulator.pytest_plugin import artefacts  # noqa: PLC0415

    monkeypatch.setattr(artefacts, "_written", set())
    monkeypatch.setattr(artefacts, "MAX_TESTS", 1)
    monkeypatch.setattr(artefacts, "MAX_FRAMES", 50)
    result = run("def test_a(hil_session): assert 0\ndef test_b(hil_session): assert 0\n")
    result.assert_outcomes(failed=2)
    (directory,) = kept(result)
    assert len((directory / "bus.log").read_text().splitlines()) == 50
    result.stdout.fnmatch_lines(["*older ones dropped*", "*not kept: 1 failed tests have left theirs*"])


# -- its neighbours ----------------------------------------------------------------------------------------------------


def test_it_costs_next_to_nothing_until_it_is_used() -> None:
    code = (
        "import sys, pytest; before = set(sys.modules); "
        "import plant_emulator.pytest_plugin; print(*sorted(set(sys.modules) - before))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.split() == ["plant_emulator", "plant_emulator.pytest_plugin"]


def test_it_can_be_switched_off(run: Run) -> None:
    result = run("def test_it(hil_drive): pass\n", "-p", "no:hil-bench")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*fixture 'hil_drive' not found*"])


@pytest.mark.slow
def test_workers_have_a_robot_each(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(PASSES + "def test_again(hil_drive): hil_drive.move_by(0.5)\ndef test_bad(hil_drive): assert 0\n")
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-n", "2", "-W", "error")
    result.assert_outcomes(passed=2, failed=1)
    assert len(kept(result)) == 1


def test_workers_do_not_share_a_real_bench(run: Run, pytester: pytest.Pytester) -> None:
    result = run(PASSES, "-n", "2", f"--hil-bench={bench_file(pytester, 'socketcan:can7')}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "one bus for one master" in result.stderr.str()


def test_the_options_of_pytest_benchmark_stand_beside_it(run: Run, pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        neighbour="def pytest_addoption(parser):\n    parser.addoption('--benchmark-only', action='store_true')\n"
        "    parser.addoption('--benchmark-name')\n"
    )
    pytester.syspathinsert()
    run(PASSES, "-p", "neighbour", "--benchmark-only", "--hil-bench", "reference").assert_outcomes(passed=1)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_in_a_motion_ends_it_by_a_ramp_and_then_the_tests(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        "import os, signal\n"
        "def test_it(hil_drive, hil_robot):\n"
        "    hil_robot.channel.on_sync = lambda n: os.kill(os.getpid(), signal.SIGINT) if n == 600 else None\n"
        "    try:\n"
        "        hil_drive.move_to(10.0)\n"
        "    finally:\n"
        "        print('braked', hil_robot.is_braked(2), 'at', 0.0 < hil_robot.position_rev(2) < 10.0)\n"
        "def test_not_reached(): pass\n"
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-s")
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(["*braked True at True*"])
