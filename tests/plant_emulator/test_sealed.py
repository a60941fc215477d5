"""Nothing is loaded or compiled while a robot is served: no mode, stop, homing method or fault silences the bus."""

import importlib
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest

from drive_profiles.standard.cia402 import Mode
from hil.control.compiled import compiled
from plant_emulator.motion.axes import Axes, rehearse
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import load_robot
from plant_emulator.sealed import LATE, sealed
from tests.drive_profiles.profiles import DRIVES
from tests.plant_emulator import tour
from tests.strangers.conftest import Tcp

# -- the seal ----------------------------------------------------------------------------------------------------------


def test_a_late_import_is_said_once_and_done(tmp_path, monkeypatch):
    for name in ("late_one", "late_two"):
        (tmp_path / f"{name}.py").write_text("VALUE = 3\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    said = []
    with sealed(said.append):
        assert importlib.import_module("late_one").VALUE == 3
        assert said == [f"{LATE} module late_one, and the bus was silent meanwhile"]
        del sys.modules["late_one"]
        importlib.import_module("late_one")
        importlib.import_module("json")
        assert len(said) == 1
    importlib.import_module("late_two")
    assert len(said) == 1
    for name in ("late_one", "late_two"):
        del sys.modules[name]


def shift(values, by):
    values[0] += by


def test_machine_code_that_is_late_is_said_and_runs(tmp_path, monkeypatch):
    door, values, others, said = compiled(shift), np.zeros(1), np.zeros(1, np.int64), []
    monkeypatch.setattr(door, "_folder", lambda: tmp_path)
    door(values, 2.0)
    with sealed(said.append):
        door(values, 3.0)
        assert said == []
        door(others, 4.0)  # other machine code
        door(others, 5.0)
    assert (values[0], others[0]) == (5.0, 9)
    of_code = [words for words in said if "machine code" in words]
    assert of_code == [f"{LATE} machine code of shift, and the bus was silent meanwhile"]


REHEARSED = """
from hil.control.compiled import Compiled
from plant_emulator.motion import axes
from plant_emulator.robots.robot import load_robot

robot = load_robot("reference")
axes.rehearse(robot)
axes.rehearse(robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"delay_s": 0.001})}))
doors = {name: len(door._entries) for name, door in vars(axes).items() if isinstance(door, Compiled)}
print(len(doors) > 3, [name for name, count in doors.items() if count != 1])
"""


@pytest.mark.parametrize("delay_s", [0.0, 0.0043])
def test_an_arm_that_was_rehearsed_loads_nothing_any_more(delay_s):
    robot = load_robot("reference-arm")
    robot = robot.model_copy(update={"accelerometer": robot.accelerometer.model_copy(update={"delay_s": delay_s})})
    axes, said = Axes(robot), []
    rehearse(robot)
    with sealed(said.append):
        for row in range(6):
            axes.open_brake(row, POSITION, 8)
        for periods in (8, 1, 5):
            axes.advance(periods)
            axes.sensed_acceleration()
        axes.stop(2, 100.0)
        axes.advance(8)
    assert said == []


def test_the_rehearsal_goes_through_every_door_to_machine_code_that_the_axes_have():
    said = subprocess.run([sys.executable, "-c", REHEARSED], capture_output=True, text=True, check=True).stdout
    assert said == "True []\n"


# -- a served robot, by the wall clock ---------------------------------------------------------------------------------


@pytest.fixture
def serve(tmp_path):
    """A server whose machine code lies on disk, as all but the very first find it; it must not have said anything late."""
    processes = []

    def start(*options, drives=(), rate=""):
        while True:
            process, path, robot = tour.start(tmp_path, *options, drives=drives, rate=rate)
            processes.append(process)
            if "/numba/" not in Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8"):
                return process, path, robot
            assert len(processes) < 3, "the machine code has not been kept"
            processes.pop()
            tour.end(process)

    yield start
    for process in processes:
        process.kill()
        process.communicate()


ENOUGH = 100
"""Heartbeats to be heard before a tour says anything."""


def assert_undisturbed(process, watch):
    maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
    said = tour.end(process)
    assert LATE not in said
    assert "/numba/" not in maps
    assert watch.beats > ENOUGH
    assert watch.missed < watch.beats / 2, "this machine is too busy to see a gap"
    assert watch.worst_s[0] < tour.GAP_S, f"the bus was silent for {watch.worst_s[0]:.3f} s at {watch.worst_s[1]}"


VENDORS = sorted(set(DRIVES) - {"emulated_drive"})
SHORT = (tour.modes, tour.stops, partial(tour.homing, methods=(1, 7, 33, 35, 37)), tour.reactions, tour.faults, tour.parameters)


@pytest.mark.wall
def test_nothing_that_a_drive_does_silences_the_bus(serve):
    process, path, robot = serve()
    watch, idle = tour.visit(process, path, robot, (*SHORT, tour.services))
    assert idle == []
    assert_undisturbed(process, watch)


@pytest.mark.slow
@pytest.mark.wall
def test_no_stop_in_any_mode_and_no_homing_method_silences_the_bus(serve):
    process, path, robot = serve()
    stops = partial(tour.stops, in_modes=tuple(Mode))
    watch, idle = tour.visit(process, path, robot, (tour.modes, stops, tour.homing))
    assert idle == []
    assert_undisturbed(process, watch)


@pytest.mark.wall
@pytest.mark.parametrize(
    "parts",
    [
        pytest.param((tour.modes, tour.faults, tour.services), marks=pytest.mark.ci, id="modes, faults and services"),
        pytest.param((*SHORT, tour.services), marks=pytest.mark.slow, id="all"),
    ],
)
def test_nothing_that_any_vendors_drive_does_silences_the_bus(serve, parts):
    """Each is an axis of one robot, and all are on tour at the same time."""
    process, path, robot = serve(drives=VENDORS)
    watch, idle = tour.visit_all(process, path, robot, parts)
    assert [robot.axis[axis].profile for axis, names in idle.items() if "what it holds" in names] == []
    assert_undisturbed(process, watch)


WIRE = """
seed = 1

[[fault]]
kind = "{kind}"
from_s = {begin}
to_s = {end}
{more}
"""


@pytest.mark.slow
@pytest.mark.wall
def test_no_fault_of_the_wire_silences_the_bus_for_longer_than_it_lasts(serve, tmp_path):
    kinds = [("drop", "can_id = 0x583"), ("delay", "can_id = 0x183\ndelay_ns = 2_000_000"), ("duplicate", "can_id = 0x183"),
             ("reorder", "can_id = 0x183\ndelay_ns = 2_000_000"), ("corrupt", "can_id = 0x183\nbits = [3]\ncrc = false"),
             ("corrupt", "can_id = 0x203\nattempts = 40"), ("mute", "port = 3"), ("babble", "port = 3\ncan_id = 0x123"),
             ("stuck", ""), ("bus_off", "port = 3")]  # fmt: skip
    faults = tmp_path / "faults.toml"
    tables = [WIRE.format(kind=kind, begin=0.5 + 0.2 * i, end=0.52 + 0.2 * i, more=more) for i, (kind, more) in enumerate(kinds)]
    faults.write_text(tables[0] + "".join(table.replace("seed = 1", "") for table in tables[1:]), encoding="utf-8")
    process, path, robot = serve("--faults", str(faults), rate="@1M")

    def wait(guest):
        for _ in range(60):
            guest.sync()
            guest.send(0x203, b"\x00\x00")
            yield "faults of the wire", guest.wait(40) is not None

    watch, _ = tour.visit(process, path, robot, (wait,))
    assert_undisturbed(process, watch)


@pytest.mark.wall
def test_who_joins_by_another_door_finds_everything_loaded(serve, tmp_path):
    process, path, _ = serve(
        "--slcan", str(tmp_path / "tty"), "--serial-accelerometer", str(tmp_path / "acc"), "--virtualcan", "0"
    )
    watch = tour.Watch(path, process.pid)
    said = [process.stdout.readline()]
    while not said[-1].startswith("virtualcan: "):
        said.append(process.stdout.readline())
    tcp = Tcp(said[-1].removeprefix("virtualcan: ").strip().rsplit(":", 1))
    try:
        tcp.send(0x600 + tour.SENSOR, bytes((0x2B, 0x17, 0x10, 0, tour.BEAT_MS, 0, 0, 0)))
        assert tcp.until(0x580 + tour.SENSOR)
        with can.Bus(interface="slcan", channel=str(tmp_path / "tty"), bitrate=1_000_000) as bus:
            bus.send(can.Message(arbitration_id=0x603, data=bytes.fromhex("4041600000000000"), is_extended_id=False))
            end = time.monotonic() + tour.PATIENCE_S
            while (message := bus.recv(1.0)) is None or message.arbitration_id != 0x583:
                assert time.monotonic() < end
        with (tmp_path / "acc").open("rb") as line:
            assert line.read(20)
        watch.wait_for_beats(ENOUGH + 1)
    finally:
        tcp.close()
        watch.close()
    assert_undisturbed(process, watch)
