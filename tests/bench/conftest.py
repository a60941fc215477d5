"""Benches of all sizes, beside the fixtures of plant_emulator.pytest_plugin."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.bench.bench import Bench, load_bench
from plant_emulator.motion.record import BRAKED
from plant_emulator.pytest_plugin.target import ServedBus
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World
from tests.bench.shared_demo import DemoRun, common_root, shared_demo
from tests.bench.warm_server import IS_POSSIBLE, WarmServers


@pytest.fixture(scope="session")
def reference_bench() -> Bench:
    return load_bench("reference")


@pytest.fixture(scope="session")
def reference_robot() -> Robot:
    return load_robot("reference")


@pytest.fixture(scope="session")
def quiet_robot(reference_robot: Robot) -> Robot:
    """The reference robot with an accelerometer that has neither noise nor a coarse step."""
    sensor = reference_robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    return reference_robot.model_copy(update={"accelerometer": sensor})


@pytest.fixture(scope="session")
def warm_servers() -> Iterator[WarmServers]:
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        servers = WarmServers(Path(folder))
        yield servers
        servers.close()


@pytest.fixture
def hil_local_bus(request: pytest.FixtureRequest) -> Iterator[ServedBus]:
    """The plug-in's, from a process that has loaded everything, where that is possible."""
    config = request.config
    if not IS_POSSIBLE or config.getoption("hil_robot") or config.getoption("hil_bitrate"):
        yield request.getfixturevalue("hil_serve_local_bus")()
        return
    with request.getfixturevalue("warm_servers").serving() as bus:
        yield bus


@pytest.fixture(scope="session")
def demo_run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    """`hil demo --json`, once: whole where a test of this run asks for that, else its first part."""
    is_whole = any("whole_demo_run" in getattr(item, "fixturenames", ()) for item in request.session.items)
    return shared_demo(common_root(tmp_path_factory), is_whole=is_whole)


@pytest.fixture(scope="session")
def whole_demo_run(demo_run: DemoRun) -> DemoRun:
    """The same with the tour and the whole arm."""
    return demo_run


def with_bus(bench: Bench, **changes: object) -> Bench:
    return bench.model_copy(update={"bus": bench.bus.model_copy(update=changes)})


def with_motion(bench: Bench, **changes: object) -> Bench:
    motion = bench.constant_acceleration
    assert motion is not None
    return bench.model_copy(update={"constant_acceleration": motion.model_copy(update=changes)})


def shortened(bench: Bench) -> Bench:
    """A second of motion up to 4 rps: enough for what does not look at the vibration."""
    return with_motion(bench, acceleration_rps_s=8.0, end_rps=4.0, tail_s=0.1)


@pytest.fixture
def short_bench(reference_bench: Bench) -> Bench:
    return shortened(reference_bench)


def all_braked(world: World) -> bool:
    """True if the brake of every axis is closed."""
    return bool(np.all(world.axes.motion["mode"] == BRAKED))
