"""The reaction of a gear on its motor, told from ramps of robots that have it and of such that have not."""

import math

import numpy as np
import pytest
from scipy import stats

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.design.ate.reaction import Reaction, Turning, gear_reaction
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.motion import ramps
from hil.experiments.ate.request import AteRequest, axis_knowledge, first_ramp
from hil.master.session import Session
from hil.recording import BusLog
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.world import World


def told(seed: int, kind: str, *, reacts: bool) -> Reaction | None:
    """Reaction of a drawn robot's gear, by one pass of ramps."""
    robot, text = drawn(seed, kind)
    bench = loads(text, Bench, "bench")
    axis = min(bench.axis)
    drawn_axis = robot.axis[axis].model_copy(update={"gear_reaction": reacts})
    robot = robot.model_copy(update={"axis": {**robot.axis, axis: drawn_axis}})
    knowledge, request = (
        axis_knowledge(bench, axis, model_of(robot, bench, axis, drawn_axis.ate), sensorless=False),
        AteRequest(axis),
    )
    assert knowledge.side is not None
    with Session(bench, InProcessChannel(World(robot), bitrate=robot.bus.bitrate), BusLog(None)) as session:
        session.bring_up()
        start_rev = session.axes[axis].position_rad() / (2.0 * math.pi)
        motion = ramps(bench, start_rev, first_ramp(bench, request, knowledge))
        recording = session.run(motion.motion, "none", "drive").recording
    turned = Turning(recording.axis(axis, "position_rad"), recording.axis(axis, "torque_nm"), recording.period_s)
    error = TransmissionError(drawn_axis.ate.amplitudes_arcsec(), drawn_axis.ate.phases_deg())
    return gear_reaction([turned], knowledge.side, error)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "kind"), [(109, "linear"), (110, "real"), (113, "linear"), (123, "linear")])
def test_a_gear_that_reacts_on_its_motor_is_told_from_one_that_does_not(seed: int, kind: str) -> None:
    with_it, without = told(seed, kind, reacts=True), told(seed, kind, reacts=False)
    assert with_it is not None
    assert with_it.probability() > 0.975
    assert with_it.value == pytest.approx(1.0, abs=max(0.05, 4.0 * with_it.standard_error))
    assert without is not None
    assert without.probability() < 0.5
    assert abs(without.value) < max(0.05, 4.0 * without.standard_error)


def test_a_gear_reacts_as_certainly_as_its_measurement_says() -> None:
    assert Reaction(1.0, 0.1).probability() > 0.999
    assert Reaction(1.4, 0.25).probability() > 0.999
    assert Reaction(-0.01, 0.08).probability() < 0.001
    assert Reaction(0.2, 0.08).probability() < 0.001
    assert 0.4 < Reaction(0.5, 0.5).probability() < 0.6
    assert 0.4 < Reaction(3.0, 20.0).probability() < 0.6
    odds = stats.norm.pdf(0.7, 1.0, math.hypot(0.3, 0.1)) / stats.norm.pdf(0.7, 0.0, 0.3)
    assert Reaction(0.7, 0.3).probability(0.2) == pytest.approx(0.25 * odds / (1.0 + 0.25 * odds))


def test_a_reaction_is_as_large_as_expected_between_a_gear_that_reacts_and_one_that_does_not() -> None:
    expected = {
        Reaction(1.4, 0.3): (1.04, 0.095),
        Reaction(0.9, 0.001): (0.9, 0.001),
        Reaction(1.2, 0.1): (1.1, 0.1 / math.sqrt(2.0)),
        Reaction(0.2, 0.08): (0.0, 0.08),
        Reaction(0.0, 50.0): (0.5, 0.51),
    }
    for measured, (value, error) in expected.items():
        found = measured.posterior()
        assert found.value == pytest.approx(value, abs=0.01)
        assert found.standard_error == pytest.approx(error, abs=0.01)


@pytest.mark.parametrize("measured", [Reaction(3.0, 0.1), Reaction(-1.0, 0.1), Reaction(0.4, 0.02), Reaction(-9.8, 2.3)])
def test_what_is_no_reaction_of_a_gear_is_not_believed(measured: Reaction) -> None:
    assert measured.posterior() == Reaction(0.5, 0.5)
    assert measured.posterior(0.9) == Reaction(0.9, pytest.approx(0.3))


def test_an_arm_without_a_load_shows_neither_a_reaction_nor_that_there_is_none() -> None:
    seen = told(111, "linear", reacts=True)
    assert seen is not None
    assert 0.025 < seen.probability() < 0.975
    assert seen.standard_error > 0.2


def test_a_motor_that_never_turns_tells_nothing() -> None:
    robot, text = drawn(109, "linear")
    bench = loads(text, Bench, "bench")
    axis = min(bench.axis)
    knowledge = axis_knowledge(bench, axis, model_of(robot, bench, axis, robot.axis[axis].ate), sensorless=False)
    assert knowledge.side is not None
    still = Turning(np.zeros(1000), np.zeros(1000), 0.001)
    assert gear_reaction([still], knowledge.side, TransmissionError({2: 5.0}, {2: 0.0})) is None
    assert gear_reaction([still], knowledge.side, TransmissionError({}, {})) is None
