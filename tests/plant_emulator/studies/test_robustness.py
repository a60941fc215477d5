"""plant-emulator robustness: the run is `simulate`'s, the metric the report's; equal seeds give equal files on any cores."""

import csv
import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from drive_profiles.files.toml import FileError, load, loads
from hil.analysis import constant_acceleration_metrics, line_motion_metrics, tip_displacement_mm, tip_scale
from hil.bench.bench import load_bench
from hil.bench.design import DesignedAxis, Designs, notch_table
from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.design.frequency import Loop, margins
from hil.recording import Recording
from hil.robot_tables import Control
from plant_emulator.cli.main import app
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.robot import REFERENCE, load_robot
from plant_emulator.robots.tuning import REFERENCE_TUNING, Tuning, load_tuning, robot_tuning
from plant_emulator.studies import summary as robustness_summary
from plant_emulator.studies.closed_loop import frozen_laws, growth_per_s, linear_plant
from plant_emulator.studies.page import write_page
from plant_emulator.studies.robustness import RESULTS, Study, judge_all
from plant_emulator.studies.simulate import simulate
from plant_emulator.studies.spread import AXIS_UNKNOWNS, SENSOR_UNKNOWNS, PlantSpread, drawn, drawn_axis, drawn_sensor, nominal
from plant_emulator.studies.summary import document, draws_csv, influences, summarise
from plant_emulator.studies.tables import tables
from plant_emulator.trials.executors import DaskWorkers, ExecutorsRefusedError, LocalProcesses
from plant_emulator.trials.statistics import run_fraction

ROBOT, BENCH, TUNING = load_robot("reference"), load_bench("reference"), load_tuning("reference")
CONTROLS = {number: axis.control for number, axis in TUNING.axis.items()}
NOTCHES = {number: tuple(table.notch() for table in axis.notch) for number, axis in TUNING.axis.items()}
CLOSED = PlantSpread(**dict.fromkeys(PlantSpread.model_fields, 0.0))
"""Nothing is unknown."""


def study(axis=2, notches=NOTCHES, **changes):
    return Study(ROBOT, axis, CONTROLS, notches, **changes)


def as_recorded(made, trace):
    """What a master would have recorded."""
    columns = {"time_s": made.times, "tip_z_m_s2": trace.measured_m_s2}
    for column, number in enumerate(made.axes):
        per_rad = ROBOT.axis[number].encoder_counts_per_rev / (2.0 * math.pi)
        columns[f"axis{number}_position_rad"] = trace.run.position_counts[:, column] / per_rad
    return Recording(columns)


# ---- the run


@pytest.mark.parametrize("axis", [2, 3, None])
def test_a_run_of_the_robot_as_its_file_says_is_that_of_simulate_to_the_last_bit(axis):
    made = study(axis)
    found = made.run(*made.draw(-1))
    tables = {number: table.notch for number, table in TUNING.axis.items()}
    known = simulate(ROBOT, axis, controls=CONTROLS, notches=tables)
    assert np.array_equal(found.run.position_counts, known.position_counts)
    assert np.array_equal(found.run.arm_angle_rad, known.arm_angle_rad)
    assert np.array_equal(found.run.torque_nm, known.torque_nm)
    assert np.array_equal(found.run.tip_m_s2, known.tip_acceleration_m_s2)
    assert np.array_equal(made.set_points, known.reference_counts)


def test_a_drawn_plant_with_its_encoder_and_sensor_delay_is_that_of_simulate_too():
    made = study(3)
    plant, source = made.draw(4)
    assert plant.robot.axis[3].encoder.noise_counts > 0.0
    assert plant.robot.accelerometer.delay_s > 0.0
    # the noise of an axis begins from the seed and its number
    robot = ROBOT.model_copy(
        update={"axis": ROBOT.axis | plant.robot.axis, "accelerometer": plant.robot.accelerometer, "seed": plant.robot.seed}
    )
    known = simulate(robot, 3, controls=CONTROLS, notches={3: TUNING.axis[3].notch})
    found = made.run(plant, source).run
    assert np.array_equal(found.position_counts, known.position_counts)
    assert np.array_equal(found.sensed_m_s2, known.tip_acceleration_m_s2)
    assert not np.array_equal(found.sensed_m_s2, found.tip_m_s2)


def test_plants_have_noise_of_their_own_and_equal_indices_equal_noise():
    made = study()
    seeds = [made.draw(index)[0].robot.seed for index in (0, 1, 2)]
    assert len(set(seeds)) == 3
    assert seeds == [made.draw(index)[0].robot.seed for index in (0, 1, 2)]


def test_the_gains_and_filters_of_the_package_are_those_of_the_reference_bench():
    for number, axis in BENCH.axis.items():
        assert TUNING.axis[number].control.model_dump() == axis.control.model_dump()
        assert [table.notch() for table in TUNING.axis[number].notch] == [table.notch() for table in axis.notch]


def test_an_encoder_error_of_the_2nd_order_moves_the_arm_like_a_transmission_error():
    """E/N of it at the arm: 120 arcsec behind 120:1 are 1 arcsec of the 5 that are there."""
    made = study(2, {}, spread=CLOSED)
    plant, source = made.draw(-1)
    sensor = plant.robot.accelerometer.model_copy(update={"noise_m_s2": 0.0, "resolution_m_s2": 0.0})
    quiet = plant.robot.model_copy(update={"accelerometer": sensor})
    wrong = quiet.axis[2].model_copy(update={"encoder": MotorEncoder(error_2_arcsec=120.0, phase_2_deg=math.degrees(1.0))})
    bare = made.run(dataclasses.replace(plant, robot=quiet), source)
    other = made.run(dataclasses.replace(plant, robot=quiet.model_copy(update={"axis": {2: wrong}})), source)
    inside = made._window(bare)
    apart = tip_displacement_mm((other.run.tip_m_s2 - bare.run.tip_m_s2)[:, 2], 0.002, tip_scale(bare.f_al_hz))[inside]
    own = tip_displacement_mm(bare.run.tip_m_s2[:, 2], 0.002, tip_scale(bare.f_al_hz))[inside]
    assert 0.1 < np.max(np.abs(apart)) / np.max(np.abs(own)) < 0.3
    assert other.run.position_counts[0, 0] == bare.run.position_counts[0, 0]


# ---- the metrics


@pytest.mark.parametrize("index", [-1, 0, 1, 2])
@pytest.mark.parametrize("axis", [2, 3])
def test_tip_peak_and_rms_are_those_of_the_report(axis, index):
    made = study(axis)
    judged = made.judge(index)
    run = made.run(*made.draw(index))
    known = constant_acceleration_metrics(as_recorded(made, run), axis, 2, tip_scale(run.f_al_hz))
    assert judged["tip_peak_mm"] == pytest.approx(known.tip_peak_mm, rel=1e-9)
    assert judged["tip_rms_mm"] == pytest.approx(known.tip_rms_mm, rel=1e-9)


def test_a_plant_is_judged_by_its_own_f_al_and_not_by_the_robot_files():
    made = study()
    plants = [made.draw(index)[0] for index in range(6)]
    runs = [made.run(*made.draw(index)) for index in range(6)]
    for plant, run in zip(plants, runs, strict=True):
        axis = plant.robot.axis[2]
        near = math.sqrt(axis.gear_stiffness_nm_rad / axis.arm_inertia_kg_m2) / (2.0 * math.pi)
        assert run.f_al_hz == pytest.approx(near, rel=0.1)
    assert max(run.f_al_hz for run in runs) > 1.05 * min(run.f_al_hz for run in runs)


def test_the_line_motions_metrics_are_those_of_the_report():
    made = study(None)
    judged = made.judge(0)
    runs = [made.runs([made.draw(0)], filters)[0] for filters in ({}, None)]
    bare, filtered = (line_motion_metrics(as_recorded(made, run), 0.2, 2.2, tip_scale(run.f_al_hz)) for run in runs)
    assert judged["tip_peak_mm"] == pytest.approx(filtered.tip_peak_mm, rel=1e-9)
    assert judged["area_reduction_percent"] == pytest.approx(
        100.0 * (1.0 - filtered.spectrum_area / bare.spectrum_area), rel=1e-9
    )
    assert study(None, {}).judge(0)["area_reduction_percent"] is None


@pytest.mark.parametrize("notches", [(), NOTCHES[2], (Notch(mode=NOTCH_TRAPEZOID), Notch(order=4, start_rps=2.0, end_rps=4.0))])
@pytest.mark.parametrize("gain", [1.0, 12.0])
def test_the_slowest_pole_is_the_designers(notches, gain):
    """At a gain twelve times too high the loop is unstable; both say so, and how fast it grows."""
    axis = ROBOT.axis[2]
    plant = linear_plant(axis)
    cascade = dataclasses.replace(CONTROLS[2].cascade(), velocity_gain_nm_s_rad=gain * 0.196)
    speeds = (0.0, 3.0, 4.5, 6.0, 8.5)
    loop = Loop(plant, cascade, notches)
    known = max(margins(loop, speed).pole_radius for speed in speeds)
    found = growth_per_s(axis, frozen_laws(loop, speeds), 250e-6)
    assert math.exp(250e-6 * found) == pytest.approx(known, abs=1e-9)
    assert (found > 0.0) == (gain > 1.0)


def test_soft_wind_up_hysteresis_and_a_slow_current_loop_count_at_the_poles():
    axis = ROBOT.axis[2]
    laws = frozen_laws(Loop(linear_plant(axis), CONTROLS[2].cascade()), [0.0])
    bare = growth_per_s(axis, laws, 250e-6)
    slow = growth_per_s(axis.model_copy(update={"current_time_constant_s": 30e-3}), laws, 250e-6)
    assert slow > 0.0 > bare
    soft = growth_per_s(axis.model_copy(update={"wind_up_softness": 0.9, "hysteresis_torque_nm": 20.0}), laws, 250e-6)
    assert soft > bare


# ---- stability


def test_a_gain_far_too_high_is_not_stable_and_says_why():
    control = CONTROLS[2].model_copy(update={"velocity_gain_nm_s_rad": 12.0 * 0.196})
    judged = dataclasses.replace(study(), controls={2: control}).judge(-1)
    assert judged["faults"]
    assert not judged["meets"]
    assert {"poles", "torque"} <= set(judged["faults"].split())
    assert judged["growth_per_s"] > 0.0


def test_a_motor_that_cannot_follow_is_not_stable():
    weak = ROBOT.model_copy(update={"axis": {2: ROBOT.axis[2].model_copy(update={"torque_limit_nm": 0.1})}})
    judged = Study(weak, 2, CONTROLS, {}).judge(-1)
    assert "following" in judged["faults"]
    assert math.isinf(judged["tip_peak_mm"]) or not judged["meets"]


@pytest.mark.parametrize("axis", [2, 3])
def test_the_reference_robot_breaks_the_specification_without_and_keeps_it_with_table_3(axis):
    bare, filtered = study(axis, {}).judge(-1), study(axis).judge(-1)
    assert not bare["faults"]
    assert not filtered["faults"]
    assert bare["tip_peak_mm"] > 0.065
    assert not bare["meets"]
    assert filtered["meets"]


def test_a_current_lag_shorter_than_the_solvers_step_is_none():
    made = study(spread=PlantSpread(current_time_constant_ms=0.02))
    assert all(made.draw(index)[0].robot.axis[2].current_time_constant_s == 0.0 for index in range(5))
    assert not made.judge(0)["faults"]


# ---- draws


def test_draws_stay_within_the_spread_on_both_sides():
    source = np.random.default_rng(1)
    rows = [drawn((*AXIS_UNKNOWNS, *SENSOR_UNKNOWNS), PlantSpread(), source) for _ in range(500)]
    stiffness = np.array([row["gear_stiffness_factor"] for row in rows])
    assert 1.0 / 1.15 <= stiffness.min() < 0.88
    assert 1.13 < stiffness.max() <= 1.15
    assert abs(np.mean(np.log(stiffness))) < 0.01
    assert 0.4 < np.mean([row["gear_reaction"] for row in rows]) < 0.6
    assert all(0.0 <= row["a1_arcsec"] <= 5.0 and -3.0 <= row["accelerometer_sensitivity_percent"] <= 3.0 for row in rows)


def test_nothing_unknown_and_the_nominal_values_are_the_robot_file():
    values = drawn(AXIS_UNKNOWNS, CLOSED, np.random.default_rng(1)) | {"phi1_deg": 0.0}
    for axis in ROBOT.axis.values():
        assert drawn_axis(axis, nominal(AXIS_UNKNOWNS)) == axis
        assert drawn_axis(axis, values) == axis
    made = study(spread=CLOSED)
    assert [unknown for unknown in made.unknowns if unknown.is_open(CLOSED)] == []


def test_closing_one_unknown_leaves_the_others_as_they_were():
    wide, narrow = (study(spread=PlantSpread(gear_stiffness_percent=p)).draw(3)[0].values for p in (15.0, 0.0))
    assert narrow["gear_stiffness_factor"] == 1.0 != wide["gear_stiffness_factor"]
    assert {name for name in wide if wide[name] != narrow[name]} == {"gear_stiffness_factor"}


def test_a_plant_of_the_line_is_that_of_the_single_axis():
    single, line = study(3).draw(7)[0], study(None).draw(7)[0]
    assert line.robot.axis[3] == single.robot.axis[3]
    assert line.values["axis3_a2_factor"] == single.values["a2_factor"]
    assert line.robot.accelerometer == single.robot.accelerometer


def test_what_a_robot_file_has_of_an_effect_is_added_to():
    axis = ROBOT.axis[2].model_copy(update={"hysteresis_torque_nm": 1.0, "wind_up_softness": 0.1, "gear_reaction": True})
    values = nominal(AXIS_UNKNOWNS) | {"hysteresis_arcsec": 10.0, "wind_up_softness": 0.2, "a1_arcsec": 3.0, "phi1_deg": 90.0}
    found = drawn_axis(axis, values)
    assert found.hysteresis_torque_nm == pytest.approx(1.0 + 0.5 * 48950.0 * 10.0 * math.pi / 180.0 / 3600.0)
    assert found.wind_up_softness == pytest.approx(0.3)
    assert found.gear_reaction is True
    assert (found.ate.a1_arcsec, found.ate.phi1_deg) == pytest.approx((3.0, 90.0))


def test_more_softness_than_there_is_stiffness_is_refused():
    soft = ROBOT.model_copy(update={"axis": {2: ROBOT.axis[2].model_copy(update={"wind_up_softness": 0.7})}})
    with pytest.raises(ValueError, match=r"wind_up_softness 1\.1 leaves no stiffness"):
        Study(soft, 2, CONTROLS, {})


def test_an_arm_is_refused_whose_axes_cannot_be_varied_one_by_one():
    with pytest.raises(ValueError, match=r"robot 'reference arm' has an \[arm\]"):
        Study(load_robot("reference-arm"), 2, CONTROLS, {})


@pytest.mark.parametrize(("axis", "controls", "said"), [
    (4, CONTROLS, "axis 4"),
    (2, {}, "axis 2 has no gains"),
    (2, {2: Control(position_gain_per_s=0.0, velocity_gain_nm_s_rad=0.2, velocity_integral_gain_nm_rad=4.0)}, "closes no loop"),
])  # fmt: skip
def test_what_cannot_be_run_is_refused(axis, controls, said):
    with pytest.raises(ValueError, match=said):
        Study(ROBOT, axis, controls, {})


# ---- what the runs say


def fake(values, results):
    rows = []
    for i, (row, result) in enumerate(zip(values, results, strict=True)):
        judged = (i, float(result), float(result), None, 0.1, 0.0, -1.0, "", bool(result <= 0.05))
        rows.append(dict(zip(RESULTS, judged, strict=True)) | row)
    return rows


def test_the_strongest_unknown_comes_first_and_what_is_unrelated_is_not_beyond_chance():
    made, source = study(), np.random.default_rng(2)
    values = [drawn(made.unknowns, made.spread, source) for _ in range(400)]
    results = np.array([0.04 + 0.05 * (row["a2_factor"] - 1.0) - 0.02 * (row["arm_inertia_factor"] - 1.0)
                        + 0.004 * math.cos(math.radians(row["phi4_deg"]) + 0.7) for row in values])  # fmt: skip
    found, explained = influences(made, fake(values, results), results)
    assert [each.name for each in found[:3]] == ["a2_factor", "phi4_deg", "arm_inertia_factor"] or found[0].name == "phi4_deg"
    by_name = {each.name: each for each in found}
    assert by_name["a2_factor"].correlation > 0.0 > by_name["arm_inertia_factor"].correlation
    assert {each.name for each in found if each.is_clear} == {"a2_factor", "phi4_deg", "arm_inertia_factor"}
    assert all(each.low <= each.correlation <= each.high for each in found)
    assert explained > 0.95
    assert by_name["a2_factor"].coefficient == pytest.approx(
        0.05 * np.std([r["a2_factor"] for r in values]) / np.std(results), rel=0.1
    )


@pytest.mark.ci
def test_runs_that_cannot_be_measured_are_the_worst_and_json_and_page_still_take_them(tmp_path):
    made, source = study(), np.random.default_rng(3)
    values = [drawn(made.unknowns, made.spread, source) for _ in range(100)]
    judged = fake(values, np.linspace(0.03, 0.06, 100))
    judged[7] |= {"tip_peak_mm": math.inf, "faults": "diverged", "meets": False}
    found = summarise(made, judged, judged[0])
    assert found.worst["index"] == 7
    assert found.stable.count == 99
    assert found.faults == {"diverged": 1}
    whole = json.loads(json.dumps(document(found), allow_nan=False))
    assert whole["worst"]["tip_peak_mm"] is None
    assert "inf" in draws_csv(found)
    page = write_page(tmp_path / "report.html", [(found, tables(found, "again"))]).read_text(encoding="utf-8")
    assert "Worst: plant 7 of seed 1" in page
    assert "∞" in page
    assert 'class="verdict bad"' in page


def test_shares_carry_wilsons_interval():
    """Brown, Cai and DasGupta (2001): 0 of 10 gives 0 to 0.2775; symmetric about a half."""
    assert run_fraction(0, 10).low == 0.0
    assert run_fraction(0, 10).high == pytest.approx(0.2775, abs=1e-4)
    half = run_fraction(50, 100)
    assert (half.low, half.high) == pytest.approx((0.4038, 0.5962), abs=1e-4)


def test_with_too_few_runs_nothing_is_said_about_influences():
    made = study()
    judged = [made.judge(index) for index in range(3)]
    found = summarise(made, judged, made.judge(-1))
    assert found.influences == ()
    assert found.explained is None
    assert draws_csv(found).count("\n") == 4
    assert {each.key for each in tables(found, "again")} == {"criteria-axis2", "judged-axis2", "plant-axis2"}


# ---- files


def test_a_bench_file_and_a_robot_file_are_tuning_files_too(tmp_path):
    bench = load_tuning(REFERENCE.parents[2] / "hil" / "bench" / "reference.toml")
    assert {n: a.control for n, a in bench.axis.items()} == CONTROLS
    text = REFERENCE.read_text().replace(
        "[axis.3]", "notch = { start_rps = 4.0, end_rps = 9.0, offset_hz = 0.5, zeta_rn = 0.03, zeta_rdth = 0.1 }\n\n[axis.3]", 1
    )
    (tmp_path / "robot.toml").write_text(text)
    assert load_tuning(tmp_path / "robot.toml").axis[2].notch[0].zeta_rn == 0.03
    assert robot_tuning(load_robot(tmp_path / "robot.toml"))[2].notch[0].zeta_rn == 0.03
    assert robot_tuning(ROBOT) == {}


def test_a_design_file_keeps_the_slopes_of_its_trapezoid(tmp_path):
    notch = Notch(mode=NOTCH_TRAPEZOID, ramp_rps=0.4, hysteresis_rps=0.0, speed_lowpass_hz=40.0)
    axis = DesignedAxis(
        notch=(notch_table(notch),), sensitivity_peak=1.6, phase_margin_deg=36.0, gain_margin_db=9.0, period_s=250e-6
    )
    Designs(robot="reference", axis={2: axis}).save(tmp_path / "design.toml")
    assert load_tuning(tmp_path / "design.toml").axis[2].notch[0].notch() == notch


@pytest.mark.parametrize(("text", "said"), [
    ("[[axis.2.notch]]\nstart_rps = 9.0\nend_rps = 4.0\noffset_hz = 0.5\nzeta_rn = 0.03\nzeta_rdth = 0.1\n", ":1: axis.2.notch"),
    ("[[axis.2.notch]]\nstart_rps = 4.0\nend_rps = -1\noffset_hz = 0.5\nzeta_rn = 0.03\nzeta_rdth = 0.1\n", ":3: axis.2.notch"),
    ("[axis.2.control]\nposition_gain_per_s = 1.0\nvelocity_gain_nm_s_rad = 1.0\n", "velocity_integral_gain_nm_rad: is missing"),
    ("name = 1\n", "axis: is missing"),
])  # fmt: skip
def test_a_wrong_tuning_file_is_located(text, said):
    with pytest.raises(FileError, match=said.replace(".", r"\.").replace("[", r"\[")):
        loads(text, Tuning)


def test_the_documented_spread_file_is_the_default(tmp_path):
    page = (REFERENCE.parents[2] / "docs" / "robustness.md").read_text(encoding="utf-8")
    block = page.split("```toml\n", 1)[1].split("```", 1)[0]
    (tmp_path / "spread.toml").write_text(block, encoding="utf-8")
    assert load(tmp_path / "spread.toml", PlantSpread) == PlantSpread()
    assert set(tomllib.loads(block)) == set(PlantSpread.model_fields)


def test_every_unknown_has_its_key_and_a_name_of_its_own():
    unknowns = (*AXIS_UNKNOWNS, *SENSOR_UNKNOWNS)
    assert {unknown.key for unknown in unknowns} == set(PlantSpread.model_fields)
    assert len({unknown.name for unknown in unknowns}) == len({unknown.label for unknown in unknowns}) == len(unknowns)
    assert REFERENCE_TUNING.exists()


# ---- the command


def command(*arguments):
    return CliRunner().invoke(app, ["robustness", *map(str, arguments)])


@pytest.mark.slow
def test_equal_seeds_give_equal_runs_whatever_the_number_of_processes():
    studies = [study(axis, seed=5) for axis in (2, 3)]
    told = []
    spread_out = judge_all(studies, 7, LocalProcesses(2), told.append)
    assert spread_out == [[one.judge(index) for index in range(7)] for one in studies]
    assert spread_out == judge_all(studies, 7, LocalProcesses(1))
    assert sum(told) == 14
    assert spread_out[0] != [study(seed=6).judge(index) for index in range(7)]


@pytest.mark.slow
def test_the_command_leaves_json_draws_and_a_page_and_the_worst_plant_can_be_run_again(tmp_path):
    found = command("--axis", "2,3", "--runs", 20, "--jobs", 1, "--seed", 5, "--out", tmp_path, "--json")
    assert found.exit_code == 0, found.output
    whole = json.loads(found.stdout)
    assert json.loads((tmp_path / "robustness.json").read_text()) == whole
    first = whole["studies"][0]
    assert (first["axis"], first["runs"], first["stable"]["count"]) == (2, 20, 20)
    assert len(first["influences"]) == len(AXIS_UNKNOWNS) + len(SENSOR_UNKNOWNS)
    with (tmp_path / "draws-axis2.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["index"]) for row in rows] == list(range(20))
    assert sum(int(row["meets"]) for row in rows) == first["meeting"]["count"]
    worst = max(rows, key=lambda row: float(row["tip_peak_mm"]))
    assert int(worst["index"]) == first["worst"]["index"]
    assert (tmp_path / "draws-axis3.csv").read_text().count("\n") == 21
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for axis in (2, 3):
        for key in ("figure", "criteria", "judged", "influences", "plant"):
            assert f'id="{key}-axis{axis}"' in page
    assert f"--axis 2 --seed 5 --only {worst['index']}</code> repeats it" in page
    assert "nothing on this page was measured on a real one" in page
    assert "<script" not in page
    assert "src=" not in page
    again = command("--axis", 2, "--seed", 5, "--only", worst["index"], "--json", "--out", tmp_path)
    run = json.loads(again.stdout)["runs"][0]
    assert run["tip_peak_mm"] == first["worst"]["tip_peak_mm"]
    assert run["values"] == first["worst"]["values"]
    signals = np.genfromtxt(tmp_path / f"run-axis2-{worst['index']}.csv", delimiter=",", names=True)
    assert {"time_s", "axis2_position_counts", "tip_z_m_s2", "measured_z_m_s2"} <= set(signals.dtype.names)


@pytest.mark.slow
def test_the_tables_say_shares_percentiles_influences_and_how_to_see_the_worst_again():
    found = command("--runs", 20, "--jobs", 1, "--axis", 3)
    assert found.exit_code == 0, found.output
    for words in ("meets the specification, tip peak ≤ 0.05 mm", "stable", "95 %", "rank correlation", "Worst: plant", "--only"):
        assert words in found.stdout
    assert "plants: 20 in" in found.stderr
    one = command("--axis", 3, "--only", 2)
    assert one.exit_code == 0
    assert "gear_stiffness_factor" in one.stdout
    assert "meets the specification" in one.stdout


@pytest.mark.ci
def test_the_line_motion_is_judged_by_its_area_with_filters_and_by_its_peak_without():
    assert "reduction of the area in %" in command("--experiment", "line-motion", "--runs", 2, "--jobs", 1).stdout
    bare = command("--experiment", "line-motion", "--treatment", "none", "--runs", 1, "--jobs", 1)
    assert "tip peak in mm" in bare.stdout


@pytest.mark.parametrize(("arguments", "code", "said"), [
    (["--runs", "0"], 2, "--runs"),
    (["--axis", "7"], 2, "no axis 7; it has 2, 3, 5"),
    (["--axis", "2,x"], 2, "comma-separated list"),
    (["--axis", "2,2"], 2, "axis 2 is given twice"),
    (["--axis", "5"], 2, "axis 5 has no filter"),
    (["--tip-mm", "-1"], 2, "--tip-mm"),
    (["--area-percent", "nan"], 2, "--area-percent"),
    (["--experiment", "line-motion", "--axis", "2"], 2, "all axes"),
    (["--treatment", "none", "--notch", "x.toml"], 2, "no filter"),
    (["--robot", "nowhere.toml"], 3, "nowhere.toml: cannot be read"),
    (["--spread", "nowhere.toml"], 3, "nowhere.toml: cannot be read"),
    (["--notch", "nowhere.toml"], 3, "nowhere.toml: cannot be read"),
])  # fmt: skip
def test_wrong_options_are_told_by_name(arguments, code, said):
    found = command(*arguments)
    assert found.exit_code == code, found.output
    assert said in found.stderr


@pytest.mark.parametrize(("text", "said"), [
    ("a2_percent = 10.0\ngear_stiffness_percent = -1.0\n", ":2: gear_stiffness_percent: found -1.0; expected at least 0"),
    ("gear_stifness_percent = 1.0\n", "did you mean gear_stiffness_percent"),
    ("wind_up_softness = 1.0\n", "less than 1"),
    ('a1_arcsec = "5"\n', "a number in arcsec"),
])  # fmt: skip
def test_a_wrong_spread_file_is_located(tmp_path, text, said):
    (tmp_path / "spread.toml").write_text(text)
    found = command("--spread", tmp_path / "spread.toml", "--runs", 1)
    assert found.exit_code == 3
    assert said in found.stderr


def test_a_robot_without_gains_is_told(tmp_path):
    (tmp_path / "robot.toml").write_text(REFERENCE.read_text())
    found = command("--robot", tmp_path / "robot.toml", "--treatment", "none", "--axis", 2)
    assert found.exit_code == 2
    assert "axis 2 has no gains" in found.stderr
    found = command("--robot", tmp_path / "robot.toml")
    assert "no axis has a filter" in found.stderr


@pytest.mark.ci
def test_a_place_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    found = command("--runs", 1, "--jobs", 1, "--axis", 2, "--out", tmp_path / "file" / "below")
    assert found.exit_code == 3
    assert "cannot be written" in found.stderr


def test_no_runs_are_refused():
    with pytest.raises(ValueError, match="at least 1 is needed"):
        judge_all([study()], 0, LocalProcesses(1))


@pytest.mark.wall
@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="process groups are POSIX")
def test_ctrl_c_ends_the_command_and_its_workers(tmp_path):
    arguments = [sys.executable, "-m", "plant_emulator", "robustness", "--axis", "2", "--runs", "5000", "--jobs", "2"]
    started = subprocess.Popen(arguments, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60.0
        while len(members(started.pid)) < 3 and time.monotonic() < deadline:  # itself and its workers
            time.sleep(0.05)
        os.killpg(started.pid, signal.SIGINT)
        said, wrong = started.communicate(timeout=30.0)
    finally:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()
    assert started.returncode == 130, wrong
    assert wrong.strip() == "interrupted"
    assert said == ""
    deadline = time.monotonic() + 10.0  # multiprocessing's tracker ends when it sees that its parent has gone
    while members(started.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert members(started.pid) == []


class Mortal:
    """A study whose process dies of plant 3."""

    def judge_some(self, indices):
        if 3 in indices:
            os.kill(os.getpid(), signal.SIGKILL)
        return [{"index": index} for index in indices]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
def test_the_plant_whose_process_dies_twice_ends_the_study_and_is_named():
    with pytest.raises(RuntimeError, match="plant 3: its process died 2 times"):
        judge_all([Mortal()], 40, LocalProcesses(1))


def members(group):
    """Living processes of a process group."""
    found = []
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            try:
                with open(f"/proc/{entry.name}/stat", encoding="utf-8") as file:
                    state, _, pgid = file.read().rpartition(")")[2].split()[:3]
            except OSError:
                continue
            if int(pgid) == group and state != "Z":
                found.append(int(entry.name))
    return found


@pytest.mark.slow
def test_of_a_thousand_plants_most_keep_the_specification_with_table_3():
    judged = judge_all([study()], 1000, LocalProcesses(2))[0]
    found = robustness_summary.summarise(study(), judged, study().judge(-1))
    assert found.stable.count == 1000
    assert found.meeting.share > 0.7
    assert found.influences[0].name == "gear_stiffness_factor"  # as docs/robustness-criteria.md has it for axis 2 with Table 3


def test_the_robots_own_sensor_delay_is_added_to_the_drawn_one():
    values = nominal(SENSOR_UNKNOWNS) | {"accelerometer_delay_ms": 2.0}
    late = drawn_sensor(ROBOT.accelerometer.model_copy(update={"delay_s": 0.003}), values)
    assert late.delay_s == pytest.approx(0.005)


def test_the_sensors_low_pass_and_mounting_are_those_of_the_emulated_robot():
    sensor = ROBOT.accelerometer.model_copy(update={"lowpass_hz": 90.0, "mounting_resonance_hz": 200.0})
    robot = ROBOT.model_copy(update={"accelerometer": sensor})
    found = Study(robot, 2, CONTROLS, NOTCHES)
    run = found.run(*found.draw(-1)).run
    known = simulate(robot, 2, controls=CONTROLS, notches={2: TUNING.axis[2].notch})
    assert np.array_equal(run.sensed_m_s2, known.tip_acceleration_m_s2)


def test_a_study_refuses_a_sensor_that_the_control_period_does_not_show():
    robot = ROBOT.model_copy(update={"accelerometer": ROBOT.accelerometer.model_copy(update={"lowpass_hz": 1900.0})})
    with pytest.raises(ValueError, match="lowpass_hz = 1900 is too high"):
        Study(robot, 2, CONTROLS, NOTCHES)


def test_a_scheduler_that_does_not_answer_is_all_that_is_said(monkeypatch):
    def refuse(self):
        raise ExecutorsRefusedError("tcp://127.0.0.1:1: no Dask scheduler answers")

    monkeypatch.setattr(DaskWorkers, "__enter__", refuse)
    done = CliRunner().invoke(app, ["robustness", "--runs", "2", "--axis", "2", "--on", "dask:tcp://127.0.0.1:1"])
    assert (done.exit_code, done.stderr) == (4, "tcp://127.0.0.1:1: no Dask scheduler answers\n")


def test_a_study_refuses_a_folder_that_it_cannot_write_before_it_simulates(tmp_path, monkeypatch):
    monkeypatch.setattr("plant_emulator.studies.robustness.judge_all", lambda *_: pytest.fail("it has simulated"))
    (tmp_path / "file").write_text("precious")
    done = CliRunner().invoke(app, ["robustness", "--axis", "2", "--out", str(tmp_path / "file")])
    assert done.exit_code == 3
    assert f"cannot be written: {tmp_path / 'file'} is a file; expected a folder" in done.stderr


def test_the_reference_robot_is_simulated_with_its_own_gains_and_filters(tmp_path):
    tips = []
    for name, option in (("with", "--notch"), ("without", "--no-notch")):
        out = tmp_path / f"{name}.csv"
        done = CliRunner().invoke(app, ["simulate", "--axis", "2", option, "--out", str(out)])
        assert done.exit_code == 0, done.output
        tips.append(np.genfromtxt(out, delimiter=",", names=True)["tip_z_m_s2"])
    assert np.ptp(tips[0]) < np.ptp(tips[1])
