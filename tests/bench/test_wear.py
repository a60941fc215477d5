"""A gear that wears, identified again and again on an emulated robot: its passport says so before the tip leaves its limit."""

from pathlib import Path

import pytest

from hil.bench.bench import load_bench
from hil.bench.model import Identified, load_identified
from hil.experiments.ate.on_bus import identify_ate
from hil.experiments.ate.request import AteRequest
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.passport.gather import gather
from hil.passport.store import add, read
from hil.passport.watch import trends
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.angle_lines import CoggingLine, EccentricityLine
from plant_emulator.robots.gear_change import ErrorChange
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

BEFORE = 6
"""Runs before the wear begins."""


GROWTH_PERCENT_H = 1500.0
"""Wear of years in minutes: a step of 3 % from one identification to the next, which takes the gear seven seconds of motion."""


def aged(seed: int, growth_percent_h: float = 0.0, a2_factor: float = 1.0) -> Robot:
    """The reference robot with a motor that cogs and a gear that knows direction and warmth, and wears."""
    robot = load_robot("reference")
    axis = robot.axis[2]
    change = ErrorChange(order=2, growth_percent_h=growth_percent_h, direction_percent=3.0, temperature_percent_k=0.3)
    worn = axis.model_copy(
        update={
            "ate": axis.ate.model_copy(update={"a2_arcsec": a2_factor * axis.ate.a2_arcsec}),
            "ate_change": (change,),
            "cogging": (CoggingLine(order=60, torque_nm=0.01), CoggingLine(order=4, torque_nm=0.01, phi_deg=50.0)),
            "eccentricity": (EccentricityLine(order=1, a_arcsec=20.0),),
        }
    )
    return robot.model_copy(update={"seed": seed, "axis": {**robot.axis, 2: worn}})


@pytest.mark.slow
def test_wear_is_alarmed_before_the_tip_leaves_its_limit(tmp_path: Path) -> None:
    """A_2 grows by the hour: before a fifth it is an alarm, and the cancellation of the new gear still keeps the tip then."""
    bench, passport = load_bench("reference"), tmp_path / "passport.sqlite"
    old = World(aged(99, GROWTH_PERCENT_H))
    alarmed: set[str] = set()
    for number in range(BEFORE + 12):
        world, folder = World(aged(1 + number)) if number < BEFORE else old, tmp_path / f"run-{number}"
        outcome = identify_ate(
            bench,
            AteRequest(2, passes=1),
            folder,
            channel=InProcessChannel(world, bitrate=world.robot.bus.bitrate, is_logged=False),
        )
        assert outcome.part is not None
        a2_arcsec = outcome.part.values.a2_arcsec
        if number == 0:
            new_arcsec = a2_arcsec
            Identified(robot=bench.name).with_part(2, outcome.part).save(tmp_path / "new.toml")
        assert add(passport, gather([folder]).runs) == 1
        alarmed = {trend.symbol for trend in trends(read(passport), {}) if trend.is_alarmed}
        if alarmed:
            break
    factor = a2_arcsec / new_arcsec
    assert (number >= BEFORE, alarmed) == (True, {"A_2"})
    assert 1.0 < factor < 1.2
    robot = aged(100, a2_factor=max(factor, 1.2))
    knowledge = Knowledge(identified=load_identified(tmp_path / "new.toml"))
    experiments = [Experiment("constant-acceleration", 2, "cancellation")]
    done = run_experiments(
        bench,
        experiments,
        tmp_path / "tip",
        knowledge=knowledge,
        channel=InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False),
    )
    assert all(run.within_spec for run in done.result.runs)
