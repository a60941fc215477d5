"""The transmission error over CAN, of a robot of which nothing is known: friction, gravity, encoder, a noisy accelerometer."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedPlant
from hil.errors import NotPossibleError
from hil.experiments.ate.checks import AteNotIdentifiedError
from hil.experiments.ate.identify import Identification, identify_on
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest, Goal, axis_knowledge, sensing_of
from hil.master.session import Session
from hil.recording import BusLog
from hil.report.writer import write_report_of
from hil.robot_tables import PlantTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot
from plant_emulator.world import World

TRUTH = {2: (5.0, 222.0, 3.0, 126.0), 3: (10.0, 262.0, 5.0, 306.0)}
ASKED = (2.0, 2.0, 3.0, 3.0)
"""A_2 in %, φ_2 in degrees, A_4 in %, φ_4 in degrees."""
ONE_PASS = Goal({1: 9.0, 2: 1.0, 4: 1.0}, {1: 180.0, 2: 90.0, 4: 90.0})


def noisy(robot: Robot, period_s: float, seed: int, **sensor: float) -> Robot:
    changes = {"noise_m_s2": 0.05, "resolution_m_s2": 0.01} | sensor
    accelerometer = robot.accelerometer.model_copy(update=changes)
    return robot.model_copy(update={"accelerometer": accelerometer, "seed": seed, "sync_period_s": period_s})


def ignorant(bench: Bench, period_s: float = 0.002) -> Bench:
    """The bench without any model of its axes."""
    axes = {number: table.model_copy(update={"model": None, "notch": ()}) for number, table in bench.axis.items()}
    bus = bench.bus.model_copy(update={"sync_period_s": period_s, "answer_timeout_s": 0.05})
    return bench.model_copy(update={"axis": axes, "bus": bus})


def identified(
    bench: Bench,
    robot: Robot,
    request: AteRequest,
    prepare: Callable[[InProcessChannel], None] = lambda channel: None,
) -> Identification:
    channel = InProcessChannel(World(robot))
    prepare(channel)
    with Session(bench, channel, BusLog(None)) as session:
        session.bring_up()
        known = axis_knowledge(bench, request.axis, None, sensorless=request.sensorless)
        return identify_on(session, request, known)


def off(found: Identification, axis: int) -> list[float]:
    """How far from the truth, in the units of ASKED."""
    error, (a2, phi2, a4, phi4) = found.estimate.error, TRUTH[axis]
    turns = [(error.phase_deg[k] - phi + 180.0) % 360.0 - 180.0 for k, phi in ((2, phi2), (4, phi4))]
    sizes = [100.0 * (error.amplitude_arcsec[k] / a - 1.0) for k, a in ((2, a2), (4, a4))]
    return [sizes[0], turns[0], sizes[1], turns[1]]


def late_by(channel: InProcessChannel, cycles: float) -> None:
    """Put the accelerometer's output off by so many SYNCs, between two of them by interpolation."""
    sensor = channel.world.accelerometer
    measure, history = sensor.measure, [(0.0, 0.0, 0.0)] * (int(cycles) + 2)

    def delayed() -> tuple[float, float, float]:
        history.append(measure())
        history.pop(0)
        share = cycles - int(cycles)
        first, second = history[-1 - int(cycles)], history[-2 - int(cycles)]
        x, y, z = ((1.0 - share) * a + share * b for a, b in zip(first, second, strict=True))
        return x, y, z

    sensor.measure = delayed


# -- what is reached ---------------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_everything_is_kept_of_an_identification(reference_bench: Bench, reference_robot: Robot, tmp_path: Path) -> None:
    bench = ignorant(reference_bench)
    channel = InProcessChannel(World(noisy(reference_robot, 0.002, 5)))
    outcome = identify_ate(bench, AteRequest(3, goal=ONE_PASS), tmp_path, channel=channel)
    assert outcome.failure is None
    assert outcome.not_restored == ()
    kept = json.loads((tmp_path / "result.json").read_text())
    assert kept["is_within_goal"]
    assert kept["known_before"]["source"] == "nothing"
    for entry in kept["passes"]:
        assert (tmp_path / entry["recording"]).is_file()
    part = outcome.part
    assert part is not None
    assert part.learnt_by == "identify"
    assert part.values.a2_arcsec == pytest.approx(10.0, rel=0.03)
    assert part.values.phi4_deg == pytest.approx(306.0, abs=3.0)
    assert abs(part.accelerometer_delay_s) < 3e-4
    assert set(part.standard_error) == {
        "a1_arcsec", "phi1_deg", "a2_arcsec", "phi2_deg", "a4_arcsec", "phi4_deg", "arm_hz", "damping", "accelerometer_delay_s",
    }  # fmt: skip
    text = write_report_of(tmp_path).read_text()
    for words in ("Transmission error of axis 3", "is identified", "Table 2", "Fig. 5", "Fig. 8", "delay of the accelerometer"):
        assert words in text


@pytest.mark.slow
def test_a_late_accelerometer_is_stated_and_does_no_harm(reference_bench: Bench, reference_robot: Robot) -> None:
    bench, request = ignorant(reference_bench, 0.001), AteRequest(2, goal=ONE_PASS)
    found = identified(bench, noisy(reference_robot, 0.001, 4), request, lambda channel: late_by(channel, 3.7))
    assert found.estimate.arm.delay_s == pytest.approx(3.7e-3, abs=3e-4)
    assert np.all(np.abs(off(found, 2)) < 1.5 * np.array(ASKED))


@pytest.mark.slow
def test_a_slow_pass_with_late_answers_says_the_same_over_frames(reference_bench: Bench, reference_robot: Robot) -> None:
    """Noise, a coarse encoder and late answers: the slower the pass, the less of its own motion a motor shows beside rounding."""
    axis = reference_robot.axis[2].model_copy(update={"encoder_counts_per_rev": 2**15})
    axis = axis.model_copy(
        update={"behaviour": axis.behaviour.model_copy(update={"tpdo_delay_us": 300.0, "tpdo_jitter_us": 200.0})}
    )
    robot = noisy(reference_robot, 0.002, 3, noise_m_s2=0.1).model_copy(update={"axis": {**reference_robot.axis, 2: axis}})
    found = identified(ignorant(reference_bench), robot, AteRequest(2, passes=3))
    assert len(found.passes) == 3
    assert found.passes[-1].ramps.trajectory.acceleration_rps_s <= 1.1
    for made in found.passes:
        assert made.estimate.motion_scale == pytest.approx(1.0, abs=0.05)
    assert np.all(np.abs(off(found, 2)) < 2.0 * np.array(ASKED))


@pytest.mark.ci
def test_without_an_accelerometer(reference_bench: Bench, reference_robot: Robot) -> None:
    bench = reference_bench.model_copy(update={"bus": reference_bench.bus.model_copy(update={"answer_timeout_s": 0.05})})
    found = identified(bench, noisy(reference_robot, 0.002, 4), AteRequest(2, sensorless=True, goal=ONE_PASS))
    assert np.all(np.abs(off(found, 2)) < 1.5 * np.array(ASKED))
    assert any("sensorless: A_k has the relative error of J_l, which comes from the bench file" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("axis", "period_s", "seeds"), [(2, 0.002, range(1, 6)), (3, 0.001, range(11, 16))])
def test_ten_seeds_keep_what_is_asked(
    reference_bench: Bench, reference_robot: Robot, axis: int, period_s: float, seeds: range
) -> None:
    bench = ignorant(reference_bench, period_s)
    found = [identified(bench, noisy(reference_robot, period_s, seed), AteRequest(axis)) for seed in seeds]
    assert all(each.is_good for each in found), "the standard errors are near what is asked, or reach it"
    away = np.array([off(each, axis) for each in found])
    assert np.all(np.abs(away) < ASKED), away
    assert max(abs(each.estimate.arm.delay_s) for each in found) < 3e-4
    claimed = np.mean([each.estimate.phase_error_deg[2] for each in found])
    # they hold what any spring gear may bend φ_k by, 0.1°, which does not scatter from seed to seed
    assert 0.5 < claimed / np.std(away[:, 1]) < 7.0, "the standard errors are what they say"


# -- what is refused, with its number ----------------------------------------------------------------------------------


def test_a_silent_accelerometer(reference_bench: Bench, reference_robot: Robot, tmp_path: Path) -> None:
    channel = InProcessChannel(World(noisy(reference_robot, 0.002, 1)))
    channel.passes = lambda frame: frame.can_id != 0x190
    outcome = identify_ate(ignorant(reference_bench), AteRequest(2), tmp_path, channel=channel)
    assert isinstance(outcome.failure, AteNotIdentifiedError)
    assert outcome.part is None
    assert "without the accelerometer" in (outcome.result.not_identified or "")
    assert "was not identified" in write_report_of(tmp_path).read_text()


def test_a_saturated_accelerometer(reference_bench: Bench, reference_robot: Robot) -> None:
    with pytest.raises(AteNotIdentifiedError, match=r"saturates at -0\.25 m/s²"):
        identified(ignorant(reference_bench), noisy(reference_robot, 0.002, 1, range_m_s2=0.25), AteRequest(2))


@pytest.mark.slow
def test_another_axis_moves(reference_bench: Bench, reference_robot: Robot) -> None:
    bench = ignorant(reference_bench)
    # the drive at axis 2's place is that of axis 3
    wrong = bench.axis[3].model_copy(update={"reduction_ratio": 120.0, "tip_lever_m": 0.7})
    bench = bench.model_copy(update={"axis": {2: wrong, 5: bench.axis[5]}})
    with pytest.raises(AteNotIdentifiedError, match=r"check that this is the axis that moved.* factor is 0\.6"):
        identified(bench, noisy(reference_robot, 0.002, 1), AteRequest(2))


@pytest.mark.slow
def test_noise_that_hides_everything(reference_bench: Bench, reference_robot: Robot) -> None:
    with pytest.raises(AteNotIdentifiedError, match="at least"):
        identified(ignorant(reference_bench), noisy(reference_robot, 0.002, 1, noise_m_s2=5.0), AteRequest(2))


@pytest.mark.ci
def test_a_ramp_that_ends_before_the_resonance(reference_bench: Bench, reference_robot: Robot) -> None:
    bench = ignorant(reference_bench)
    table = bench.axis[2]
    narrow = table.model_copy(
        update={"limits": table.limits.model_copy(update={"position_min_rev": -1.2, "position_max_rev": 1.2})}
    )
    bench = bench.model_copy(update={"axis": {**bench.axis, 2: narrow}})
    with pytest.raises(
        AteNotIdentifiedError, match=r"rev/s \(at least \d\.\d+ rev/s\); .* between its position limits there are 1\.4"
    ):
        identified(bench, noisy(reference_robot, 0.002, 1), AteRequest(2))


def test_without_a_plant_there_is_no_sensorless_result(reference_bench: Bench) -> None:
    with pytest.raises(NotPossibleError, match="hil identify plant finds them"):
        axis_knowledge(ignorant(reference_bench), 2, None, sensorless=True)
    with pytest.raises(NotPossibleError, match="has no axis 4"):
        axis_knowledge(reference_bench, 4, None, sensorless=False)


# -- what is known before ----------------------------------------------------------------------------------------------


def test_an_identified_plant_is_a_start_and_its_inertia_widens_what_is_sensorless(reference_bench: Bench) -> None:
    model = reference_bench.axis[2].model
    assert model is not None
    values = PlantTable(**model.model_dump(exclude={"ate"}))
    plant = IdentifiedPlant(
        values=values, standard_error={"arm_inertia_kg_m2": 0.16}, antiresonance_hz=12.4, resonance_hz=22.0, damping=0.04
    )
    file = Identified(robot="reference").with_part(2, plant)
    known = axis_knowledge(ignorant(reference_bench), 2, file, sensorless=True)
    assert known.start is not None
    assert (known.start.resonance_hz, known.start.damping) == (12.4, 0.04)
    assert known.start.gear_fraction == pytest.approx(42.0 / 48.0)
    assert known.arm_inertia_fraction == pytest.approx(0.02)
    assert known.source == "the model file"
    sensing = sensing_of(reference_bench, 2, known, sensorless=True)
    assert sensing.gain == pytest.approx(8.0 / 120.0)
    assert sensing.motor_inertia_kg_m2 == 2.6e-4
    with pytest.raises(NotPossibleError, match="the model file is of robot 'another'"):
        axis_knowledge(reference_bench, 2, file.model_copy(update={"robot": "another"}), sensorless=False)
