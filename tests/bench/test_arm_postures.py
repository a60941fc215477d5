"""The reference arm in other postures: the way there and back, what is refused, and a plant that is identified in one."""

from pathlib import Path

import pytest

from hil.bench.bench import Bench, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedPlant, load_identified
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.on_bus import run_identify_plant
from hil.experiments.plant.posture import bring_to, check_posture, felt_posture, standing_deg
from hil.master.session import Session
from hil.recording import BusLog
from hil.robot_tables import PlantTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

ROBOT = load_robot("reference-arm")


def believed() -> Bench:
    bench = load_bench("reference-arm")
    return bench.model_copy(update={"bus": bench.bus.model_copy(update={"answer_timeout_s": 0.05})})


def known_plant() -> IdentifiedPlant:
    values = PlantTable(
        motor_inertia_kg_m2=1.2e-4, motor_damping_nm_s_rad=4e-4, arm_inertia_kg_m2=2.8, arm_damping_nm_s_rad=2.5,
        gear_stiffness_nm_rad=16170.0, gear_damping_nm_s_rad=13.5,
    )  # fmt: skip
    errors = {"antiresonance_hz": 0.02, "arm_inertia_kg_m2": 0.03}
    return IdentifiedPlant(values=values, standard_error=errors, antiresonance_hz=12.1, resonance_hz=19.0, damping=0.03)


def test_the_arm_goes_into_a_posture_joint_by_joint_and_stays_there_until_it_is_brought_back() -> None:
    wanted = {2: 20.0, 3: -100.0}
    with Session(believed(), InProcessChannel(World(ROBOT)), BusLog(None)) as session:
        session.bring_up()
        stood = standing_deg(session)
        assert list(stood.values()) == pytest.approx(list(ROBOT.arm.home_deg), abs=0.01)
        bring_to(session, wanted)
        there = standing_deg(session)
        bring_to(session, {number: stood[number] for number in reversed(list(wanted))})
        back = standing_deg(session)
    assert there == pytest.approx({**stood, **wanted}, abs=0.05)
    assert back == pytest.approx(stood, abs=0.05)


def test_a_posture_beyond_a_limit_is_refused_before_anything_moves() -> None:
    with pytest.raises(NotPossibleError, match=r"link 'upper arm' \(axis 2\) at 130° is outside of its range_deg, -90 to 120"):
        check_posture(believed(), {2: 130.0})
    with pytest.raises(NotPossibleError, match="has no axis 9"):
        check_posture(believed(), {9: 0.0})
    with pytest.raises(NotPossibleError, match=r"has no \[arm\]"):
        check_posture(load_bench("reference"), {2: 10.0})
    with Session(believed(), InProcessChannel(World(ROBOT)), BusLog(None)) as session:
        session.bring_up()
        stood = standing_deg(session)
        with pytest.raises(UnsafeRequestError):
            bring_to(session, {2: 100.0})  # within the link's range, beyond the motor's limits of position
        assert standing_deg(session) == pytest.approx(stood, abs=1e-9)


def test_a_plant_with_one_mode_is_felt_as_that() -> None:
    posture = felt_posture(known_plant(), {1: 0.0, 3: -90.0})
    assert posture.joints_deg == (0.0, -90.0)
    (mode,) = posture.mode
    assert (mode.antiresonance_hz, mode.inertia_kg_m2) == (12.1, 2.8)
    assert mode.standard_error == {"antiresonance_hz": 0.02, "inertia_kg_m2": 0.03}


@pytest.mark.slow  # a whole identification
def test_a_plant_in_a_posture_is_kept_beside_the_one_that_designs_use(tmp_path: Path) -> None:
    model = tmp_path / "model.toml"
    Identified(robot="reference arm", axis={3: IdentifiedAxis(plant=known_plant())}).save(model)
    request = PlantRequest(3, posture_deg={2: 44.0, 3: -61.0, 5: -100.0})
    outcome = run_identify_plant(believed(), request, tmp_path / "out", model=model, channel=InProcessChannel(World(ROBOT)))
    assert outcome.failure is None
    axis = load_identified(model).axis[3]
    assert axis.plant == known_plant()
    (posture,) = axis.posture
    assert posture.joints_deg == pytest.approx((0.0, 44.0, -61.0, 0.0, -100.0, 0.0), abs=3.0)
    dips = [mode.antiresonance_hz for mode in posture.mode]
    assert dips[:2] == pytest.approx((9.00, 18.93), rel=0.01)  # eigenvalues of the true mass matrix on its gears there
    assert sum(mode.inertia_kg_m2 for mode in posture.mode) == pytest.approx(2.21, rel=0.03)
