"""Masses of the reference arm from a model file with three postures: dips along the line, file and page, and what is refused."""

import json
import math
import re

import numpy as np
import pytest
from scipy import linalg
from typer.testing import CliRunner

from hil.arm.line import arm_line
from hil.arm.masses import mass_matrix
from hil.bench.bench import load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedMode, IdentifiedPosture, load_identified
from hil.cli.main import app
from hil.errors import NotPossibleError
from hil.experiments.arm_masses import ArmNotIdentifiedError, identify_arm
from hil.results.arm import ArmResult
from hil.results.files import load_result
from plant_emulator.robots.drawn_arms import draw_arm
from plant_emulator.robots.robot import load_robot
from tests.hil.design.coupled.test_masses import AXES, HOME, OTHERS, ROWS, true_modes, turned

BENCH = load_bench("reference-arm")


def model_file(postures=OTHERS, seed=1, axes=AXES, beside_deg=2.0):
    """As identifications write it; each about its own middle, a few degrees beside the posture that was asked for."""
    noise, found = np.random.default_rng(seed), {}
    for axis in axes:
        felt = []
        for posture in postures:
            joints = turned(posture)
            joints[ROWS[AXES.index(axis)]] += math.radians(beside_deg * noise.uniform(-1.0, 1.0))
            dips, inertias = true_modes(joints)
            own = inertias[AXES.index(axis)]
            modes = tuple(
                IdentifiedMode(
                    antiresonance_hz=hz * (1.0 + 0.002 * noise.standard_normal()), resonance_hz=1.2 * hz, damping=0.03,
                    inertia_kg_m2=max(1e-4, size + 0.005 * own.sum() * noise.standard_normal()),
                    standard_error={"antiresonance_hz": 0.001 * hz, "inertia_kg_m2": 0.003 * size},
                )
                for hz, size in zip(dips, own, strict=True)
                if size > 0.004 * own.sum()  # what a motor hardly feels is not found
            )  # fmt: skip
            felt.append(IdentifiedPosture(joints_deg=tuple(np.degrees(joints).tolist()), mode=modes, emulated=True))
        found[axis] = IdentifiedAxis(posture=tuple(felt))
    return Identified(robot=BENCH.name, axis=found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_three_postures_predict_the_dips_along_the_line_within_two_per_cent_and_within_their_errors(seed):
    result = identify_arm(BENCH, model_file(seed=seed))
    fractions, line_rad = arm_line(BENCH.arm, BENCH.line_motion).line.joints_along
    for row in result.line:
        true = true_modes(line_rad[int(np.argmin(np.abs(fractions - row.way_fraction)))])[0]
        off = np.array(row.dips_hz) - true
        assert np.all(np.abs(off) < 0.02 * true)
        assert np.all(np.abs(off) < 4.0 * np.array(row.standard_error_hz))
    assert len(result.line) == 21
    assert result.arm.dip_error < 0.01
    for axis, stiffness in zip(result.arm.axes, result.arm.stiffness_nm_rad, strict=True):
        assert stiffness == pytest.approx(load_robot("reference-arm").axis[axis].gear_stiffness_nm_rad, rel=0.03)


@pytest.mark.slow
def test_the_bench_files_bodies_are_held_against_what_was_measured():
    arm = load_robot("reference-arm").arm
    right = identify_arm(BENCH.model_copy(update={"arm": arm}), model_file())
    assert max(abs(row.measured_hz / row.bodies_hz - 1.0) for row in right.measured) < 0.02
    assert any(note.startswith("the bench file's bodies") and "; check that" not in note for note in right.notes)
    light = identify_arm(BENCH.model_copy(update={"arm": arm.model_copy(update={"payload": None})}), model_file())
    assert max(abs(row.measured_hz / row.bodies_hz - 1.0) for row in light.measured) > 0.2
    assert any("check that the bodies and the payload are those of this robot" in note for note in light.notes)


@pytest.mark.ci
def test_too_few_postures_are_refused_and_those_that_do_not_do_name_one_more():
    with pytest.raises(NotPossibleError, match=r"has 2 postures of an axis; at least 3 are needed"):
        identify_arm(BENCH, model_file(OTHERS[:2]))
    alike = ((0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (40.0, 0.0, 0.0))
    added = r" --posture-deg 2=-?\d+,3=-?\d+,5=-?\d+"
    with pytest.raises(ArmNotIdentifiedError, match="combinations of masses and gears; .*" + added):
        identify_arm(BENCH, model_file(alike, beside_deg=0.0))
    nearly = identify_arm(BENCH, model_file(alike))  # only what each joint turns about its posture tells the rest
    assert nearly.arm.dip_error > 0.03
    assert any(re.search("dips along the line are known to .* % only; .*" + added, note) for note in nearly.notes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("alike", [((0, 0, 0), (0, 20, 0), (0, 40, 0)), ((0, 0, 0), (0, 5, 5), (0, 10, 10))])
def test_postures_that_lie_close_end_in_the_right_masses_all_the_same(alike, seed):
    """From a linear fit of the joints' inertias they ended beside them, 5 to 15 % off, with errors of 0.5 to 4 %."""
    result = identify_arm(BENCH, model_file(alike, seed=seed))
    fractions, line_rad = arm_line(BENCH.arm, BENCH.line_motion).line.joints_along
    assert result.arm.misfit < 1.0
    for row in result.line:
        true = true_modes(line_rad[int(np.argmin(np.abs(fractions - row.way_fraction)))])[0]
        off = np.abs(np.array(row.dips_hz) - true)
        assert np.all(off < 4.0 * np.array(row.standard_error_hz) + 1e-3 * true)


@pytest.mark.ci
@pytest.mark.parametrize(("factor", "is_refused"), [(1.06, False), (1.2, True)])
def test_postures_that_contradict_each_other_are_said_to_and_refused_where_no_masses_explain_them(factor, is_refused):
    known = model_file()
    wrong = known.axis[2].posture[0].mode[0]
    modes = (wrong.model_copy(update={"antiresonance_hz": factor * wrong.antiresonance_hz}), *known.axis[2].posture[0].mode[1:])
    posture = known.axis[2].posture[0].model_copy(update={"mode": modes})
    axis = known.axis[2].model_copy(update={"posture": (posture, *known.axis[2].posture[1:])})
    said = "explain the measured modes.*: misfit of .* axes 1, 4, 6, which were not identified"
    if is_refused:
        with pytest.raises(ArmNotIdentifiedError, match=f"no masses {said}"):
            identify_arm(BENCH, known.model_copy(update={"axis": {**known.axis, 2: axis}}))
    else:
        result = identify_arm(BENCH, known.model_copy(update={"axis": {**known.axis, 2: axis}}))
        assert any(re.search(f"the masses do not {said}", note) for note in result.notes)


def test_axes_that_swing_along_and_were_not_identified_are_no_masses():
    """The drawn arm of seed 1 stands out of its plane at home: its axes 1, 4 and 6 swing with 2, 3 and 5."""
    robot = draw_arm(1)
    rows = [robot.links.axes.index(axis) for axis in AXES]
    gears = np.diag([robot.axis[axis].gear_stiffness_nm_rad for axis in robot.links.axes])
    found = {}
    for axis, row in zip(AXES, rows, strict=True):
        felt = []
        for posture in ((0.0, 0.0, 0.0), (30.0, 40.0, -35.0), (-25.0, 20.0, 40.0)):
            joints = robot.links.home_rad()
            joints[rows] += np.radians(posture)
            inertia = mass_matrix(robot.links, joints)
            squares, shapes = linalg.eigh(gears, inertia)
            own = (inertia @ shapes)[row] ** 2
            modes = tuple(
                IdentifiedMode(
                    antiresonance_hz=math.sqrt(squares[i]) / (2.0 * math.pi),
                    resonance_hz=100.0,
                    damping=0.03,
                    inertia_kg_m2=own[i],
                )
                for i in sorted(np.argsort(-own)[:3].tolist())
            )
            felt.append(IdentifiedPosture(joints_deg=tuple(np.degrees(joints).tolist()), mode=modes))
        found[axis] = IdentifiedAxis(posture=tuple(felt))
    bench = BENCH.model_copy(update={"arm": robot.links, "line_motion": None})
    with pytest.raises(ArmNotIdentifiedError, match="no masses explain the measured modes"):
        identify_arm(bench, Identified(robot=bench.name, axis=found))


def test_a_posture_that_is_measured_again_replaces_the_one_before():
    known = model_file()
    again = known.axis[2].posture[1].model_copy(update={"mode": known.axis[2].posture[1].mode[:1]})
    changed = known.with_posture(2, again)
    assert len(changed.axis[2].posture) == 3
    assert changed.axis[2].posture[-1] == again


def test_a_posture_that_is_no_list_of_angles_is_a_wrong_option():
    done = CliRunner().invoke(app, ["identify", "plant", "--bench", "reference-arm", "--axis", "2", "--posture-deg", "2:30"])
    assert done.exit_code == 2
    assert "--posture-deg 2:30: expected AXIS=ANGLE, such as 2=30" in done.output


@pytest.mark.ci
def test_the_command_writes_the_masses_into_the_model_file_and_a_page(tmp_path):
    model = tmp_path / "model.toml"
    model_file().save(model)
    assert load_identified(model) == model_file()
    done = CliRunner().invoke(
        app, ["identify", "arm", "--bench", "reference-arm", "--model", str(model), "--out", str(tmp_path / "arm"), "--json"]
    )
    assert done.exit_code == 0, done.output
    result = load_result(tmp_path / "arm", ArmResult, "an arm")
    assert json.loads(done.stdout)["kind"] == "identify-arm"
    assert load_identified(model).arm == result.arm
    assert result.arm.axes == AXES
    page = (tmp_path / "arm" / "report.html").read_text()
    assert "Resonances of the arm along its line" in page
    assert "emulated" in page
    assert any(row.way_fraction is not None for row in result.measured if abs(row.joints_deg[1] - math.degrees(HOME[1])) < 2.1)
