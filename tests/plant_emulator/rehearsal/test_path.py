"""The documented path on drawn robots: every step by the product, truth beside what it finds."""

import math
from types import SimpleNamespace

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.errors import HilError, InterruptedRunError
from hil.reporter import Reporter
from plant_emulator.rehearsal import path
from plant_emulator.rehearsal.estimates import facts_of, sensor_delay_s
from plant_emulator.rehearsal.path import PathOptions, run_path
from plant_emulator.rehearsal.probes import wrong_corrections, wrong_orders
from plant_emulator.rehearsal.record import COLUMNS, FACTS, PROBES, QUANTITIES, STEPS
from plant_emulator.rehearsal.steps import PathFiles, StepsInProcess
from plant_emulator.rehearsal.survey import Survey
from plant_emulator.rehearsal.truth import ratio_of_tips, true_f_al_hz
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import antiresonance_hz, draw
from plant_emulator.robots.robot import load_robot


def bench_of(robot):
    return loads(blank_bench(robot), Bench)


class Heard(Reporter):
    """Steps that were told."""

    def __init__(self):
        self.steps = []

    def step(self, text):
        self.steps.append(text)


class Refusing:
    """Steps that refuse, or break."""

    channel = SimpleNamespace(syncs=0)

    def __init__(self, error):
        self.error = error

    def __getattr__(self, name):
        def act(*_, **__):
            raise self.error

        return act


# -- truth


def test_f_al_of_a_robot_is_a_little_below_its_antiresonance():
    for seed in range(8):
        robot = draw(seed, kind="linear")
        f_al_hz, f_a_hz = true_f_al_hz(bench_of(robot), robot, 2), antiresonance_hz(robot.axis[2])
        assert 0.8 * f_a_hz < f_al_hz < 1.02 * f_a_hz


@pytest.mark.ci
def test_a_robot_without_an_error_is_at_its_floor_and_the_error_is_seen_in_each_order():
    robot = draw(2, kind="linear")
    survey = Survey(robot, bench_of(robot), 2)
    floor, none = survey.floor(), survey.tip("none", path.PathFiles(path.Path("nowhere")).knowledge(is_learnt=False))
    assert set(none) == {1, 2, 4}
    for order, tip in none.items():
        assert tip > 20.0 * floor[order]


def test_tips_below_two_micrometres_make_no_ratio():
    assert ratio_of_tips({2: 0.2, 4: 0.001}, {2: 0.1, 4: 0.00001}) == pytest.approx(2.0)
    assert ratio_of_tips({}, {2: 0.1}) is None


def test_the_low_pass_of_a_sensor_is_a_delay_of_slow_vibrations_and_a_longer_one_of_fast_ones():
    sensor = load_robot("reference").accelerometer.model_copy(update={"delay_s": 0.002, "lowpass_hz": 100.0})
    assert sensor_delay_s(sensor, 1.0) == pytest.approx(0.002 + 2.25e-3, rel=0.001)
    assert sensor_delay_s(sensor, 100.0) == pytest.approx(0.002 + 0.25 / 100.0)
    mounted = sensor.model_copy(update={"lowpass_hz": None, "mounting_resonance_hz": 100.0, "mounting_damping": 0.05})
    assert sensor_delay_s(mounted, 1.0) == pytest.approx(0.002, abs=1e-6)
    assert sensor_delay_s(mounted, 100.0) == pytest.approx(0.002 + (math.pi / 2.0 - math.atan(0.1)) / (200.0 * math.pi))


def test_every_fact_of_a_robot_is_told():
    robot = draw(3)
    assert set(facts_of(robot, bench_of(robot), 2)) == set(FACTS)


# -- wrong corrections


def test_wrong_corrections_are_wrong_in_the_order_that_they_name():
    robot = draw(4)
    true = robot.axis[2].ate
    made = wrong_corrections(robot, 2)
    assert set(made) == set(PROBES)
    for name, table in made.items():
        if name != "another_robot":
            assert wrong_orders(true, table) == {int(name.removeprefix("phi").removeprefix("a").split("_")[0])}, name
    assert wrong_orders(true, true) == set()
    assert wrong_orders(true, made["another_robot"])


# -- the walk


@pytest.mark.ci
def test_a_walk_in_which_everything_is_refused_is_told_step_by_step_and_raises_nothing(tmp_path, monkeypatch):
    robot, heard = draw(3, kind="linear"), Heard()
    monkeypatch.setattr(path, "StepsInProcess", lambda *_: Refusing(HilError("not today")))
    record = run_path(robot, bench_of(robot), tmp_path, PathOptions(with_probes=False), heard)
    assert tuple(record.steps) == STEPS
    assert {name: step.ended for name, step in record.steps.items()} == {
        "plant": "refused", "ate": "refused", "design": "skipped", "none": "refused", "notch": "refused",
        "notch_designed": "skipped", "cancellation": "skipped", "learn": "refused", "cancellation_learnt": "skipped",
    }  # fmt: skip
    assert record.steps["plant"].words == "not today"
    assert record.steps["cancellation"].words == "needs ate"
    assert heard.steps == ["plant", "ate", "none", "notch", "learn"]
    assert set(record.tips) == {"none", "notch"}  # the truth needs no step
    assert (record.end_treatment, record.worse) == ("none", ())
    assert tuple(record.row()) == COLUMNS


@pytest.mark.slow
def test_an_error_that_nobody_expected_is_a_crash_in_the_record(tmp_path, monkeypatch):
    robot = draw(3, kind="linear")
    monkeypatch.setattr(path, "StepsInProcess", lambda *_: Refusing(ZeroDivisionError("by zero")))
    record = run_path(robot, bench_of(robot), tmp_path, PathOptions(with_probes=False, with_design=False))
    assert (record.steps["plant"].ended, record.steps["plant"].error) == ("crashed", "ZeroDivisionError")
    assert (record.steps["design"].ended, record.steps["design"].words) == ("skipped", "not asked for")


def test_a_signal_ends_the_walk_and_is_no_fact_of_the_robot(tmp_path, monkeypatch):
    robot = draw(3, kind="linear")
    error = InterruptedRunError("interrupted by SIGTERM", all_disabled=True)
    monkeypatch.setattr(path, "StepsInProcess", lambda *_: Refusing(error))
    with pytest.raises(KeyboardInterrupt):
        run_path(robot, bench_of(robot), tmp_path)


@pytest.mark.slow
def test_the_whole_path_on_a_drawn_robot_finds_its_plant_and_says_how_every_step_ended(tmp_path):
    robot = draw(4, kind="linear")
    # searches and wrong corrections cost most, and have tests of their own
    record = run_path(robot, bench_of(robot), tmp_path / "walk", PathOptions(with_design=False, with_probes=False))
    assert tuple(record.steps) == STEPS
    assert not [name for name, step in record.steps.items() if step.ended == "crashed"]
    assert record.steps["plant"].is_done
    assert set(record.quantities) == set(QUANTITIES)
    for name in ("arm_inertia_kg_m2", "gear_stiffness_nm_rad", "antiresonance_hz"):
        quantity = record.quantities[name]
        assert quantity.estimate == pytest.approx(quantity.true, rel=0.05), name
    assert sorted(each.name for each in (tmp_path / "walk").iterdir() if each.is_dir()) == []
    assert record.simulated_s > 30.0


@pytest.mark.ci
@pytest.mark.parametrize("seed", [51396, 51502, 51664])
def test_more_runs_lower_what_one_wave_would_repeat(seed, tmp_path):
    """Slow arms with a coarse encoder, or a soft gear: four runs of one wave left K_g with errors of 7 to 13 %."""
    robot = draw(seed, kind="real")
    axis = robot.axis[min(robot.axis)]
    files = PathFiles(tmp_path)
    StepsInProcess(robot, bench_of(robot), min(robot.axis), files).plant()
    identified = files.identified()
    assert identified is not None
    found = identified.axis[min(robot.axis)].plant
    for name in ("motor_inertia_kg_m2", "arm_inertia_kg_m2"):
        assert abs(getattr(found.values, name) - getattr(axis, name)) < 3.0 * found.standard_error[name], name


@pytest.mark.ci
def test_an_arm_that_its_loop_damps_out_is_not_refused_for_its_cycle(tmp_path):
    """f_a is 20.5 Hz, and 8 ms show it; its |G_al| has no peak, and the end of the search, 49 Hz, was taken for f_al."""
    robot = draw(51750, kind="real")
    axis = min(robot.axis)
    steps = StepsInProcess(robot, bench_of(robot), axis, PathFiles(tmp_path))
    steps.plant()
    assert steps.ate() is None
    assert steps.run("cancellation", is_learnt=False).left_mm < 0.010
