"""The design of a notch on the full physics: specification, Table 3, models that are off, what a drive takes and refuses."""

import dataclasses
import math

import numpy as np
import pytest

from drive_profiles.parameter_set.parameters import ParameterSet
from drive_profiles.standard.units import real32
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from hil.analysis import constant_acceleration_metrics
from hil.bench.bench import load_bench
from hil.bench.design import notch_table
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedPlant
from hil.control.notch import Notch
from hil.design.notch_design import verdict
from hil.design.notch_problem import Requirements
from hil.design.notch_search import Effort
from hil.errors import NotPossibleError
from hil.experiments.judge import axis_scale
from hil.experiments.notch_design import design, designed_axis, parameter_set, result_of
from hil.experiments.notch_problem import NotchDesignRequest, problem_of
from hil.recording import Recording
from hil.robot_tables import Control, PlantTable
from plant_emulator.robots.robot import load_robot
from plant_emulator.studies.simulate import simulate
from tests.drive_profiles.world_bus import WorldBus, robot_with

BENCH, ROBOT = load_bench("reference"), load_robot("reference")
CONTROLS = {number: Control(**axis.control.model_dump()) for number, axis in BENCH.axis.items()}
SCALE = {number: axis_scale(BENCH, number) for number in (2, 3)}
TABLE_3 = {number: BENCH.axis[number].notch[0].notch() for number in (2, 3)}
DESIGNED = {
    2: Notch(start_rps=3.799, end_rps=10.1, offset_hz=2.62, zeta_rn=0.0288, zeta_rdth=0.182, speed_lowpass_hz=6.76),
    3: Notch(start_rps=3.94, end_rps=9.298, offset_hz=2.876, zeta_rn=0.0593, zeta_rdth=0.285, speed_lowpass_hz=7.1),
}
"""What `hil design notch --bench reference --axis N` gives."""


def tip_peak_mm(number, notches, order=2, robot=ROBOT):
    """Of the constant-acceleration run of the emulated robot, friction, gravity and encoder on."""
    # the bench file's table, which the emulator reads like its own; that one has no slopes
    run = simulate(robot, number, controls=CONTROLS, notches={number: tuple(notch_table(notch) for notch in notches)})
    columns = {"time_s": run.time_s, "tip_z_m_s2": run.tip_acceleration_m_s2[:, 2]}
    columns[f"axis{number}_position_rad"] = run.position_counts[:, 0] * 2.0 * math.pi / ROBOT.axis[number].encoder_counts_per_rev
    return constant_acceleration_metrics(Recording(columns), number, order, SCALE[number]).tip_peak_mm


def off(stiffness, inertia):
    """A model file of a plant that is not quite the robot's."""
    axes = {}
    for number in (2, 3):
        values = BENCH.axis[number].model.model_dump(exclude={"ate"})
        values["gear_stiffness_nm_rad"] *= stiffness
        values["arm_inertia_kg_m2"] *= inertia
        plant = IdentifiedPlant(values=PlantTable(**values), antiresonance_hz=12.0, resonance_hz=22.0, damping=0.02)
        axes[number] = IdentifiedAxis(plant=plant)
    return Identified(robot="reference", axis=axes)


@pytest.mark.parametrize("number", [2, 3])
def test_what_the_simulation_of_the_design_predicts_is_what_the_full_physics_shows(number):
    problem, _ = problem_of(BENCH, NotchDesignRequest(number))
    for notches in ((), (TABLE_3[number],), (DESIGNED[number],)):
        predicted = problem.peaks_mm(problem.members[0], notches)[0, problem.row(2), 0]
        assert tip_peak_mm(number, notches) == pytest.approx(predicted, rel=0.05)


@pytest.mark.parametrize("number", [2, 3])
def test_the_designed_filter_lowers_table_3s_peak_by_15_percent_and_more(number):
    """0.046 → 0.035 mm (axis 2), 0.045 → 0.033 mm (axis 3)."""
    paper, ours = (tip_peak_mm(number, (notch,)) for notch in (TABLE_3[number], DESIGNED[number]))
    assert paper <= 0.05
    assert ours <= 0.85 * paper


@pytest.mark.ci
@pytest.mark.parametrize("number", [2, 3])
def test_it_keeps_all_margins_at_every_speed_for_every_plant(number):
    problem, _ = problem_of(BENCH, NotchDesignRequest(number))
    found = verdict(problem, (DESIGNED[number],), (2,))
    assert found.holds
    values = {check.name: check.value for check in found.checks}
    assert values["M_s"] <= 1.7
    assert values["phase margin"] >= 35.0
    assert values["gain margin"] >= 6.0
    assert len(found.margins) > 120


@pytest.mark.parametrize("number", [2, 3])
def test_table_3_is_reproduced_when_it_is_given(number):
    outcome = design(BENCH, NotchDesignRequest(number, is_given=True, uncertainty_percent=0.0))
    assert outcome.failure is None
    assert outcome.given.holds
    assert outcome.designed is None
    assert outcome.best.notches == (TABLE_3[number],)
    row, bare = outcome.best.peak(2), outcome.none.peak(2)
    assert bare.rising_mm > 0.07
    assert row.rising_mm == pytest.approx({2: 0.0461, 3: 0.0446}[number], abs=0.0005)
    line = {check.name: check for check in outcome.none.checks}["|G_al| on the line over constraint (5), k = 2,"]
    assert line.value > 1.0
    result = result_of(outcome)
    assert result.given.notch[0].zeta_rn == TABLE_3[number].zeta_rn
    assert result.feasible is True


def test_where_no_filter_keeps_all_the_reason_is_said_with_how_close_the_best_came():
    tiny = Effort(8, 2, 5, 1)
    request = NotchDesignRequest(
        2, shapes=("switched",), requirements=Requirements(gain_margin_db=20.1), effort=tiny, uncertainty_percent=0.0
    )
    outcome = design(BENCH, request)
    assert outcome.failure.exit_code == 9
    said = str(outcome.failure)
    assert said.startswith("axis 2: no switched filter of order 2 meets every requirement; the best one violates: ")
    assert "at least 20.1 dB required" in said
    assert not outcome.is_usable
    bare = design(BENCH, dataclasses.replace(request, requirements=Requirements(max_sensitivity=1.2)))
    assert str(bare.failure).startswith("axis 2: the gains violate the requirements even without a filter: M_s 1.3")
    late = design(BENCH, dataclasses.replace(request, requirements=None, period_s=1e-3, delay_samples=1))
    assert "even without a filter" in str(late.failure)


@pytest.mark.parametrize(
    ("changes", "request_changes", "said"),
    [
        ({"model": None}, {}, "axis 2 has no model"),
        ({}, {"axis": 4}, "has no axis 4"),
        ({}, {"orders": (3,)}, "of order 3 is not known"),
        ({}, {"orders": (9,)}, "no filter of order 9"),
        ({}, {"orders": (1, 2, 4)}, "3 orders; an axis has 2"),
        ({"ate": {"a2_arcsec": 5.0, "phi2_deg": 0.0}}, {"orders": (4,)}, "of order 4 is not known"),
        ({"ramp": None}, {}, "no constant_acceleration"),
    ],
)
def test_what_a_design_needs_is_asked_for(changes, request_changes, said):
    bench, table = BENCH, BENCH.axis[2]
    if "model" in changes:
        table = table.model_copy(update={"model": None})
    if "ate" in changes:
        ate = type(table.model.ate)(**changes["ate"])
        table = table.model_copy(update={"model": table.model.model_copy(update={"ate": ate})})
    if "ramp" in changes:
        bench = bench.model_copy(update={"constant_acceleration": None})
    bench = bench.model_copy(update={"axis": {**bench.axis, 2: table}})
    with pytest.raises(NotPossibleError, match=said):
        problem_of(bench, NotchDesignRequest(**{"axis": 2, **request_changes}))


def test_the_parameter_set_goes_into_an_emulated_drive(tmp_path):
    problem, f_al = problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=0.0))
    both = (DESIGNED[2], Notch(order=4, start_rps=1.6, end_rps=3.2, offset_hz=0.3, zeta_rn=0.05, zeta_rdth=0.1))
    found = verdict(problem, both, (2,))
    path = tmp_path / "notch-axis2.toml"
    parameter_set(BENCH, 2, found, f_al).save(path)
    loaded = ParameterSet.load(path)
    assert loaded.header.profile == "emulated_drive"
    assert loaded.header.node_id == 2
    assert "M_s 1." in loaded.header.title
    bus = WorldBus(robot_with())
    made = [Upload(bus.device(2, "emulated_drive"), loaded, UploadOptions(journals=tmp_path / "j"))]
    fleet.prepare(made)
    [outcome] = fleet.run(made)
    assert outcome.kind == "done", outcome
    dictionary = bus.world.drives[2].slave.dictionary
    for index, notch in zip((0x2110, 0x2111), both, strict=True):
        held = [dictionary.get(index, sub) for sub in range(1, 11)]
        assert held == [real32(value) if isinstance(value, float) else value for value in vars(notch).values()]


def test_one_filter_switches_the_drives_other_one_off():
    problem, f_al = problem_of(BENCH, NotchDesignRequest(3, uncertainty_percent=0.0))
    made = parameter_set(BENCH, 3, verdict(problem, (TABLE_3[3],), (2,)), f_al)
    assert made.tuning["notch_2.mode"].value == 0
    assert made.tuning["notch_1.mode"].value == 1


def test_a_drive_without_a_notch_that_follows_the_speed_gets_no_set():
    table = BENCH.axis[2].model_copy(update={"profile": "kollmorgen_akd"})
    bench = BENCH.model_copy(update={"axis": {**BENCH.axis, 2: table}})
    problem, f_al = problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=0.0))
    with pytest.raises(NotPossibleError, match="no notch that follows the speed"):
        parameter_set(bench, 2, verdict(problem, (TABLE_3[2],), (2,)), f_al)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "stiffness", "inertia"), [(2, 0.97, 1.02), (3, 1.03, 0.99)])
def test_designed_from_a_plant_that_is_1_to_3_percent_off_it_still_beats_table_3_by_15_percent(number, stiffness, inertia):
    outcome = design(BENCH, NotchDesignRequest(number, effort=Effort.quick(), jobs=2), off(stiffness, inertia))
    assert outcome.failure is None
    kept = designed_axis(outcome)
    assert kept.sensitivity_peak <= 1.7
    assert kept.phase_margin_deg >= 35.0
    assert tip_peak_mm(number, outcome.best.notches) <= min(0.05, 0.85 * tip_peak_mm(number, (TABLE_3[number],)))
    # and the true loop, which the design did not know, keeps what was promised; of order 4, which got no filter, a little less
    problem, _ = problem_of(BENCH, NotchDesignRequest(number, uncertainty_percent=0.0))
    checks = verdict(problem, outcome.best.notches, (2,)).checks
    assert [check.name for check in checks if not check.holds and not check.is_rise] == []
    assert max(check.value for check in checks if check.is_rise) < 1.15


@pytest.mark.slow
def test_a_filter_of_either_order_lowers_both_peaks():
    outcome = design(BENCH, NotchDesignRequest(3, orders=(2, 4), effort=Effort.quick(), jobs=2))
    assert outcome.failure is None
    assert [notch.order for notch in outcome.best.notches] == [2, 4]
    assert tip_peak_mm(3, outcome.best.notches, 4) < 0.95 * tip_peak_mm(3, (), 4)
    assert tip_peak_mm(3, outcome.best.notches, 2) <= 0.85 * tip_peak_mm(3, (TABLE_3[3],), 2)


@pytest.mark.parametrize("number", [2, 3])
def test_without_a_transmission_error_the_designed_filter_adds_no_vibration_that_matters(number):
    ate = type(ROBOT.axis[number].ate)(a2_arcsec=0.0, phi2_deg=0.0)
    axis = ROBOT.axis[number].model_copy(update={"ate": ate})
    quiet = ROBOT.model_copy(update={"axis": {**ROBOT.axis, number: axis}})
    bare, filtered = (tip_peak_mm(number, notches, robot=quiet) for notches in ((), (DESIGNED[number],)))
    assert np.isfinite(filtered)
    assert filtered - bare <= 0.01


def scaled(factor, **ate):
    """The bench with an axis 2 that is another robot's: all its frequencies and speeds times a factor, Table 3 left as it is."""
    table = BENCH.axis[2]
    model, control, limits = table.model, table.control, table.limits
    by_power = {"motor_damping_nm_s_rad": 1, "arm_damping_nm_s_rad": 1, "gear_stiffness_nm_rad": 2, "gear_damping_nm_s_rad": 1}
    plant = {name: getattr(model, name) * factor**power for name, power in by_power.items()}
    error = model.ate.model_copy(update=ate)
    gains = {"position_gain_per_s": 1, "velocity_gain_nm_s_rad": 1, "velocity_integral_gain_nm_rad": 2, "lowpass_hz": 1}
    axis = table.model_copy(
        update={
            "model": model.model_copy(update={**plant, "ate": error}),
            "control": control.model_copy(update={name: getattr(control, name) * factor**power for name, power in gains.items()}),
            "limits": limits.model_copy(update={"speed_rps": limits.speed_rps * factor, "torque_nm": 7.1 * factor**2}),
        }
    )
    ramp = BENCH.constant_acceleration.model_copy(update={"acceleration_rps_s": 4.0 * factor**2})
    return BENCH.model_copy(update={"reference": None, "axis": {2: axis}, "constant_acceleration": ramp})


@pytest.mark.ci
@pytest.mark.parametrize("factor", [pytest.param(0.34, marks=pytest.mark.slow), 2.53])
def test_a_robot_of_4_or_30_hertz_gets_a_filter_at_its_own_speeds(factor):
    """Table 3 is for 12 Hz: at 4 Hz it acts beyond the resonance, at 30 Hz below it, and helps neither."""
    request = NotchDesignRequest(2, shapes=("trapezoid",), effort=Effort(10, 1, 5, 1), uncertainty_percent=0.0)
    outcome = design(scaled(factor), dataclasses.replace(request, period_s=250e-6 / factor))
    assert outcome.is_usable
    (notch,), resonant = outcome.best.notches, outcome.f_al_hz / 2.0
    assert notch.start_rps < 0.765 * resonant < 1.27 * resonant < notch.end_rps < 1.8 * resonant
    # after a tenth of the usual search
    assert outcome.best.peak(2).rising_mm < 0.9 * outcome.none.peak(2).rising_mm
    assert outcome.best.peak(2).rising_mm < 0.9 * outcome.given.peak(2).rising_mm


def test_an_order_that_the_speed_limit_keeps_from_the_resonance_is_said_to_need_nothing():
    with pytest.raises(NotPossibleError, match=r"order 1 meets f_al = 11.84 Hz at 11.84 rev/s, beyond .* nothing to suppress"):
        problem_of(scaled(1.0, a1_arcsec=5.0), NotchDesignRequest(2, orders=(1,)))
    problem, _ = problem_of(scaled(1.0, a1_arcsec=5.0), NotchDesignRequest(2, orders=(1, 2)))
    assert problem.orders == (2, 4)
    bench = scaled(1.0, a1_arcsec=5.0)
    limits = bench.axis[2].limits.model_copy(update={"speed_rps": 18.0})
    faster = bench.model_copy(update={"axis": {2: bench.axis[2].model_copy(update={"limits": limits})}})
    problem, f_al = problem_of(faster, NotchDesignRequest(2, orders=(1,)))
    assert problem.orders == (1, 2, 4)
    assert problem.ramps[0].top_rps > 1.27 * f_al


@pytest.mark.ci
def test_where_no_filter_is_better_than_none_none_is_given(monkeypatch):
    """Every filter that is tried costs more than it gives: here because any rise of any peak is refused."""
    monkeypatch.setattr("hil.design.notch_problem.RISE", 0.3)
    outcome = design(BENCH, NotchDesignRequest(2, shapes=("switched",), effort=Effort(6, 1, 5, 1), uncertainty_percent=0.0))
    assert not outcome.is_usable
    assert outcome.best.notches == ()
    assert outcome.failure.exit_code == 9
    assert "no filter of order 2 is an improvement" in str(outcome.failure)
    assert result_of(outcome).usable is False


@pytest.mark.ci
def test_the_best_filter_is_given_where_it_still_misses_the_limit_of_the_tip():
    request = NotchDesignRequest(
        2, shapes=("switched",), requirements=Requirements(tip_mm=0.02), effort=Effort(6, 1, 5, 1), uncertainty_percent=0.0
    )
    outcome = design(BENCH, request)
    assert outcome.is_usable
    assert "do not meet the limits of the tip" in str(outcome.failure)
    assert designed_axis(outcome).notch


def test_friction_and_gravity_of_the_model_file_are_held_against_the_motor():
    problem, _ = problem_of(BENCH, NotchDesignRequest(2))
    assert (problem.friction_nm, problem.gravity_nm, problem.is_gravity_known) == pytest.approx((0.02 * 7.1, 0.06 * 7.1, False))
    identified = off(1.0, 1.0).axis[2]
    plant = identified.plant.model_copy(update={"coulomb_friction_nm": 0.1, "gravity_moment_nm": -52.0})
    problem, _ = problem_of(BENCH, NotchDesignRequest(2), identified.model_copy(update={"plant": plant}))
    assert (problem.friction_nm, problem.gravity_nm, problem.is_gravity_known) == pytest.approx((0.1, 52.0 / 120.0, True))
    assert len(problem.peaks_mm(problem.members[0], ())) == 6


@pytest.mark.parametrize("percent", [None, 3.0])
def test_with_a_model_file_the_plants_are_3_percent_of_f_a_apart_at_least(percent):
    axis = off(1.0, 1.0).axis[2]
    errors = {"gear_stiffness_nm_rad": 1.0, "arm_inertia_kg_m2": 1e-4, "antiresonance_hz": 1e-3}
    axis = axis.model_copy(update={"plant": axis.plant.model_copy(update={"standard_error": errors})})
    problem, _ = problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=percent), axis)
    f_a = [member.plant.antiresonance_hz / problem.members[0].plant.antiresonance_hz for member in problem.members]
    assert min(f_a) <= 0.971
    assert max(f_a) >= 1.029
    with pytest.raises(ValueError, match="below the 3 %"):
        problem_of(BENCH, NotchDesignRequest(2, uncertainty_percent=0.5), axis)
