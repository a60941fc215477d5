"""The same steps as commands over a served bus: they record what the functions in one process do."""

import math

import pytest

from drive_profiles.address import parse_address
from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.bench.model import load_identified
from hil.control.order_keys import amplitude_key, phase_key
from hil.emulator import EmulatorProcess
from hil.errors import HilError
from hil.recording import Recording
from hil.robot_tables import ORDERS, PlantTable
from plant_emulator.rehearsal.over_bus import CommandError, StepsOverBus
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.robots.blank_bench import blank_bench, file_text
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import Robot

DRAWN = draw(8, kind="linear")
QUIET = {
    number: axis.model_copy(update={"encoder": axis.encoder.model_copy(update={"noise_counts": 0.0})})
    for number, axis in DRAWN.axis.items()
}
ROBOT = DRAWN.model_copy(update={"axis": QUIET})
"""Without noise of the encoder, of which each control period draws: a served robot lives on between two commands."""
AMPLITUDES_AND_PHASES = [key(order) for order in ORDERS for key in (amplitude_key, phase_key)]


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
    steps = StepsInProcess(ROBOT, bench, 2, PathFiles(tmp_path / "process"))
    assert steps.run("none", is_learnt=False) == over_bus
    file = "none/runs/constant-acceleration-axis2-drive-none.csv"
    assert (tmp_path / "bus" / file).read_bytes() == (tmp_path / "process" / file).read_bytes()
    assert len(Recording.load(tmp_path / "bus" / file).time_s) > 50
    with pytest.raises(HilError, match="model"):
        steps.design()


def test_a_bench_file_and_a_robot_file_are_written_as_they_were_read(bench):
    assert loads(file_text(bench), Bench) == bench
    assert loads(file_text(ROBOT), Robot) == ROBOT


@pytest.mark.slow
def test_the_steps_over_a_served_bus_find_what_they_find_in_one_process(tmp_path):
    """Not to the bit: between two commands a served robot's noise goes on, and what differs is told by the standard errors."""
    bench = loads(blank_bench(ROBOT), Bench)
    left_out, found = {}, {}

    def steps_of(name, made):
        made.plant()
        made.ate()
        _, left_out[name], *_ = made.run("cancellation", is_learnt=False)
        found[name] = load_identified(tmp_path / name / "model.toml").axis[2]

    for name in ("bus", "process"):
        (tmp_path / name).mkdir()
    (tmp_path / "robot.toml").write_text(file_text(ROBOT), encoding="utf-8")
    with EmulatorProcess(str(tmp_path / "robot.toml"), ROBOT.bus.bitrate) as served:
        steps_of("bus", StepsOverBus(bench, 2, PathFiles(tmp_path / "bus"), served.address))
    steps_of("process", StepsInProcess(ROBOT, bench, 2, PathFiles(tmp_path / "process")))
    assert left_out["bus"] == left_out["process"]
    one, other = found["bus"], found["process"]
    beside = ("antiresonance_hz", "resonance_hz", "damping")
    pairs = [(name, one.plant, other.plant, False) for name in beside]
    pairs += [(name, one.plant, other.plant, True) for name in PlantTable.model_fields]
    pairs += [(name, one.ate, other.ate, True) for name in AMPLITUDES_AND_PHASES]
    for name, here, there, is_value in pairs:
        apart = abs(getattr(here.values if is_value else here, name) - getattr(there.values if is_value else there, name))
        assert apart < 5.0 * math.hypot(here.standard_error[name], there.standard_error[name]), name


class Missing(StepsOverBus):
    """Its design command ends with 9; what it has written by then is `writes`."""

    writes = ""

    def _hil(self, *arguments, out, may_miss=False):
        if self.writes:
            self._files.designs.write_text(self.writes, encoding="utf-8")
        raise CommandError(arguments, 9, "axis 2: the best filters do not meet the limits of the tip")


def test_a_design_that_was_written_all_the_same_is_noted_as_in_one_process(tmp_path, bench):
    steps = Missing(bench, 2, PathFiles(tmp_path), parse_address("local:/nowhere.sock"))
    with pytest.raises(CommandError, match="best filters"):
        steps.design()
    steps.writes = "robot = 'r'"
    assert steps.design() == "axis 2: the best filters do not meet the limits of the tip"
