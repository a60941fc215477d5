"""Drawn robots whose motor's torque does not tell whether the gear reacts on its motor: learning tells it by the tip."""

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from plant_emulator.rehearsal.many.one import BOTH, drawn
from plant_emulator.rehearsal.record import QUIET_MM
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.rehearsal.survey import Survey


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(50407, id="a linear gear that does not react: 0.0113 mm were left"),
        pytest.param(50440, id="a soft gear that reacts, of which the motor makes 1 % too little: 0.0185 mm were left"),
        pytest.param(50466, id="a soft gear that does not react: 0.0187 mm were left", marks=pytest.mark.slow),
    ],
)
def test_learning_tells_a_reaction_by_the_tip_and_silences_it(seed, tmp_path):
    robot, text = drawn(seed, BOTH)
    bench, files = loads(text, Bench, "blank bench"), PathFiles(tmp_path)
    number = min(bench.axis)
    steps = StepsInProcess(robot, bench, number, files)
    steps.plant()
    steps.ate()
    steps.learn()
    known = files.knowledge(is_learnt=True)
    assert known.learnt.axis[number].ate.gear_reaction == pytest.approx(float(robot.axis[number].gear_reaction), abs=0.2)
    tip = Survey(robot, bench, number).tip("cancellation_learnt", known)
    assert max(tip.values()) < QUIET_MM
