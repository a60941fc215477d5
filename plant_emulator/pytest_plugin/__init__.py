"""pytest plug-in for tests on the emulated robot or a bench.

A test file runs on the emulated robot without set-up, and unchanged on a real bench; see docs/testing.md.

Only this package may import both the world and the master. Every pytest of an environment with this distribution imports
this file, so it imports nothing of ours before a fixture is used. Its modules must not have the names of fixtures: importing
one would replace the fixture.
"""

from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hil.bench.bench import Bench
    from plant_emulator.pytest_plugin.artefacts import Artefacts
    from plant_emulator.pytest_plugin.emulated import EmulatedRobot
    from plant_emulator.pytest_plugin.enabled_drive import EnabledDrive
    from plant_emulator.pytest_plugin.injection import FaultInjection
    from plant_emulator.pytest_plugin.master import AccelerometerReadings, BenchSession
    from plant_emulator.pytest_plugin.target import ServedBus, Target
    from plant_emulator.robots.robot import Robot

_ARTEFACTS: pytest.StashKey["Artefacts"] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of a bench."""
    group = parser.getgroup("hil-bench", "robot bench (hil-bench)")
    add = group.addoption
    add(
        "--hil-bench", metavar="FILE|NAME", default="reference",
        help="Bench: a file, on the bus that it names; or `reference`, on the emulated robot (default).",
    )  # fmt: skip
    add(
        "--hil-robot", metavar="FILE|NAME",
        help="Emulate this robot and ignore the bus of --hil-bench. An emulated robot is `reference` by default.",
    )  # fmt: skip
    add("--hil-axis", type=int, metavar="N", help="Axis of the `hil_drive` fixture; default: the lowest of the bench.")
    add("--hil-bitrate", metavar="RATE", help="Bit times on the emulated bus, such as 1M; default: none.")
    add("--hil-allow-motion", action="store_true", help="Let fixtures move a real robot; by default they skip.")
    add("--hil-require-hardware", action="store_true", help="Missing hardware fails instead of skipping.")
    add("--hil-keep-traces", metavar="DIR", help="Folder for trace and recordings of failed tests; default: .hil-traces.")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse several workers on one real bus."""
    workers = getattr(config.option, "numprocesses", None) or 0
    named = config.getoption("hil_bench") != "reference" and config.getoption("hil_robot") is None
    if named and workers > 1:
        raise pytest.UsageError(
            f"--hil-bench {config.getoption('hil_bench')} is one bus for one master; run with -n 0 instead of {workers}"
        )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Keep the frames and runs of a failed test.

    The report names their files; those of other tests are dropped.
    """
    report = yield
    artefacts = item.stash.get(_ARTEFACTS, None)
    if artefacts is None:
        return report
    if report.failed:
        report.sections.append(("hil-bench", artefacts.keep()))
    elif artefacts.is_saved and report.when == "teardown":
        artefacts.keep()  # once more: the teardown's frames belong to the log
    if report.when == "teardown":
        del item.stash[_ARTEFACTS]
    return report


# -- where the test runs -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def hil_robot_model(pytestconfig: pytest.Config) -> "Robot":
    """Robot file of the emulated robot.

    It is `--hil-robot`, else the reference. Override it for a robot of your own.
    """
    from plant_emulator.pytest_plugin.target import load_model  # noqa: PLC0415

    return load_model(pytestconfig)


@pytest.fixture
def _hil_target(request: pytest.FixtureRequest) -> Iterator["Target"]:
    """Emulated robot in this process, or bus of the bench file."""
    from plant_emulator.pytest_plugin.artefacts import Artefacts, directory_of  # noqa: PLC0415
    from plant_emulator.pytest_plugin.target import open_target  # noqa: PLC0415

    artefacts = Artefacts(directory_of(request.config, request.node.nodeid))
    request.node.stash[_ARTEFACTS] = artefacts
    target = open_target(request.config, lambda: request.getfixturevalue("hil_robot_model"), artefacts)
    yield target
    target.close()


@pytest.fixture
def hil_bench(_hil_target: "Target") -> "Bench":
    """Bench file of `--hil-bench`.

    Unless that is a file, it describes the emulated robot. Override it to change it.
    """
    return _hil_target.bench


@pytest.fixture
def hil_axis(pytestconfig: pytest.Config, hil_bench: "Bench") -> int:
    """Number of the axis under test.

    It is `--hil-axis`, else the lowest of the bench; parametrise it to test several.
    """
    number: int | None = pytestconfig.getoption("hil_axis")
    return min(hil_bench.axis) if number is None else number


@pytest.fixture
def hil_robot(_hil_target: "Target") -> "EmulatedRobot":
    """The emulated robot: world, channel, drives by axis, and `advance()`.

    Time is virtual; equal seeds give equal frames.
    """
    if _hil_target.robot is None:
        pytest.skip(f"needs the emulated robot; {_hil_target.where} is not one")
    return _hil_target.robot


@pytest.fixture
def hil_local_bus(hil_serve_local_bus: Callable[..., "ServedBus"]) -> "ServedBus":
    """Process that serves an emulated robot on a local bus.

    Other programs join the bus at its `.address`.
    """
    return hil_serve_local_bus()


@pytest.fixture
def hil_serve_local_bus(pytestconfig: pytest.Config) -> Iterator[Callable[..., "ServedBus"]]:
    """Starter of processes that serve an emulated robot.

    `hil_serve_local_bus("--seed", "2", robot="robot.toml")` takes the options of `plant-emulator serve`.
    """
    from plant_emulator.pytest_plugin.target import local_bus_servers  # noqa: PLC0415

    with local_bus_servers(pytestconfig) as start:
        yield start


# -- the master --------------------------------------------------------------------------------------------------------


@pytest.fixture
def hil_session(_hil_target: "Target", hil_bench: "Bench") -> Iterator["BenchSession"]:
    """A master on the bench.

    Every node has been found and checked; nothing is enabled.
    """
    from plant_emulator.pytest_plugin.master import open_session  # noqa: PLC0415

    with open_session(_hil_target, hil_bench) as opened:
        yield opened


@pytest.fixture
def hil_drive(hil_session: "BenchSession", request: pytest.FixtureRequest) -> Iterator["EnabledDrive"]:
    """One enabled drive that holds its position.

    Afterwards it is disabled and restored to its former state.
    """
    from plant_emulator.pytest_plugin.enabled_drive import enabled  # noqa: PLC0415

    number = getattr(request, "param", None)
    with enabled(hil_session, request.getfixturevalue("hil_axis") if number is None else number) as held:
        yield held


@pytest.fixture
def hil_accelerometer(hil_session: "BenchSession") -> "AccelerometerReadings":
    """Sensor at the tip; an emulated one measures no gravity.

    `read()` returns X, Y, Z in m/s². A test for an emulated and a real robot subtracts the reading at rest. An emulated arm
    with `[accelerometer.mounting]` measures gravity.
    """
    from plant_emulator.pytest_plugin.master import AccelerometerReadings  # noqa: PLC0415

    return AccelerometerReadings(hil_session)


@pytest.fixture
def hil_faults(_hil_target: "Target") -> "FaultInjection":
    """Faults on demand.

    Frames can be lost, delayed, doubled or corrupted; bus, heartbeats or nodes can fail; other participants can interfere.
    """
    from plant_emulator.pytest_plugin.injection import FaultInjection  # noqa: PLC0415

    return FaultInjection(_hil_target)
