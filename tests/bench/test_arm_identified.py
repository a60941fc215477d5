"""The reference arm identified from a bench file that knows nothing: ramps that turn its joints little, learning, modes."""

import math
from pathlib import Path

import numpy as np
import pytest

from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedMode, IdentifiedPlant, load_identified
from hil.experiments.cancellation.correction import error_of
from hil.experiments.cancellation.learning import learn
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.master.session import Session
from hil.recording import BusLog
from hil.report.writer import write_report_of
from hil.robot_tables import PlantTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World


def believed() -> Bench:
    bench = load_bench("reference-arm")
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"answer_timeout_s": 0.05})})


def session_of(bench: Bench, robot: Robot) -> Session:
    return Session(bench, InProcessChannel(World(robot)), BusLog(None))


@pytest.mark.slow  # four passes of two axes
@pytest.mark.parametrize("axis", [2, 3])
def test_learning_on_an_arm_turns_its_joint_little_and_finds_the_error(axis: int) -> None:
    bench, robot = believed(), load_robot("reference-arm")
    inertia, turned = robot.axis[axis].motor_inertia_kg_m2, list[float]()
    with session_of(bench, robot) as session:
        session.bring_up()
        began = session.axes[axis].position_rad()

        def keep(_: int, result, __) -> None:  # type: ignore[no-untyped-def]
            turned.extend((result.recording.axis(axis, "position_rad") - began).tolist())

        learnt = learn(session, axis, passes=4, motor_inertia_kg_m2=inertia, keep=keep)
        ended = session.axes[axis].position_rad()
    joint_deg = np.degrees(np.array(turned)) / bench.axis[axis].reduction_ratio
    assert 8.0 < float(np.max(np.abs(joint_deg))) < 10.5
    assert abs(ended - began) < 0.1  # the next axis finds the arm in the same posture
    true, found = robot.axis[axis].ate, error_of(learnt.values())
    for order, amplitude in true.amplitudes_arcsec().items():
        assert found.amplitude_arcsec[order] == pytest.approx(amplitude, abs=0.35)
        apart = (found.phase_deg[order] - true.phases_deg()[order] + 180.0) % 360.0 - 180.0
        assert abs(math.radians(apart)) * amplitude < 0.35
    assert learnt.left_out == {}
    assert learnt.reduction_fraction > 0.85


TRUE_MODES_HZ = (10.44, 14.73, 36.00)
"""Of the arm in its plane at the line's start, all motors held: the eigenvalues of its mass matrix on its gears."""


@pytest.mark.slow  # a whole identification
def test_the_plant_of_an_arm_has_all_its_modes_and_the_motor_in_model_file_and_report(tmp_path: Path) -> None:
    bench, robot = believed(), load_robot("reference-arm")
    outcome = run_identify_plant(
        bench, PlantRequest(5), tmp_path, model=tmp_path / "model.toml", channel=InProcessChannel(World(robot))
    )
    assert outcome.failure is None
    assert any("several modes are visible: 10.4, 14.7, 36.0 Hz" in remark for remark in outcome.result.remarks)
    plant = load_identified(tmp_path / "model.toml").axis[5].plant
    assert plant is not None
    assert [mode.antiresonance_hz for mode in plant.modes] == pytest.approx(TRUE_MODES_HZ, rel=5e-3)
    assert sum(mode.inertia_kg_m2 for mode in plant.modes) == pytest.approx(0.16, rel=0.03)
    assert sum(mode.tip_part or 0.0 for mode in plant.modes) == pytest.approx(1.0)
    assert plant.values.motor_inertia_kg_m2 == pytest.approx(robot.axis[5].motor_inertia_kg_m2, rel=0.01)
    assert plant.antiresonance_hz == pytest.approx(14.73, rel=5e-3)  # the lowest that the tip shows well
    low, high = outcome.result.plan.travel_rev if outcome.result.plan is not None else (0.0, 0.0)
    assert high - low < 6.1
    page = write_report_of(tmp_path).read_text(encoding="utf-8")
    assert "Part of the tip" in page


def known_plant(inertia_kg_m2: float) -> IdentifiedPlant:
    """Axis 5's plant as its identification gives it, the inertia apart."""
    rows = ((10.41, 0.0354, 0.018, 0.114), (14.74, 0.0430, 0.055, 0.403), (35.98, 0.0503, 0.088, 0.483))
    modes = tuple(
        IdentifiedMode(antiresonance_hz=hz, resonance_hz=1.1 * hz, damping=zeta, inertia_kg_m2=size, tip_part=part)
        for hz, zeta, size, part in rows
    )
    values = PlantTable(
        motor_inertia_kg_m2=inertia_kg_m2, motor_damping_nm_s_rad=1e-5, arm_inertia_kg_m2=0.055, arm_damping_nm_s_rad=0.0,
        gear_stiffness_nm_rad=471.0, gear_damping_nm_s_rad=0.44,
    )  # fmt: skip
    return IdentifiedPlant(values=values, antiresonance_hz=14.74, resonance_hz=16.23, damping=0.043, modes=modes)


@pytest.mark.slow  # four passes
def test_an_axis_whose_leading_mode_is_not_the_arms_lowest_is_learnt_with_the_modes_of_its_plant() -> None:
    robot = load_robot("reference-arm")
    bench = believed().model_copy(update={"identification_travel_deg": 15.0})
    plant = known_plant(robot.axis[5].motor_inertia_kg_m2)
    known = Identified(robot=bench.name, axis={5: IdentifiedAxis(plant=plant)})
    with session_of(bench, robot) as session:
        session.bring_up()
        learnt = learn(session, 5, known, passes=4)
    found = error_of(learnt.values())
    assert found.amplitude_arcsec[2] == pytest.approx(10.0, abs=0.3)
    assert found.amplitude_arcsec[4] == pytest.approx(5.0, abs=0.3)
    assert found.phase_deg[2] == pytest.approx(40.0, abs=3.0)
    assert found.phase_deg[4] == pytest.approx(120.0, abs=3.0)
    assert learnt.left_out == {}
