"""The same steps as commands over a served bus: they record what the functions in one process do."""

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.design.notch_search import Effort
from hil.emulator import EmulatorProcess
from hil.errors import HilError
from hil.recording import Recording
from plant_emulator.rehearsal.direct import DirectChannel
from plant_emulator.rehearsal.over_bus import CommandError, StepsOverBus
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.robot import Robot
from plant_emulator.robots.stable import draw
from plant_emulator.robots.writing import file_text
from plant_emulator.world import World

ROBOT = draw(8, kind="linear")


@pytest.fixture
def bench():
    made = loads(blank_bench(ROBOT), Bench)
    motion = made.constant_acceleration.model_copy(update={"acceleration_rps_s": 12.0, "end_rps": 6.0, "tail_s": 0.1})
    return made.model_copy(update={"constant_acceleration": motion, "settle_s": 0.1})


@pytest.mark.slow
def test_a_run_by_its_command_over_a_served_bus_is_that_of_the_process_to_the_bit(tmp_path, bench):
    for name in ("bus", "process"):
        (tmp_path / name).mkdir()
    (tmp_path / "robot.toml").write_text(file_text(ROBOT), encoding="utf-8")
    with EmulatorProcess(str(tmp_path / "robot.toml")) as served:
        steps = StepsOverBus(bench, 2, PathFiles(tmp_path / "bus"), served.address)
        over_bus = steps.run("none", is_learnt=False)
        with pytest.raises(CommandError, match=r"model.toml.*exit status \d") as refused:
            steps.design()
    assert refused.value.status == 3
    steps = StepsInProcess(bench, 2, PathFiles(tmp_path / "process"), DirectChannel(World(ROBOT)), Effort.quick())
    assert steps.run("none", is_learnt=False) == over_bus
    file = "none/runs/constant-acceleration-axis2-drive-none.csv"
    assert (tmp_path / "bus" / file).read_bytes() == (tmp_path / "process" / file).read_bytes()
    assert len(Recording.load(tmp_path / "bus" / file).time_s) > 50
    with pytest.raises(HilError, match="model"):
        steps.design()


def test_a_bench_file_and_a_robot_file_are_written_as_they_were_read(bench):
    assert loads(file_text(bench), Bench) == bench
    assert loads(file_text(ROBOT), Robot) == ROBOT
